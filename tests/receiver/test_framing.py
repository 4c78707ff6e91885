"""Frames in a channel's symbols: time, polarity and messages, however the symbols arrive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver import framing, lnav
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.known_symbols import KnownSymbols
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal
from deepgnss.sim.constellation import nominal_gps

START = GpsTime(2290, 382_260.0)  # of a subframe
NAV = nominal_gps(START, 60.0)
EPHEMERIS = NAV.ephemerides["G07"][0]
AHEAD = 137  # symbols before the first subframe


@dataclass
class _Channel:
    """What framing looks at."""

    symbols: bytearray = field(default_factory=bytearray)
    symbols_first: int = 40  # code period of the first symbol
    satellite: str = "G07"
    anchor: int | None = None
    half_cycle: float | None = None
    signal: Signal = GPS_L1CA_SIGNAL


def _bits(polarity: int, subframes: int = 6, start: GpsTime = START) -> NDArray[np.int8]:
    """Noise, then subframes 1, 2, 3 … as received."""
    noise = np.random.default_rng(2).integers(0, 2, AHEAD)
    frames = [
        lnav.encode_subframe(start.plus(6.0 * k), k % 5 + 1, EPHEMERIS) for k in range(subframes)
    ]
    return (np.concatenate([noise, *frames]) ^ polarity).astype(np.int8)


def _feed(
    bits: NDArray[np.int8], piece: int, state: framing.FrameState, channel: _Channel
) -> Iterator[tuple[int, framing.Found]]:
    """Give symbols piece by piece, as the epochs bring them."""
    for first in range(0, bits.size, piece):
        channel.symbols.extend(bits[first : first + piece].tolist())
        found = framing.read_symbols(state, cast(Channel, channel), START)
        state = found.state
        yield len(channel.symbols), found


@pytest.mark.parametrize("polarity", [0, 1])
@pytest.mark.parametrize("piece", [5, 23, 301])
def test_every_subframe_is_found_once_it_is_there(polarity: int, piece: int) -> None:
    channel = _Channel()
    steps = list(_feed(_bits(polarity), piece, framing.start("G07"), channel))
    heads = [(count, head) for count, found in steps for head in found.heads]
    subframes = [s for _, found in steps for s in found.subframes]
    assert [s.subframe_id for s in subframes] == [1, 2, 3, 4, 5, 1]
    for count, head in heads:
        assert (head.first - AHEAD) % 300 == 0
        assert head.polarity == polarity
        number = (head.first - AHEAD) // 300
        assert head.start_tow_s == START.tow_s + 6 * number
        assert count >= head.first + 60
    # The first head is told right after its two words, long before its subframe is over.
    assert heads[0][0] <= AHEAD + 60 + max(2 * piece, 10 + piece)
    news = [item for _, found in steps for item in found.news]
    assert [type(item) for item in news] == [Ephemeris]
    assert isinstance(news[0], Ephemeris)
    assert news[0].m0_rad == pytest.approx(EPHEMERIS.m0_rad, abs=1e-8)
    assert news[0].satellite == "G07"


def test_a_wrong_bit_costs_one_subframe_only() -> None:
    bits = _bits(0)
    bits[AHEAD + 300 + 150] ^= 1
    steps = list(_feed(bits, 5, framing.start("G07"), _Channel()))
    subframes = [s.subframe_id for _, found in steps for s in found.subframes]
    assert subframes == [1, 3, 4, 5, 1]


def test_a_new_lock_counts_its_symbols_anew() -> None:
    """After a loss the polarity may be another; pages gathered before still count."""
    channel, state = _Channel(), framing.start("G07")
    for _, found in _feed(_bits(0, 2), 5, state, channel):
        state = found.state
    channel.symbols, channel.symbols_first = bytearray(), 77_777
    rest = _bits(1)[AHEAD + 600 - 40 :]  # subframe 3 and on, turned over
    steps = list(_feed(rest, 5, state, channel))
    assert steps[-1][1].state.stretch == 77_777
    subframes = [s.subframe_id for _, found in steps for s in found.subframes]
    assert subframes[:2] == [3, 4]
    assert [type(n) for _, found in steps for n in found.news] == [Ephemeris]


def test_the_next_channel_of_a_satellite_starts_from_scratch_but_keeps_the_pages() -> None:
    """Even where its symbols start at the same count as those of the channel before."""
    channel, state = _Channel(), framing.start("G07")
    for _, found in _feed(_bits(0, 2), 5, state, channel):
        state = found.state
    steps = list(_feed(_bits(0, 4)[AHEAD + 600 :], 5, framing.resume(state), _Channel()))
    assert [s.subframe_id for _, found in steps for s in found.subframes] == [3, 4]
    assert [type(n) for _, found in steps for n in found.news] == [Ephemeris]


@pytest.mark.parametrize("first", [0, 137, 1500])
def test_anchor_is_the_satellite_s_time_at_period_0(first: int) -> None:
    channel = _Channel(symbols_first=13)
    frame = lnav.Frame(first, 0, 382_260, 1, True, None)
    anchor = framing.anchor_of(cast(Channel, channel), frame, 2290)
    period_of_frame = 13 + 20 * first
    sent_ms = (2290 * SECONDS_PER_WEEK + 382_260) * 1000
    assert anchor + period_of_frame == sent_ms


# --- polarity from symbols known before ----------------------------------------------------------

SENT = np.random.default_rng(7).integers(0, 2, 400).astype(np.int8)
ANCHOR = 1_385_374_256_000


@pytest.mark.parametrize("turned", [0, 1])
@pytest.mark.parametrize("lead", [-60, 0, 35, 200])
def test_polarity_from_known_symbols(turned: int, lead: int) -> None:
    """Stretches that begin before or after what is known; a wrong decision is borne."""
    told = KnownSymbols(ANCHOR + 100 * 20 + 7, bytes(SENT[100:].tolist()))
    seen = (SENT[100 + max(lead, -100) : 100 + lead + 90] ^ turned).copy()
    seen[75] ^= 1
    channel = _Channel(bytearray(seen.tolist()), 7 + 20 * (100 + lead) - 5000, anchor=ANCHOR + 5000)
    found = framing.polarity(cast(Channel, channel), told)
    assert found == 0.5 * turned


def test_unlike_symbols_tell_nothing() -> None:
    told = KnownSymbols(ANCHOR, bytes(SENT.tolist()))
    other = np.random.default_rng(8).integers(0, 2, 200).tolist()
    channel = _Channel(bytearray(other), 0, anchor=ANCHOR)
    assert framing.polarity(cast(Channel, channel), told) is None
    few = _Channel(bytearray(SENT[385:].tolist()), 385 * 20, anchor=ANCHOR)
    assert framing.polarity(cast(Channel, few), told) is None
    few.anchor = None
    assert framing.polarity(cast(Channel, few), told) is None


@pytest.mark.parametrize("half_cycle", [0.0, 0.5])
def test_known_symbols_are_upright(half_cycle: float) -> None:
    received = (SENT ^ int(half_cycle * 2)).tolist()
    channel = _Channel(bytearray(received), 33, anchor=ANCHOR, half_cycle=half_cycle)
    told = framing.known_symbols(cast(Channel, channel))
    assert told is not None
    assert told.first == ANCHOR + 33
    assert list(told.symbols) == SENT.tolist()
    assert framing.polarity(cast(Channel, channel), told) == half_cycle
    channel.half_cycle = None
    assert framing.known_symbols(cast(Channel, channel)) is None


# --- news ----------------------------------------------------------------------------------------


def test_news_goes_into_the_navigation_data() -> None:
    assert NAV.utc is not None
    message = lnav.IonoUtc(NAV.klobuchar["G"], NAV.utc)
    nav = framing.take_news(NavData(), (EPHEMERIS, message))
    assert nav.ephemerides == {"G07": (EPHEMERIS,)}
    assert nav.klobuchar == {"G": NAV.klobuchar["G"]}
    assert nav.utc == NAV.utc
    assert framing.take_news(nav, ()) is nav
