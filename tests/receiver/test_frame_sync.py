"""Known heads against whole messages, and where they are found."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from deepgnss.core.time import GpsTime
from deepgnss.receiver.beidou_nav import encode_d1
from deepgnss.receiver.frame_sync import (
    d1_heads,
    expected_heads,
    find_frame,
    find_head,
    head_amplitudes,
    lnav_heads,
)
from deepgnss.receiver.lnav import encode_subframe
from deepgnss.receiver.messages import Bits
from deepgnss.sim.constellation import nominal

WEEK = 2290
NAV = nominal(GpsTime(WEEK, 0.0), 3600.0, "GC")
GPS, BDS = NAV.ephemerides["G07"][0], NAV.ephemerides["C21"][0]


def lnav_bits(tow_s: float, telemetry: int) -> Bits:
    number = int(tow_s) // 6 % 5 + 1
    return encode_subframe(GpsTime(WEEK, tow_s), number, GPS, telemetry=telemetry)


def agreement(signs: np.ndarray, bits: Bits) -> float:
    """Correlation of a head with the bits sent, 1 or −1: the same up to a common sign."""
    sent = 1.0 - 2.0 * bits[: signs.size]
    return float(signs @ sent) / float(np.abs(signs).sum())


@pytest.mark.parametrize("tow_s", [0.0, 6.0, 345_606.0, 604_794.0])
@pytest.mark.parametrize("telemetry", [0, 0x2C5B, 0xFFFF])
def test_lnav_heads_are_what_is_sent(tow_s: float, telemetry: int) -> None:
    bits = lnav_bits(tow_s, telemetry)
    for known, symbols in (((), 8), ((None, telemetry), 30), ((tow_s, telemetry), 52)):
        (head,) = lnav_heads(*known)
        assert np.count_nonzero(head.signs) == symbols
        assert agreement(head.signs, bits) == 1.0
    (head,) = lnav_heads(tow_s, telemetry, 0)
    assert np.count_nonzero(head.signs) == 60
    assert agreement(head.signs, bits) == 1.0
    # Without the telemetry message: one of the two signs of the hand-over word fits.
    pair = lnav_heads(tow_s)
    assert sorted(agreement(head.signs, bits) == 1.0 for head in pair) == [False, True]
    assert all(np.count_nonzero(head.signs) == 28 for head in pair)


@pytest.mark.parametrize("tow_s", [14.0, 20.0, 345_614.0, 2.0])
def test_d1_heads_are_what_is_sent(tow_s: float) -> None:
    bits = encode_d1(GpsTime(WEEK, tow_s), BDS)
    for known, symbols in ((None, 15), (tow_s, 46)):
        (head,) = d1_heads(known)
        assert np.count_nonzero(head.signs) == symbols
        assert agreement(head.signs, bits) == 1.0
    # A frame later it is another head.
    assert agreement(d1_heads(tow_s + 6.0)[0].signs, bits) < 1.0


def test_expected_heads_follow_the_clock() -> None:
    """Symbol 0 leaves 1 s into a subframe: the next one begins 250 symbols later."""
    heads = partial(lnav_heads, telemetry=5)
    (one,) = expected_heads(heads, 601.0, 0.5)
    assert one.head.start_tow_s == 606.0
    assert (one.first, one.stop) == (225, 276)
    wide = expected_heads(heads, 601.0, 3.0)
    assert [e.head.start_tow_s for e in wide] == [600.0, 606.0]
    assert [(e.first, e.stop) for e in wide] == [(0, 101), (100, 300)]
    (any_time,) = expected_heads(heads)
    assert (any_time.head.start_tow_s, any_time.first, any_time.stop) == (None, 0, 300)
    (late,) = expected_heads(d1_heads, 604_799.0, 0.5, zero_s=14.0)
    assert late.head.start_tow_s == 2.0  # of the next week
    assert late.first == 125


def _sums(bits: Bits, off_hz: float, snr: float, rng: np.random.Generator) -> np.ndarray:
    turn = np.exp(2j * np.pi * (off_hz * 0.02 * np.arange(bits.size) + rng.random()))
    noise = rng.normal(size=(bits.size, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5 / snr)
    return (1.0 - 2.0 * bits) * turn + noise


@pytest.mark.parametrize("off_hz", [0.0, -3.7, 7.5])
@pytest.mark.parametrize("skip", [0, 1, 113, 299])
def test_heads_are_found_where_they_are(off_hz: float, skip: int) -> None:
    rng = np.random.default_rng(skip)
    stream = np.concatenate([lnav_bits(6.0 * k, 0x2C5B) for k in range(7, 11)])
    sums = _sums(stream[skip:][:700], off_hz, 4.0, rng)
    heads = partial(lnav_heads, telemetry=0x2C5B)
    place = find_frame(sums, expected_heads(heads), expected_heads(heads))
    assert place is not None
    assert place.first == -skip % 300
    assert place.frequency_hz == pytest.approx(off_hz, abs=0.5)
    assert place.amplitude > place.runner_up
    tow_s = 42.0 + 0.02 * skip + 1.7  # the clock is off
    timed = [expected_heads(heads, tow_s + late_s) for late_s in (0.0, 6.0)]
    seen = find_frame(sums, *timed)
    assert seen is not None
    assert seen.first == -skip % 300
    assert seen.head.start_tow_s == (42.0 if skip == 0 else 48.0)


def test_noise_is_not_confirmed_and_too_few_sums_say_nothing() -> None:
    expected = expected_heads(d1_heads)
    agreed = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=700) + 1j * rng.normal(size=700)
        agreed += find_frame(noise, expected, expected) is not None
    assert agreed <= 1
    assert find_head(noise[:313], expected) is None
    assert find_head(noise[:314], expected) is not None


def test_no_frequency_falls_between_bins() -> None:
    """Against the sum at the frequency itself: at most 0.25 dB are lost, unpadded it is 3.9."""
    (head,) = lnav_heads(None, 0x2C5B)
    bits = lnav_bits(0.0, 0x2C5B)[:30]
    for off_hz in np.linspace(-7.0, 7.0, 41):
        turn = np.exp(2j * np.pi * off_hz * 0.02 * np.arange(30))
        amplitudes, frequencies_hz = head_amplitudes((1.0 - 2.0 * bits) * turn, head.signs)
        assert amplitudes.shape == (1,)
        assert 30.0 * 10 ** (-0.25 / 20.0) <= amplitudes[0] <= 30.0 + 1e-9
        assert abs(frequencies_hz[0] - off_hz) < 0.25
