"""The Kalman update, with the test of what comes in.

x is the estimated error (estimate − truth) of the nominal state; a measurement gives
z = predicted − measured, so that z = H·x + noise, as T(2.73), T(2.74).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.special import chdtri

from deepgnss.core.errors import NumericalError
from deepgnss.core.records import FloatArray


class Correction(NamedTuple):
    """A filter after a measurement, and what the measurement said against the prediction."""

    x: FloatArray  # (n,)
    P: FloatArray  # (n, n)
    innovation: FloatArray  # (m,) z − H·x
    nis: float  # innovation squared in units of its covariance: chi-square of m degrees


def correct(
    x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> Correction:
    """One Kalman update: gain through Cholesky, covariance in Joseph's form.

    Parameters: x (n,), P (n, n), z (m,), H (m, n), R (m, m). Raises NumericalError when the
    innovation's covariance is not positive or anything is not finite.
    """
    innovation, PHt = z - H @ x, P @ H.T
    factor = _factor(innovation, H @ PHt + R)
    nis = float(innovation @ cho_solve(factor, innovation, check_finite=False))
    K = cho_solve(factor, PHt.T, check_finite=False).T
    remaining = np.eye(x.size) - K @ H
    after = remaining @ P @ remaining.T + K @ R @ K.T
    return Correction(x + K @ innovation, 0.5 * (after + after.T), innovation, nis)


def squared_innovation(
    x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> float:
    """`nis` of a measurement that is not taken in."""
    innovation = z - H @ x
    factor = _factor(innovation, H @ P @ H.T + R)
    return float(innovation @ cho_solve(factor, innovation, check_finite=False))


def _factor(innovation: FloatArray, S: FloatArray) -> tuple[FloatArray, bool]:
    """Cholesky factor of an innovation's covariance."""
    if not (np.all(np.isfinite(innovation)) and np.all(np.isfinite(S))):
        raise NumericalError("innovation or its covariance is not finite")
    try:
        factor: tuple[FloatArray, bool] = cho_factor(S, lower=True, check_finite=False)
    except LinAlgError as error:
        raise NumericalError(f"innovation covariance is not positive: {error}") from error
    return factor


@lru_cache(maxsize=64)
def innovation_limit(degrees: int, false_alarm: float) -> float:
    """NIS that a sound measurement of so many components exceeds with the given probability."""
    return float(chdtri(degrees, false_alarm))


def check_covariance(P: FloatArray) -> None:
    """Raise NumericalError unless P is finite and positive definite."""
    scale = np.sqrt(np.diagonal(P))
    try:  # scaled to correlations: metres and rad/s side by side
        np.linalg.cholesky(P / np.outer(scale, scale))
    except np.linalg.LinAlgError as error:
        raise NumericalError(f"covariance is not positive definite: {error}") from error
