"""Measurement models of the integration: each returns z = predicted − measured, H and R.

A point at l in body axes (antenna, rear axle) lies at r + C_nb·l and moves with
v + C_nb·(ω_nb×l); ω_nb is the gyro's rate, freed of its errors, less the frame's own ω_in. Left
out of H: how ω_in and the directions of NED themselves depend on the errors of position and
velocity (1/R, below 2e-6 of what stands there).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.attitude import (
    Quaternion,
    Vector,
    cross,
    matrix,
    rotated,
    rotation_matrix,
    skew,
)
from deepgnss.core.earth import earth_rate_n, place_e_m, transport_rate_n
from deepgnss.core.frames import C_ne, q_en
from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, InsState
from deepgnss.ins.error_model import (
    ATTITUDE,
    GYRO_BIAS,
    GYRO_SCALE,
    POSITION,
    VELOCITY,
    WITH_SCALES,
    cross_matrix,
)
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.mechanization import pose_of

ROLLING: Final = ("non-holonomic", "odometer")
"""Kinds that tell how a car moves along its own axes."""


class Measurement(NamedTuple):
    """z = predicted − measured (m,), its slope H (m, size) in the errors, and R (m, m).

    in_body: of the velocity along body axes, see `error_state.turned_along`.
    together: errors last, so that so many of them count as one: R is that often the measurement's
    own covariance, by which it is tested.
    """

    kind: str
    z: FloatArray
    H: FloatArray
    R: FloatArray
    in_body: bool = False
    together: float = 1.0


class Point(NamedTuple):
    """A point fixed to the body: position and velocity, and their slopes in the errors."""

    r_e_m: FloatArray  # (3,)
    v_n_mps: FloatArray  # (3,)
    H_position: FloatArray  # (3, size), metres NED
    H_velocity: FloatArray  # (3, size)


def body_point(
    ins: InsState, omega_ib_b_radps: FloatArray, lever_b_m: FloatArray, layout: Layout
) -> Point:
    """Where a point at a lever arm is and how it moves; ω_ib (3,) freed of sensor errors."""
    return Point(
        *_point(
            *pose_of(ins),
            omega_ib_b_radps,
            lever_b_m,
            layout.size,
            layout.inertial == WITH_SCALES,
        )
    )


@kernel
def _point(
    lat_rad: float,
    lon_rad: float,
    height_m: float,
    v_n_mps: Vector,
    q_nb: Quaternion,
    omega_ib_b_radps: FloatArray,
    lever_b_m: FloatArray,
    size: int,
    scales: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fields of `Point`."""
    lever_b = (lever_b_m[0], lever_b_m[1], lever_b_m[2])
    omega_b = (omega_ib_b_radps[0], omega_ib_b_radps[1], omega_ib_b_radps[2])
    ie = earth_rate_n(lat_rad)
    en = transport_rate_n(lat_rad, height_m, v_n_mps[0], v_n_mps[1])
    omega_in = (ie[0] + en[0], ie[1] + en[1], ie[2] + en[2])
    lever_n = rotated(q_nb, lever_b)
    swing_n = rotated(q_nb, cross(omega_b, lever_b))  # seen from inertial space
    dragged = cross(omega_in, lever_n)

    H_position, H_velocity = np.zeros((3, size)), np.zeros((3, size))
    H_position[:, POSITION] = H_velocity[:, VELOCITY] = np.eye(3)
    lever_cross = cross_matrix(lever_n)
    H_position[:, ATTITUDE] = lever_cross
    H_velocity[:, ATTITUDE] = cross_matrix(swing_n) - cross_matrix(omega_in) @ lever_cross
    swung = np.array(matrix(q_nb)) @ cross_matrix(lever_b)
    H_velocity[:, GYRO_BIAS] = swung
    if scales:
        H_velocity[:, GYRO_SCALE] = swung * omega_ib_b_radps
    imu_e = place_e_m(lat_rad, lon_rad, height_m)
    lever_e = rotated(q_en(lat_rad, lon_rad), lever_n)
    r_e_m, v_out_n_mps = np.empty(3), np.empty(3)
    for axis in range(3):
        r_e_m[axis] = imu_e[axis] + lever_e[axis]
        v_out_n_mps[axis] = v_n_mps[axis] + swing_n[axis] - dragged[axis]
    return r_e_m, v_out_n_mps, H_position, H_velocity


def position(
    ins: InsState,
    antenna: Point,
    r_e_m: FloatArray,
    covariance_n_m2: FloatArray,
    together: float = 1.0,
) -> Measurement:
    """Antenna position (ECEF, covariance in NED) of a fix, T(2.74)."""
    z = C_ne(ins.lat_rad, ins.lon_rad) @ (antenna.r_e_m - r_e_m)
    return Measurement("position", z, antenna.H_position, covariance_n_m2, together=together)


def velocity(antenna: Point, v_n_mps: FloatArray, covariance_n_m2ps2: FloatArray) -> Measurement:
    """Antenna velocity (NED) of a fix, T(2.74)."""
    return Measurement(
        "velocity", antenna.v_n_mps - v_n_mps, antenna.H_velocity, covariance_n_m2ps2
    )


