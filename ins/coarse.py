"""Attitude from what the sensors felt and the velocities of fixes say, without any start value.

Over a stretch the antenna's velocity in NED is v_i = v_0 + C_nb0·α_i + (g − coriolis)·t_i, with α
the specific force summed up in the body axes of the stretch's start, which the gyros give. Pairs
(α_i, β_i) with their means taken off determine C_nb0 (Wahba's problem): tilt always, for gravity
is in them; yaw as far as the vehicle speeds up, brakes or turns. Course over ground adds yaw once
it is known whether the vehicle goes forwards.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.attitude import (
    from_rotation_vector,
    product,
    quaternion_from_matrix,
    quaternion_product,
    rotate,
    rotated,
    rotation_matrix,
    skew,
    slerp,
)
from deepgnss.core.earth import earth_rate_n, gravity_mps2, transport_rate_n
from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.ins.increments import between
from deepgnss.ins.mechanization import NOTHING_BEFORE, Increment, body_rotation, body_velocity

SLOWEST_COURSE_MPS: Final = 1.0
"""Speed below which a course is not taken for a heading."""

SURELY_FORWARD_MPS: Final = 8.0
"""Nobody reverses a vehicle faster than this."""

SURE_YAW_RAD: Final = 0.35
"""1σ of yaw from accelerations that tells forwards from backwards (π/3 is 3σ)."""

SLIP_RAD: Final = 0.03
"""1σ of heading against course, driving straight: slip and mounting."""

AXLE_M: Final = 1.5
"""How far ahead of the axle that does not slip a unit may sit: in turns it moves sideways."""

MODEL_MPS: Final = 0.05
"""1σ of a velocity against the model on top of its own: vibration, timing, curved motion."""


class Track(NamedTuple):
    """Velocities of the antenna at instants, seconds since the increments' origin."""

    time_s: FloatArray  # (m,)
    v_n_mps: FloatArray  # (m, 3)
    sigma_mps: FloatArray  # (m,) per axis


class Reckoned(NamedTuple):
    """What the sensors say at the instants of a track, in the body axes of its first one."""

    q_0b: FloatArray  # (m, 4) body → body at the first instant
    gained_0_mps: FloatArray  # (m, 3) integral of the antenna's specific force
    swing_b_mps: FloatArray  # (m, 3) ω × lever arm
    turn_radps: FloatArray  # (m,) size of ω


class CoarseAttitude(NamedTuple):
    """Attitude at the last instant of a track."""

    q_nb: FloatArray  # (4,)
    covariance_rad2: FloatArray  # (3, 3) of φ in NED
    forward: bool


class MotionAttitude(NamedTuple):
    """Attitude at the first instant of a track, with the pairs it was found from."""

    alpha_0_mps: FloatArray  # (m, 3) specific force summed up, its mean taken off
    beta_n_mps: FloatArray  # (m, 3) velocities less their fall and mean
    weight: FloatArray  # (m,)
    C_n0: FloatArray  # (3, 3)
    yaw_sigma_rad: float

    @property
    def misfit(self) -> float:
        """Weighted sum of the squares of β − Cα."""
        left = self.beta_n_mps - self.alpha_0_mps @ self.C_n0.T
        return float(self.weight @ np.sum(left**2, axis=1))


class Heading(NamedTuple):
    """Yaw that is to be added, from courses."""

    turn_rad: float
    variance_rad2: float
    forward: bool


