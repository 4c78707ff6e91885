"""Delay of the signal in ionosphere and troposphere. All delays in metres, positive."""

from __future__ import annotations

from typing import Final

import numpy as np

from deepgnss.core.constants import BDT_MINUS_GPST_S, SPEED_OF_LIGHT_MPS
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import BDS_B1I, GPS_L1CA, FloatArray, Klobuchar

_DAY_S: Final = 86_400.0
_TROPOPAUSE_M: Final = 11_000.0
_BEIDOU_RADIUS_M: Final = 6_378_000.0
_BEIDOU_SHELL_M: Final = 375_000.0

_Four = tuple[float, float, float, float]

TYPICAL_KLOBUCHAR: Final = Klobuchar(
    (0.1118e-7, -0.7451e-8, -0.5961e-7, 0.1192e-6),
    (0.1167e6, -0.2294e6, -0.1311e6, 0.1049e7),
)
"""Broadcast of 2004-01-01, between the extremes of the solar cycle: better than no ionosphere at
all while none has been received; RTKLIB assumes the same."""


@brief_kernel
def klobuchar_delay(
    coefficients: Klobuchar,
    lat_rad: float,
    lon_rad: float,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: float,
    carrier_hz: float | FloatArray = GPS_L1CA.carrier_hz,
) -> FloatArray:
    """Ionospheric delay of the code, m, at a carrier frequency (the phase is early by as much).

    A satellite below the horizon gets the delay of the horizon: the thin-shell model has no
    meaning there.

    Parameters: azimuth and elevation, shape (k,); tow_s, GPST.
    Source: IS-GPS-200 20.3.3.5.2.5, scaled by (L1/f)².
    """
    alpha, beta = coefficients
    at_l1_s = _klobuchar(alpha, beta, lat_rad, lon_rad, azimuth_rad, elevation_rad, tow_s)
    return SPEED_OF_LIGHT_MPS * at_l1_s * (GPS_L1CA.carrier_hz / carrier_hz) ** 2


@brief_kernel
def _klobuchar(
    alpha: _Four,
    beta: _Four,
    lat_rad: float,
    lon_rad: float,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: float,
) -> FloatArray:
    """Delays at L1, s; the model counts angles in semicircles."""
    delay_s = np.empty(azimuth_rad.size)
    for k in range(azimuth_rad.size):
        E = max(elevation_rad[k], 0.0) / np.pi
        psi = 0.0137 / (E + 0.11) - 0.022
        lat_i = min(max(lat_rad / np.pi + psi * np.cos(azimuth_rad[k]), -0.416), 0.416)
        lon_i = lon_rad / np.pi + psi * np.sin(azimuth_rad[k]) / np.cos(lat_i * np.pi)
        lat_m = lat_i + 0.064 * np.cos((lon_i - 1.617) * np.pi)
        local_s = (0.5 * _DAY_S * lon_i + tow_s) % _DAY_S
        amplitude_s = max(_cubic(alpha, lat_m), 0.0)
        x = 2.0 * np.pi * (local_s - 50_400.0) / max(_cubic(beta, lat_m), 72_000.0)
        day_s = amplitude_s * (1.0 - x**2 / 2.0 + x**4 / 24.0) if abs(x) < 1.57 else 0.0
        delay_s[k] = (1.0 + 16.0 * (0.53 - E) ** 3) * (5e-9 + day_s)
    return delay_s


@brief_kernel
def _cubic(coefficients: _Four, x: float) -> float:
    a, b, c, d = coefficients
    return a + x * (b + x * (c + x * d))


@brief_kernel
def beidou_klobuchar_delay(
    coefficients: Klobuchar,
    lat_rad: float,
    lon_rad: float,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: float,
    carrier_hz: float | FloatArray = BDS_B1I.carrier_hz,
) -> FloatArray:
    """Ionospheric delay of the code by BeiDou's coefficients, as `klobuchar_delay`.

    The same day curve, but a whole cosine over the geographic latitude (its magnitude: both
    hemispheres are alike) of a point 375 km up, with the exact geometry of a sphere. Satellites
    below the horizon get the delay of the horizon.

    Source: BDS-SIS-ICD B1I 5.2.4.7; tow_s, GPST.
    """
    alpha, beta = coefficients
    at_b1i_s = _beidou_klobuchar(alpha, beta, lat_rad, lon_rad, azimuth_rad, elevation_rad, tow_s)
    return SPEED_OF_LIGHT_MPS * at_b1i_s * (BDS_B1I.carrier_hz / carrier_hz) ** 2


