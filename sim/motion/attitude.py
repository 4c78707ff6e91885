"""Attitude along a path: roll, pitch, yaw with exact derivatives, and what body axes make of them.

The angles turn the local NED frame of the vehicle's place into body axes FRD (Z-Y-X); that frame
is fixed to the Earth, so the rates are those of the body against the Earth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from deepgnss.core.attitude import matrix_from_euler
from deepgnss.core.constants import STANDARD_GRAVITY_MPS2
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.jets import Jet, arctan, constant, power
from deepgnss.sim.motion.paths import Ellipse
from deepgnss.sim.motion.profile import breaks, derivatives


class Angles(NamedTuple):
    """Roll, pitch and yaw, rad, with their derivatives."""

    roll: Jet
    pitch: Jet
    yaw: Jet


class Attitude(Protocol):
    """Angles against the local NED frame at times (n,)."""

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""

    def __call__(self, t_s: FloatArray) -> Angles:
        """Angles at seconds since the start."""


class Turning(NamedTuple):
    """Body axes: C_nb (n, 3, 3) and the angular rate ω_nb and its derivative (n, 3) in them."""

    C_nb: FloatArray
    omega_b_radps: FloatArray
    alpha_b_radps2: FloatArray


def turning(angles: Angles) -> Turning:
    """Matrices and angular rates of Euler angles: ω_b = (φ̇, 0, 0) + C_x(φ)·((0, θ̇, 0) + …)."""
    roll, pitch, yaw = angles
    sr, cr = np.sin(roll.x), np.cos(roll.x)
    sp, cp = np.sin(pitch.x), np.cos(pitch.x)
    # Axes after yaw and pitch, before roll: rates about the right and down axes, and their slopes.
    right, down = pitch.d, yaw.d * cp
    right_slope, down_slope = pitch.dd, yaw.dd * cp - yaw.d * pitch.d * sp
    y, z = right * cr + down * sr, down * cr - right * sr
    omega = np.column_stack([roll.d - yaw.d * sp, y, z])
    alpha = np.column_stack(
        [
            roll.dd - yaw.dd * sp - yaw.d * pitch.d * cp,
            right_slope * cr + down_slope * sr + roll.d * z,
            down_slope * cr - right_slope * sr - roll.d * y,
        ]
    )
    return Turning(
        matrix_from_euler(np.column_stack([roll.x, pitch.x, yaw.x])),
        omega,
        alpha,
    )


@dataclass(frozen=True, slots=True)
class Steady:
    """One attitude throughout."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    breaks_s: tuple[float, ...] = ()

    def __call__(self, t_s: FloatArray) -> Angles:
        """Angles at seconds since the start."""
        return Angles(
            *(constant(angle, t_s.size) for angle in (self.roll_rad, self.pitch_rad, self.yaw_rad))
        )


def along(direction_n: tuple[float, float, float]) -> Steady:
    """Attitude without roll whose forward axis lies along a direction; yaw 0 when it is upright."""
    north, east, down = direction_n
    level = math.hypot(north, east)
    yaw = math.atan2(east, north) if level > 1e-9 else 0.0
    return Steady(pitch_rad=math.atan2(-down, level), yaw_rad=yaw)


def banked(lateral_mps2: Jet, share: float) -> Jet:
    """Roll into the turn: a share of the angle at which the lateral acceleration is not felt."""
    return arctan(lateral_mps2 * (1.0 / STANDARD_GRAVITY_MPS2)) * share


@dataclass(frozen=True, slots=True)
class EllipseAttitude:
    """Forward along an ellipse, rolled into the turn by `bank` of the coordinated angle."""

    path: Ellipse
    bank: float = 0.0

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return breaks(self.path.angle)

    def __call__(self, t_s: FloatArray) -> Angles:
        """Angles at seconds since the start."""
        a, b = self.path.north_m, self.path.east_m
        u, *rates = derivatives(self.path.angle, t_s, 4)
        angle, rate = Jet(u, *rates[:2]), Jet(*rates)
        sin, cos = np.sin(u), np.cos(u)
        square, slope = (a * cos) ** 2 + (b * sin) ** 2, 2.0 * (b * b - a * a) * sin * cos
        speed2 = angle.through(square, slope, 2.0 * (b * b - a * a) * (cos**2 - sin**2))
        yaw = angle.through(
            np.arctan2(b * sin, a * cos), a * b / square, -a * b * slope / square**2
        )
        lateral = rate * rate * power(speed2, -0.5) * (a * b)  # |v|·yaw rate, |v|² = rate²·square
        return Angles(banked(lateral, self.bank), constant(0.0, t_s.size), yaw)
