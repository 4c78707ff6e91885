"""Strapdown mechanization in NED: increments in, velocity, position and attitude out (T 2.4.2).

A step takes the integrals of ω_ib and of the specific force over one interval and, for coning and
sculling, those of the interval before: rate and force are taken as linear in time over both, which
gives the two-sample terms at any, also unequal, lengths. Earth geometry is taken once per step, in
its middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepgnss.core.attitude import (
    Quaternion,
    Vector,
    cross,
    from_rotation_vector,
    normalized,
    product,
    rotated,
)
from deepgnss.core.earth import (
    SEMI_MAJOR_M,
    earth_rate_n,
    gravity_mps2,
    meridian_radius_m,
    transport_rate_n,
    transverse_radius_m,
)
from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, InsState


class Pose(NamedTuple):
    """Position, velocity and attitude at an instant, as kernels carry them."""

    lat_rad: float
    lon_rad: float
    height_m: float
    v_n_mps: Vector
    q_nb: Quaternion


class Increment(NamedTuple):
    """Integrals of angular rate and specific force over an interval, body axes."""

    dt_s: float
    dtheta_b_rad: Vector
    dv_b_mps: Vector


class Calibration(NamedTuple):
    """What the sensors read too much: reading = (1 + scale)·true + bias."""

    gyro_bias_radps: Vector
    accel_bias_mps2: Vector
    gyro_scale: Vector
    accel_scale: Vector


class Poses(NamedTuple):
    """Poses at the ends of consecutive intervals, and their increments freed of sensor errors."""

    lat_rad: FloatArray  # (n,)
    lon_rad: FloatArray  # (n,)
    height_m: FloatArray  # (n,)
    v_n_mps: FloatArray  # (n, 3)
    q_nb: FloatArray  # (n, 4)
    dtheta_b_rad: FloatArray  # (n, 3)
    dv_b_mps: FloatArray  # (n, 3)


NOTHING_BEFORE = Increment(1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""The interval before the first one: coning and sculling start without it."""


def pose_of(state: InsState) -> Pose:
    """Position, velocity and attitude of a navigation state."""
    return Pose(
        state.lat_rad, state.lon_rad, state.height_m, triple(state.v_n_mps), _quadruple(state.q_nb)
    )


def calibration_of(state: InsState) -> Calibration:
    """Sensor errors of a navigation state."""
    return Calibration(
        triple(state.gyro_bias_radps),
        triple(state.accel_bias_mps2),
        triple(state.gyro_scale),
        triple(state.accel_scale),
    )


def triple(values: FloatArray) -> Vector:
    """Three numbers (3,) as kernels carry them."""
    x, y, z = values.tolist()
    return x, y, z


def _quadruple(values: FloatArray) -> Quaternion:
    w, x, y, z = values.tolist()
    return w, x, y, z


