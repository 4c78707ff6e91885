"""How late the inertial log is against the receiver's time, from what both say of the motion.

Over a few seconds the antenna's velocity is v_i = v_0 + C_n0·α_i + fall·t_i, with α the specific
force summed up in the body axes of the start. A log whose stamps are late by τ holds at t + τ what
happened at t: α shifts along the specific force, by τ·(f_i − f_0). Each stretch is solved for τ
beside attitude, velocity and the errors of the sensors, whose noise bends α from one second to the
next; stretches add up by their information. Nothing of it needs an aligned navigation, and nothing
later than the fixes is looked at.

A Doppler velocity is what a carrier loop makes of the motion, L[v]: at the frequencies that tell τ
a loop of a few Hz lags by as much as the offsets looked for. An aided one gives L[v] + (1 − L)[u]
with u the log's own word. What the sensors felt goes through the same loop before it is compared.

Late is positive: what `imu.time_offset` (added to the log's times) must take off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.attitude import from_rotation_vector, rotation_matrix, skew
from deepgnss.core.frames import geodetic
from deepgnss.core.jit import brief_kernel
from deepgnss.core.loops import follow, loop_gains
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.ins.coarse import (
    SURE_YAW_RAD,
    Track,
    attitude_by_motion,
    free_fall_mps2,
    reckoned,
)
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.increments import between, gaps

STRETCH_S: Final = 10.0
"""Length of a stretch: what it takes anew, attitude and biases, costs half of a shorter one."""

LARGEST_S: Final = 1.0
"""Offsets looked for; what is further off is a matter of the log's clock, not of its delay."""

_FEWEST = 12  # fixes in a stretch
_BIN_S = 1.0  # over which the sensors' noise is taken as one step
_APART_S = 0.02  # half of the stretch over which the specific force at a fix is taken
_SETTLING_S = 1.5  # of the loop, before the first fix of a stretch
_FLOOR_MPS = 0.005  # 1σ of a Doppler velocity at its best
_GRID_S = 0.2  # of the first search
_PLAIN = 0.5  # of the squares left, for an offset to start from
_REACH_S = 0.3  # that a later one may differ
_ROUNDS = 8  # of Gauss–Newton with weights of its own
_SETTLED_S = 1e-4
_STEP_S = 0.1  # farthest of a round: linear no further
_WANDER_S = 0.01  # from one stretch to another
_VAGUE_S = 0.05  # 1σ from which a stretch says nothing
_LIVELY_MPS = 0.7  # spread of velocities that should tell
_REMEMBERED = 3  # stretches that did not
_HUBER = 1.5  # σ from which a velocity counts less
_FORGET_S = 600.0  # a log's delay may wander with its clock
_SURE_S = 0.004  # 1σ with which an offset is taken at its word …
_SURE_SHARE = 0.1  # or share of itself
_SURE_STRETCHES = 2  # … and stretches that must have told it


class StretchFit(NamedTuple):
    """What a stretch of fixes and increments say together."""

    time_s: float  # its end, since the increments' origin
    late_s: float  # of the log's stamps
    sigma_s: float  # 1σ of it
    residual_mps: float  # robust 1σ of a velocity against the sensors
    moved_mps: float  # the same of a velocity against its mean: what there was to explain
    gyro_bias_radps: FloatArray  # (3,) found
    accel_bias_mps2: FloatArray  # (3,) found
    forward_b: FloatArray  # (3,) direction of travel in body axes; zeros: too slow to tell


class CarrierLoop(NamedTuple):
    """The loop behind the velocities, as most channels run it."""

    order: int
    bandwidth_hz: float
    interval_s: float

    def frequency(self, phase: FloatArray) -> FloatArray:
        """Frequencies (n, 3) it finds, per interval, in mean phases (n, 3) of n intervals."""
        gain = np.array(loop_gains(*self)) * self.interval_s ** np.arange(3)
        found = np.empty(phase.shape)
        follow(gain, phase, found)
        return found


