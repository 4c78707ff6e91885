"""Modelled delays of the pseudoranges, and how much each observation is to be believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deepgnss.core.frames import geodetic
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import BDS_B1I, Ephemeris, FloatArray, Klobuchar, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.atmosphere import (
    TYPICAL_KLOBUCHAR,
    beidou_klobuchar_delay,
    klobuchar_delay,
    saastamoinen_delay,
)


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """Standard deviations that weigh the observations.

    Range: σ² = (orbit·URA)² + multipath²/sin²E + code_noise²·10^((45 − C/N0)/10)
              + (ionosphere·I)² + (troposphere·T)² + lasting²
    Range rate: σ² = rate_floor² + rate_noise²·10^((45 − C/N0)/10)
    where I and T are the modelled delays. A delay that is not modelled on purpose counts as
    absent; with Klobuchar asked for but its coefficients not yet known, a typical set serves, with
    the slant factor times `unknown_zenith` as its σ.
    """

    orbit: float = 0.5  # of what a satellite claims for its orbit and clock
    multipath_m: float = 0.5
    code_noise_m: float = 0.6
    ionosphere: float = 0.4
    unknown_zenith_m: float = 3.0
    troposphere: float = 0.05
    lasting_m: float = 0.0  # of whoever takes many epochs: errors that do not average
    rate_floor_mps: float = 0.05
    rate_noise_mps: float = 0.05


@dataclass(frozen=True, slots=True)
class PvtParameters:
    """How positions are computed."""

    elevation_mask_rad: float = float(np.radians(10.0))
    ionosphere: Literal["klobuchar", "none"] = "klobuchar"
    troposphere: Literal["saastamoinen", "none"] = "saastamoinen"
    raim: bool = True
    false_alarm: float = 1e-5  # of the residual test, per epoch
    errors: ErrorModel = field(default_factory=ErrorModel)


def delays(
    nav: NavData,
    parameters: PvtParameters,
    time: GpsTime,
    r_e_m: FloatArray,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    carriers_hz: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Atmospheric delay of each pseudorange, m, and the variance of the model, m², shape (k,)."""
    model = parameters.errors
    lat, lon, height_m = geodetic(r_e_m)
    delay_m = np.zeros(len(azimuth_rad))
    if parameters.troposphere == "saastamoinen":
        delay_m = saastamoinen_delay(lat, height_m, elevation_rad)
    variance_m2 = (model.troposphere * delay_m) ** 2
    if parameters.ionosphere == "klobuchar":
        gps, beidou = nav.klobuchar.get("G"), nav.klobuchar.get("C")
        ionosphere_m = _ionosphere(
            gps or TYPICAL_KLOBUCHAR,
            gps is not None,
            beidou or TYPICAL_KLOBUCHAR,
            beidou is not None,
            lat,
            lon,
            azimuth_rad,
            elevation_rad,
            time.tow_s,
            carriers_hz,
        )
        delay_m = delay_m + ionosphere_m
        if gps is not None or beidou is not None:
            variance_m2 += (model.ionosphere * ionosphere_m) ** 2
        else:
            slant = 1.0 + 16.0 * (0.53 - np.maximum(elevation_rad, 0.0) / np.pi) ** 3
            variance_m2 += (model.unknown_zenith_m * slant) ** 2
    return delay_m, variance_m2


@brief_kernel
def _ionosphere(
    gps: Klobuchar,
    by_gps: bool,
    beidou: Klobuchar,
    by_beidou: bool,
    lat_rad: float,
    lon_rad: float,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    tow_s: float,
    carriers_hz: FloatArray,
) -> FloatArray:
    """Ionospheric delays (k,), m, by the coefficients of those systems that have told theirs.

    BeiDou's are for its own satellites, and for those of GPS where that has none.
    """
    delay_m = klobuchar_delay(gps, lat_rad, lon_rad, azimuth_rad, elevation_rad, tow_s, carriers_hz)
    if by_beidou:
        other_m = beidou_klobuchar_delay(
            beidou, lat_rad, lon_rad, azimuth_rad, elevation_rad, tow_s, carriers_hz
        )
        for k in range(carriers_hz.size):
            if not by_gps or carriers_hz[k] == BDS_B1I.carrier_hz:
                delay_m[k] = other_m[k]
    return delay_m


def range_sigma(
    model: ErrorModel,
    ephemerides: Sequence[Ephemeris],
    elevation_rad: FloatArray,
    cn0_dbhz: FloatArray,
    delay_variance_m2: FloatArray,
) -> FloatArray:
    """Standard deviation of each pseudorange, m, shape (k,)."""
    sin_el = np.sin(np.maximum(elevation_rad, np.radians(2.0)))
    accuracy_m = np.array([e.accuracy_m for e in ephemerides])
    return np.asarray(
        np.sqrt(
            (model.orbit * accuracy_m) ** 2
            + (model.multipath_m / sin_el) ** 2
            + model.code_noise_m**2 * 10.0 ** ((45.0 - cn0_dbhz) / 10.0)
            + delay_variance_m2
            + model.lasting_m**2
        )
    )


def rate_sigma(model: ErrorModel, cn0_dbhz: FloatArray, told_mps: FloatArray) -> FloatArray:
    """Standard deviation of each pseudorange rate, m/s, shape (k,).

    told_mps (k,): noise as the loop itself knows it; NaN: it follows from C/N0.
    """
    noise_mps = model.rate_noise_mps * 10.0 ** ((45.0 - cn0_dbhz) / 20.0)
    return np.hypot(model.rate_floor_mps, np.where(np.isnan(told_mps), noise_mps, told_mps))
