"""What comes from outside to the inertial navigation: GNSS fixes and wheel speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.jit import brief_kernel
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
    velocity_age_s: float = 0.0  # measured so long ago, and carried on by the increments since
    together: float = 1.0  # so many positions in a row count as one: their covariance has it in

    @property
    def velocity_sigma_mps(self) -> float:
        """1σ per axis of the velocity; infinite without one."""
        V = self.velocity_covariance_n_m2ps2
        return math.inf if self.v_n_mps is None or V is None else math.sqrt(np.trace(V) / 3.0)


def lasting_together(lasting_s: float, apart_s: float) -> float:
    """Number of measurements that count as one, of errors lasting for τ, taken Δt apart.

    Errors that last for τ leave a mean over T the variance σ²·2τ/T; white ones at a distance Δt
    would leave R·Δt/T. So many of them count as one with R = σ²·2τ/Δt.
    """
    return max(1.0, 2.0 * lasting_s / apart_s)


def with_lasting_errors(
    fix: GnssFix, position_m: float, velocity_mps: float, lasting_s: float, apart_s: float
) -> GnssFix:
    """A fix with errors its σ leaves out, those of position lasting for a while.

    Parameters: 1σ per axis on top of the fix's own; τ; Δt to the next fix.
    """
    together = lasting_together(lasting_s, apart_s)
    velocity = fix.velocity_covariance_n_m2ps2
    return replace(
        fix,
        covariance_n_m2=(fix.covariance_n_m2 + position_m**2 * np.eye(3)) * together,
        velocity_covariance_n_m2ps2=(
            None if velocity is None else velocity + velocity_mps**2 * np.eye(3)
        ),
        together=together,
    )


@dataclass(frozen=True, slots=True)
class WheelSpeeds:
    """Forward speeds of an odometer, seconds since `origin`."""

    origin: GpsTime
    time_s: FloatArray  # (m,) rising
    speed_mps: FloatArray  # (m,)


def fix_of(solution: NavSolution) -> GnssFix:
    """Fix of a valid navigation solution."""
    lat_rad, lon_rad, _ = geodetic(solution.r_e_m)
    covariance_n_m2, v_n_mps, velocity_covariance_n_m2ps2 = _local(
        C_ne(lat_rad, lon_rad),
        solution.covariance_m2,
        solution.v_e_mps,
        solution.velocity_covariance_m2ps2,
    )
    return GnssFix(
        solution.time, solution.r_e_m, covariance_n_m2, v_n_mps, velocity_covariance_n_m2ps2
    )


@brief_kernel
def _local(
    to_n: FloatArray, C: FloatArray, v_e_mps: FloatArray, V: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the places of (4, 4) the covariance, velocity, and of (4, 4) its covariance, in NED."""
    turned_C = to_n @ C[:3, :3].copy() @ to_n.T
    return turned_C, to_n @ v_e_mps, to_n @ V[:3, :3].copy() @ to_n.T
