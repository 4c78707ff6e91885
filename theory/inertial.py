"""How velocity and position of an unaided inertial navigation spread, T 4.3, T(4.30–4.32), T 4.5.

Over times far below the Schuler period (84 min) the errors of velocity obey δv̇ = f×φ + δf and
φ̇ = −δω with a constant specific force f in NED, T(4.13). What is drawn once (initial errors, bias,
scale) gives powers of time, T(4.77–4.83), T(4.102–4.108); white noise through an impulse response
h(t) gives the variance density²·∫h² dt, T(4.62), T(4.84–4.99), T(4.109–4.123). T lets the drift
be a random walk there; here it keeps its correlation time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray, ImuGrade

_AXES_N: Final = np.eye(3)


class Term(NamedTuple):
    """1σ along m directions (NED unless others were asked for) over time from one source."""

    name: str
    white: bool  # driven by noise on the way, not drawn once
    velocity_mps: FloatArray  # (n, m)
    position_m: FloatArray  # (n, m)


def error_growth(
    grade: ImuGrade,
    f_n_mps2: FloatArray,
    time_s: FloatArray,
    along_n: FloatArray = _AXES_N,
) -> tuple[Term, ...]:
    """Each source's share of the errors after times (n,) at constant specific force (3,) in NED.

    Initial errors are the grade's; the vertical velocity's is that of the horizontal ones; a
    position error at the start is left to the caller. A vehicle at rest has f = (0, 0, −g).
    along_n: unit vectors (m, 3) along which the errors are told; a tilt moves several axes at
    once, so that what it does along a line of sight does not follow from NED alone.
    """
    t = np.asarray(time_s, dtype=np.float64)
    f = np.asarray(f_n_mps2, dtype=np.float64)
    u = np.asarray(along_n, dtype=np.float64)
    level, turned = np.sum(u**2, axis=1), np.cross(u, f) ** 2  # u·(f×φ) = φ·(u×f)
    any_axis = turned @ np.ones(3)  # f² across the direction
    angles = turned @ np.array([grade.tilt_rad, grade.tilt_rad, grade.heading_rad]) ** 2
    gyro_s, accel_s = grade.gyro_drift_time_s, grade.accel_drift_time_s
    return (
        _drawn("initial velocity", grade.velocity_mps**2 * level, 0, t),
        _drawn("initial attitude", angles, 1, t),
        _drawn("accelerometer bias", grade.accel_bias_mps2**2 * level, 1, t),
        _drawn("accelerometer scale", grade.accel_scale**2 * (u**2 @ f**2), 1, t),
        _drawn("gyro bias", grade.gyro_bias_radps**2 * any_axis, 2, t),
        _white(
            "accelerometer noise", grade.accel_noise_mps_rts**2 * level, _power(0), _power(1), t
        ),
        _white(
            "accelerometer drift",
            grade.accel_drift_mps3_rthz**2 * level,
            _drift(1, accel_s),
            _drift(2, accel_s),
            t,
        ),
        _white("gyro noise", grade.gyro_noise_rad_rts**2 * any_axis, _power(1), _power(2), t),
        _white(
            "gyro drift",
            grade.gyro_drift_radps2_rthz**2 * any_axis,
            _drift(2, gyro_s),
            _drift(3, gyro_s),
            t,
        ),
    )


def total(terms: tuple[Term, ...]) -> tuple[FloatArray, FloatArray]:
    """1σ of velocity and position (n, m) each from independent terms together."""
    velocity2 = np.sum([term.velocity_mps**2 for term in terms], axis=0)
    position2 = np.sum([term.position_m**2 for term in terms], axis=0)
    return np.sqrt(velocity2), np.sqrt(position2)


_Response = Callable[[FloatArray], FloatArray]


def _power(order: int) -> _Response:
    """t^order/order!: an impulse integrated order + 1 times."""
    factorial = float(np.prod(np.arange(1, order + 1)))
    return lambda t: np.asarray(t**order / factorial)


def _drift(order: int, time_s: float) -> _Response:
    """e^(−t/T) integrated `order` times; T → ∞ leads to t^order/order!."""

    def response(t: FloatArray) -> FloatArray:
        # ∫₀ᵗ (t − s)^(order−1)/(order−1)!·e^(−s/T) ds by quadrature: closed forms lose digits
        points, weights = np.polynomial.legendre.leggauss(12)
        s = 0.5 * t[..., np.newaxis] * (1.0 + points)
        kernel = _power(order - 1)(t[..., np.newaxis] - s) * np.exp(-s / time_s)
        return np.asarray(0.5 * t * (kernel @ weights))

    return response


def _drawn(name: str, variance: FloatArray, order: int, t: FloatArray) -> Term:
    """A constant of the given variance (m,) that reaches velocity by t^order/order!."""
    sigma = np.sqrt(variance)
    return Term(
        name, False, np.outer(_power(order)(t), sigma), np.outer(_power(order + 1)(t), sigma)
    )


def _white(
    name: str, density2: FloatArray, to_velocity: _Response, to_position: _Response, t: FloatArray
) -> Term:
    """White noise of squared density (m,) through impulse responses."""
    points, weights = np.polynomial.legendre.leggauss(12)
    lags = 0.5 * t[:, np.newaxis] * (1.0 + points)

    def sigma(response: _Response) -> FloatArray:
        return np.sqrt(np.outer(0.5 * t * (response(lags) ** 2 @ weights), density2))

    return Term(name, True, sigma(to_velocity), sigma(to_position))