def course(
    ins: InsState, course_rad: float, sigma_rad: float, layout: Layout, mounting_yaw_rad: float = 0
) -> Measurement:
    """Course over ground, taken as the heading of the vehicle (no slip, driving forwards).

    mounting_yaw_rad: yaw of the body axes against the vehicle's forward axis.
    """
    C_nb = rotation_matrix(ins.q_nb)
    north, east, down = C_nb[:, 0]
    level2 = north**2 + east**2
    yaw_rad = np.arctan2(east, north)
    H = np.zeros((1, layout.size))
    # δ(C_nb·forward) = forward_n × φ
    H[0, ATTITUDE] = np.array([north * down, east * down, -level2]) / level2
    difference_rad = yaw_rad - mounting_yaw_rad - course_rad
    z = np.array([np.remainder(difference_rad + np.pi, 2.0 * np.pi) - np.pi])
    return Measurement("course", z, H, np.array([[sigma_rad**2]]))


def nonholonomic(
    ins: InsState,
    omega_ib_b_radps: FloatArray,
    axle_b_m: FloatArray,
    C_vb: FloatArray,
    sigma_mps: FloatArray,
    layout: Layout,
) -> Measurement:
    """A rear axle moves along the vehicle's forward axis only: no lateral, no vertical velocity.

    axle_b_m (3,): IMU → middle of the rear axle; C_vb (3, 3): body → vehicle (forward, right,
    down); sigma_mps (2,): lateral and vertical.
    """
    v_v, H = _vehicle_velocity(ins, omega_ib_b_radps, axle_b_m, C_vb, layout)
    return Measurement("non-holonomic", v_v[1:], H[1:], np.diag(np.asarray(sigma_mps) ** 2), True)


def odometer(
    estimate: Estimate,
    omega_ib_b_radps: FloatArray,
    wheel_b_m: FloatArray,
    C_vb: FloatArray,
    speed_mps: float,
    sigma_mps: float,
) -> Measurement:
    """Forward speed of an odometer, which reads (1 + scale)·true; its scale is a filter state."""
    layout = estimate.layout
    v_v, H = _vehicle_velocity(estimate.ins, omega_ib_b_radps, wheel_b_m, C_vb, layout)
    scale = estimate.extra(layout.odometer_scale)
    H = (1.0 + scale) * H[:1]
    H[0, layout.odometer_scale] = v_v[0]
    z = np.array([(1.0 + scale) * v_v[0] - speed_mps])
    return Measurement("odometer", z, H, np.array([[sigma_mps**2]]), True)


def zero_velocity(ins: InsState, sigma_mps: float, layout: Layout) -> Measurement:
    """The vehicle stands."""
    H = np.zeros((3, layout.size))
    H[:, VELOCITY] = np.eye(3)
    return Measurement("zero velocity", ins.v_n_mps, H, sigma_mps**2 * np.eye(3))


def zero_rotation(
    ins: InsState, omega_ib_b_radps: FloatArray, sigma_radps: float, layout: Layout
) -> Measurement:
    """The vehicle does not turn: the gyros read the frame's rate and their bias."""
    C_bn = rotation_matrix(ins.q_nb).T
    omega_in = _omega_in_n(ins)
    H = np.zeros((3, layout.size))
    H[:, ATTITUDE] = C_bn @ skew(omega_in)
    H[:, GYRO_BIAS] = -np.eye(3)
    if layout.inertial == WITH_SCALES:
        H[:, GYRO_SCALE] = -np.diag(omega_ib_b_radps)
    z = omega_ib_b_radps - C_bn @ omega_in
    return Measurement("zero rotation", z, H, sigma_radps**2 * np.eye(3))


def _vehicle_velocity(
    ins: InsState,
    omega_ib_b_radps: FloatArray,
    point_b_m: FloatArray,
    C_vb: FloatArray,
    layout: Layout,
) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) of a body point in vehicle axes and its slope (3, size)."""
    C_bn = rotation_matrix(ins.q_nb).T
    omega_in = _omega_in_n(ins)
    omega_nb_b = omega_ib_b_radps - C_bn @ omega_in
    H = np.zeros((3, layout.size))
    H[:, VELOCITY] = C_bn
    H[:, ATTITUDE] = -C_bn @ skew(ins.v_n_mps) - skew(point_b_m) @ C_bn @ skew(omega_in)
    H[:, GYRO_BIAS] = skew(point_b_m)
    if layout.inertial == WITH_SCALES:
        H[:, GYRO_SCALE] = skew(point_b_m) * omega_ib_b_radps
    v_b = C_bn @ ins.v_n_mps + np.cross(omega_nb_b, point_b_m)
    return C_vb @ v_b, C_vb @ H


def _omega_in_n(ins: InsState) -> FloatArray:
    transport = transport_rate_n(ins.lat_rad, ins.height_m, ins.v_n_mps[0], ins.v_n_mps[1])
    omega_in: FloatArray = np.add(earth_rate_n(ins.lat_rad), transport)
    return omega_in
