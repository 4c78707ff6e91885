"""Earth and local frames: places on the ellipsoid, the rotations between, directions in the sky."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from deepgnss.core.attitude import Quaternion
from deepgnss.core.earth import SEMI_MAJOR_M, SEMI_MINOR_M, place_e_m
from deepgnss.core.jit import brief_kernel, kernel
from deepgnss.core.records import FloatArray

_FOCAL_M: Final = math.sqrt(SEMI_MAJOR_M**2 - SEMI_MINOR_M**2)


def geodetic(r_e_m: FloatArray) -> tuple[float, float, float]:
    """Latitude and longitude in rad and ellipsoidal height in m of an ECEF point (WGS-84)."""
    return _geodetic(*(float(x) for x in r_e_m))


@lru_cache(maxsize=8)  # a dozen callers ask for the same fix in turn
def _geodetic(x_e_m: float, y_e_m: float, z_e_m: float) -> tuple[float, float, float]:
    return geodetic_of(x_e_m, y_e_m, z_e_m)


@kernel
def geodetic_of(x_e_m: float, y_e_m: float, z_e_m: float) -> tuple[float, float, float]:
    """As `geodetic`, of numbers: by confocal ellipsoids, without iterations (You 2000)."""
    a, b, E = SEMI_MAJOR_M, SEMI_MINOR_M, _FOCAL_M
    off_axis_m = math.hypot(x_e_m, y_e_m)
    beyond_m2 = off_axis_m**2 + z_e_m**2 - E**2
    u = math.sqrt(0.5 * beyond_m2 + 0.5 * math.hypot(beyond_m2, 2.0 * E * z_e_m))
    if u < 1e-8 or off_axis_m < 1e-8:
        lat_rad = beta = 0.0 if abs(z_e_m) < 1e-8 else math.copysign(0.5 * math.pi, z_e_m)
        sin, cos = math.sin(beta), 1.0 if beta == 0.0 else 0.0
    else:
        v = math.hypot(u, E)
        beta = math.atan(v / u * z_e_m / off_axis_m)
        sin, cos = math.sin(beta), math.cos(beta)
        beta += (b * u - a * v + E**2) * sin / (a * v / cos - E**2 * cos)
        sin, cos = math.sin(beta), math.cos(beta)
        lat_rad = math.atan2(a * sin, b * cos)
    height_m = math.hypot(z_e_m - b * sin, off_axis_m - a * cos)
    if (off_axis_m / a) ** 2 + (z_e_m / b) ** 2 < 1.0:
        height_m = -height_m
    return lat_rad, math.atan2(y_e_m, x_e_m), height_m


def ecef(lat_rad: float, lon_rad: float, height_m: float) -> FloatArray:
    """ECEF position (3,) of a geodetic point (WGS-84)."""
    return np.array(place_e_m(float(lat_rad), float(lon_rad), float(height_m)))


def C_ne(lat_rad: float | FloatArray, lon_rad: float | FloatArray) -> FloatArray:
    """Rotation e → n (NED), v_n = C_ne @ v_e: (3, 3), or (n, 3, 3) of arrays (n,)."""
    if isinstance(lat_rad, float):
        return _C_ne(lat_rad, float(lon_rad))
    lat, lon = (np.ascontiguousarray(angle) for angle in np.broadcast_arrays(lat_rad, lon_rad))
    return _each_C_ne(lat.ravel(), lon.ravel()).reshape(*lat.shape, 3, 3)


@kernel
def _each_C_ne(lat_rad: FloatArray, lon_rad: FloatArray) -> FloatArray:
    """As `C_ne`, of arrays (n,)."""
    rotations = np.empty((lat_rad.size, 3, 3))
    for k in range(lat_rad.size):
        rotations[k] = _C_ne(lat_rad[k], lon_rad[k])
    return rotations


@brief_kernel
def _C_ne(lat_rad: float, lon_rad: float) -> FloatArray:
    sl, cl, so, co = np.sin(lat_rad), np.cos(lat_rad), np.sin(lon_rad), np.cos(lon_rad)
    return np.array(
        [[-sl * co, -sl * so, cl], [-so, co, 0.0], [-cl * co, -cl * so, -sl]], dtype=np.float64
    )


@kernel
def q_en(lat_rad: float, lon_rad: float) -> Quaternion:
    """Rotation NED → ECEF as a quaternion: down the meridian, then about the Earth's axis."""
    half_lon, half_tilt = 0.5 * lon_rad, -0.5 * (lat_rad + 0.5 * math.pi)
    cl, sl, ct, st = np.cos(half_lon), np.sin(half_lon), np.cos(half_tilt), np.sin(half_tilt)
    return cl * ct, -sl * st, cl * st, sl * ct


@brief_kernel
def azimuth_elevation(
    r_e_m: FloatArray, satellites_e_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Azimuth in [0, 2π) and elevation, rad, of ECEF points (k, 3) seen from r_e_m."""
    lat_rad, lon_rad, _ = geodetic_of(r_e_m[0], r_e_m[1], r_e_m[2])
    to_n = _C_ne(lat_rad, lon_rad)
    count = satellites_e_m.shape[0]
    azimuth, elevation = np.empty(count), np.empty(count)
    for k in range(count):
        x, y, z = satellites_e_m[k, 0], satellites_e_m[k, 1], satellites_e_m[k, 2]
        x, y, z = x - r_e_m[0], y - r_e_m[1], z - r_e_m[2]
        north = to_n[0, 0] * x + to_n[0, 1] * y + to_n[0, 2] * z
        east = to_n[1, 0] * x + to_n[1, 1] * y + to_n[1, 2] * z
        down = to_n[2, 0] * x + to_n[2, 1] * y + to_n[2, 2] * z
        azimuth[k] = math.atan2(east, north) % (2.0 * math.pi)
        if azimuth[k] == 2.0 * math.pi:
            azimuth[k] = 0.0  # rounded up from just west of north
        elevation[k] = math.atan2(-down, math.hypot(north, east))
    return azimuth, elevation