class Offset(NamedTuple):
    """How late the log is, as far as known."""

    late_s: float
    sigma_s: float
    stretches: int

    @property
    def sure(self) -> bool:
        """Whether it may be taken off."""
        limit_s = max(_SURE_S, _SURE_SHARE * abs(self.late_s))
        return self.stretches >= _SURE_STRETCHES and self.sigma_s <= limit_s

    @property
    def significant(self) -> bool:
        """Whether it is more than chance and large enough to matter: 5 ms at 2 m/s² are 1 cm/s."""
        return self.sure and abs(self.late_s) > max(0.005, 4.0 * self.sigma_s)

    def moved(self, seconds: float) -> Offset:
        """The same of a log that has been moved forward in time."""
        return self._replace(late_s=self.late_s + seconds)

    @property
    def reach_s(self) -> float:
        """How far from a fix the increments may lie that belong to it."""
        return abs(self.late_s) + _REACH_S if self.sure else LARGEST_S + _GRID_S

    def __str__(self) -> str:
        way = "late" if self.late_s >= 0.0 else "early"
        return f"{abs(self.late_s):.3f} s {way} (±{self.sigma_s:.3f} s)"


UNKNOWN = Offset(0.0, math.inf, 0)


def fit_stretch(
    block: ImuBlock,
    fixes: Sequence[GnssFix],
    grade: ImuGrade,
    lever_b_m: FloatArray,
    loop: CarrierLoop,
    known: Offset = UNKNOWN,
    aided: bool = False,
) -> StretchFit | str:
    """Fit increments to the velocities of a few seconds of fixes, or why that cannot be done.

    loop, aided: the carrier loop behind the velocities, and whether this log aided it. known: by
    other stretches; it says where to look, and is no part of what this one says.
    """
    fixes = [f for f in fixes if f.v_n_mps is not None and np.isfinite(f.v_n_mps).all()]
    if len(fixes) < _FEWEST:
        return "too few velocities"
    time_s = np.array([f.time.since(block.origin) for f in fixes])
    reach_s = known.reach_s
    piece = between(block, time_s[0] - _SETTLING_S - reach_s, time_s[-1] + reach_s)
    if piece.time_s.size < 2 or gaps(piece, float(piece.time_s[0]), float(np.median(piece.dt_s))):
        return "increments missing"
    track = Track(
        time_s,
        np.array([f.v_n_mps for f in fixes]),
        np.array([f.velocity_sigma_mps for f in fixes]),
    )
    lat_rad, _, height_m = geodetic(fixes[0].r_e_m)
    fall = free_fall_mps2(lat_rad, height_m, track.v_n_mps.mean(axis=0))
    stretch = _Stretch(piece, track, grade, lever_b_m, fall, loop, aided)
    if known.sure:
        return stretch.solved(known.late_s, math.hypot(2.0 * known.sigma_s, _WANDER_S))
    found_s = stretch.searched()
    if found_s is not None or known.sigma_s > _VAGUE_S:
        return stretch.solved(found_s or 0.0, _GRID_S / 2.0)
    return stretch.solved(known.late_s, math.hypot(2.0 * known.sigma_s, _WANDER_S))


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Fixes and the increments around them."""

    block: ImuBlock
    track: Track
    grade: ImuGrade
    lever_b_m: FloatArray
    fall_n_mps2: FloatArray
    loop: CarrierLoop
    aided: bool

    def covers(self, late_s: float) -> bool:
        """Whether there are increments for all fixes."""
        first_s, last_s = self.block.time_s[0] - self.block.dt_s[0], self.block.time_s[-1]
        both_s = (late_s, 0.0 if self.aided else late_s)
        since_s = float(self.track.time_s[0]) + min(both_s) - _SETTLING_S - 2.0 * _APART_S
        until_s = float(self.track.time_s[-1]) + max(both_s) + 2.0 * _APART_S
        return bool(since_s >= first_s - 1e-9 and until_s <= last_s + 1e-9)

    @property
    def _grid_s(self) -> FloatArray:
        """Intervals of the loop, from before the first fix, where it settles, to the last."""
        track, step_s = self.track, self.loop.interval_s
        since_s = track.time_s[0] - _SETTLING_S - _APART_S
        count = math.ceil((track.time_s[-1] + _APART_S - since_s) / step_s) + 1
        return np.asarray(since_s + step_s * np.arange(count))

    def _gained(self, late_s: float) -> FloatArray:
        """Specific force summed up on the grid (n, 3), in the body axes of its start."""
        return reckoned(self.block, self._grid_s + late_s, self.lever_b_m).gained_0_mps

    def _looped(
        self, late_s: float, C_n0: FloatArray, told_0_mps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What the loop makes of the velocity felt at the fixes (m, 3), and its slope over τ.

        C_n0: of the first fix at `late_s`; told: what the log, as it is, has aided the loop with.
        """
        track, grid_s = self.track, self._grid_s
        first_s = float(track.time_s[0]) + late_s

        def velocity(gained_0_mps: FloatArray, late_s: float) -> FloatArray:
            both_s = np.array([grid_s[0] + late_s, first_s])
            here = reckoned(self.block, both_s, self.lever_b_m)
            C = C_n0 @ rotation_matrix(here.q_0b[1]).T
            fall = np.outer(grid_s - grid_s[0], self.fall_n_mps2)
            return np.asarray(gained_0_mps @ C.T + fall)

        felt = velocity(self._gained(late_s), late_s)
        moves = shown = self._followed(felt)
        if self.aided:
            given = velocity(told_0_mps, 0.0)
            shown = self._followed(felt - given) + given
        before, after = (
            _columns_at(track.time_s + apart_s, grid_s, moves) for apart_s in (-_APART_S, _APART_S)
        )
        now = _columns_at(track.time_s, grid_s, shown)
        return now - now[0], (after - before) / (2.0 * _APART_S)

    def _followed(self, v_n_mps: FloatArray) -> FloatArray:
        """Velocities (n, 3), an interval apart, as the loop gives them."""
        middle = 0.5 * (v_n_mps[1:] + v_n_mps[:-1])
        way = np.concatenate([np.zeros((1, 3)), np.cumsum(middle, axis=0)])
        return self.loop.frequency(way - way[0])

    def searched(self) -> float | None:
        """The offset of a grid with which attitude alone explains most; None: it hardly tells."""
        grid_s = np.arange(-LARGEST_S, LARGEST_S + _GRID_S / 2, _GRID_S)
        costs = [self._cost(late_s) if self.covers(late_s) else np.inf for late_s in grid_s]
        best, here = int(np.argmin(costs)), int(np.argmin(np.abs(grid_s)))
        return float(grid_s[best]) if costs[best] < _PLAIN * costs[here] else None

    def _cost(self, late_s: float) -> float:
        felt = reckoned(self.block, self.track.time_s + late_s, self.lever_b_m)
        found = attitude_by_motion(self.track, felt, self.fall_n_mps2, self.grade.gyro_bias_radps)
        return found.misfit

    def solved(self, near_s: float, spread_s: float) -> StretchFit | str:
        """Gauss–Newton on everything, each velocity weighted by how it fits.

        A stretch that hardly tells τ would wander off: it is solved near what is known, and then
        asked what it says itself.
        """
        C: FloatArray | None = None
        track, count = self.track, self.track.time_s.size
        relative = track.sigma_mps / np.median(track.sigma_mps)
        scale_mps, weight = 0.2 * float(np.median(track.sigma_mps)), np.ones(count)
        told_0_mps = self._gained(0.0) if self.aided else np.zeros((0, 3))
        x, sigma_s, late_s, says_s = np.zeros(0), math.inf, near_s, 0.0
        residual = np.zeros((count, 3))
        for _ in range(_ROUNDS):
            if not self.covers(late_s):
                return "no offset found"
            felt = reckoned(self.block, track.time_s + late_s, self.lever_b_m)
            if C is None:
                found = attitude_by_motion(
                    track, felt, self.fall_n_mps2, self.grade.gyro_bias_radps
                )
                if found.yaw_sigma_rad > SURE_YAW_RAD:
                    return "neither speeding up nor turning"
                C = found.C_n0
            gained, C_nb = felt.gained_0_mps @ C.T, C @ rotation_matrix(felt.q_0b)
            shown, slope = self._looped(late_s, C, told_0_mps)
            sigma = scale_mps * relative / np.sqrt(weight)
            A, prior = _design(track.time_s, gained, slope, self.fall_n_mps2, C_nb, self.grade)
            y = track.v_n_mps - shown
            rows = A / sigma[:, np.newaxis, np.newaxis]
            normal = np.einsum("mij,mik->jk", rows, rows) + np.diag(prior)
            pull = np.einsum("mij,mi->j", rows, y / sigma[:, np.newaxis])
            covariance = np.linalg.inv(normal)
            sigma_s = math.sqrt(float(covariance[_LATE, _LATE]))
            says_s = late_s + float(covariance[_LATE] @ pull)
            normal[_LATE, _LATE] += spread_s**-2
            pull[_LATE] += (near_s - late_s) * spread_s**-2
            x = np.linalg.solve(normal, pull)
            residual = (y - A @ x) / relative[:, np.newaxis]
            scale_mps = max(1.48 * float(np.median(np.abs(residual))), _FLOOR_MPS)
            size = np.linalg.norm(residual, axis=1) / (scale_mps * math.sqrt(3.0))
            weight = np.minimum(1.0, _HUBER / np.maximum(size, 1e-9))
            late_s += min(max(float(x[_LATE]), -_STEP_S), _STEP_S)
            turn = (float(x[3]), float(x[4]), float(x[5]))
            C = rotation_matrix(np.array(from_rotation_vector(turn))) @ C
        sigma_s *= _inflated(residual)
        if abs(float(x[_LATE])) > max(_SETTLED_S, 0.2 * sigma_s) or sigma_s > _VAGUE_S:
            return "no offset found"
        return StretchFit(
            float(track.time_s[-1]),
            says_s,
            sigma_s,
            scale_mps,
            1.48 * float(np.median(np.abs(track.v_n_mps - track.v_n_mps.mean(axis=0)))),
            x[_GYRO],
            x[_ACCEL],
            _forward(track, C_nb),
        )


