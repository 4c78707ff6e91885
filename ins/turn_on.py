"""Biases with which a log begins, as a vehicle at rest shows them.

Drift starts at zero and walks: over a run it may hide a bias many times that of a grade, in the
first tenths of a second it has not gone far. At rest the gyros feel the Earth's rate, and the force
is as large as gravity whatever the attitude; level parts of it are tilt as well as bias.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import EARTH_RATE_RADPS
from deepgnss.core.earth import gravity_mps2
from deepgnss.core.frames import geodetic
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.increments import between
from deepgnss.ins.standstill import fastest_at_rest_mps, standing, standstill_limits

_EARTH_RADPS: Final = EARTH_RATE_RADPS / math.sqrt(3.0)  # on an axis, in any attitude
_ANOMALY_MPS2: Final = 5e-4  # of gravity against the ellipsoid's
_LONGEST_S: Final = 1e4  # over which a sensor without drift is averaged
_QUIETEST: Final = 1e-12  # noise, rad/√s or m/s/√s


class TurnOnBias(NamedTuple):
    """What three like sensors read too much as a log begins, rad/s or m/s²."""

    largest: float  # of the axes, or along the plumb line
    sigma: float  # 1σ of it by all that the grade allows a unit


class TurnOn(NamedTuple):
    """Biases with which a log begins."""

    gyro: TurnOnBias
    accel: TurnOnBias


def turn_on(block: ImuBlock, fix: GnssFix, grade: ImuGrade) -> TurnOn | None:
    """Biases with which a log begins, by the rest up to a fix; None: it did not rest all the time.

    fix: with a velocity. What moves at a steady speed feels what it would at rest; what speeds up
    or brakes as steadily does not, and only the fix tells that it did neither.
    """
    begin_s = float(block.time_s[0] - block.dt_s[0])
    rest = between(block, begin_s, fix.time.since(block.origin))
    limits = standstill_limits(grade, 1.0 / float(np.median(rest.dt_s)))
    whole = rest.time_s > begin_s + limits.window_s + float(rest.dt_s.max())
    moves = fix.v_n_mps is None or float(np.linalg.norm(fix.v_n_mps)) > fastest_at_rest_mps(
        fix.velocity_sigma_mps
    )
    if moves or not whole.any() or not standing(rest, limits)[whole].all():
        return None
    lat_rad, _, height_m = geodetic(fix.r_e_m)
    gravity = float(gravity_mps2(lat_rad, height_m))
    turned_b, turned_sigma = first_mean(
        rest.dtheta_b_rad, rest.dt_s, grade.gyro_noise_rad_rts, grade.gyro_drift_radps2_rthz
    )
    felt_b, felt_sigma = first_mean(
        rest.dv_b_mps, rest.dt_s, grade.accel_noise_mps_rts, grade.accel_drift_mps3_rthz
    )
    gyro_radps = math.hypot(grade.gyro_bias_radps, _EARTH_RADPS, turned_sigma)
    scaled_mps2 = grade.accel_scale * gravity
    accel_mps2 = math.hypot(grade.accel_bias_mps2, scaled_mps2, _ANOMALY_MPS2, felt_sigma)
    return TurnOn(
        TurnOnBias(float(np.abs(turned_b).max()), gyro_radps),
        TurnOnBias(abs(float(np.linalg.norm(felt_b)) - gravity), accel_mps2),
    )


def first_mean(
    increments: FloatArray, dt_s: FloatArray, noise_rts: float, drift_rthz: float
) -> tuple[FloatArray, float]:
    """Rates (3,) at the beginning of constant ones, and their 1σ by white noise and drift.

    Weights w(t) that leave the least of noise r and drift q, r²∫w²dt + q²∫(∫ₜw)²dt, over a length
    T are as cosh((T − t)/τ), τ = r/q, and leave r·q·coth(T/τ). The noise is that of the grade, or
    what consecutive increments (n, 3) show if that is more.
    """
    rate = increments / dt_s[:, np.newaxis]
    seen2 = 0.5 * float(np.mean(np.diff(rate, axis=0) ** 2, axis=0).max() * np.median(dt_s))
    noise = max(noise_rts, math.sqrt(seen2), drift_rthz * float(dt_s.max()), _QUIETEST)
    tau_s = noise / max(drift_rthz, noise / _LONGEST_S)
    since_s = np.cumsum(dt_s) - 0.5 * dt_s
    length_s = float(dt_s.sum())
    weight = np.exp(-since_s / tau_s) + np.exp((since_s - 2.0 * length_s) / tau_s)
    weight /= weight @ dt_s
    variance = noise * noise / (tau_s * math.tanh(length_s / tau_s))
    return weight @ increments, math.sqrt(variance)
