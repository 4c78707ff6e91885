"""Bodies carried by a vehicle: a unit mounted away from its reference point, a vehicle that shakes.

Both are a motion within the body axes of the carrier put on top of its own, with exact derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.attitude import Angles, Steady, Turning, turning
from deepgnss.sim.motion.jets import Jet
from deepgnss.sim.motion.paths import Motion
from deepgnss.sim.motion.vehicle import Pose, swung


class Moving(Protocol):
    """A body whose motion is known in closed form."""

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""

    def pose(self, t_s: FloatArray) -> Pose:
        """Pose at seconds since the scenario's start (n,)."""


def carry(pose: Pose, inner: Motion, turn: Turning) -> Pose:
    """Pose of a body that moves by `inner` and turns by `turn` within the axes of a carrier.

    inner: motion in the carrier's body axes; turn: C from the body to those axes, its rate and
    the rate's derivative in the body's own.
    """
    r_b, v_b, a_b = inner
    w, alpha = pose.omega_eb_b_radps, pose.alpha_eb_b_radps2
    swing = np.cross(w, r_b)
    felt = a_b + 2.0 * np.cross(w, v_b) + np.cross(alpha, r_b) + np.cross(w, swing)
    to_inner = np.swapaxes(turn.C_nb, -1, -2)
    w_inner = _turned(to_inner, w)
    return Pose(
        pose.r_e_m + _turned(pose.C_eb, r_b),
        pose.v_e_mps + _turned(pose.C_eb, v_b + swing),
        pose.a_e_mps2 + _turned(pose.C_eb, felt),
        pose.C_eb @ turn.C_nb,
        w_inner + turn.omega_b_radps,
        _turned(to_inner, alpha) + np.cross(w_inner, turn.omega_b_radps) + turn.alpha_b_radps2,
    )


@dataclass(frozen=True, slots=True)
class Mounted:
    """A unit fixed to a vehicle at a lever arm, its axes turned by roll, pitch and yaw."""

    vehicle: Moving
    lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the vehicle's reference, FRD
    euler_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)  # vehicle axes → axes of the unit

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return self.vehicle.breaks_s

    def pose(self, t_s: FloatArray) -> Pose:
        """Pose of the unit at seconds since the start (n,)."""
        t_s = np.asarray(t_s, dtype=np.float64)
        still = np.zeros((t_s.size, 3))
        inner = Motion(still + self.lever_b_m, still, still)
        return carry(self.vehicle.pose(t_s), inner, turning(Steady(*self.euler_rad)(t_s)))


class VibrationLine(NamedTuple):
    """One sine of a vibration: amplitudes along and about forward, right and down."""

    frequency_hz: float
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angle_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    phases_cycles: tuple[float, ...] = (0.0,) * 6  # of the positions, then of the angles


def with_phases(
    lines: Sequence[VibrationLine], rng: np.random.Generator
) -> tuple[VibrationLine, ...]:
    """The lines with phases drawn at random."""
    return tuple(line._replace(phases_cycles=tuple(rng.random(6).tolist())) for line in lines)


@dataclass(frozen=True, slots=True)
class Shaken:
    """A vehicle whose body vibrates about its path: what a unit and an antenna on it see alike."""

    vehicle: Moving
    lines: tuple[VibrationLine, ...]

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return self.vehicle.breaks_s

    def pose(self, t_s: FloatArray) -> Pose:
        """Pose of the reference point at seconds since the start (n,)."""
        t_s = np.asarray(t_s, dtype=np.float64)
        amplitudes = np.array([[*line.position_m, *line.angle_rad] for line in self.lines])
        cycles = np.array([line.phases_cycles for line in self.lines])
        w = 2.0 * math.pi * np.array([line.frequency_hz for line in self.lines])
        phases = w * t_s[:, np.newaxis]
        value, rate, slope = (np.zeros((6, t_s.size)) for _ in range(3))
        for axis in range(6):
            size, phase = amplitudes[:, axis], phases + 2.0 * math.pi * cycles[:, axis]
            value[axis], cosine = np.sin(phase) @ size, np.cos(phase) @ (size * w)
            rate[axis], slope[axis] = cosine, -np.sin(phase) @ (size * w**2)
        inner = Motion(value[:3].T, rate[:3].T, slope[:3].T)
        angles = (Jet(*parts) for parts in zip(value[3:], rate[3:], slope[3:], strict=True))
        return carry(self.vehicle.pose(t_s), inner, turning(Angles(*angles)))

    def point(
        self, t_s: FloatArray, lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Motion:
        """Motion in ECEF of the body's point at a lever arm from the reference (body FRD)."""
        pose = self.pose(t_s)
        turn = Turning(pose.C_eb, pose.omega_eb_b_radps, pose.alpha_eb_b_radps2)
        arm = swung(turn, lever_b_m)
        return Motion(*(a + b for a, b in zip(pose[:3], arm, strict=True)))

    @property
    def highest_hz(self) -> float:
        """Highest frequency of the vibration."""
        return max(line.frequency_hz for line in self.lines)


def _turned(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    turned: FloatArray = np.einsum("nij,nj->ni", matrices, vectors)
    return turned
