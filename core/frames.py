"""Earth and local frames: thin, vectorised names over pymap3d plus the rotations we need."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pymap3d

from deepgnss.core.records import FloatArray


def geodetic(r_e_m: FloatArray) -> tuple[float, float, float]:
    """Latitude and longitude in rad and ellipsoidal height in m of an ECEF point (WGS-84)."""
    return _geodetic(*(float(x) for x in r_e_m))


@lru_cache(maxsize=8)  # a dozen callers ask for the same fix in turn
def _geodetic(x_e_m: float, y_e_m: float, z_e_m: float) -> tuple[float, float, float]:
    lat, lon, height = pymap3d.ecef2geodetic(x_e_m, y_e_m, z_e_m, deg=False)
    return float(lat), float(lon), float(height)


def ecef(lat_rad: float, lon_rad: float, height_m: float) -> FloatArray:
    """ECEF position (3,) of a geodetic point (WGS-84)."""
    return np.array(pymap3d.geodetic2ecef(lat_rad, lon_rad, height_m, deg=False), dtype=np.float64)


def C_ne(lat_rad: float | FloatArray, lon_rad: float | FloatArray) -> FloatArray:
    """Rotation e → n (NED), v_n = C_ne @ v_e: (3, 3), or (n, 3, 3) of arrays (n,)."""
    sl, cl, so, co = np.sin(lat_rad), np.cos(lat_rad), np.sin(lon_rad), np.cos(lon_rad)
    rows = [[-sl * co, -sl * so, cl], [-so, co, 0.0 * so], [-cl * co, -cl * so, -sl]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def azimuth_elevation(
    r_e_m: FloatArray, satellites_e_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Azimuth in [0, 2π) and elevation, rad, of ECEF points (k, 3) seen from r_e_m."""
    lat, lon, _ = geodetic(r_e_m)
    los_n = (satellites_e_m - r_e_m) @ C_ne(lat, lon).T
    horizontal = np.hypot(los_n[:, 0], los_n[:, 1])
    azimuth = np.mod(np.arctan2(los_n[:, 1], los_n[:, 0]), 2.0 * np.pi)
    azimuth[azimuth == 2.0 * np.pi] = 0.0  # rounded up from just west of north
    return azimuth, np.arctan2(-los_n[:, 2], horizontal)
