"""Is the inertial navigation to be trusted with the loops? And if not, what is wrong with it.

A log with wrong axes, of another drive, or worse than its grade says makes a navigation that
contradicts the fixes. The watch holds every innovation against what the filter expects of it; in
doubt the receiver runs unaided, and gets its aid back once the navigation has been consistent for a
while. The while grows with every time it failed, so that a log that is right by chance now and then
does not flap.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray, ImuGrade
from deepgnss.core.time import GpsTime
from deepgnss.ins.turn_on import TurnOn
from deepgnss.ins.updates import Innovation

PATIENCE_S: Final = 2.0
"""Of consistency before the first trust; three times as long after each loss of it."""

LONGEST_PATIENCE_S: Final = 180.0

FASTEST_SIGMA_MPS: Final = 0.2
"""1σ of the antenna's velocity (per axis) with which aiding may begin: 1 Hz of carrier."""

_FEWEST = 3  # epochs on which trust is founded
_KEPT = 2000  # epochs, more than the longest limit's at 25 Hz
_CAP = 10.0  # one wild fix is not a wrong log
_APART_S = 0.11  # from the last tag at which a measurement stands to the first of the next one
_PLACING = ("position", "velocity", "pseudorange", "range rate")


class Limit(NamedTuple):
    """Trust ends where the mean strain over a time exceeds a value."""

    seconds: float
    epochs: int  # at least, to count
    strain: float


LIMITS: Final = (Limit(2.0, 6, 4.0), Limit(10.0, 10, 2.5), Limit(60.0, 30, 1.6))
"""Strain is NIS per degree of freedom: 1 for a consistent filter, less where σ are generous."""

_CONSISTENT = 1.3  # mean strain with which patience is rewarded


class Turn(NamedTuple):
    """The watch changed its mind."""

    time: GpsTime
    trusted: bool
    reason: str


@dataclass(slots=True)
class Watch:
    """Innovations in, trust out."""

    trusted: bool = False
    distrusts: int = 0  # how often trust, or the navigation itself, was lost by contradiction
    _ended: bool = False  # trust in this navigation, and counted
    _origin: GpsTime | None = None
    _same: list[float] = field(default_factory=list)  # strains of a measurement that still stands
    _same_since: GpsTime | None = None
    _times_s: list[float] = field(default_factory=list)  # since `_origin`
    _strains: list[float] = field(default_factory=list)
    _sums: list[float] = field(default_factory=lambda: [0.0])  # of the strains up to each
    _since_s: float | None = None  # consistent from then on

    @property
    def patience_s(self) -> float:
        """Consistency it takes to be trusted."""
        return min(PATIENCE_S * 3.0**self.distrusts, LONGEST_PATIENCE_S)

    def restart(self, *, contradicted: bool) -> None:
        """The navigation stopped or starts anew; contradicted: because fixes said otherwise."""
        if contradicted and not self._ended:
            self.distrusts += 1
        self.trusted = self._ended = False
        self._times_s, self._strains, self._sums = [], [], [0.0]
        self._same, self._same_since = [], None
        self._since_s = None

    def take(
        self, innovations: Sequence[Innovation], velocity_sigma_mps: float, stands_s: float = 0.0
    ) -> list[Turn]:
        """Take innovations in, in order of time; where trust began or ended.

        velocity_sigma_mps: 1σ per axis of the antenna's velocity as it stands. stands_s: for which
        a Doppler is the same measurement, carried on: its epochs count as one.
        """
        turns = []
        for time, strain in _by_epoch(innovations):
            self._same.append(strain)
            self._same_since = self._same_since or time
            if time.since(self._same_since) < stands_s - _APART_S:
                continue
            now_s = self._note(time, float(np.mean(self._same)))
            self._same, self._same_since = [], None
            worst = self._exceeded(now_s)
            if worst:
                self._since_s = None
                if self.trusted:
                    turns.append(Turn(time, False, worst))
                    self.trusted, self._ended = False, True
                    self.distrusts += 1
            elif self._since_s is None:
                self._since_s = now_s
            if self._ripe(now_s, velocity_sigma_mps):
                turns.append(Turn(time, True, f"consistent for {self.patience_s:.0f} s"))
                self.trusted = True
        return turns

    def _note(self, time: GpsTime, strain: float) -> float:
        self._origin = self._origin or time
        self._times_s.append(time.since(self._origin))
        self._strains.append(strain)
        self._sums.append(self._sums[-1] + strain)
        if len(self._strains) > 2 * _KEPT:
            self._times_s, self._strains = self._times_s[-_KEPT:], self._strains[-_KEPT:]
            self._sums = self._sums[-_KEPT - 1 :]
        return self._times_s[-1]

    def _ripe(self, now_s: float, velocity_sigma_mps: float) -> bool:
        if self.trusted or self._since_s is None or velocity_sigma_mps > FASTEST_SIGMA_MPS:
            return False
        since_s = now_s - self._since_s
        strain, epochs = self._mean(now_s, min(since_s, LIMITS[-1].seconds))
        return since_s >= self.patience_s and epochs >= _FEWEST and strain <= _CONSISTENT

    def _exceeded(self, now_s: float) -> str:
        """The limit that the strain exceeds, in words; empty: none."""
        for limit in LIMITS:
            strain, epochs = self._mean(now_s, limit.seconds)
            if limit is LIMITS[0]:  # a few wild fixes, as after a tunnel, are not its fault
                strain = min(strain, median(self._strains[-epochs:]))
            if epochs >= limit.epochs and strain > limit.strain:
                times = f"{math.sqrt(strain):.1f}" if strain < _CAP else "more than 3"
                return (
                    f"innovations of the last {limit.seconds:.0f} s are {times} times what the"
                    " navigation expects"
                )
        return ""

    def _mean(self, now_s: float, seconds: float) -> tuple[float, int]:
        """Mean strain of the last seconds, and the number of epochs."""
        first = bisect_left(self._times_s, now_s - seconds - 1e-6)
        count = len(self._times_s) - first
        return (self._sums[-1] - self._sums[first]) / max(count, 1), count


