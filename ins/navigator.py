"""The navigator: an estimate carried over blocks of increments, covariance and all.

    navigator, trajectory = navigator.advance(block)
    navigator = navigator.corrected(x, P)

`advance` goes to the end of the block (or to an instant in it), `corrected` feeds an estimated
error back. Both return a new navigator; nothing changes in place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import median
from typing import Final

import numpy as np

from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray, ImuBlock, InsState
from deepgnss.ins.error_model import (
    ATTITUDE,
    POSITION,
    VELOCITY,
    ProcessNoise,
    predicted,
    transition,
)
from deepgnss.ins.error_state import Estimate
from deepgnss.ins.increments import (
    LONGEST_BRIDGE_S,
    SAME_INSTANT_S,
    Gap,
    Reading,
    between,
    bridge,
    gaps,
    joined,
    rows,
)
from deepgnss.ins.mechanization import (
    NOTHING_BEFORE,
    Calibration,
    Increment,
    Poses,
    calibration_of,
    mechanize,
    pose_of,
    triple,
    without_errors,
)
from deepgnss.ins.trajectory import Trajectory

BRIDGE_FORCE_MPS2: Final = 1.0
"""1σ of a vehicle's acceleration against the line through a gap of a second, growing with it."""

BRIDGE_RATE_RADPS: Final = 0.1
"""1σ of a vehicle's turn rate against the line through a gap of a second, growing with it."""


