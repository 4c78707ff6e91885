"""Trajectory between two corrections, at the rate of the IMU and at any instant in between."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from deepgnss.core.attitude import (
    Quaternion,
    Vector,
    conjugate,
    cross,
    from_rotation_vector,
    matrix,
    product,
    rotated,
    to_rotation_vector,
)
from deepgnss.core.earth import (
    earth_rate_n,
    meridian_radius_m,
    place_e_m,
    transport_rate_n,
    transverse_radius_m,
)
from deepgnss.core.errors import NumericalError
from deepgnss.core.frames import q_en
from deepgnss.core.jit import brief_kernel, kernel
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, cross_matrix
from deepgnss.ins.increments import SAME_INSTANT_S, Gap


class Prediction(NamedTuple):
    """Position, velocity, attitude and angular rate of the IMU at instants."""

    lat_rad: FloatArray  # (k,)
    lon_rad: FloatArray  # (k,) not wrapped
    height_m: FloatArray  # (k,)
    v_n_mps: FloatArray  # (k, 3)
    q_nb: FloatArray  # (k, 4)
    omega_ib_b_radps: FloatArray  # (k, 3) sensor errors removed


class Antenna(NamedTuple):
    """Position and velocity of a point fixed to the body at instants."""

    r_e_m: FloatArray  # (k, 3)
    v_e_mps: FloatArray  # (k, 3)
    v_n_mps: FloatArray  # (k, 3)


@dataclass(frozen=True)
class Trajectory:
    """Navigation over a stretch of increments.

    Row 0 is the start, row k the end of increment k − 1, seconds since `origin`; rates and forces
    are means over the increments, freed of sensor errors. Covariances, of all errors the estimate
    carries, stand at instants of their own, the start and the end among them; Phi and Q lead the
    inertial errors (`error_model`) from start to end.
    """

    origin: GpsTime
    time_s: FloatArray  # (n + 1,)
    lat_rad: FloatArray  # (n + 1,)
    lon_rad: FloatArray  # (n + 1,) not wrapped
    height_m: FloatArray  # (n + 1,)
    v_n_mps: FloatArray  # (n + 1, 3)
    q_nb: FloatArray  # (n + 1, 4)
    omega_ib_b_radps: FloatArray  # (n, 3)
    f_b_mps2: FloatArray  # (n, 3)
    covariance_time_s: FloatArray  # (c,)
    covariances: FloatArray  # (c, size, size)
    Phi: FloatArray  # (states, states)
    Q: FloatArray  # (states, states)
    bridged: tuple[Gap, ...]  # gaps filled by rates linear between their ends
    outage: Gap | None  # a gap too long to bridge, at whose start the trajectory ends

    def predict(self, time_s: FloatArray) -> Prediction:
        """Navigation at instants (k,) of the stretch.

        Position is the cubic through positions and velocities of the two rows around, velocity the
        cubic spline through all rows, attitude turns evenly. Raises NumericalError outside.
        """
        t = self._inside(time_s)
        lat_rad, lon_rad, height_m, q_nb, omega_ib_b_radps = self._poses(t)
        return Prediction(lat_rad, lon_rad, height_m, self._velocity(t), q_nb, omega_ib_b_radps)

    def antenna(self, time_s: FloatArray, lever_b_m: FloatArray) -> Antenna:
        """Point at a lever arm (3,) in body axes at instants (k,): C_nb·l away, turning with ω_nb.

        v = v_imu + C_nb·(ω_ib × l) − ω_in × C_nb·l.
        """
        return Antenna(*_attached(*self.predict(time_s), lever_b_m))

    def antenna_place(self, time_s: FloatArray, lever_b_m: FloatArray) -> FloatArray:
        """Position (k, 3) of `antenna` alone."""
        lat_rad, lon_rad, height_m, q_nb, _ = self._poses(self._inside(time_s))
        return _places(lat_rad, lon_rad, height_m, q_nb, lever_b_m)

    def covariance(self, time_s: FloatArray) -> FloatArray:
        """Covariance of the errors at instants: (k, size, size), linear between those at hand.

        A variance grows convexly between corrections, so the line lies on or above it.
        """
        return _between(self.covariance_time_s, self.covariances, self._inside(time_s))

    def antenna_covariance(self, time_s: FloatArray, lever_b_m: FloatArray) -> FloatArray:
        """Covariance (k, 6, 6) of position (NED) and velocity (NED) of a point at a lever arm.

        To the first order in attitude and gyro bias; without the frame's own rate (1e-4 rad/s).
        """
        t = self._inside(time_s)
        P = _between(self.covariance_time_s, self.covariances, t)
        *_, q_nb, omega_ib_b_radps = self._poses(t)
        H = _slopes(q_nb, omega_ib_b_radps, lever_b_m, P.shape[-1])
        return H @ P @ np.swapaxes(H, -1, -2)

    def _inside(self, time_s: FloatArray) -> FloatArray:
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        inside, there = _clipped(t, self.time_s[0], self.time_s[-1])
        if self.time_s.size < 2 or not there:
            raise NumericalError(
                f"trajectory asked for at {t.min():.6f} … {t.max():.6f} s: it has increments"
                f" from {self.time_s[0]:.6f} to {self.time_s[-1]:.6f} s"
            )
        return inside

    def _poses(
        self, t: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """All of a prediction but velocity."""
        return _poses(
            self.time_s,
            self.lat_rad,
            self.lon_rad,
            self.height_m,
            self.v_n_mps,
            self.q_nb,
            self.omega_ib_b_radps,
            t,
        )

    def _velocity(self, t: FloatArray) -> FloatArray:
        row = np.searchsorted(self.time_s, t)
        if (self.time_s[row] == t).all():  # the spline meets its rows
            return self.v_n_mps[row]
        return np.asarray(self._velocities(t))

    @cached_property
    def _velocities(self) -> CubicSpline:
        return CubicSpline(self.time_s, self.v_n_mps)


@brief_kernel
def _clipped(t: FloatArray, first_s: float, last_s: float) -> tuple[FloatArray, bool]:
    """Instants (k,) within a stretch, and whether they were, but for the rounding of instants."""
    inside, there = np.empty(t.size), True
    for k in range(t.size):
        there = there and first_s - SAME_INSTANT_S <= t[k] <= last_s + SAME_INSTANT_S
        inside[k] = min(max(t[k], first_s), last_s)
    return inside, there


@brief_kernel
def _between(nodes_s: FloatArray, matrices: FloatArray, t: FloatArray) -> FloatArray:
    """Matrices (k, n, n) at instants (k,), linear between those (c, n, n) at nodes (c,)."""
    found = np.empty((t.size, *matrices.shape[1:]))
    for k in range(t.size):
        row = min(max(int(np.searchsorted(nodes_s, t[k], side="right")), 1), nodes_s.size - 1)
        share = (t[k] - nodes_s[row - 1]) / (nodes_s[row] - nodes_s[row - 1])
        found[k] = (1.0 - share) * matrices[row - 1] + share * matrices[row]
    return found


@kernel
def _poses(
    time_s: FloatArray,
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    height_m: FloatArray,
    v_n_mps: FloatArray,
    q_nb: FloatArray,
    omega_ib_b_radps: FloatArray,
    t: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Latitudes, longitudes, heights, attitudes and rates at instants within the rows."""
    count, last = t.size, time_s.size - 1
    places, q, omega = np.empty((3, count)), np.empty((count, 4)), np.empty((count, 3))
    slow = fast = turn = (0.0, 0.0, 0.0)
    before_row = 0
    for k in range(count):
        row = min(max(int(np.searchsorted(time_s, t[k], side="right")), 1), last)
        before, after = q_nb[row - 1], q_nb[row]
        q_before = (before[0], before[1], before[2], before[3])
        if row != before_row:  # many instants between two rows have these in common
            before_row = row
            slow = _per_second(lat_rad[row - 1], height_m[row - 1], v_n_mps[row - 1])
            fast = _per_second(lat_rad[row], height_m[row], v_n_mps[row])
            turn = _turn(q_before, (after[0], after[1], after[2], after[3]))
        passed_s, length_s = t[k] - time_s[row - 1], time_s[row] - time_s[row - 1]
        for axis, values in enumerate((lat_rad, lon_rad, height_m)):
            places[axis, k] = _hermite(
                passed_s, length_s, values[row - 1], values[row], slow[axis], fast[axis]
            )
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = _turned(q_before, turn, passed_s / length_s)
        one = row - 1  # increments around, between whose middles the rate is linear
        middle_s = 0.5 * (time_s[row - 1] + time_s[row])
        other = max(one - 1, 0) if t[k] < middle_s else min(one + 1, last - 1)
        apart_s = 0.5 * (time_s[other] + time_s[other + 1]) - middle_s
        share = (t[k] - middle_s) / apart_s if other != one else 0.0
        for axis in range(3):
            rate = omega_ib_b_radps[one, axis]
            omega[k, axis] = rate + share * (omega_ib_b_radps[other, axis] - rate)
    return places[0], places[1], places[2], q, omega


