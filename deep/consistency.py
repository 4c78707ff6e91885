"""What a run finds against what it was told: sample rate and frequency, date, NAV file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import SIGNAL_IDS, Epoch, NavData
from deepgnss.core.time import GpsTime

TOLERATED_MPS = 6.0  # 0.02 ppm; the ionosphere drifts by centimetres per second
_SHORTEST_S = 4.0  # of an arc that tells
_FEWEST = 3  # satellites
_REACH_S = 12 * 3600.0  # of an ephemeris about its reference time, amply


class _Arc(NamedTuple):
    """Observations without a slip, from the first to the last."""

    begin: GpsTime
    first_m: float  # code minus carrier
    end: GpsTime
    last_m: float

    @property
    def seconds(self) -> float:
        return self.end.since(self.begin)


class CodeMinusCarrier:
    """Takes epoch after epoch, and tells the common drift of code minus carrier.

    What an oscillator does to one it does to the other: a drift between them means that samples
    do not come at the rate, or the carrier does not lie at the frequency, the description says.
    """

    def __init__(self) -> None:
        self._arcs: dict[str, _Arc] = {}
        self._longest: dict[str, _Arc] = {}

    def add(self, epoch: Epoch) -> None:
        """Take the observations of all satellites at one output instant."""
        for seen in epoch.observations:
            if not seen.carrier_valid:
                self._arcs.pop(seen.satellite, None)
                continue
            wavelength_m = SPEED_OF_LIGHT_MPS / SIGNAL_IDS[seen.signal].carrier_hz
            gap_m = seen.pseudorange_m - seen.carrier_cycles * wavelength_m
            arc = self._arcs.get(seen.satellite)
            if arc is None or seen.slip:
                arc = _Arc(epoch.time, gap_m, epoch.time, gap_m)
            else:
                arc = arc._replace(end=epoch.time, last_m=gap_m)
            self._arcs[seen.satellite] = arc
            longest = self._longest.get(seen.satellite)
            if longest is None or arc.seconds >= longest.seconds:
                self._longest[seen.satellite] = arc

    @property
    def drift_mps(self) -> float | None:
        """Median drift over the satellites' longest arcs; None where they are too short."""
        told = [arc for arc in self._longest.values() if arc.seconds >= _SHORTEST_S]
        if len(told) < _FEWEST:
            return None
        return median((arc.last_m - arc.first_m) / arc.seconds for arc in told)


def check_nav_date(nav: NavData, near: GpsTime | None, path: Path) -> GpsTime:
    """The date to go by; a NAV file of another day is refused."""
    toes = sorted(_reference_times(nav))
    if not toes:
        raise InputFileError(f"{path}: holds no ephemeris of a satellite this version tracks")
    if near is None:
        return toes[len(toes) // 2]
    gap_s = _gap_s(nav, near)
    if gap_s > _REACH_S:
        raise InputFileError(
            f"{path}: its ephemerides ({toes[0].calendar():%Y-%m-%d} to "
            f"{toes[-1].calendar():%Y-%m-%d}) lie {gap_s / 86400:.1f} days from the recording "
            f"({near.calendar():%Y-%m-%d})"
        )
    return near


def check_agreement(time: GpsTime, given: NavData) -> None:
    """Refuse ephemerides a run began with whose date the signals contradict."""
    gap_s = _gap_s(given, time)
    if gap_s > _REACH_S:
        raise InputFileError(
            f"nav: the signals say {time.calendar():%Y-%m-%d %H:%M}, the NAV file's "
            f"ephemerides lie {gap_s / 86400:.1f} days from that"
        )


def _reference_times(nav: NavData) -> Iterator[GpsTime]:
    return (e.toe for several in nav.ephemerides.values() for e in several)


def _gap_s(nav: NavData, time: GpsTime) -> float:
    """Time to the nearest ephemeris; 0 where there is none."""
    return min((abs(toe.since(time)) for toe in _reference_times(nav)), default=0.0)


def check_week(time: GpsTime, given: NavData, known: NavData) -> None:
    """Refuse a date, of the config or a NAV file, that is not the one the satellites send.

    Parameters
    ----------
    time: by the receiver. given: ephemerides a run began with. known: these, and
        what was decoded since.
    """
    for satellite, several in known.ephemerides.items():
        for ephemeris in several:
            gap_s = ephemeris.toe.since(time)
            if abs(gap_s) > _REACH_S and ephemeris not in given.ephemerides.get(satellite, ()):
                raise InputFileError(
                    f"nav, recording.start_time: {satellite} sends an ephemeris of "
                    f"{ephemeris.toe.calendar():%Y-%m-%d %H:%M}, {abs(gap_s) / 86400:.1f} days "
                    "from the date they give"
                )
