"""True atmosphere: Klobuchar's ionosphere and Saastamoinen's troposphere, vectorised over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from deepgnss.core.constants import BDT_MINUS_GPST_S, SPEED_OF_LIGHT_MPS
from deepgnss.core.records import BDS_B1I, GPS_L1CA, FloatArray, Klobuchar, SignalId

_NIGHT_S: Final = 5.0e-9
_PEAK_S: Final = 50_400.0  # 14 h local time
_BEIDOU_SHELL: Final = 375.0 / 6378.0  # height of the ionosphere over the earth's radius

# Heights, m, and coefficient of tan² z, hPa (Saastamoinen 1973, table).
_BEND: Final = (
    (0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0),
    (1.156, 1.079, 1.006, 0.938, 0.874, 0.813, 0.757, 0.654, 0.563),
)


def ionosphere_of(
    models: Mapping[str, Klobuchar],
    signal: SignalId,
    latitude_rad: FloatArray,
    longitude_rad: FloatArray,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: FloatArray,
) -> FloatArray:
    """Group delay of a signal by its system's own coefficients or else the other's, m, (n,).

    Parameters: models by system letter, at least one; tow_s in GPST.
    """
    system = signal.system if signal.system in models else next(iter(models))
    delay_m = beidou_ionosphere_m if system == "C" else ionosphere_m
    place = latitude_rad, longitude_rad, azimuth_rad, elevation_rad
    return delay_m(models[system], *place, tow_s, signal.carrier_hz)


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


def beidou_ionosphere_m(
    model: Klobuchar,
    latitude_rad: FloatArray,
    longitude_rad: FloatArray,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: FloatArray,
    carrier_hz: float,
) -> FloatArray:
    """Group delay as BeiDou's coefficients tell it, m, all inputs (n,), tow_s in GPST.

    BDS-SIS-ICD B1I 5.2.4.7: a sphere of 6378 km under a shell 375 km up.
    """
    # By vectors: the ray from the antenna meets the shell; angles follow from the point's place.
    up = np.stack(
        [
            np.cos(latitude_rad) * np.cos(longitude_rad),
            np.cos(latitude_rad) * np.sin(longitude_rad),
            np.sin(latitude_rad),
        ]
    )
    east = np.stack([-np.sin(longitude_rad), np.cos(longitude_rad), np.zeros_like(longitude_rad)])
    north = np.cross(up, east, axis=0)
    level = north * np.cos(azimuth_rad) + east * np.sin(azimuth_rad)
    rise = np.sin(elevation_rad)
    shell = 1.0 + _BEIDOU_SHELL
    reach = np.sqrt(shell**2 - np.cos(elevation_rad) ** 2) - rise  # earth radii along the ray
    pierce = up * (1.0 + reach * rise) + level * (reach * np.cos(elevation_rad))
    semicircles = np.abs(np.arcsin(pierce[2] / shell)) / np.pi
    local_s = np.mod(
        43_200.0 / np.pi * np.arctan2(pierce[1], pierce[0]) + tow_s + BDT_MINUS_GPST_S, 86_400.0
    )
    amplitude = np.maximum(np.polynomial.polynomial.polyval(semicircles, model.alpha), 0.0)
    period = np.clip(np.polynomial.polynomial.polyval(semicircles, model.beta), 72_000.0, 172_800.0)
    phase = 2.0 * np.pi * (local_s - _PEAK_S) / period
    day = np.where(np.abs(phase) < 0.5 * np.pi, amplitude * np.cos(phase), 0.0)
    obliquity = shell / (reach + rise)  # 1 / cos of the angle at which the ray pierces the shell
    at_b1i_m = obliquity * (_NIGHT_S + day) * SPEED_OF_LIGHT_MPS
    return np.asarray(at_b1i_m * (BDS_B1I.carrier_hz / carrier_hz) ** 2)


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