def _columns_at(time_s: FloatArray, grid_s: FloatArray, values: FloatArray) -> FloatArray:
    """Columns of values (n, 3), linear between the points of a grid (n,)."""
    return np.column_stack([np.interp(time_s, grid_s, column) for column in values.T])


_LATE = 6
_GYRO, _ACCEL = slice(7, 10), slice(10, 13)


def _design(
    time_s: FloatArray,
    gained_n: FloatArray,
    slope_n: FloatArray,
    fall_n: FloatArray,
    C_nb: FloatArray,
    grade: ImuGrade,
) -> tuple[FloatArray, FloatArray]:
    """Slopes (m, 3, k) of velocities and prior information (k,) of their unknowns.

    Unknown: v_0, φ_0, τ, biases of gyros and accelerometers, then by bin of a second what their
    noise turned, and by how much their biases drifted.
    """
    since_s = time_s - time_s[0]
    edges_s = np.arange(0.0, since_s[-1], _BIN_S)
    eye = np.broadcast_to(np.eye(3), C_nb.shape)
    columns: list[FloatArray] = [eye, -skew(gained_n), slope_n[:, :, np.newaxis]]
    information: list[FloatArray] = [np.full(7, 1e-6)]
    pull = -skew(slope_n - fall_n)  # δv̇ = φ × f = −f × φ
    # ten times the grade: what is beyond that is for the residuals to say
    gyro, accel = 10.0 * grade.gyro_bias_radps, 10.0 * grade.accel_bias_mps2
    columns += [_summed(time_s, pull @ _summed(time_s, -C_nb)), _summed(time_s, -C_nb)]
    information += [np.full(3, gyro**-2), np.full(3, accel**-2)]
    root_s = math.sqrt(_BIN_S)
    for edge_s in edges_s:
        on = (since_s >= edge_s).astype(float)[:, np.newaxis, np.newaxis]
        columns += [
            _summed(time_s, pull * on),
            _summed(time_s, pull @ _summed(time_s, -C_nb * on)),
            _summed(time_s, -C_nb * on),
        ]
        information += [
            np.full(3, (grade.gyro_noise_rad_rts * root_s) ** -2),
            np.full(3, (grade.gyro_drift_radps2_rthz * root_s) ** -2),
            np.full(3, (grade.accel_drift_mps3_rthz * root_s) ** -2),
        ]
    return np.concatenate(columns, axis=2), np.concatenate(information)


