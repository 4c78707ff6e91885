"""What comes from outside to the inertial navigation: GNSS fixes and wheel speeds."""

from __future__ import annotations

from dataclasses import dataclass

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray, NavSolution
from deepgnss.core.time import GpsTime


@dataclass(frozen=True, slots=True)
class GnssFix:
    """Antenna position (ECEF) and, where there is one, velocity (NED), covariances in NED."""

    time: GpsTime
    r_e_m: FloatArray  # (3,)
    covariance_n_m2: FloatArray  # (3, 3)
    v_n_mps: FloatArray | None = None  # (3,)
    velocity_covariance_n_m2ps2: FloatArray | None = None  # (3, 3)


@dataclass(frozen=True, slots=True)
class WheelSpeeds:
    """Forward speeds of an odometer, seconds since `origin`."""

    origin: GpsTime
    time_s: FloatArray  # (m,) rising
    speed_mps: FloatArray  # (m,)


def fix_of(solution: NavSolution) -> GnssFix:
    """Fix of a valid navigation solution."""
    lat_rad, lon_rad, _ = geodetic(solution.r_e_m)
    to_n = C_ne(lat_rad, lon_rad)
    return GnssFix(
        solution.time,
        solution.r_e_m,
        to_n @ solution.covariance_m2[:3, :3] @ to_n.T,
        to_n @ solution.v_e_mps,
        to_n @ solution.velocity_covariance_m2ps2[:3, :3] @ to_n.T,
    )
