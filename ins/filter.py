"""The Kalman update, with the test of what comes in.

x is the estimated error (estimate − truth) of the nominal state; a measurement gives
z = predicted − measured, so that z = H·x + noise, as T(2.73), T(2.74).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv
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
    weighed = _weighed(H @ PHt + R, np.column_stack([innovation, PHt.T]))
    nis, K = float(innovation @ weighed[:, 0]), weighed[:, 1:].T
    remaining = np.eye(x.size) - K @ H
    after = remaining @ P @ remaining.T + K @ R @ K.T
    return Correction(x + K @ innovation, 0.5 * (after + after.T), innovation, nis)


def squared_innovation(
    x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> float:
    """`nis` of a measurement that is not taken in."""
    innovation = z - H @ x
    return float(innovation @ _weighed(H @ P @ H.T + R, innovation))


def _weighed(S: FloatArray, columns: FloatArray) -> FloatArray:
    """S⁻¹ times columns, the innovation among them, by the Cholesky factor of its covariance S."""
    if not (np.isfinite(columns).all() and np.isfinite(S).all()):
        raise NumericalError("innovation or its covariance is not finite")
    _, solved, info = dposv(S, columns, lower=True)  # SciPy's front ends take as long again
    if info > 0:
        raise NumericalError(f"innovation covariance is not positive: row {info} of its factor")
    return np.asarray(solved)


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