@brief_kernel
def _beidou_klobuchar(
    alpha: _Four,
    beta: _Four,
    lat_rad: float,
    lon_rad: float,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: float,
) -> FloatArray:
    """Delays at B1I, s."""
    delay_s = np.empty(azimuth_rad.size)
    for k in range(azimuth_rad.size):
        E = max(elevation_rad[k], 0.0)
        sin_nadir = _BEIDOU_RADIUS_M / (_BEIDOU_RADIUS_M + _BEIDOU_SHELL_M) * np.cos(E)
        psi = 0.5 * np.pi - E - np.arcsin(sin_nadir)  # earth's central angle to the pierce point
        lat_i = np.arcsin(
            np.sin(lat_rad) * np.cos(psi) + np.cos(lat_rad) * np.sin(psi) * np.cos(azimuth_rad[k])
        )
        lon_i = lon_rad + np.arcsin(np.sin(psi) * np.sin(azimuth_rad[k]) / np.cos(lat_i))
        local_s = (0.5 * _DAY_S * lon_i / np.pi + tow_s + BDT_MINUS_GPST_S) % _DAY_S
        latitude = abs(lat_i) / np.pi
        amplitude_s = max(_cubic(alpha, latitude), 0.0)
        period_s = min(max(_cubic(beta, latitude), 72_000.0), 172_800.0)
        from_peak_s = local_s - 50_400.0
        by_day = abs(from_peak_s) < 0.25 * period_s
        day_s = amplitude_s * np.cos(2.0 * np.pi * from_peak_s / period_s) if by_day else 0.0
        delay_s[k] = (5e-9 + day_s) / np.sqrt(1.0 - sin_nadir**2)
    return delay_s


@brief_kernel
def standard_atmosphere(
    height_m: float, relative_humidity: float = 0.5
) -> tuple[float, float, float]:
    """Pressure and water vapour pressure in hPa, temperature in K, at a height.

    ICAO standard atmosphere: 6.5 K/km up to the tropopause, isothermal above. Heights under
    −1 km count as −1 km.
    """
    height_m = max(height_m, -1000.0)
    low_m = min(height_m, _TROPOPAUSE_M)
    temperature_k = 288.15 - 6.5e-3 * low_m
    pressure_hpa = 1013.25 * (temperature_k / 288.15) ** 5.25588
    pressure_hpa *= np.exp(-(height_m - low_m) * 1.576885e-4)
    vapour_hpa = (
        6.108
        * relative_humidity
        * np.exp((17.15 * temperature_k - 4684.0) / (temperature_k - 38.45))
        * np.exp(-(height_m - low_m) / 2000.0)
    )
    return pressure_hpa, vapour_hpa, temperature_k


@brief_kernel
def saastamoinen_delay(
    lat_rad: float, height_m: float, elevation_rad: FloatArray, relative_humidity: float = 0.5
) -> FloatArray:
    """Tropospheric delay, m, in a standard atmosphere.

    Zenith delays of Saastamoinen (1972) times the mapping of Black and Eisner (RTCA DO-229
    A.4.2.4: 1 % down to 4°, there with its correction down to 2°). Satellites below 2° get the
    delay of 2°, some 60 m at sea level: nothing better is known, and an aircraft that sees them
    should give them little weight.

    Parameters: elevation, shape (k,).
    """
    pressure_hpa, vapour_hpa, temperature_k = standard_atmosphere(height_m, relative_humidity)
    gravity = 1.0 - 0.00266 * np.cos(2.0 * lat_rad) - 0.28e-6 * max(height_m, -1000.0)
    dry_m = 0.0022768 * pressure_hpa / gravity
    wet_m = 0.002277 * (1255.0 / temperature_k + 0.05) * vapour_hpa
    delay_m = np.empty(elevation_rad.size)
    for k in range(elevation_rad.size):
        E = max(elevation_rad[k], np.radians(2.0))
        low_deg = max(4.0 - np.degrees(E), 0.0)
        mapping = 1.001 / np.sqrt(0.002001 + np.sin(E) ** 2) * (1.0 + 0.015 * low_deg**2)
        delay_m[k] = (dry_m + wet_m) * mapping
    return delay_m
