"""Outlier test of ranges against the navigation, T(5.23–5.25).

ρ_D = corrected range − range the navigation predicts; what changes slowly in it (atmosphere, orbit,
receiver clock, place of the navigation) is followed, ρ_DS; a range whose ρ_DDS = ρ_D − ρ_DS exceeds
the threshold leaves the position. T follows each satellite by itself; here a filter tells apart

    what a place that drifted does to all ranges by their directions (δ, ECEF, driven by the growth
    of the navigation's covariance),
    what clock (whose drift the carrier phases tell) and time system do to all or to those of a
    system, and
    what is a satellite's own: α a second, starting at 0 ± the error budget of its range,

so that after a tunnel the others tell what a returning range should be, also where most of them
come back as reflections. Whom it learns from is found by RAIM with the filter as prior knowledge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import Epoch, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.tight import CLOCK_NOISE
from deepgnss.ins.filter import correct, innovation_limit, squared_innovation
from deepgnss.ins.trajectory import Trajectory
from deepgnss.receiver.measured import NOBODY_REFUSED, Measured, Ranges, ranges_from
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.raim import check_residuals
from deepgnss.receiver.receiver import Screen

_SOUND_M = 0.7  # 1σ of a sound range in a street …
_LOOP_M = 0.2  # … and of its code loop's noise at 45 dB-Hz: in what weighs ranges for positions,
# weak ones are also suspect of being reflections, which is to be found out here
_LASTING_S = 2.0  # for which such errors last: so many tags count as one
_FALSE_ALARM = 1e-4  # of the test that finds whom to learn from
_WIDENING = 3.0  # σ of the prediction by which the limit widens
_RETURN = 0.5  # of the limit: a refused range is sound again below it
_PATIENCE_S = 30.0  # refused for longer, a satellite's own slow value is forgotten …
_LOST_S = 5.0  # … and all of it where the ranges disagree for so long
_UNKNOWN_M = 30.0  # of a clock set by the median of its ranges
_UNKNOWN_MPS = 30.0
_LEAST_M2 = 1e-8  # of growth, so that no direction is known exactly
_PLACE = slice(0, 3)
_BIAS, _DRIFT, _FIXED = 3, 4, 5  # systems and satellites follow


class ScreenSettings(NamedTuple):
    """Keys `positioning.outliers`."""

    alpha_ps: float = 0.05  # share of a lasting difference the slow value takes over in a second
    threshold_m: float = 6.0


class Flag(NamedTuple):
    """Beginning or end of a stretch in which a satellite's range is refused."""

    time: GpsTime
    satellite: str
    refused: bool
    reason: str


@dataclass(slots=True)
class _Stretch:
    """A range being refused."""

    since: GpsTime
    largest_m: float


class _Way:
    """The antenna's way over trajectories that follow each other, without corrections in between.

    step_e_m, grown_e_m2: from the last tag on, how far it went and how the covariance grew.
    """

    def __init__(self, trajectory: Trajectory, lever_b_m: FloatArray) -> None:
        self._trajectory, self._lever_b_m = trajectory, lever_b_m
        self._at_s = float(trajectory.time_s[0])
        self.step_e_m, self.grown_e_m2 = np.zeros(3), np.zeros((3, 3))
        self.r_e_m, self.covariance_e_m2 = np.zeros(3), np.zeros((3, 3))  # where it has come to

    def to(self, time_s: float) -> bool:
        """Go on to an instant; False where the trajectory does not lead there."""
        trajectory = self._trajectory
        if not self._at_s < time_s <= trajectory.time_s[-1]:
            return time_s == self._at_s
        both_s = np.array([self._at_s, time_s])
        r_e_m = trajectory.antenna_place(both_s, self._lever_b_m)
        lat_rad, lon_rad, _ = geodetic(r_e_m[1])
        to_e = C_ne(lat_rad, lon_rad).T
        P_n = trajectory.antenna_covariance(both_s, self._lever_b_m)[:, :3, :3]
        before, after = to_e @ P_n @ to_e.T
        self.step_e_m = self.step_e_m + (r_e_m[1] - r_e_m[0])
        self.grown_e_m2 = self.grown_e_m2 + _growth(before, after)
        self.r_e_m, self.covariance_e_m2, self._at_s = r_e_m[1], after, time_s
        return True

    def onto(self, trajectory: Trajectory) -> bool:
        """Go on to where the next trajectory begins, and be on it."""
        begin_s = float(trajectory.time_s[0])
        reached = begin_s <= self._at_s or self.to(min(begin_s, float(self._trajectory.time_s[-1])))
        self._trajectory = trajectory
        return reached and abs(self._at_s - begin_s) < 1e-3