@brief_kernel
def _summed(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Integral from the first instant on, (m, …), by the trapezoidal rule."""
    sums = np.zeros(values.shape)
    for k in range(1, time_s.size):
        step = 0.5 * (values[k] + values[k - 1]) * (time_s[k] - time_s[k - 1])
        sums[k] = sums[k - 1] + step
    return sums


def _inflated(residual: FloatArray) -> float:
    """Factor on a σ for residuals that are not independent, from their lag-one correlation."""
    power = float(np.sum(residual**2))
    rho = float(np.sum(residual[1:] * residual[:-1])) / power if power > 0.0 else 0.0
    rho = min(max(rho, 0.0), 0.9)
    return math.sqrt((1.0 + rho) / (1.0 - rho))


def _forward(track: Track, C_nb: FloatArray) -> FloatArray:
    """Mean direction of travel in body axes, (3,); zeros where nothing moves fast enough."""
    fast = np.linalg.norm(track.v_n_mps, axis=1) > 3.0
    if not fast.any():
        return np.zeros(3)
    mean = np.einsum("mji,mj->i", C_nb[fast], track.v_n_mps[fast])
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9))


@dataclass(slots=True)
class OffsetEstimator:
    """Adds stretches up as the fixes come.

    Times of fixes and log as they are; a log that has been shifted is told by `shifted`.
    """

    grade: ImuGrade
    lever_b_m: FloatArray
    loop: CarrierLoop
    fits: list[StretchFit] = field(default_factory=list)
    unexplained: list[list[GnssFix]] = field(default_factory=list)  # the last in lively motion
    _waiting: list[GnssFix] = field(default_factory=list)
    _aided: bool = False

    def take(self, block: ImuBlock, fix: GnssFix, *, aided: bool) -> StretchFit | None:
        """Take a fix in; the stretch that ends with it, if one does and tells something.

        aided: whether the log, as it is in the block, aids the loops.
        """
        waiting = self._waiting
        if waiting and (fix.time.since(waiting[-1].time) > 1.0 or aided is not self._aided):
            waiting.clear()
        self._aided = aided
        waiting.append(fix)
        known = self.offset
        # What a late log says of these fixes bears the stamps of fixes to come: wait for them.
        first = waiting[0].time
        if fix.time.since(first) < STRETCH_S + known.reach_s:
            return None
        inside = [f for f in waiting if f.time.since(first) <= STRETCH_S]
        self._waiting = waiting[len(inside) :]
        fitted = fit_stretch(block, inside, self.grade, self.lever_b_m, self.loop, known, aided)
        if isinstance(fitted, str):
            if _lively(inside):
                self.unexplained = [*self.unexplained, inside][-_REMEMBERED:]
            return None
        self.fits.append(fitted)
        while fitted.time_s - self.fits[0].time_s > _FORGET_S:
            self.fits.pop(0)
        return fitted

    @property
    def offset(self) -> Offset:
        """Weighted mean of the stretches, those aside that contradict the others."""
        if not self.fits:
            return UNKNOWN
        late_s = np.array([fit.late_s for fit in self.fits])
        sigma_s = np.array([fit.sigma_s for fit in self.fits])
        mean_s = _weighted_median(late_s, sigma_s**-2.0)
        inside = np.abs(late_s - mean_s) <= 4.0 * sigma_s
        if not inside.any():
            return Offset(mean_s, math.inf, 0)
        weight = sigma_s[inside] ** -2.0
        mean_s = float(np.average(late_s[inside], weights=weight))
        chi2 = float(np.sum(weight * (late_s[inside] - mean_s) ** 2))
        spread = max(1.0, chi2 / max(int(inside.sum()) - 1, 1))
        return Offset(mean_s, math.sqrt(spread / float(weight.sum())), int(inside.sum()))

    def shifted(self, seconds: float) -> None:
        """The log's times have been moved by some seconds."""
        self.fits = [fit._replace(late_s=fit.late_s + seconds) for fit in self.fits]


def _lively(fixes: Sequence[GnssFix]) -> bool:
    velocities = [f.v_n_mps for f in fixes if f.v_n_mps is not None]
    return bool(velocities) and float(np.std(velocities, axis=0).max()) > _LIVELY_MPS


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][int(np.searchsorted(total, 0.5 * total[-1]))])
