"""Navigations and loops run step by step with drawn errors: what the formulas are held against.

Nothing here knows theory's formulas. A vehicle keeps a specific force in NED; its increments go
through the strapdown mechanization of `ins` (round, turning Earth, gravity, transport and all)
once as they are and once with the errors of a unit on them; the difference of the two velocities
feeds a sampled loop forward. A run of the unit with every error at +1σ gives the sums T draws.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.attitude import quaternion_from_rotation_vector
from deepgnss.core.earth import earth_rate_n, gravity_mps2
from deepgnss.core.loops import loop_gains
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.core.time import GpsTime
from deepgnss.ins.imu_errors import ImuErrors
from deepgnss.ins.mechanization import NOTHING_BEFORE, Calibration, Pose, mechanize

_LAT_RAD: Final = math.radians(45.0)
_ZERO: Final = (0.0, 0.0, 0.0)
_NO_ERRORS: Final = Calibration(_ZERO, _ZERO, _ZERO, _ZERO)
_NOTHING: Final = np.zeros(3)
_START: Final = GpsTime(2300, 0.0)


class Motion(NamedTuple):
    """Constant acceleration north and east from rest, level, nose north."""

    north_mps2: float
    east_mps2: float
    seconds: float
    rate_hz: float  # of the inertial unit

    @property
    def force_n_mps2(self) -> FloatArray:
        """Specific force (3,) in NED, as theory takes it: gravity here is that of the place."""
        down = -float(gravity_mps2(_LAT_RAD, 0.0))
        return np.array([self.north_mps2, self.east_mps2, down])


def times_s(motion: Motion) -> FloatArray:
    """Ends of the unit's intervals (n,), since the start."""
    return _increments(motion).time_s


def signed_mps(grade: ImuGrade, motion: Motion, axis: int = 0) -> FloatArray:
    """Velocity error (n,), estimate − truth, of a unit without noise, every other error at +1σ."""
    ideal = _increments(motion)
    dt_s = ideal.dt_s[:, np.newaxis]
    read = replace(
        ideal,
        dtheta_b_rad=ideal.dtheta_b_rad + grade.gyro_bias_radps * dt_s,
        dv_b_mps=ideal.dv_b_mps * (1.0 + grade.accel_scale) + grade.accel_bias_mps2 * dt_s,
    )
    errors = _velocities(read, np.full(3, grade.velocity_mps), _tilts(grade))
    return np.asarray((errors - _velocities(ideal))[:, axis])


def white_mps(
    grade: ImuGrade, motion: Motion, runs: int, rng: np.random.Generator, axis: int = 0
) -> FloatArray:
    """Velocity errors (runs, n) by noise and drift alone."""
    noise = grade._replace(
        gyro_bias_radps=0.0, gyro_scale=0.0, accel_bias_mps2=0.0, accel_scale=0.0
    )
    ideal = _increments(motion)
    truth = _velocities(ideal)[:, axis]
    errors = np.empty((runs, truth.size))
    for k in range(runs):
        read, _ = ImuErrors(noise, rng).apply(ideal)
        errors[k] = _velocities(read)[:, axis] - truth
    return errors


def drawn_mps(
    grade: ImuGrade, motion: Motion, runs: int, rng: np.random.Generator, axis: int = 0
) -> FloatArray:
    """Velocity errors (runs, n) by what is drawn once alone; gyro scale left out, as T does."""
    constant = grade._replace(
        gyro_drift_radps2_rthz=0.0,
        gyro_noise_rad_rts=0.0,
        accel_drift_mps3_rthz=0.0,
        accel_noise_mps_rts=0.0,
        gyro_scale=0.0,
    )
    ideal = _increments(motion)
    truth = _velocities(ideal)[:, axis]
    errors = np.empty((runs, truth.size))
    for k in range(runs):
        read, _ = ImuErrors(constant, rng).apply(ideal)
        velocity = grade.velocity_mps * rng.standard_normal(3)
        tilt = _tilts(grade) * rng.standard_normal(3)
        errors[k] = _velocities(read, velocity, tilt)[:, axis] - truth
    return errors


def _tilts(grade: ImuGrade) -> FloatArray:
    return np.array([grade.tilt_rad, grade.tilt_rad, grade.heading_rad])


