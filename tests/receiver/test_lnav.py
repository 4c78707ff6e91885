"""LNAV: parity, round trips, frame search, and what a u-blox receiver handed on."""

import struct
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_sky import KLOBUCHAR, WHEN, sky

from deepgnss.core.errors import NumericalError
from deepgnss.core.records import Ephemeris, UtcParameters
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver import lnav

EPHEMERIS = sky().ephemerides["G08"][0]
IONO_UTC = lnav.IonoUtc(
    KLOBUCHAR, UtcParameters(2.8e-9, 8e-15, GpsTime(2191, 147_456.0), 18, 18, 2185, 7)
)
quiet = settings(deadline=None, derandomize=True, max_examples=60)


def frame(
    start: GpsTime, ephemeris: Ephemeris = EPHEMERIS, iono: lnav.IonoUtc | None = None
) -> np.ndarray:
    return np.concatenate(
        [
            lnav.encode_subframe(start.plus(6.0 * k), k + 1, ephemeris, iono, page=18)
            for k in range(5)
        ]
    )


def parity_twin(word: list[int], d29: int, d30: int) -> list[int]:
    """IS-GPS-200 table 20-XIV written out bit by bit."""
    d = [0, *word]
    x = d[1] ^ d[2] ^ d[3] ^ d[5] ^ d[6] ^ d[10] ^ d[11] ^ d[12] ^ d[13] ^ d[14]
    p25 = d29 ^ x ^ d[17] ^ d[18] ^ d[20] ^ d[23]
    x = d[2] ^ d[3] ^ d[4] ^ d[6] ^ d[7] ^ d[11] ^ d[12] ^ d[13] ^ d[14] ^ d[15]
    p26 = d30 ^ x ^ d[18] ^ d[19] ^ d[21] ^ d[24]
    x = d[1] ^ d[3] ^ d[4] ^ d[5] ^ d[7] ^ d[8] ^ d[12] ^ d[13] ^ d[14] ^ d[15] ^ d[16]
    p27 = d29 ^ x ^ d[19] ^ d[20] ^ d[22]
    x = d[2] ^ d[4] ^ d[5] ^ d[6] ^ d[8] ^ d[9] ^ d[13] ^ d[14] ^ d[15] ^ d[16] ^ d[17]
    p28 = d30 ^ x ^ d[20] ^ d[21] ^ d[23]
    x = d[1] ^ d[3] ^ d[5] ^ d[6] ^ d[7] ^ d[9] ^ d[10] ^ d[14] ^ d[15] ^ d[16] ^ d[17]
    p29 = d30 ^ x ^ d[18] ^ d[21] ^ d[22] ^ d[24]
    x = d[3] ^ d[5] ^ d[6] ^ d[8] ^ d[9] ^ d[10] ^ d[11] ^ d[13] ^ d[15] ^ d[19]
    p30 = d29 ^ x ^ d[22] ^ d[23] ^ d[24]
    return [p25, p26, p27, p28, p29, p30]


@quiet
@given(st.integers(0, 2**24 - 1), st.integers(0, 3))
def test_parity_against_the_table_written_out(word: int, stars: int) -> None:
    data = np.array([word >> k & 1 for k in range(23, -1, -1)], np.int8)
    before = np.array([stars >> 1, stars & 1], np.int8)
    assert lnav.parity(data, before).tolist() == parity_twin(data.tolist(), *before.tolist())


@pytest.mark.parametrize("polarity", [0, 1])
def test_every_single_and_double_error_in_a_word_is_seen(polarity: int) -> None:
    bits = lnav.encode_subframe(WHEN.plus(-0.5), 1, EPHEMERIS)[:30] ^ polarity
    before = (polarity, polarity)
    assert lnav.check_words(bits, before)[1].all()
    for first in range(30):
        for second in range(first, 30):
            wrong = bits.copy()
            wrong[first] ^= 1
            wrong[second] ^= first != second
            assert not lnav.check_words(wrong, before)[1].any()


def decoded(bits: np.ndarray, near: GpsTime) -> Ephemeris:
    state, found = lnav.start("G08"), []
    for k in range(3):
        subframe = lnav.decode_subframe(bits[300 * k : 300 * (k + 1)])
        assert subframe is not None
        state, news = lnav.collect(state, subframe, near)
        found = [*found, *news]
    assert len(found) == 1
    assert isinstance(found[0], Ephemeris)
    return found[0]


