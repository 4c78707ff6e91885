"""Antenna trajectories: parametric paths with exact derivatives, in a local NED frame at a place.

The local frame is the tangent plane of the WGS-84 ellipsoid at the origin; a path is a function
of seconds since the scenario's start that gives position, velocity and acceleration in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BPoly, PPoly

from deepgnss.core.errors import ConfigError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray

_FOREVER_S = 1.0e7


class Motion(NamedTuple):
    """Position and its derivatives, each (n, 3), in the frame its user says."""

    r_m: FloatArray
    v_mps: FloatArray
    a_mps2: FloatArray


class Path(Protocol):
    """Motion in the local NED frame at times (n,)."""

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A path laid at a place (WGS-84 latitude and longitude in rad, ellipsoidal height)."""

    latitude_rad: float
    longitude_rad: float
    height_m: float
    path: Path

    def point(self, t_s: FloatArray, lever_b_m: tuple[float, float, float]) -> Motion:
        """Motion in ECEF of the path's own point; there is no attitude to turn a lever arm."""
        if any(lever_b_m):
            raise ConfigError(f"lever_arm: {lever_b_m} needs a vehicle with an attitude")
        return self.at(t_s)

    def at(self, t_s: FloatArray) -> Motion:
        """Motion in ECEF."""
        local = self.path(np.asarray(t_s, dtype=np.float64))
        C = C_ne(self.latitude_rad, self.longitude_rad)  # row vectors: v_e = v_n @ C_ne
        origin_e_m = ecef(self.latitude_rad, self.longitude_rad, self.height_m)
        return Motion(origin_e_m + local.r_m @ C, local.v_mps @ C, local.a_mps2 @ C)


# --- profiles: a scalar along the path over time --------------------------------------------------


def smooth_profile(points: Sequence[tuple[float, float]]) -> PPoly:
    """Integral of a rate that passes through (time, rate) points by smooth steps (3u² − 2u³).

    Between points the rate's slope starts and ends at zero, so jerk stays finite; before the
    first and after the last it is constant. The integral is zero at t = 0.
    """
    times, rates = (np.array(column, dtype=np.float64) for column in zip(*points, strict=True))
    knots = np.concatenate([[times[0] - _FOREVER_S], times, [times[-1] + _FOREVER_S]])
    left = np.concatenate([rates[:1], rates])
    right = np.concatenate([rates, rates[-1:]])
    rate = PPoly.from_bernstein_basis(BPoly(np.array([left, left, right, right]), knots))
    integral = rate.antiderivative()
    integral.c[-1] -= integral(0.0)
    return integral


def constant_rate(rate: float) -> PPoly:
    """Integral of a constant rate."""
    return smooth_profile([(0.0, rate)])


# --- paths ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Static:
    """At rest at the origin."""

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        return Motion(*(np.zeros((t_s.size, 3)) for _ in range(3)))


@dataclass(frozen=True, slots=True)
class Line:
    """Along a direction of the local frame, `distance` in m over time."""

    direction_n: tuple[float, float, float]  # unit vector
    distance: PPoly

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        along = np.array(self.direction_n)
        return Motion(*(np.outer(self.distance(t_s, order), along) for order in range(3)))


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Level ellipse through the origin, `angle` in rad over time, clockwise seen from above.

    Starts northwards at its westernmost point; equal semi-axes make a circle.
    """

    north_m: float
    east_m: float
    angle: PPoly

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        u, rate, slope = (self.angle(t_s, order) for order in range(3))
        level = np.zeros_like(u)
        sin, cos = np.sin(u), np.cos(u)
        r_m = (self.north_m * sin, self.east_m * (1.0 - cos), level)
        v_mps = (self.north_m * cos * rate, self.east_m * sin * rate, level)
        a_mps2 = (
            self.north_m * (cos * slope - sin * rate**2),
            self.east_m * (sin * slope + cos * rate**2),
            level,
        )
        return Motion(*(np.column_stack(parts) for parts in (r_m, v_mps, a_mps2)))


@dataclass(frozen=True, slots=True)
class Sine:
    """To and fro along a direction (e.g. a line of sight): amplitude·sin(2π·frequency·t)."""

    direction_n: tuple[float, float, float]  # unit vector
    amplitude_m: float
    frequency_hz: float

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        along = np.array(self.direction_n)
        w = 2.0 * np.pi * self.frequency_hz
        swing, slope = self.amplitude_m * np.sin(w * t_s), self.amplitude_m * np.cos(w * t_s)
        return Motion(*(np.outer(s, along) for s in (swing, w * slope, -(w**2) * swing)))
