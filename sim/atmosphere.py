"""True atmosphere: Klobuchar's ionosphere and Saastamoinen's troposphere, vectorised over time."""

from __future__ import annotations

from typing import Final

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray, Klobuchar

_NIGHT_S: Final = 5.0e-9
_PEAK_S: Final = 50_400.0  # 14 h local time

# Heights, m, and coefficient of tan² z, hPa (Saastamoinen 1973, table).
_BEND: Final = (
    (0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0),
    (1.156, 1.079, 1.006, 0.938, 0.874, 0.813, 0.757, 0.654, 0.563),
)


def ionosphere_m(
    model: Klobuchar,
    latitude_rad: FloatArray,
    longitude_rad: FloatArray,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: FloatArray,
    carrier_hz: float,
) -> FloatArray:
    """Group delay at `carrier_hz` (the carrier phase advances as much), m, all inputs (n,).

    IS-GPS-200 figure 20-4; angles there are semicircles.
    """
    lat, lon, elevation = (x / np.pi for x in (latitude_rad, longitude_rad, elevation_rad))
    earth_angle = 0.0137 / (elevation + 0.11) - 0.022
    pierce_lat = np.clip(lat + earth_angle * np.cos(azimuth_rad), -0.416, 0.416)
    pierce_lon = lon + earth_angle * np.sin(azimuth_rad) / np.cos(pierce_lat * np.pi)
    magnetic_lat = pierce_lat + 0.064 * np.cos((pierce_lon - 1.617) * np.pi)
    local_s = np.mod(43_200.0 * pierce_lon + tow_s, 86_400.0)
    amplitude = np.maximum(np.polynomial.polynomial.polyval(magnetic_lat, model.alpha), 0.0)
    period = np.maximum(np.polynomial.polynomial.polyval(magnetic_lat, model.beta), 72_000.0)
    x = 2.0 * np.pi * (local_s - _PEAK_S) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    slant = 1.0 + 16.0 * (0.53 - elevation) ** 3
    at_l1_m = slant * (_NIGHT_S + day) * SPEED_OF_LIGHT_MPS
    return np.asarray(at_l1_m * (GPS_L1CA.carrier_hz / carrier_hz) ** 2)


def troposphere_m(
    latitude_rad: FloatArray, height_m: FloatArray, elevation_rad: FloatArray
) -> FloatArray:
    """Saastamoinen's delay in the standard atmosphere (15 °C, 50 % humidity at sea level), m.

    With the term in tan² z that bends it below 1 / cos z (Saastamoinen 1973): good from 5° up.
    """
    height = np.maximum(height_m, 0.0)
    temperature_k = 288.15 - 6.5e-3 * height
    pressure_hpa = 1013.25 * (temperature_k / 288.15) ** 5.2559
    vapour_hpa = 0.5 * 6.108 * np.exp((17.15 * temperature_k - 4684.0) / (temperature_k - 38.45))
    gravity = 1.0 - 0.00266 * np.cos(2.0 * latitude_rad) - 0.28e-6 * height
    bend_hpa = np.interp(height, *_BEND) / np.tan(elevation_rad) ** 2
    effective_hpa = pressure_hpa + (1255.0 / temperature_k + 0.05) * vapour_hpa - bend_hpa
    return np.asarray(0.0022768 / gravity * effective_hpa / np.sin(elevation_rad))
