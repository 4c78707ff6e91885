"""The navigation symbols each satellite sends, counted from the start of the GPS week."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import Ephemeris, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.lnav import SUBFRAME_BITS, SUBFRAME_S, IonoUtc, encode_subframe

_BITS_PER_SECOND: Final = SUBFRAME_BITS // SUBFRAME_S


class Symbols(NamedTuple):
    """Symbols as ±1 (bit 0 = +1); the first has number `first` since the week's start."""

    first: int
    values: NDArray[np.int8]


def lnav_symbols(nav: NavData, orbit_set: Ephemeris, start: GpsTime, seconds: float) -> Symbols:
    """LNAV bits from a subframe before `start` (satellite time) to one past the end.

    Frames of 30 s run from the start of the week: subframes 1–3 with `orbit_set`, 4 and 5 with
    the page due, page 18 of 4 carrying ionosphere and UTC when `nav` has them.
    """
    iono_utc = None
    if "G" in nav.klobuchar and nav.utc is not None:
        iono_utc = IonoUtc(nav.klobuchar["G"], nav.utc)
    first = math.floor(start.tow_s / SUBFRAME_S) - 1
    end = math.ceil((start.tow_s + seconds) / SUBFRAME_S) + 1
    week = GpsTime(start.week, 0.0)
    bits = [
        encode_subframe(week.plus(SUBFRAME_S * number), number % 5 + 1, orbit_set, iono_utc)
        for number in range(first, end)
    ]
    values = (1 - 2 * np.concatenate(bits)).astype(np.int8)
    return Symbols(first * SUBFRAME_S * _BITS_PER_SECOND, values)
