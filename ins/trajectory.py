"""Trajectory between two corrections, at the rate of the IMU and at any instant in between."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pymap3d
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from deepgnss.core.attitude import rotate, skew, slerp
from deepgnss.core.earth import (
    earth_rate_n,
    meridian_radius_m,
    transport_rate_n,
    transverse_radius_m,
)
from deepgnss.core.errors import NumericalError
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import ATTITUDE, GYRO_BIAS, POSITION, VELOCITY
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
        lat_rad, lon_rad, height_m = self._place(t).T
        row = np.clip(np.searchsorted(self.time_s, t, side="right"), 1, self.time_s.size - 1)
        passed_s = t - self.time_s[row - 1]
        share = passed_s / (self.time_s[row] - self.time_s[row - 1])
        return Prediction(
            lat_rad,
            lon_rad,
            height_m,
            self._velocity(t),
            slerp(self.q_nb[row - 1], self.q_nb[row], share),
            self._rate(t),
        )

    def antenna(self, time_s: FloatArray, lever_b_m: FloatArray) -> Antenna:
        """Point at a lever arm (3,) in body axes at instants (k,): C_nb·l away, turning with ω_nb.

        v = v_imu + C_nb·(ω_ib × l) − ω_in × C_nb·l.
        """
        imu = self.predict(time_s)
        lever_n = rotate(imu.q_nb, lever_b_m)
        swing_n = rotate(imu.q_nb, np.cross(imu.omega_ib_b_radps, lever_b_m))
        transport = transport_rate_n(
            imu.lat_rad, imu.height_m, imu.v_n_mps[:, 0].copy(), imu.v_n_mps[:, 1].copy()
        )
        omega_in = np.column_stack(earth_rate_n(imu.lat_rad)) + np.column_stack(transport)
        v_n = imu.v_n_mps + swing_n - np.cross(omega_in, lever_n)
        r_e = np.column_stack(
            pymap3d.geodetic2ecef(imu.lat_rad, imu.lon_rad, imu.height_m, deg=False)
        )
        to_e = _q_en(imu.lat_rad, imu.lon_rad)
        return Antenna(r_e + rotate(to_e, lever_n), rotate(to_e, v_n), v_n)

    def covariance(self, time_s: FloatArray) -> FloatArray:
        """Covariance of the errors at instants: (k, size, size), linear between those at hand.

        A variance grows convexly between corrections, so the line lies on or above it.
        """
        t, nodes = self._inside(time_s), self.covariance_time_s
        row = np.clip(np.searchsorted(nodes, t, side="right"), 1, nodes.size - 1)
        share = ((t - nodes[row - 1]) / (nodes[row] - nodes[row - 1]))[:, np.newaxis, np.newaxis]
        between: FloatArray = (1.0 - share) * self.covariances[row - 1]
        return between + share * self.covariances[row]

    def antenna_covariance(self, time_s: FloatArray, lever_b_m: FloatArray) -> FloatArray:
        """Covariance (k, 6, 6) of position (NED) and velocity (NED) of a point at a lever arm.

        To the first order in attitude and gyro bias; without the frame's own rate (1e-4 rad/s).
        """
        P, imu = self.covariance(time_s), self.predict(time_s)
        H = np.zeros((*P.shape[:1], 6, P.shape[-1]))
        H[:, 0:3, POSITION] = np.eye(3)
        H[:, 0:3, ATTITUDE] = skew(rotate(imu.q_nb, lever_b_m))
        H[:, 3:6, VELOCITY] = np.eye(3)
        swing_b = np.cross(imu.omega_ib_b_radps, lever_b_m)
        H[:, 3:6, ATTITUDE] = skew(rotate(imu.q_nb, swing_b))
        columns = [rotate(imu.q_nb, column) for column in skew(lever_b_m).T]
        H[:, 3:6, GYRO_BIAS] = np.stack(columns, axis=-1)
        return H @ P @ np.swapaxes(H, -1, -2)

    def _inside(self, time_s: FloatArray) -> FloatArray:
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        first, last = self.time_s[0], self.time_s[-1]
        if self.time_s.size < 2 or not (
            first - SAME_INSTANT_S <= t.min() and t.max() <= last + SAME_INSTANT_S
        ):
            raise NumericalError(
                f"trajectory asked for at {t.min():.6f} … {t.max():.6f} s: it has increments"
                f" from {first:.6f} to {last:.6f} s"
            )
        return np.clip(t, first, last)

    @cached_property
    def _place(self) -> CubicHermiteSpline:
        """Latitude, longitude, height over time."""
        north_m = meridian_radius_m(self.lat_rad) + self.height_m
        east_m = (transverse_radius_m(self.lat_rad) + self.height_m) * np.cos(self.lat_rad)
        per_second = self.v_n_mps / np.column_stack([north_m, east_m, -np.ones_like(north_m)])
        places = np.column_stack([self.lat_rad, self.lon_rad, self.height_m])
        return CubicHermiteSpline(self.time_s, places, per_second)

    @cached_property
    def _velocity(self) -> CubicSpline:
        return CubicSpline(self.time_s, self.v_n_mps)

    def _rate(self, t: FloatArray) -> FloatArray:
        """Angular rate linear between the middles of the increments."""
        middles = 0.5 * (self.time_s[:-1] + self.time_s[1:])
        axes = [np.interp(t, middles, self.omega_ib_b_radps[:, axis]) for axis in range(3)]
        return np.column_stack(axes)


def _q_en(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """Rotation NED → ECEF (k, 4): down the meridian, then about the Earth's axis."""
    half_lon, half_tilt = 0.5 * lon_rad, -0.5 * (lat_rad + 0.5 * np.pi)
    cl, sl, ct, st = np.cos(half_lon), np.sin(half_lon), np.cos(half_tilt), np.sin(half_tilt)
    return np.column_stack([cl * ct, -sl * st, cl * st, sl * ct])