def _increments(motion: Motion) -> ImuBlock:
    """What a unit without errors reads while its axes stay those of NED."""
    n = round(motion.seconds * motion.rate_hz)
    dt_s = np.full(n, 1.0 / motion.rate_hz)
    return ImuBlock(
        _START,
        np.cumsum(dt_s),
        dt_s,
        np.outer(dt_s, earth_rate_n(_LAT_RAD)),
        np.outer(dt_s, motion.force_n_mps2),
    )


def _velocities(
    read: ImuBlock, velocity_mps: FloatArray = _NOTHING, phi_rad: FloatArray = _NOTHING
) -> FloatArray:
    """Velocities (n, 3) of a navigation that starts with these errors: C_est = (I − φ×)·C."""
    north, east, down = (float(v) for v in velocity_mps)
    w, x, y, z = (float(q) for q in quaternion_from_rotation_vector(-phi_rad))
    pose = Pose(_LAT_RAD, 0.0, 0.0, (north, east, down), (w, x, y, z))
    poses, _, _ = mechanize(
        pose, NOTHING_BEFORE, _NO_ERRORS, read.dt_s, read.dtheta_b_rad, read.dv_b_mps
    )
    return poses.v_n_mps


# --- what is made of a velocity that is wrong -----------------------------------------------------


def open_loop_m(velocity_mps: FloatArray, interval_s: float) -> FloatArray:
    """Way (…, n) that velocities at the ends of intervals (…, n) add up to."""
    return np.asarray(np.cumsum(0.5 * interval_s * (_before(velocity_mps) + velocity_mps), axis=-1))


def finer(velocity_mps: FloatArray, factor: int) -> FloatArray:
    """Velocities (…, n) at the ends of intervals, in the middles of `factor` parts of each."""
    before = _before(velocity_mps)
    at = (np.arange(factor) + 0.5) / factor
    parts = before[..., np.newaxis] * (1.0 - at) + velocity_mps[..., np.newaxis] * at
    return np.asarray(parts.reshape(*velocity_mps.shape[:-1], -1))


def _before(velocity_mps: FloatArray) -> FloatArray:
    """Velocities at the begins of the intervals, the first carried back in a line."""
    first = 2.0 * velocity_mps[..., :1] - velocity_mps[..., 1:2]
    return np.concatenate([first, velocity_mps[..., :-1]], axis=-1)


def closed_loop_m(
    velocity_mps: FloatArray, interval_s: float, order: int, bandwidth_hz: float
) -> FloatArray:
    """Phase error (…, n), m, in the middles of intervals, of the receiver's loop fed forward by
    wrong velocities (…, n) there.

    The loop of `core.loops`: in every interval it sees its mean phase error and corrects phase,
    frequency and rate in the middle of it.
    """
    gains = loop_gains(order, bandwidth_hz, interval_s)
    phase, frequency, rate = (np.zeros(velocity_mps.shape[:-1]) for _ in range(3))
    out = np.empty_like(velocity_mps)
    T = interval_s
    before = np.zeros(velocity_mps.shape[:-1])
    for k in range(velocity_mps.shape[-1]):
        # the way from the middle of the interval before to that of this one
        phase = phase + 0.5 * T * (before + velocity_mps[..., k])
        before = velocity_mps[..., k]
        out[..., k] = phase
        seen = phase
        phase = phase - gains.phase * seen
        frequency = frequency - gains.frequency * seen
        rate = rate - gains.rate * seen
        phase = phase + T * frequency + 0.5 * T * T * rate
        frequency = frequency + T * rate
    return out


def damped_loop_m(
    velocity_mps: FloatArray, interval_s: float, omega_radps: float, damping: float
) -> FloatArray:
    """The same of a loop of order 2 with this damping, T figure 4.2, as a sampled PI controller."""
    phase, integral = (np.zeros(velocity_mps.shape[:-1]) for _ in range(2))
    out = np.empty_like(velocity_mps)
    for k in range(velocity_mps.shape[-1]):
        drive = velocity_mps[..., k] + integral - 2.0 * damping * omega_radps * phase
        out[..., k] = phase + 0.5 * interval_s * drive
        integral = integral - omega_radps**2 * interval_s * out[..., k]
        phase = phase + interval_s * drive
    return out
