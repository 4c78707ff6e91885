"""Paths: motion in a local NED frame with exact derivatives; jerk is finite everywhere.

The local frame is the tangent plane of the WGS-84 ellipsoid at the vehicle's place; a path is a
function of seconds since the scenario's start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import PPoly

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.profile import breaks, derivatives


class Motion(NamedTuple):
    """Position and its derivatives, each (n, 3), in the frame its user says."""

    r_m: FloatArray
    v_mps: FloatArray
    a_mps2: FloatArray


class Path(Protocol):
    """Motion in the local NED frame at times (n,)."""

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""


@dataclass(frozen=True, slots=True)
class Static:
    """At rest at the origin."""

    breaks_s: tuple[float, ...] = ()

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        return Motion(*(np.zeros((t_s.size, 3)) for _ in range(3)))


@dataclass(frozen=True, slots=True)
class Line:
    """Along a direction of the local frame, `distance` in m over time."""

    direction_n: tuple[float, float, float]  # unit vector
    distance: PPoly

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return breaks(self.distance)

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        return Motion(*(np.outer(f, self.direction_n) for f in derivatives(self.distance, t_s, 3)))


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Level ellipse through the origin, `angle` in rad over time, clockwise seen from above.

    Starts northwards at its westernmost point; equal semi-axes make a circle, a negative east
    semi-axis makes it anticlockwise.
    """

    north_m: float
    east_m: float
    angle: PPoly

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return breaks(self.angle)

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        u, rate, slope = derivatives(self.angle, t_s, 3)
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
    breaks_s: tuple[float, ...] = ()

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        w = 2.0 * np.pi * self.frequency_hz
        swing, slope = self.amplitude_m * np.sin(w * t_s), self.amplitude_m * np.cos(w * t_s)
        return Motion(*(np.outer(s, self.direction_n) for s in (swing, w * slope, -(w**2) * swing)))


@dataclass(frozen=True, slots=True)
class SineFromRest:
    """At rest, then along a direction with an acceleration amplitude·w²·sin(w·t), w = 2π·frequency.

    It never turns back: its speed is amplitude·w·(1 − cos(w·t)).
    """

    direction_n: tuple[float, float, float]  # unit vector
    amplitude_m: float
    frequency_hz: float
    rest_s: float

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instant at which it sets out."""
        return (self.rest_s,)

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        w = 2.0 * np.pi * self.frequency_hz
        angle = w * np.maximum(t_s - self.rest_s, 0.0)
        parts = (angle - np.sin(angle), w * (1.0 - np.cos(angle)), w**2 * np.sin(angle))
        return Motion(*(np.outer(self.amplitude_m * s, self.direction_n) for s in parts))
