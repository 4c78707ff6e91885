"""Observations against the truth with nothing taken off: the simulator knows when a sample was.

Sample n was taken when the receiver's clock read start + n/rate; what that clock was off by then
is known, so that neither the receiver's idea of time nor what its satellites have in common
enters. A range is the time of flight: the sample's true instant less the satellite clock's
reading when what arrived then left it. Errors are observation − truth.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Epoch, FloatArray, Observation, SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.reproduce.whole_receiver import Recording

_STEP_S: Final = 0.15  # truth further apart than this has a gap between


class Path(NamedTuple):
    """What a perfect receiver sees of a satellite, at seconds since the scenario's start."""

    seconds: FloatArray
    range_m: FloatArray
    doppler_hz: FloatArray


class Missed(NamedTuple):
    """Errors of an observation; Doppler's holds the receiver clock's drift."""

    range_m: float
    doppler_hz: float


class Perfect(NamedTuple):
    """What should have been observed."""

    range_m: float
    doppler_hz: float


class SampledTruth:
    """True instants, ranges and Dopplers of a recording."""

    def __init__(self, recording: Recording) -> None:
        scenario = recording.scenario
        self.start = scenario.start
        self._rate_hz = scenario.streams[0].front_end.sample_rate_hz
        clock = pd.read_csv(recording.folder / "clock.csv")
        self._clock_s = self._since_start(clock["gps_week"], clock["gps_tow_s"])
        self._offset_s = clock["offset_s"].to_numpy(np.float64)
        ranges = pd.read_csv(recording.folder / "ranges.csv")
        ranges = ranges[ranges["visible"] == 1]
        self._paths = {
            str(name): Path(
                self._since_start(rows["week"], rows["tow"]),
                rows["pseudorange_m"].to_numpy(np.float64),
                rows["doppler_hz"].to_numpy(np.float64),
            )
            for name, rows in ranges.groupby("satellite")
        }

    def _since_start(self, weeks: pd.Series, tows_s: pd.Series) -> FloatArray:
        return np.array([GpsTime(*at).since(self.start) for at in zip(weeks, tows_s, strict=True)])

    def true_s(self, instant: SampleInstant) -> float:
        """GPST of a point among the first stream's samples, s since the scenario's start."""
        reading_s = (instant.sample + instant.fraction) / self._rate_hz
        offset_s = np.interp(reading_s, self._clock_s + self._offset_s, self._offset_s)
        return float(reading_s - offset_s)

    def perfect(self, satellite: str, instant: SampleInstant) -> Perfect | None:
        """Range and Doppler at a sample; None where truth has nothing about it."""
        path, now_s = self._paths.get(satellite), self.true_s(instant)
        if path is None:
            return None
        after = int(np.searchsorted(path.seconds, now_s))
        if not 0 < after < path.seconds.size or np.diff(path.seconds)[after - 1] > _STEP_S:
            return None
        return Perfect(
            float(np.interp(now_s, path.seconds, path.range_m)),
            float(np.interp(now_s, path.seconds, path.doppler_hz)),
        )

    def missed(self, seen: Observation, instant: SampleInstant) -> Missed | None:
        """Errors of an observation taken at a sample; None where truth has nothing about it."""
        perfect = self.perfect(seen.satellite, instant)
        if perfect is None:
            return None
        flown_s = self.true_s(instant) - seen.transmit.since(self.start)
        return Missed(
            SPEED_OF_LIGHT_MPS * flown_s - perfect.range_m, seen.doppler_hz - perfect.doppler_hz
        )

    def errors(self, epoch: Epoch) -> dict[str, Missed]:
        """Errors by satellite of an epoch's observations."""
        found = {seen.satellite: self.missed(seen, epoch.instant) for seen in epoch.observations}
        return {name: missed for name, missed in found.items() if missed is not None}
