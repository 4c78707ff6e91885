"""The vehicle: a path and an attitude laid at a place, and the motion of every point of its body.

Seconds count true time (GPST) from the scenario's start. The path is that of the IMU; the
derivatives are those in the rotating Earth frame, without Coriolis or centripetal terms.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pymap3d

from deepgnss.core.attitude import euler_rad, quaternion_from_matrix
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.attitude import Attitude, Steady, Turning, turning
from deepgnss.sim.motion.paths import Motion, Path, Static
from deepgnss.sim.motion.road import Road
from deepgnss.sim.motion.street import StreetPath


class Pose(NamedTuple):
    """Motion and attitude of the IMU at times (n,)."""

    r_e_m: FloatArray  # (n, 3) ECEF, and its derivatives by time
    v_e_mps: FloatArray
    a_e_mps2: FloatArray
    C_eb: FloatArray  # (n, 3, 3) body FRD → ECEF
    omega_eb_b_radps: FloatArray  # (n, 3) of the body against ECEF in body axes
    alpha_eb_b_radps2: FloatArray  # (n, 3) its derivative


class Geographic(NamedTuple):
    """Where things stand in the local frame of the present position, each over times (n,)."""

    lat_rad: FloatArray
    lon_rad: FloatArray
    height_m: FloatArray
    v_n_mps: FloatArray  # (n, 3) NED
    euler_rad: FloatArray  # (n, 3) roll, pitch, yaw


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A path and an attitude in the local NED frame of a place (WGS-84, ellipsoidal height)."""

    latitude_rad: float
    longitude_rad: float
    height_m: float
    path: Path = field(default_factory=Static)
    attitude: Attitude = field(default_factory=Steady)

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative of the motion jumps, rising: where quadrature splits."""
        return tuple(sorted({*self.path.breaks_s, *self.attitude.breaks_s}))

    @property
    def road(self) -> Road | None:
        """The road it drives along, if there is one."""
        return self.path.road if isinstance(self.path, StreetPath) else None

    def pose(self, t_s: FloatArray) -> Pose:
        """Everything of the IMU at seconds since the start (n,)."""
        t_s = np.asarray(t_s, dtype=np.float64)
        motion, turn = self._laid(self.path(t_s)), turning(self.attitude(t_s))
        C_en = C_ne(self.latitude_rad, self.longitude_rad).T
        return Pose(*motion, C_en @ turn.C_nb, turn.omega_b_radps, turn.alpha_b_radps2)

    def point(
        self, t_s: FloatArray, lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Motion:
        """Motion in ECEF of the body's point at a lever arm from the IMU (body FRD)."""
        t_s = np.asarray(t_s, dtype=np.float64)
        motion = self.path(t_s)
        if any(lever_b_m):
            arm = swung(turning(self.attitude(t_s)), lever_b_m)
            motion = Motion(*(a + b for a, b in zip(motion, arm, strict=True)))
        return self._laid(motion)

    def _laid(self, local: Motion) -> Motion:
        """Motion in ECEF of a motion in the local frame."""
        C = C_ne(self.latitude_rad, self.longitude_rad)  # row vectors: v_e = v_n @ C_ne
        origin_e_m = ecef(self.latitude_rad, self.longitude_rad, self.height_m)
        return Motion(origin_e_m + local.r_m @ C, local.v_mps @ C, local.a_mps2 @ C)


def swung(turn: Turning, lever_b_m: tuple[float, float, float]) -> Motion:
    """Motion a lever arm adds: C l, C (ω × l), C (α × l + ω × (ω × l))."""
    arm = np.broadcast_to(lever_b_m, turn.omega_b_radps.shape)
    swing = np.cross(turn.omega_b_radps, arm)
    pull = np.cross(turn.alpha_b_radps2, arm) + np.cross(turn.omega_b_radps, swing)
    return Motion(*(np.einsum("kij,kj->ki", turn.C_nb, part) for part in (arm, swing, pull)))


def geographic(pose: Pose) -> Geographic:
    """Position, velocity and attitude as a navigator states them."""
    lat, lon, height_m = (
        np.asarray(x, dtype=np.float64).reshape(-1)  # pymap3d drops the axis of a single point
        for x in pymap3d.ecef2geodetic(*pose.r_e_m.T, deg=False)
    )
    to_n = C_ne(lat, lon)
    return Geographic(
        lat,
        lon,
        height_m,
        np.einsum("kij,kj->ki", to_n, pose.v_e_mps),
        euler_rad(quaternion_from_matrix(to_n @ pose.C_eb)),
    )