@kernel
def _chained(
    dt_s: FloatArray, dtheta_b_rad: FloatArray, dv_b_mps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Attitude (n + 1, 4) and integral of specific force (n + 1, 3) in the axes of the start."""
    count = dt_s.size
    turned, gained = np.zeros((count + 1, 4)), np.zeros((count + 1, 3))
    q = (1.0, 0.0, 0.0, 0.0)
    turned[0, 0] = 1.0
    before = NOTHING_BEFORE
    for k in range(count):
        theta, dv = dtheta_b_rad[k], dv_b_mps[k]
        now = Increment(dt_s[k], (theta[0], theta[1], theta[2]), (dv[0], dv[1], dv[2]))
        step = rotated(q, body_velocity(before, now))
        q = product(q, from_rotation_vector(body_rotation(before, now)))
        before = now
        for axis in range(3):
            gained[k + 1, axis] = gained[k, axis] + step[axis]
        for part in range(4):
            turned[k + 1, part] = q[part]
    return turned, gained


def reckoned(block: ImuBlock, time_s: FloatArray, lever_b_m: FloatArray) -> Reckoned:
    """Sum up the sensors from the first to the last of the instants (m,)."""
    piece = between(block, float(time_s[0]), float(time_s[-1]))
    turned, gained = _chained(piece.dt_s, piece.dtheta_b_rad, piece.dv_b_mps)
    nodes_s = np.concatenate([time_s[:1], piece.time_s])
    row = np.clip(np.searchsorted(nodes_s, time_s, side="right"), 1, nodes_s.size - 1)
    share = np.clip((time_s - nodes_s[row - 1]) / (nodes_s[row] - nodes_s[row - 1]), 0.0, 1.0)
    q_0b = slerp(turned[row - 1], turned[row], share)
    gained_0 = gained[row - 1] + share[:, np.newaxis] * (gained[row] - gained[row - 1])
    omega_b = _mean_rate(nodes_s, piece.dtheta_b_rad, time_s)
    swing_b = np.cross(omega_b, lever_b_m)
    swing_0 = rotate(q_0b, swing_b)
    return Reckoned(q_0b, gained_0 + swing_0 - swing_0[0], swing_b, np.linalg.norm(omega_b, axis=1))


def _mean_rate(nodes_s: FloatArray, dtheta_b_rad: FloatArray, time_s: FloatArray) -> FloatArray:
    """Angular rates (m, 3), means over a tenth of a second around the instants."""
    sums = np.vstack([np.zeros((1, 3)), np.cumsum(dtheta_b_rad, axis=0)])
    since, until = (np.clip(time_s + half_s, nodes_s[0], nodes_s[-1]) for half_s in (-0.05, 0.05))
    turned = np.column_stack(
        [
            np.interp(until, nodes_s, sums[:, axis]) - np.interp(since, nodes_s, sums[:, axis])
            for axis in range(3)
        ]
    )
    return turned / (until - since)[:, np.newaxis]


def free_fall_mps2(lat_rad: float, height_m: float, v_n_mps: FloatArray) -> FloatArray:
    """What velocity gains without specific force: g − (2ω_ie + ω_en) × v, (3,)."""
    ie = np.array(earth_rate_n(lat_rad))
    en = np.array(transport_rate_n(lat_rad, height_m, float(v_n_mps[0]), float(v_n_mps[1])))
    gravity = np.array([0.0, 0.0, gravity_mps2(lat_rad, height_m)])
    return gravity - np.cross(2.0 * ie + en, v_n_mps)


def attitude_by_motion(
    track: Track, felt: Reckoned, fall_n_mps2: FloatArray, gyro_bias_radps: float
) -> MotionAttitude:
    """Attitude at the start of a track by velocities alone; parameters as of `from_motion`."""
    passed_s = (track.time_s - track.time_s[0])[:, np.newaxis]
    # What a gyro bias bends off the line through the velocities: ½·g·b·t² less its best line.
    bent_mps = 9.8 * gyro_bias_radps * float(passed_s[-1, 0]) ** 2 / (2.0 * np.sqrt(180.0))
    weight = 1.0 / (track.sigma_mps**2 + MODEL_MPS**2 + bent_mps**2)
    alpha = _centred(felt.gained_0_mps, weight)
    beta = _centred(track.v_n_mps - passed_s * fall_n_mps2, weight)
    C = _rotation_between(alpha, beta, weight)
    return MotionAttitude(alpha, beta, weight, C, _yaw_sigma(_information(alpha @ C.T, weight)))


def from_motion(
    track: Track,
    felt: Reckoned,
    fall_n_mps2: FloatArray,
    gyro_bias_radps: float,
    mounting_yaw_rad: float = 0.0,
) -> CoarseAttitude | str:
    """Attitude at the end of a track of at least three instants, or why there is none.

    Parameters: what velocity gains without specific force (3,), NED; 1σ of a bias still in the
    gyros; yaw of the body axes against the vehicle's forward axis.
    """
    found = attitude_by_motion(track, felt, fall_n_mps2, gyro_bias_radps)
    alpha, beta, weight, C, yaw_sigma_rad = found

    heading = heading_by_course(track, felt, C, yaw_sigma_rad, mounting_yaw_rad)
    if isinstance(heading, str):
        return heading
    if yaw_sigma_rad > SURE_YAW_RAD:  # C's yaw means nothing: start from the course
        C = _about_down(heading.turn_rad) @ C
    total = np.zeros((3, 3))
    for _ in range(6):  # Gauss–Newton; residual β − Cα = φ × Cα
        again = heading_by_course(track, felt, C, 0.0, mounting_yaw_rad)
        if isinstance(again, str):
            return again
        turned = alpha @ C.T
        total = _information(turned, weight)
        total[2, 2] += 1.0 / again.variance_rad2
        pull = np.einsum("k,kij,kj->i", weight, skew(turned), beta - turned)
        pull[2] += again.turn_rad / again.variance_rad2
        C = rotation_matrix(_small(np.linalg.solve(total, pull))) @ C
    q_nb = quaternion_product(quaternion_from_matrix(C), felt.q_0b[-1])
    return CoarseAttitude(q_nb, np.array(np.linalg.inv(total), np.float64), heading.forward)


def heading_by_course(
    track: Track, felt: Reckoned, C_n0: FloatArray, yaw_sigma_rad: float, mounting_yaw_rad: float
) -> Heading | str:
    """Turn of C_n0 about down that brings headings to courses, or why there is no telling.

    yaw_sigma_rad: 1σ of the yaw in C_n0 itself, which tells forwards from backwards.
    """
    v_n = track.v_n_mps - rotate(quaternion_from_matrix(C_n0), rotate(felt.q_0b, felt.swing_b_mps))
    speed_mps = np.hypot(v_n[:, 0], v_n[:, 1])
    used = speed_mps > np.maximum(SLOWEST_COURSE_MPS, 3.0 * track.sigma_mps)
    if not used.any():
        return (
            f"too slow for a course: {speed_mps.max():.1f} m/s, {SLOWEST_COURSE_MPS:.1f} m/s needed"
        )
    v_n, speed_mps = v_n[used], speed_mps[used]
    forward_n = C_n0 @ rotation_matrix(felt.q_0b[used])[:, :, 0].T
    course_rad = np.arctan2(v_n[:, 1], v_n[:, 0])
    yaw_rad = np.arctan2(forward_n[1], forward_n[0])
    noise2 = (track.sigma_mps[used] / speed_mps) ** 2 + 1e-6
    turning2 = (AXLE_M * felt.turn_radps[used] / speed_mps) ** 2
    weight = 1.0 / (noise2 + turning2)
    mean = np.average(np.exp(1j * (course_rad + mounting_yaw_rad - yaw_rad)), weights=weight)
    if abs(mean) < 0.8:
        return "courses and gyros do not turn alike: manoeuvring to and fro, or axes mixed up"
    turn_rad = float(np.angle(mean))
    variance_rad2 = SLIP_RAD**2 + 1.0 / float(np.sum(1.0 / noise2))
    variance_rad2 += float(np.average(turning2, weights=weight))
    if yaw_sigma_rad > SURE_YAW_RAD:
        if speed_mps.max() < SURELY_FORWARD_MPS:
            return (
                f"neither speeding up nor turning, at {speed_mps.max():.1f} m/s: no telling"
                " forwards from backwards"
            )
        return Heading(turn_rad, variance_rad2, True)
    if abs(turn_rad) < np.pi / 3.0:
        return Heading(turn_rad, variance_rad2, True)
    if abs(turn_rad) > 2.0 * np.pi / 3.0:
        return Heading(turn_rad - np.copysign(np.pi, turn_rad), variance_rad2, False)
    return (
        f"moves {np.degrees(turn_rad):.0f} deg off the body's forward axis:"
        " axes of the unit, or its time, may be wrong"
    )


def _centred(vectors: FloatArray, weight: FloatArray) -> FloatArray:
    centred: FloatArray = vectors - np.average(vectors, axis=0, weights=weight)
    return centred


def _rotation_between(alpha: FloatArray, beta: FloatArray, weight: FloatArray) -> FloatArray:
    """C that makes β ≈ C·α in the sense of weighted squares (Kabsch)."""
    U, _, Vt = np.linalg.svd((alpha * weight[:, np.newaxis]).T @ beta)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    C: FloatArray = Vt.T @ proper @ U.T
    return C


def _information(turned: FloatArray, weight: FloatArray) -> FloatArray:
    """Information (3, 3) on φ: Σ w [Cα×]ᵀ[Cα×]; the sensors' side, whose noise is small."""
    slope = skew(turned)
    information: FloatArray = np.einsum("k,kji,kjl->il", weight, slope, slope)
    return information


def _yaw_sigma(information: FloatArray) -> float:
    """1σ of the rotation about down with tilt unknown."""
    tilt, tie = information[:2, :2], information[:2, 2]
    left = float(information[2, 2] - tie @ np.linalg.solve(tilt, tie))
    return float("inf") if left <= 0.0 else left**-0.5


def _about_down(angle_rad: float) -> FloatArray:
    return rotation_matrix(_small(np.array([0.0, 0.0, angle_rad])))


def _small(phi: FloatArray) -> FloatArray:
    return np.array(from_rotation_vector((float(phi[0]), float(phi[1]), float(phi[2]))))