def _by_epoch(innovations: Sequence[Innovation]) -> list[tuple[GpsTime, float]]:
    """Strain of each instant: by kind the median over its measurements, the worst of the kinds."""
    epochs: dict[float, tuple[GpsTime, dict[str, list[float]]]] = {}
    for i in innovations:
        if i.kind in _PLACING:
            first = next(iter(epochs.values()))[0] if epochs else i.time
            _, kinds = epochs.setdefault(round(i.time.since(first), 4), (i.time, {}))
            kinds.setdefault(i.kind, []).append(i.nis / i.innovation.size)
    return [
        (time, min(max(median(values) for values in kinds.values()), _CAP))
        for time, kinds in epochs.values()
    ]


# --- what is wrong -------------------------------------------------------------------------------

_AXES = (("forward", "backward"), ("right", "left"), ("down", "up"))
_ALONG = 0.7  # share of the direction of travel along an axis that is not the forward one
_BEYOND = 4.0  # times the grade's own σ …
_SETTLED_S = 45.0  # … after so long a run


def travel_finding(forward_b: Sequence[FloatArray], mounting_yaw_rad: float) -> str:
    """What directions of travel in body axes say of the axes; empty: nothing wrong."""
    told = [f for f in forward_b if np.any(f)]
    if not told:
        return ""
    mean = np.median(told, axis=0)
    vehicle = np.array([math.cos(mounting_yaw_rad), -math.sin(mounting_yaw_rad), 0.0])
    axis = int(np.abs(mean).argmax())
    if abs(float(mean @ vehicle)) > _ALONG or abs(mean[axis]) < _ALONG:
        return ""
    return f"it travels along its {_AXES[axis][int(mean[axis] < 0.0)]} axis: imu.axes?"


def bias_finding(
    gyro_bias_radps: FloatArray, accel_bias_mps2: FloatArray, grade: ImuGrade, run_s: float
) -> str:
    """Biases far beyond what the grade allows for after a run; empty: within it, or too early.

    What an alignment got wrong passes for biases of a good unit at first.
    """
    if run_s < _SETTLED_S:
        return ""
    gyro_radps = math.hypot(
        grade.gyro_bias_radps,
        _walked(grade.gyro_drift_radps2_rthz, grade.gyro_drift_time_s, run_s),
    )
    accel_mps2 = math.hypot(
        grade.accel_bias_mps2,
        _walked(grade.accel_drift_mps3_rthz, grade.accel_drift_time_s, run_s),
    )
    found = [
        *_beyond("gyros", float(np.abs(gyro_bias_radps).max()), gyro_radps, gyro_radps),
        *_beyond("accelerometers", float(np.abs(accel_bias_mps2).max()), accel_mps2, accel_mps2),
    ]
    return f"biases of {' and '.join(found)}: imu.grade?" if found else ""


def turn_on_finding(biases: TurnOn, grade: ImuGrade) -> str:
    """Biases at a log's beginning far beyond all that the grade allows there; empty: within it."""
    gyro, accel = biases
    found = [
        *_beyond("gyros", gyro.largest, gyro.sigma, grade.gyro_bias_radps),
        *_beyond("accelerometers", accel.largest, accel.sigma, grade.accel_bias_mps2),
    ]
    return f"biases at its start are {' and '.join(found)}: imu.grade?" if found else ""


def _beyond(sensors: str, bias: float, sigma: float, stated: float) -> list[str]:
    """A bias beyond `_BEYOND` of its σ, in multiples of what is stated."""
    if bias <= _BEYOND * sigma:
        return []
    return [f"{bias / (stated or sigma):.0f} times those of its grade in the {sensors}"]


def _walked(drift: float, time_s: float, run_s: float) -> float:
    """1σ of a first-order Gauss–Markov drift some time after it was zero."""
    return drift * math.sqrt(0.5 * time_s * -math.expm1(-2.0 * run_s / time_s))
