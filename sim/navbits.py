"""The navigation symbols each satellite sends, counted from the start of the GPS week.

The message follows the sets of the NAV data as a control segment would upload them; the orbit that
is flown is that of one set throughout (`Scenario.orbit_set`), so that the truth has no step where
the message changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import BDT_MINUS_GPST_S
from deepgnss.core.records import Ephemeris, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.beidou_nav import encode_d1, encode_d2
from deepgnss.receiver.lnav import SUBFRAME_BITS, SUBFRAME_S, IonoUtc, encode_subframe
from deepgnss.receiver.messages import Bits
from deepgnss.receiver.signals import Signal

_CYCLE_S: Final = 30  # in which LNAV, D1 and D2 send a whole ephemeris once: sets change between

_Encoder = Callable[[GpsTime, Ephemeris], Bits]


class Symbols(NamedTuple):
    """Symbols as ±1 (bit 0 = +1), without secondary code.

    The first has number `first` since the start of the GPS week that the recording starts in, for
    BeiDou, too: its subframes begin 14 s later than those of GPS, 700 or 7000 whole symbols.
    """

    first: int
    values: NDArray[np.int8]


def sent_symbols(
    signal: Signal, nav: NavData, orbit_set: Ephemeris, start: GpsTime, seconds: float
) -> Symbols:
    """Symbols of a satellite from a subframe before `start` (satellite time) to one past the end.

    Parameters: orbit_set, the truth: the message begins with it and changes where other sets of
    `nav` are first transmitted later on, at the next whole 30 s.
    """
    klobuchar, utc = nav.klobuchar.get(signal.id.system), nav.utc
    encoders: dict[str, _Encoder] = {
        "LNAV": partial(_lnav, iono_utc=IonoUtc(klobuchar, utc)),
        "D1": partial(encode_d1, klobuchar=klobuchar, utc=utc),
        "D2": partial(encode_d2, klobuchar=klobuchar, utc=utc),
    }
    encode = encoders[signal.message.name]
    zero_s = BDT_MINUS_GPST_S if signal.id.system == "C" else 0.0
    per_cycle = round(_CYCLE_S / (SUBFRAME_BITS * signal.symbol_s))
    subframe_s = _CYCLE_S / per_cycle
    begin = GpsTime(start.week, -zero_s)  # of the system's week
    first = math.floor(start.since(begin) / subframe_s) - 1
    end = math.ceil((start.since(begin) + seconds) / subframe_s) + 1
    sets = nav.ephemerides.get(orbit_set.satellite, ())
    bits = []
    for number in range(first, end):
        cycle = begin.plus(number // per_cycle * float(_CYCLE_S))
        ephemeris = in_force(sets, orbit_set, start, cycle)
        bits.append(encode(cycle.plus(number % per_cycle * subframe_s), ephemeris))
    values = (1 - 2 * np.concatenate(bits)).astype(np.int8)
    ahead = round(-zero_s / signal.symbol_s)
    return Symbols(ahead + first * SUBFRAME_BITS, values)


def in_force(
    sets: Sequence[Ephemeris], orbit_set: Ephemeris, start: GpsTime, time: GpsTime
) -> Ephemeris:
    """The set a satellite broadcasts at a time of a recording from `start` on, flying orbit_set."""
    later = [e for e in sets if start < e.transmitted <= time]
    if later:
        return max(later, key=lambda e: e.transmitted)
    before = [e for e in sets if e.transmitted <= start]
    if orbit_set.transmitted > start and before:
        return max(before, key=lambda e: e.transmitted)
    return orbit_set


def _lnav(start: GpsTime, ephemeris: Ephemeris, iono_utc: IonoUtc) -> Bits:
    return encode_subframe(start, int(start.tow_s) // SUBFRAME_S % 5 + 1, ephemeris, iono_utc)