@kernel
def _per_second(lat_rad: float, height_m: float, v_n_mps: FloatArray) -> Vector:
    """Rates of latitude, longitude and height."""
    north_m = meridian_radius_m(lat_rad) + height_m
    east_m = (transverse_radius_m(lat_rad) + height_m) * np.cos(lat_rad)
    return v_n_mps[0] / north_m, v_n_mps[1] / east_m, -v_n_mps[2]


@kernel
def _hermite(t: float, length: float, y0: float, y1: float, slope0: float, slope1: float) -> float:
    """The cubic through two values and slopes, t after the first."""
    slope = (y1 - y0) / length
    bend = (slope0 + slope1 - 2.0 * slope) / length
    return y0 + t * (slope0 + t * ((slope - slope0) / length - bend + t * bend / length))


@kernel
def _turn(q0: Quaternion, q1: Quaternion) -> Vector:
    """Rotation vector from one attitude to another."""
    return to_rotation_vector(product(conjugate(q0), q1))  # type: ignore[no-any-return]


@kernel
def _turned(q0: Quaternion, turn: Vector, share: float) -> Quaternion:
    """Attitude after a share of a turn."""
    step = (turn[0] * share, turn[1] * share, turn[2] * share)
    return product(q0, from_rotation_vector(step))  # type: ignore[no-any-return]