@quiet
@given(st.integers(0, 10**6), st.integers(0, 100_799), st.integers(1025, 3000))
def test_ephemeris_round_trip(seed: int, count: int, week: int) -> None:
    """Within half a step of each field; encoding what was decoded gives the same bits."""
    start = GpsTime(week, 6.0 * count)
    rng = np.random.default_rng(seed)
    toe = start.plus(float(rng.integers(-7000, 7000)))
    toe = GpsTime(toe.week, 16.0 * (toe.tow_s // 16.0))
    wanted = replace(
        next(iter(sky(seed=seed).ephemerides.values()))[0],
        satellite="G08",
        toe=toe,
        toc=toe,
        iode=int(rng.integers(256)),
        health=int(rng.integers(64)),
        fit_hours=float(rng.choice([4.0, 6.0])),
    )
    wanted = replace(wanted, iodc=wanted.iode if wanted.fit_hours == 4.0 else wanted.iode % 240)
    wanted = replace(wanted, iode=wanted.iodc)
    bits = frame(start, wanted)
    got = decoded(bits, start.plus(86_400.0 * 700))
    steps = {f.name: f.scale for page in (1, 2, 3) for f in lnav.PAGES[page]}
    for field in fields(Ephemeris):
        name, value = field.name, getattr(got, field.name)
        if name == "transmitted":
            assert value == start
        elif isinstance(value, float) and name in steps:
            assert abs(value - getattr(wanted, name)) <= 0.5001 * steps[name], name
        else:
            assert value == getattr(wanted, name), name
    assert np.array_equal(frame(start, got), bits)


def test_iono_and_utc_round_trip_and_week_of_the_bits() -> None:
    bits = frame(WHEN.plus(-4.5), iono=IONO_UTC)[900:1200]
    subframe = lnav.decode_subframe(bits)
    assert subframe is not None
    _, (got,) = lnav.collect(lnav.start("G08"), subframe, GpsTime(2190, 0.0))
    assert isinstance(got, lnav.IonoUtc)
    assert got.klobuchar.alpha == pytest.approx(KLOBUCHAR.alpha, abs=2**-25)
    assert got.klobuchar.beta == pytest.approx(KLOBUCHAR.beta, abs=2**15)
    assert got.utc._replace(a0_s=0.0, a1_sps=0.0) == IONO_UTC.utc._replace(a0_s=0.0, a1_sps=0.0)
    assert got.utc.a0_s == pytest.approx(2.8e-9, abs=2**-31)


@pytest.mark.parametrize("name", ["crs_m", "eccentricity", "af0_s"])
def test_a_value_that_needs_more_bits_is_refused(name: str) -> None:
    with pytest.raises(NumericalError, match=name):
        frame(WHEN.plus(-4.5), replace(EPHEMERIS, **{name: 3000.0}))


def test_sets_of_different_issue_never_mix() -> None:
    start = GpsTime(2190, 302_400.0)
    other = replace(EPHEMERIS, iode=77, iodc=77, m0_rad=0.5)
    old, new = frame(start), frame(start.plus(30.0), other)
    state, got = lnav.start("G08"), []
    for k, bits in [(0, old), (1, old), (2, new), (0, new), (1, new)]:
        subframe = lnav.decode_subframe(bits[300 * k : 300 * (k + 1)])
        assert subframe is not None
        state, found = lnav.collect(state, subframe)
        got.append(found)
    assert got[:4] == [()] * 4
    (new,) = got[4]
    assert isinstance(new, Ephemeris)
    assert new.iode == 77
    assert new.m0_rad == pytest.approx(0.5, abs=1e-8)


def test_the_same_set_again_is_no_news_but_a_change_of_health_is() -> None:
    start = GpsTime(2190, 302_400.0)
    sick = replace(EPHEMERIS, health=63)
    state, count = lnav.start("G08"), []
    for bits in (frame(start), frame(start.plus(30.0)), frame(start.plus(60.0), sick)):
        for k in range(3):
            subframe = lnav.decode_subframe(bits[300 * k : 300 * (k + 1)])
            assert subframe is not None
            state, found = lnav.collect(state, subframe)
            count.append(len(found))
    assert np.flatnonzero(count).tolist() == [2, 6]
    assert state.ephemeris is not None
    assert state.ephemeris.health == 63


def test_week_of_toe_across_the_end_of_the_week() -> None:
    toe = GpsTime(2191, 0.0)
    got = decoded(
        frame(GpsTime(2190, 604_770.0), replace(EPHEMERIS, toe=toe, toc=toe)), GpsTime(2190, 0.0)
    )
    assert got.toe == toe
    assert got.transmitted == GpsTime(2190, 604_770.0)


@pytest.mark.parametrize("polarity", [0, 1])
@pytest.mark.parametrize("offset", [0, 1, 137])
def test_frames_are_found_in_both_polarities(polarity: int, offset: int) -> None:
    rng = np.random.default_rng(offset)
    start = GpsTime(2190, 604_782.0)  # the week ends within the frame
    stream = np.concatenate([rng.integers(0, 2, offset, np.int8), frame(start), frame(start)[:70]])
    frames = lnav.find_frames((stream ^ polarity).astype(np.int8))
    assert [f.first for f in frames] == [offset + 300 * k for k in range(6)]
    assert [f.start_tow_s for f in frames][:5] == [604_782, 604_788, 604_794, 0, 6]
    assert [f.subframe_id for f in frames] == [1, 2, 3, 4, 5, 1]
    assert {f.polarity for f in frames} == {polarity}
    assert [f.confirmed for f in frames] == [True] * 5 + [False]
    assert frames[-1].subframe is None


def test_a_frame_with_a_wrong_bit_is_still_a_place_when_its_successor_is_there() -> None:
    stream = np.concatenate([frame(GpsTime(2190, 302_400.0))])
    stream[150] ^= 1
    frames = lnav.find_frames(stream)
    assert frames[0].subframe is None
    assert frames[0].confirmed
    stream[300 + 40] ^= 1  # and without it there is none
    assert [f.first for f in lnav.find_frames(stream)] == [600, 900, 1200]


def test_noise_holds_no_confirmed_frame() -> None:
    rng = np.random.default_rng(5)
    frames = lnav.find_frames(rng.integers(0, 2, 300_000, np.int8))
    assert not [f for f in frames if f.confirmed]


# --- what a receiver in Oxford decoded -----------------------------------------------------------


def ublox_messages(raw: bytes) -> Iterator[tuple[int, bytes]]:
    """Class and number, and payload, of every UBX message."""
    at = raw.find(b"\xb5\x62")
    while at >= 0:
        (length,) = struct.unpack_from("<H", raw, at + 4)
        yield raw[at + 2] << 8 | raw[at + 3], raw[at + 6 : at + 6 + length]
        at = raw.find(b"\xb5\x62", at + 8 + length)


def ublox_subframes(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """GPS L1 C/A subframes as 300 transmitted bits.

    The receiver turns whole words upright, parity included: undone here from the first word on.
    """
    for kind, payload in ublox_messages(path.read_bytes()):
        if kind == 0x0213 and payload[0] == 0 and payload[2] == 0:
            words = struct.unpack_from("<10I", payload, 8)
            bits = np.array([[w >> k & 1 for k in range(29, -1, -1)] for w in words], np.int8)
            for k in range(1, 10):
                bits[k] ^= bits[k - 1, 29]
            yield f"G{payload[1]:02d}", bits.ravel()


def test_real_subframes_give_the_ephemerides_others_decoded(shared_data: Path) -> None:
    folder = shared_data / "real/gnss/snapper-ubx"
    states: dict[str, lnav.LnavState] = {}
    got: dict[str, Ephemeris] = {}
    failed = []
    for satellite, bits in ublox_subframes(folder / "COM6_211122_123733.ubx"):
        subframe = lnav.decode_subframe(bits)
        inverted = lnav.decode_subframe(bits ^ 1, (1, 1))
        assert inverted == subframe
        if subframe is None:
            failed.append(lnav.check_words(bits, (0, 0))[1].sum())
            continue
        state = states.get(satellite, lnav.start(satellite))
        states[satellite], news = lnav.collect(state, subframe)
        for new in news:
            if isinstance(new, Ephemeris):
                got[satellite] = new
    assert failed == [9]  # one of 573 has one word whose parity does not hold
    reference = {
        name: sets
        for name, sets in read_nav(folder / "w00_f9p.nav").ephemerides.items()
        if name[0] == "G"
    }
    assert got.keys() == reference.keys()
    assert len(got) == 10
    for name, (wanted,) in reference.items():
        for field in fields(Ephemeris):
            value, printed = getattr(got[name], field.name), getattr(wanted, field.name)
            if field.name == "transmitted":  # theirs is the hand-over word's: a subframe later
                assert 0.0 < printed.since(value) <= 30.0
            elif isinstance(value, float):
                assert value == pytest.approx(printed, rel=1e-11, abs=1e-30), (name, field.name)
            else:
                assert value == printed, (name, field.name)


def test_encoding_what_was_decoded_gives_the_real_fields_again(shared_data: Path) -> None:
    """Every number of subframes 1–3 to the bit; reserved bits are not kept."""
    path = shared_data / "real/gnss/snapper-ubx/COM6_211122_123733.ubx"
    states: dict[str, lnav.LnavState] = {}
    iono_utc: lnav.IonoUtc | None = None
    real: list[tuple[str, lnav.Subframe]] = []
    for satellite, bits in ublox_subframes(path):
        subframe = lnav.decode_subframe(bits)
        if subframe is not None:
            real.append((satellite, subframe))
            state = states.get(satellite, lnav.start(satellite))
            states[satellite], news = lnav.collect(state, subframe)
            iono_utc = next((new for new in news if isinstance(new, lnav.IonoUtc)), iono_utc)
    compared = dict.fromkeys(lnav.PAGES, 0)
    for satellite, subframe in real:
        ephemeris, page = states[satellite].ephemeris, lnav._page(subframe)
        if ephemeris is None or page is None:
            continue
        start = GpsTime(ephemeris.transmitted.week, float(subframe.start_tow_s))
        bits = lnav.encode_subframe(start, subframe.subframe_id, ephemeris, iono_utc, page=18)
        again = lnav.decode_subframe(bits)
        assert again is not None
        assert (again.start_tow_s, again.subframe_id) == (start.tow_s, subframe.subframe_id)
        assert lnav._unpack(page, again.words) == lnav._unpack(page, subframe.words)
        compared[page] += 1
    assert all(compared[page] > 50 for page in (1, 2, 3))  # page 18 did not come in that time
