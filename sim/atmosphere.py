"""True atmosphere: Klobuchar's ionosphere and Saastamoinen's troposphere, vectorised over time."""

from __future__ import annotations

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray, Klobuchar

_NIGHT_S = 5.0e-9
_HOUR_OF_PEAK_S = 50_400.0  # 14 h local time


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
    x = 2.0 * np.pi * (local_s - _HOUR_OF_PEAK_S) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    slant = 1.0 + 16.0 * (0.53 - elevation) ** 3
    at_l1_m = slant * (_NIGHT_S + day) * SPEED_OF_LIGHT_MPS
    return np.asarray(at_l1_m * (GPS_L1CA.carrier_hz / carrier_hz) ** 2)


def troposphere_m(
    latitude_rad: FloatArray, height_m: FloatArray, elevation_rad: FloatArray
) -> FloatArray:
    """Saastamoinen's delay in the standard atmosphere (15 °C, 50 % humidity at sea level), m."""
    height = np.maximum(height_m, 0.0)
    pressure_hpa = 1013.25 * (1.0 - 2.2557e-5 * height) ** 5.2568
    temperature_k = 288.15 - 6.5e-3 * height
    vapour_hpa = 0.5 * 6.108 * np.exp((17.15 * temperature_k - 4684.0) / (temperature_k - 38.45))
    gravity = 1.0 - 0.00266 * np.cos(2.0 * latitude_rad) - 0.00028e-3 * height
    cos_zenith = np.sin(elevation_rad)
    dry = 0.0022768 * pressure_hpa / gravity
    wet = 0.002277 * (1255.0 / temperature_k + 0.05) * vapour_hpa
    return np.asarray((dry + wet) / cos_zenith)
