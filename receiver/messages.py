"""What every navigation message offers to frame sync and receiver, whatever its format.

A format finds its subframes in a stream of symbols, reads them, and collects them to ephemerides
and the like. Times are GPST, so that whoever uses them need not know the system's own time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, Klobuchar, UtcParameters
from deepgnss.core.time import GpsTime

Bits = NDArray[np.int8]


class Subframe(Protocol):
    """A subframe that was read and believed."""

    @property
    def start_tow_s(self) -> float:
        """GPST second of week, by the satellite's clock, at which its first bit left."""

    @property
    def subframe_id(self) -> int:
        """Its number, 1–5."""


class Frame(NamedTuple):
    """A place in a stream of symbols where the head of a subframe stands."""

    first: int  # index of the first symbol
    polarity: int  # 1: all symbols are inverted
    start_tow_s: float  # satellite time (GPST) at which the first symbol left
    subframe_id: int
    confirmed: bool  # by the checks of all words, or by the head of the next subframe
    subframe: Any  # a Subframe of the format; None: not all there, or a check failed


class IonoUtc(NamedTuple):
    """Ionosphere and UTC of a system as far as a page tells them."""

    klobuchar: Klobuchar | None
    utc: UtcParameters | None
    system: str = "G"


News = Ephemeris | IonoUtc


@dataclass(frozen=True, slots=True)
class MessageFormat:
    """A format's constants and functions. `start` gives the record that `collect` passes on.

    collect: (record, subframe, rough date for the week number) → (record, what is new).
    again: (subframe, start_tow_s) → its symbols when it is sent once more; None where it is not
    known to be. The first three come every frame, the others with the almanac.
    """

    name: str
    subframe_symbols: int
    head_symbols: int  # by which a subframe is recognised
    start: Callable[[str], Any]
    find_frames: Callable[[Bits, int], list[Frame]]
    collect: Callable[[Any, Any, GpsTime | None], tuple[Any, tuple[News, ...]]]
    again: Callable[[Any, int], Bits] | None = None
    frame_s: int = 30
    almanac_s: int = 750


def nearest(tow_s: float, reference: GpsTime) -> GpsTime:
    """The instant with this second of week that lies nearest to `reference`."""
    half = SECONDS_PER_WEEK / 2
    return reference.plus((tow_s - reference.tow_s + half) % SECONDS_PER_WEEK - half)
