"""The WGS-84 ellipsoid as a navigator needs it: radii, normal gravity, rates of the local frame.

Kernels of plain arithmetic: called with numbers inside other kernels, with numbers or equally long
arrays from Python.
"""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
import pymap3d

from deepgnss.core.constants import EARTH_RATE_RADPS
from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray

Real = TypeVar("Real", float, FloatArray)

SEMI_MAJOR_M: Final = 6_378_137.0
"""Equatorial radius a (NIMA TR8350.2 table 3.1)."""

FLATTENING: Final = 1.0 / 298.257223563
"""f = (a − b)/a (NIMA TR8350.2 table 3.1)."""

SEMI_MINOR_M: Final = SEMI_MAJOR_M * (1.0 - FLATTENING)
"""Polar radius b = a·(1 − f)."""

ECCENTRICITY2: Final = FLATTENING * (2.0 - FLATTENING)
"""Square of the first eccentricity."""

GRAVITY_EQUATOR_MPS2: Final = 9.7803253359
"""Normal gravity at the equator (NIMA TR8350.2 table 3.4)."""

GRAVITY_K: Final = 0.00193185265241
"""Somigliana's k = b·γ_pole/(a·γ_equator) − 1 (NIMA TR8350.2 table 3.4)."""

GRAVITY_M: Final = 0.00344978650684
"""m = ω²a²b/GM (NIMA TR8350.2 table 3.4)."""


@kernel
def meridian_radius_m(lat_rad: Real) -> Real:
    """Radius of curvature R_M in the meridian, m."""
    w2 = 1.0 - ECCENTRICITY2 * np.sin(lat_rad) ** 2
    return SEMI_MAJOR_M * (1.0 - ECCENTRICITY2) / (w2 * np.sqrt(w2))  # type: ignore[no-any-return]


@kernel
def transverse_radius_m(lat_rad: Real) -> Real:
    """Radius of curvature R_N in the prime vertical, m."""
    w2 = 1.0 - ECCENTRICITY2 * np.sin(lat_rad) ** 2
    return SEMI_MAJOR_M / np.sqrt(w2)  # type: ignore[no-any-return]


@kernel
def place_e_m(lat_rad: Real, lon_rad: Real, height_m: Real) -> tuple[Real, Real, Real]:
    """ECEF coordinates of a geodetic point."""
    transverse_m = transverse_radius_m(lat_rad)
    off_axis_m = (transverse_m + height_m) * np.cos(lat_rad)
    along_m = (transverse_m * (1.0 - ECCENTRICITY2) + height_m) * np.sin(lat_rad)
    return off_axis_m * np.cos(lon_rad), off_axis_m * np.sin(lon_rad), along_m


@kernel
def gravity_mps2(lat_rad: Real, height_m: Real) -> Real:
    """Normal gravity at ellipsoidal height, m/s², downwards along the ellipsoid's normal.

    Somigliana's closed form with the height terms of second order (NIMA TR8350.2 4-1, 4-3).
    """
    sin2 = np.sin(lat_rad) ** 2
    surface = GRAVITY_EQUATOR_MPS2 * (1.0 + GRAVITY_K * sin2) / np.sqrt(1.0 - ECCENTRICITY2 * sin2)
    h = height_m / SEMI_MAJOR_M
    slope = 2.0 * (1.0 + FLATTENING + GRAVITY_M - 2.0 * FLATTENING * sin2)
    return surface * (1.0 - slope * h + 3.0 * h * h)  # type: ignore[no-any-return]


@kernel
def earth_rate_n(lat_rad: Real) -> tuple[Real, Real, Real]:
    """Rate of the Earth ω_ie in NED, rad/s, T(2.48)."""
    north, down = EARTH_RATE_RADPS * np.cos(lat_rad), -EARTH_RATE_RADPS * np.sin(lat_rad)
    return north, 0.0 * north, down


@kernel
def transport_rate_n(
    lat_rad: Real, height_m: Real, north_mps: Real, east_mps: Real
) -> tuple[Real, Real, Real]:
    """Rate ω_en of the NED frame over the Earth in NED, rad/s, T(2.49)."""
    about_north = east_mps / (transverse_radius_m(lat_rad) + height_m)
    about_east = -north_mps / (meridian_radius_m(lat_rad) + height_m)
    return about_north, about_east, -about_north * np.tan(lat_rad)


def gravity_e_mps2(r_e_m: FloatArray) -> FloatArray:
    """Normal gravity (the centrifugal part within) in ECEF at points (..., 3), m/s², (..., 3)."""
    x_m, y_m, z_m = np.moveaxis(np.asarray(r_e_m, dtype=np.float64), -1, 0)
    lat, lon, height_m = (
        np.asarray(part) for part in pymap3d.ecef2geodetic(x_m, y_m, z_m, deg=False)
    )
    down_e = np.stack([-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)], -1)
    gravity_e: FloatArray = np.asarray(gravity_mps2(lat, height_m))[..., np.newaxis] * down_e
    return gravity_e