@kernel
def _places(
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    height_m: FloatArray,
    q_nb: FloatArray,
    lever_b_m: FloatArray,
) -> FloatArray:
    """Points (k, 3), ECEF, at a lever arm of poses (k)."""
    r_e_m = np.empty((lat_rad.size, 3))
    lever_b = (lever_b_m[0], lever_b_m[1], lever_b_m[2])
    for k in range(lat_rad.size):
        lever_n = rotated((q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3]), lever_b)
        lever_e = rotated(q_en(lat_rad[k], lon_rad[k]), lever_n)
        imu_e = place_e_m(lat_rad[k], lon_rad[k], height_m[k])
        for axis in range(3):
            r_e_m[k, axis] = imu_e[axis] + lever_e[axis]
    return r_e_m


@kernel
def _attached(
    lat_rad: FloatArray,
    lon_rad: FloatArray,
    height_m: FloatArray,
    v_n_mps: FloatArray,
    q_nb: FloatArray,
    omega_ib_b_radps: FloatArray,
    lever_b_m: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fields of `Antenna` at a lever arm of poses (k)."""
    v_e_mps, v_out_n_mps = np.empty((lat_rad.size, 3)), np.empty((lat_rad.size, 3))
    lever_b = (lever_b_m[0], lever_b_m[1], lever_b_m[2])
    for k in range(lat_rad.size):
        q = (q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3])
        omega_b = (omega_ib_b_radps[k, 0], omega_ib_b_radps[k, 1], omega_ib_b_radps[k, 2])
        swing_n = rotated(q, cross(omega_b, lever_b))
        ie = earth_rate_n(lat_rad[k])
        en = transport_rate_n(lat_rad[k], height_m[k], v_n_mps[k, 0], v_n_mps[k, 1])
        dragged = cross((ie[0] + en[0], ie[1] + en[1], ie[2] + en[2]), rotated(q, lever_b))
        v_n = (
            v_n_mps[k, 0] + swing_n[0] - dragged[0],
            v_n_mps[k, 1] + swing_n[1] - dragged[1],
            v_n_mps[k, 2] + swing_n[2] - dragged[2],
        )
        v_e = rotated(q_en(lat_rad[k], lon_rad[k]), v_n)
        for axis in range(3):
            v_e_mps[k, axis], v_out_n_mps[k, axis] = v_e[axis], v_n[axis]
    return _places(lat_rad, lon_rad, height_m, q_nb, lever_b_m), v_e_mps, v_out_n_mps


@kernel
def _slopes(
    q_nb: FloatArray, omega_ib_b_radps: FloatArray, lever_b_m: FloatArray, size: int
) -> FloatArray:
    """Slopes (k, 6, size) of position and velocity (NED) at a lever arm of poses (k)."""
    H = np.zeros((q_nb.shape[0], 6, size))
    lever_b = (lever_b_m[0], lever_b_m[1], lever_b_m[2])
    for k in range(q_nb.shape[0]):
        q = (q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3])
        omega_b = (omega_ib_b_radps[k, 0], omega_ib_b_radps[k, 1], omega_ib_b_radps[k, 2])
        H[k, 0:3, POSITION] = H[k, 3:6, VELOCITY] = np.eye(3)
        H[k, 0:3, ATTITUDE] = cross_matrix(rotated(q, lever_b))
        H[k, 3:6, ATTITUDE] = cross_matrix(rotated(q, cross(omega_b, lever_b)))
        H[k, 3:6, GYRO_BIAS] = np.array(matrix(q)) @ cross_matrix(lever_b)
    return H