@kernel
def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def _scaled(factor: float, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@kernel
def _freed(reading: Vector, bias: Vector, scale: Vector, dt_s: float) -> Vector:
    return (
        (reading[0] - bias[0] * dt_s) / (1.0 + scale[0]),
        (reading[1] - bias[1] * dt_s) / (1.0 + scale[1]),
        (reading[2] - bias[2] * dt_s) / (1.0 + scale[2]),
    )


@kernel
def without_errors(reading: Increment, calibration: Calibration) -> Increment:
    """Increment freed of bias and scale."""
    dt_s = reading.dt_s
    return Increment(
        dt_s,
        _freed(reading.dtheta_b_rad, calibration.gyro_bias_radps, calibration.gyro_scale, dt_s),
        _freed(reading.dv_b_mps, calibration.accel_bias_mps2, calibration.accel_scale, dt_s),
    )


@kernel
def body_rotation(before: Increment, now: Increment) -> Vector:
    """Rotation vector of the body over `now`: the angle increment and two-sample coning.

    With a rate linear in time over both intervals, of lengths T₁ and T₂, coning is
    T₂²/(6 T₁ (T₁ + T₂)) Δθ₁ × Δθ₂: the usual 1/12 when they are equal (Savage 1998, part 1).
    """
    share = now.dt_s**2 / (6.0 * before.dt_s * (before.dt_s + now.dt_s))
    return _sum(now.dtheta_b_rad, _scaled(share, cross(before.dtheta_b_rad, now.dtheta_b_rad)))


@kernel
def body_velocity(before: Increment, now: Increment) -> Vector:
    """Integral of the specific force over `now` in the body axes of its start, m/s.

    Rotation to the third order, ½ Δθ × Δv + ⅙ Δθ × (Δθ × Δv), and two-sample sculling with the
    same share as coning (Savage 1998, part 2).
    """
    share = now.dt_s**2 / (6.0 * before.dt_s * (before.dt_s + now.dt_s))
    turning = cross(now.dtheta_b_rad, now.dv_b_mps)
    turning_twice = cross(now.dtheta_b_rad, turning)
    sculling = _sum(
        cross(before.dtheta_b_rad, now.dv_b_mps), cross(before.dv_b_mps, now.dtheta_b_rad)
    )
    rotation = _sum(_scaled(0.5, turning), _scaled(1.0 / 6.0, turning_twice))
    return _sum(now.dv_b_mps, _sum(rotation, _scaled(share, sculling)))


@kernel
def _free_fall(lat_rad: float, height_m: float, v_n_mps: Vector, dt_s: float) -> Vector:
    """Velocity gained by gravity and Coriolis acceleration: g − (2ω_ie + ω_en) × v, times dt."""
    omega_ie = earth_rate_n(lat_rad)
    omega_en = transport_rate_n(lat_rad, height_m, v_n_mps[0], v_n_mps[1])
    gravity = (0.0, 0.0, gravity_mps2(lat_rad, height_m))
    coriolis = cross(_sum(_scaled(2.0, omega_ie), omega_en), v_n_mps)
    return _scaled(dt_s, _sum(gravity, _scaled(-1.0, coriolis)))


@kernel
def step(pose: Pose, before: Increment, now: Increment) -> Pose:
    """Pose at the end of `now`, increments freed of sensor errors: T(2.45–2.47)."""
    dt_s = now.dt_s
    v_n = pose.v_n_mps
    # Earth in the middle of the step; any radius does for half a step's change of latitude.
    lat_rad = pose.lat_rad + 0.5 * dt_s * v_n[0] / SEMI_MAJOR_M
    height_m = pose.height_m - 0.5 * dt_s * v_n[2]

    # Velocity
    dv_n = rotated(pose.q_nb, body_velocity(before, now))
    fall = _free_fall(lat_rad, height_m, v_n, dt_s)
    v_middle = _sum(v_n, _scaled(0.5, _sum(dv_n, fall)))
    omega_in = _sum(
        earth_rate_n(lat_rad), transport_rate_n(lat_rad, height_m, v_middle[0], v_middle[1])
    )
    frame_turned = _scaled(-0.5 * dt_s, cross(omega_in, dv_n))  # dv_n holds for the step's start
    fall = _free_fall(lat_rad, height_m, v_middle, dt_s)
    v_end = _sum(v_n, _sum(_sum(dv_n, frame_turned), fall))

    # Position
    v_mean = _scaled(0.5, _sum(v_n, v_end))
    north_rad = v_mean[0] * dt_s / (meridian_radius_m(lat_rad) + height_m)
    east_rad = v_mean[1] * dt_s / (transverse_radius_m(lat_rad) + height_m) / np.cos(lat_rad)

    # Attitude
    frame = from_rotation_vector(_scaled(-dt_s, omega_in))
    body = from_rotation_vector(body_rotation(before, now))
    q_end = normalized(product(frame, product(pose.q_nb, body)))

    return Pose(
        pose.lat_rad + north_rad,
        pose.lon_rad + east_rad,
        pose.height_m - v_mean[2] * dt_s,
        v_end,
        q_end,
    )


@kernel
def mechanize(
    pose: Pose,
    before: Increment,
    calibration: Calibration,
    dt_s: FloatArray,
    dtheta_b_rad: FloatArray,
    dv_b_mps: FloatArray,
) -> tuple[Poses, Pose, Increment]:
    """Steps through consecutive intervals.

    Parameters: pose at the start; the interval before (freed of sensor errors); calibration;
    readings: lengths (n,), integrals (n, 3) of rate and specific force.
    Returns: poses at the end of every interval, the last of them, and the last increment freed of
    sensor errors. Longitude is not wrapped.
    """
    count = dt_s.size
    poses = Poses(
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty((count, 3)),
        np.empty((count, 4)),
        np.empty((count, 3)),
        np.empty((count, 3)),
    )
    for k in range(count):
        theta, dv = dtheta_b_rad[k], dv_b_mps[k]
        reading = Increment(dt_s[k], (theta[0], theta[1], theta[2]), (dv[0], dv[1], dv[2]))
        now = without_errors(reading, calibration)
        pose = step(pose, before, now)
        before = now
        poses.lat_rad[k] = pose.lat_rad
        poses.lon_rad[k] = pose.lon_rad
        poses.height_m[k] = pose.height_m
        for axis in range(3):
            poses.v_n_mps[k, axis] = pose.v_n_mps[axis]
            poses.dtheta_b_rad[k, axis] = now.dtheta_b_rad[axis]
            poses.dv_b_mps[k, axis] = now.dv_b_mps[axis]
        for part in range(4):
            poses.q_nb[k, part] = pose.q_nb[part]
    return poses, pose, before