@brief_kernel
def _growth(before_m2: FloatArray, after_m2: FloatArray) -> FloatArray:
    """What a covariance (3, 3) has grown by, in every direction by the least at least."""
    values, axes = np.linalg.eigh(after_m2 - before_m2)
    return axes * np.maximum(values, _LEAST_M2) @ axes.T  # type: ignore[no-any-return]


@dataclass(slots=True)
class Screening:
    """The filter behind the test; `along` gives the screen of an epoch."""

    parameters: PvtParameters
    settings: ScreenSettings
    flags: list[Flag] = field(default_factory=list)
    refused_tags: dict[str, int] = field(default_factory=dict)  # by satellite, all in all
    _names: list[str] = field(default_factory=list)  # of the states behind the fixed ones
    _x: FloatArray = field(default_factory=lambda: np.zeros(_FIXED))
    _P: FloatArray = field(default_factory=lambda: np.zeros((_FIXED, _FIXED)))
    _time: GpsTime | None = None  # of the last tag; None: nothing is known
    _r_e_m: FloatArray = field(default_factory=lambda: np.zeros(3))  # navigated, not corrected
    _way: _Way | None = None
    _ahead_s: float | None = None  # of the counter, at the first tag
    _agreed: GpsTime | None = None  # last tag at which ranges agreed
    _stretches: dict[str, _Stretch] = field(default_factory=dict)

    def along(
        self,
        trajectory: Trajectory,
        lever_b_m: FloatArray,
        drift: tuple[float, float] | None = None,
    ) -> Screen:
        """The test of the tags that a stretch of navigation reaches.

        drift: of the counter and its 1σ, m/s, at the last tag; None: nobody knows it.
        """
        way = self._way
        if way is None or not way.onto(trajectory):
            self.forget()
            way = self._way = _Way(trajectory, lever_b_m)

        def screen(measured: Measured) -> Mapping[str, str]:
            if not way.to(measured.epoch.time.since(trajectory.origin)):
                return NOBODY_REFUSED
            return self._refused(measured, way, drift)

        return screen

    def news(self) -> list[Flag]:
        """Beginnings and ends of stretches since the last call."""
        told, self.flags = self.flags, []
        return told

    def forget(self) -> None:
        """Start anew: there is no navigation to hold ranges against."""
        if self._time is not None:
            for satellite in list(self._stretches):
                self._end(self._time, satellite, "no navigation to hold it against")
        self._time = self._way = None

    def _refused(
        self, measured: Measured, way: _Way, drift: tuple[float, float] | None
    ) -> Mapping[str, str]:
        """Refused satellites of a tag, to which the way leads, and why."""
        epoch = measured.epoch
        first = self._time is None
        self._r_e_m = way.r_e_m if first else self._r_e_m + way.step_e_m
        grown = way.covariance_e_m2 if first else way.grown_e_m2
        way.step_e_m, way.grown_e_m2 = np.zeros(3), np.zeros((3, 3))
        seen = ranges_from(measured, self.parameters, self._r_e_m)
        if not seen.satellites:
            return NOBODY_REFUSED
        misfit_m = seen.misfit_m + self._counter_m(epoch)
        if first:
            self._start(epoch, misfit_m, grown)
        if drift is not None:
            self._take_drift(*drift)
        passed_s = epoch.time.since(self._time) if self._time is not None else 0.0
        self._predict(passed_s, grown)
        self._time = epoch.time
        self._know(seen, misfit_m)
        H = self._slopes(seen)
        noise_m = np.minimum(
            _LOOP_M * 10.0 ** ((45.0 - seen.cn0_dbhz) / 20.0),
            self.settings.threshold_m / _WIDENING,  # what is noisier is of no use to a position
        )
        clean = self._learn(H, misfit_m, np.hypot(noise_m, _SOUND_M), passed_s)
        if clean:
            self._agreed = epoch.time
        elif self._agreed is None or epoch.time.since(self._agreed) > _LOST_S:
            self.forget()
            return NOBODY_REFUSED
        return self._judge(epoch.time, seen, H, misfit_m, noise_m)

    # --- the filter --------------------------------------------------------------------------

    def _counter_m(self, epoch: Epoch) -> float:
        """How far the sample counter runs ahead of the tags: with it the clock has no steering."""
        ahead_s = epoch.counter.ahead_s
        self._ahead_s = ahead_s if self._ahead_s is None else self._ahead_s
        return SPEED_OF_LIGHT_MPS * (ahead_s - self._ahead_s)

    def _start(self, epoch: Epoch, misfit_m: FloatArray, place: FloatArray) -> None:
        self._names = []
        self._x = np.zeros(_FIXED)
        self._x[_BIAS] = float(np.median(misfit_m))
        self._P = np.diag([0.0, 0.0, 0.0, _UNKNOWN_M**2, _UNKNOWN_MPS**2])
        self._agreed = epoch.time

    def _predict(self, passed_s: float, grown: FloatArray) -> None:
        # A random walk against errors R of a second's tags is followed with the gain √(q/R).
        second_m2 = _SOUND_M**2 * 2.0 * _LASTING_S
        walked_m2 = self.settings.alpha_ps**2 * second_m2 * passed_s
        own_m2 = np.array([walked_m2 if len(name) == 3 else 0.0 for name in self._names])
        self._x, self._P = _predicted(
            self._x,
            self._P,
            passed_s,
            grown,
            CLOCK_NOISE.bias_m_rts,
            CLOCK_NOISE.drift_mps_rts,
            own_m2,
        )

    def _take_drift(self, drift_mps: float, sigma_mps: float) -> None:
        """Believe who knows the counter's drift better than ranges tell it."""
        H = np.zeros((1, self._x.size))
        H[0, _DRIFT] = 1.0
        R = np.array([[sigma_mps**2]])
        self._x, self._P, _, _ = correct(self._x, self._P, np.array([drift_mps]), H, R)

    def _know(self, seen: Ranges, misfit_m: FloatArray) -> None:
        """States for whoever is new; the first system's clock is the receiver's."""
        known = set(self._names)
        if all(satellite in known for satellite in seen.satellites):  # and so their systems
            return
        systems = np.array([satellite[0] for satellite in seen.satellites])
        for system in dict.fromkeys(systems):
            if system not in self._names:
                ahead_m = float(np.median(misfit_m[systems == system])) - self._x[_BIAS]
                alone = not any(len(name) == 1 for name in self._names)
                self._append(system, 0.0 if alone else ahead_m, 1e-3 if alone else _UNKNOWN_M)
        for satellite, sigma_m in zip(seen.satellites, seen.sigma_m, strict=True):
            if satellite not in self._names:
                self._append(satellite, 0.0, float(sigma_m))

    def _append(self, name: str, value: float, sigma: float) -> None:
        size = self._x.size
        P = np.zeros((size + 1, size + 1))
        P[:size, :size], P[size, size] = self._P, sigma**2
        self._names.append(name)
        self._x, self._P = np.append(self._x, value), P

    def _slopes(self, seen: Ranges) -> FloatArray:
        """Misfit = −unit·δ + clock + system + satellite's own."""
        H = np.zeros((len(seen.satellites), self._x.size))
        H[:, _PLACE], H[:, _BIAS] = -seen.unit_e, 1.0
        column = {name: _FIXED + k for k, name in enumerate(self._names)}
        for row, satellite in enumerate(seen.satellites):
            H[row, column[satellite[0]]] = H[row, column[satellite]] = 1.0
        return H

    def _learn(
        self, H: FloatArray, misfit_m: FloatArray, sigma_m: FloatArray, passed_s: float
    ) -> bool:
        """Follow the ranges that agree with each other and with what is known; False: none do."""
        clean = self._agreeing(H, misfit_m, sigma_m)
        if clean.size == 0:
            return False
        together = max(1.0, 2.0 * _LASTING_S / passed_s) if passed_s else 1.0
        R = np.diag(sigma_m[clean] ** 2 * together)
        self._x, self._P, _, _ = correct(self._x, self._P, misfit_m[clean], H[clean], R)
        return True

    def _agreeing(
        self, H: FloatArray, misfit_m: FloatArray, sigma_m: FloatArray
    ) -> NDArray[np.intp]:
        """Rows of sound ranges; none where it cannot be told which they are."""
        count, size = H.shape
        rows = np.arange(count)
        nis = squared_innovation(self._x, self._P, misfit_m, H, np.diag(sigma_m**2))
        if nis <= innovation_limit(count, _FALSE_ALARM):
            return rows
        known = np.linalg.inv(np.linalg.cholesky(self._P))
        A = np.vstack([H / sigma_m[:, np.newaxis], known])
        e = np.append((misfit_m - H @ self._x) / sigma_m, np.zeros(size))
        q, _ = np.linalg.qr(A)  # of full rank by what is known
        e = e - q @ (q.T @ e)
        ones = np.ones(count + size)
        verdict = check_residuals(A, e, ones, _FALSE_ALARM, excludable=count)
        return np.delete(rows, verdict.excluded) if verdict.passed else rows[:0]

    # --- the verdict -------------------------------------------------------------------------

    def _judge(
        self,
        time: GpsTime,
        seen: Ranges,
        H: FloatArray,
        misfit_m: FloatArray,
        noise_m: FloatArray,
    ) -> Mapping[str, str]:
        off_m = misfit_m - H @ self._x
        variance_m2 = np.sum(H @ self._P * H, axis=1) + noise_m**2
        limit_m = np.hypot(self.settings.threshold_m, _WIDENING * np.sqrt(variance_m2))
        refused: dict[str, str] = {}
        for satellite, by_m, most_m in zip(
            seen.satellites, off_m.tolist(), limit_m.tolist(), strict=True
        ):
            stretch = self._stretches.get(satellite)
            if abs(by_m) <= most_m * (_RETURN if stretch else 1.0):
                if stretch:
                    self._end(time, satellite, "sound again")
                continue
            reason = f"range {by_m:+.1f} m off the navigation's, limit {most_m:.1f} m"
            if stretch is None:
                stretch = self._stretches[satellite] = _Stretch(time, 0.0)
                self.flags.append(Flag(time, satellite, True, reason))
            stretch.largest_m = max(stretch.largest_m, abs(by_m))
            self.refused_tags[satellite] = self.refused_tags.get(satellite, 0) + 1
            refused[satellite] = reason
            if time.since(stretch.since) > _PATIENCE_S:
                self._forget_own(satellite)
        for satellite in self._stretches.keys() - set(seen.satellites):
            self._end(time, satellite, "gone")
        return refused

    def _end(self, time: GpsTime, satellite: str, why: str) -> None:
        stretch = self._stretches.pop(satellite)
        lasted_s = time.since(stretch.since)
        reason = f"{why} after {lasted_s:.1f} s, {stretch.largest_m:.1f} m off at most"
        self.flags.append(Flag(time, satellite, False, reason))

    def _forget_own(self, satellite: str) -> None:
        """Its slow value may be what is wrong: start it from the others' at the next tag."""
        row = _FIXED + self._names.index(satellite)
        self._x = np.delete(self._x, row)
        self._P = np.delete(np.delete(self._P, row, 0), row, 1)
        self._names.remove(satellite)


@brief_kernel
def _predicted(
    x: FloatArray,
    P: FloatArray,
    passed_s: float,
    grown_m2: FloatArray,
    bias_m_rts: float,
    drift_mps_rts: float,
    own_m2: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """State and covariance so many seconds later.

    grown (3, 3): covariance of the place; walks of the clock; own: those of the states behind.
    """
    F = np.eye(x.size)
    F[_BIAS, _DRIFT] = passed_s
    P = F @ P @ F.T
    P[_PLACE, _PLACE] += grown_m2
    walk2 = drift_mps_rts**2
    P[_BIAS, _BIAS] += bias_m_rts**2 * passed_s + walk2 * passed_s**3 / 3.0
    P[_BIAS, _DRIFT] += walk2 * passed_s**2 / 2.0
    P[_DRIFT, _BIAS] += walk2 * passed_s**2 / 2.0
    P[_DRIFT, _DRIFT] += walk2 * passed_s
    for k in range(own_m2.size):
        P[_FIXED + k, _FIXED + k] += own_m2[k]
    return F @ x, P