@dataclass(frozen=True, slots=True)
class InsNavigator:
    """An estimate at an instant, and what is needed to carry it on.

    covariance_step_s: covariances are kept at steps of this length (one increment at least) and at
    the end of every stretch.
    """

    estimate: Estimate
    noise: ProcessNoise
    before: Reading | None = None  # the increment that ends at the estimate's instant
    covariance_step_s: float = 1.0

    @property
    def state(self) -> InsState:
        """Navigation state."""
        return self.estimate.ins

    def advance(self, block: ImuBlock, end_s: float = np.inf) -> tuple[InsNavigator, Trajectory]:
        """Carry the estimate through the increments of a block, as far as `end_s`.

        Increments before the estimate's own instant are left out; one that reaches across it, or
        across `end_s` (seconds since the block's origin), counts by its share. Gaps of at most a
        second are bridged and named in the trajectory; at a longer one it ends, with `outage`
        saying so: the estimate then stands at the gap's start and is not to be carried across.
        """
        start_s = self.state.time.since(block.origin)
        asked = between(block, start_s, end_s)
        whole, bridged, outage = _without_gaps(asked, start_s, self.before)
        poses, before = self._mechanized(whole)
        covariance_time_s, covariances, Phi, Q = self._covariances(start_s, whole, poses)
        for gap, noise in bridged:
            covariances[covariance_time_s >= gap.end_s - SAME_INSTANT_S] += _padded(
                noise, self.estimate.layout.size
            )
            Q = Q + _padded(noise, Q.shape[0])
        state = self.state
        trajectory = Trajectory(
            block.origin,
            np.concatenate([[start_s], whole.time_s]),
            np.concatenate([[state.lat_rad], poses.lat_rad]),
            np.concatenate([[state.lon_rad], poses.lon_rad]),
            np.concatenate([[state.height_m], poses.height_m]),
            np.concatenate([state.v_n_mps[np.newaxis], poses.v_n_mps]),
            np.concatenate([state.q_nb[np.newaxis], poses.q_nb]),
            poses.dtheta_b_rad / whole.dt_s[:, np.newaxis],
            poses.dv_b_mps / whole.dt_s[:, np.newaxis],
            covariance_time_s,
            covariances,
            Phi,
            Q,
            tuple(gap for gap, _ in bridged),
            outage,
        )
        return self._at_end(trajectory, before), trajectory

    def corrected(self, x: FloatArray, P: FloatArray) -> InsNavigator:
        """The navigator freed of an estimated error x (estimate − truth), whose covariance is P."""
        return replace(self, estimate=self.estimate.corrected(x, P))

    def _mechanized(self, block: ImuBlock) -> tuple[Poses, Reading | None]:
        calibration = calibration_of(self.state)
        poses, _, _ = mechanize(
            pose_of(self.state),
            _freed(self.before, calibration),
            calibration,
            block.dt_s,
            block.dtheta_b_rad,
            block.dv_b_mps,
        )
        if block.dt_s.size == 0:
            return poses, self.before
        return poses, Reading(
            float(block.dt_s[-1]), block.dtheta_b_rad[-1].copy(), block.dv_b_mps[-1].copy()
        )

    def _covariances(
        self, start_s: float, block: ImuBlock, poses: Poses
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Instants and covariances at the steps, and Φ and Q from start to end."""
        inertial = self.estimate.layout.inertial
        P, times = self.estimate.P, [start_s]
        kept = [P]
        Phi, Q = np.eye(inertial), np.zeros((inertial, inertial))
        for first, end in _steps(start_s, block, self.covariance_step_s):
            Phi_step, Q_step = transition(
                poses.lat_rad[first:end],
                poses.height_m[first:end],
                poses.v_n_mps[first:end],
                poses.q_nb[first:end],
                block.dt_s[first:end],
                poses.dtheta_b_rad[first:end],
                poses.dv_b_mps[first:end],
                self.noise,
                inertial,
            )
            P = _carried(P, Phi_step, Q_step)
            Phi, Q = Phi_step @ Phi, _carried(Q, Phi_step, Q_step)
            times.append(float(block.time_s[end - 1]))
            kept.append(P)
        return np.array(times), np.array(kept), Phi, Q

    def _at_end(self, trajectory: Trajectory, before: Reading | None) -> InsNavigator:
        lon_rad = (float(trajectory.lon_rad[-1]) + math.pi) % (2.0 * math.pi) - math.pi
        state = replace(
            self.state,
            time=trajectory.origin.plus(float(trajectory.time_s[-1])),
            lat_rad=float(trajectory.lat_rad[-1]),
            lon_rad=lon_rad,
            height_m=float(trajectory.height_m[-1]),
            v_n_mps=trajectory.v_n_mps[-1],
            q_nb=trajectory.q_nb[-1],
        )
        estimate = replace(self.estimate, ins=state, P=trajectory.covariances[-1])
        return replace(self, estimate=estimate, before=before)


def _freed(reading: Reading | None, calibration: Calibration) -> Increment:
    if reading is None:
        return NOTHING_BEFORE
    raw = Increment(reading.dt_s, triple(reading.dtheta_b_rad), triple(reading.dv_b_mps))
    return without_errors(raw, calibration)


def _steps(start_s: float, block: ImuBlock, step_s: float) -> list[tuple[int, int]]:
    """Rows first … end − 1 of steps of about equal length."""
    if block.time_s.size == 0:
        return []
    count = max(1, round((float(block.time_s[-1]) - start_s) / step_s))
    if count == 1:
        return [(0, block.time_s.size)]
    borders_s = np.linspace(start_s, float(block.time_s[-1]), count + 1)[1:]
    ends = np.unique(np.searchsorted(block.time_s, borders_s - SAME_INSTANT_S) + 1)
    ends[-1] = block.time_s.size
    return list(zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True))


@brief_kernel
def _carried(P: FloatArray, Phi: FloatArray, Q: FloatArray) -> FloatArray:
    """Φ·P·Φᵀ + Q, with errors behind the inertial ones standing still."""
    states = Phi.shape[0]
    inertial, beside = P[:states, :states].copy(), P[:states, states:].copy()
    later = P.copy()
    later[:states, :states] = predicted(inertial, Phi, Q)
    later[:states, states:] = Phi @ beside
    later[states:, :states] = later[:states, states:].T
    return later


def _without_gaps(
    block: ImuBlock, start_s: float, before: Reading | None
) -> tuple[ImuBlock, list[tuple[Gap, FloatArray]], Gap | None]:
    """Increments up to the first long gap, short ones filled, and what the filling may be off by.

    The latter are variances (9,) of position, velocity and attitude at a gap's end.
    """
    pieces: list[ImuBlock] = []
    bridged: list[tuple[Gap, FloatArray]] = []
    done = 0
    if block.dt_s.size == 0:
        return block, bridged, None
    usual_s = max(median(block.dt_s.tolist()), before.dt_s if before else 0.0)  # some may be cut
    found = gaps(block, start_s, usual_s)
    if not found:
        return block, bridged, None
    for row, gap in found:
        pieces.append(rows(block, done, row))
        done = row
        if gap.length_s > LONGEST_BRIDGE_S + SAME_INSTANT_S:
            return joined(*pieces), bridged, gap
        if row > 0:
            before = _reading(block, row - 1)
        pieces.append(bridge(block, row, gap, before))
        bridged.append((gap, _bridge_noise(before, _reading(block, row), gap.length_s)))
    return joined(*pieces, rows(block, done, block.time_s.size)), bridged, None


def _reading(block: ImuBlock, row: int) -> Reading:
    return Reading(float(block.dt_s[row]), block.dtheta_b_rad[row], block.dv_b_mps[row])


def _bridge_noise(before: Reading | None, after: Reading, length_s: float) -> FloatArray:
    """Variances (9,) from half the step of rate and force over the gap, and a vehicle's motion."""
    before = after if before is None else before
    step_radps = after.dtheta_b_rad / after.dt_s - before.dtheta_b_rad / before.dt_s
    step_mps2 = after.dv_b_mps / after.dt_s - before.dv_b_mps / before.dt_s
    rate_radps = np.hypot(0.5 * np.abs(step_radps).max(), BRIDGE_RATE_RADPS * length_s)
    force_mps2 = np.hypot(0.5 * np.abs(step_mps2).max(), BRIDGE_FORCE_MPS2 * length_s)
    variances = np.zeros(9)
    variances[POSITION] = (0.5 * force_mps2 * length_s**2) ** 2
    variances[VELOCITY] = (force_mps2 * length_s) ** 2
    variances[ATTITUDE] = (rate_radps * length_s) ** 2
    return variances


def _padded(variances: FloatArray, size: int) -> FloatArray:
    return np.diag(np.concatenate([variances, np.zeros(size - variances.size)]))
