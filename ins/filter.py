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
from deepgnss.core.jit import brief_kernel
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
    x, P, z, H, R = (np.ascontiguousarray(array) for array in (x, P, z, H, R))
    innovation, S, columns = _expected(x, P, z, H, R)
    weighed = _weighed(S, columns)
    nis, K = float(innovation @ weighed[:, 0]), weighed[:, 1:].T
    return Correction(*_joseph(x, P, K, innovation, H, R), innovation, nis)


@brief_kernel
def _expected(
    x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """z − H·x, its covariance S = H·P·Hᵀ + R, and z − H·x and H·P side by side, (m, 1 + n)."""
    innovation, PHt = z - H @ x, P @ H.T
    columns = np.empty((z.size, 1 + x.size))
    columns[:, 0], columns[:, 1:] = innovation, PHt.T
    return innovation, H @ PHt + R, columns


@brief_kernel
def _joseph(
    x: FloatArray,
    P: FloatArray,
    K: FloatArray,
    innovation: FloatArray,
    H: FloatArray,
    R: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """x and P with a gain K (n, m), P in Joseph's form: symmetric and positive with any gain."""
    remaining = np.eye(x.size) - K @ H
    after = remaining @ P @ remaining.T + K @ R @ K.T
    return x + K @ innovation, 0.5 * (after + after.T)


def squared_innovation(
    x: FloatArray, P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> float:
    """`nis` of a measurement that is not taken in."""
    innovation = z - H @ x
    return float(innovation @ _weighed(H @ P @ H.T + R, innovation))


def _weighed(S: FloatArray, columns: FloatArray) -> FloatArray:
    """S⁻¹ times columns, the innovation among them, by the Cholesky factor of its covariance S."""
    if not _finite(S, columns):
        raise NumericalError("innovation or its covariance is not finite")
    _, solved, info = dposv(S, columns, lower=True)  # SciPy's front ends take as long again
    if info > 0:
        raise NumericalError(f"innovation covariance is not positive: row {info} of its factor")
    return np.asarray(solved)


@brief_kernel
def _finite(S: FloatArray, columns: FloatArray) -> bool:
    return bool(np.isfinite(columns).all() and np.isfinite(S).all())


@lru_cache(maxsize=64)
def innovation_limit(degrees: int, false_alarm: float) -> float:
    """NIS that a sound measurement of so many components exceeds with the given probability."""
    return float(chdtri(degrees, false_alarm))


def check_covariance(P: FloatArray) -> None:
    """Raise NumericalError unless P is finite and positive definite."""
    try:
        _factor_of_correlations(P)
    except np.linalg.LinAlgError as error:
        raise NumericalError(f"covariance is not positive definite: {error}") from error


@brief_kernel
def _factor_of_correlations(P: FloatArray) -> FloatArray:
    """Cholesky factor of P scaled to correlations: it has metres and rad/s side by side."""
    scale = np.sqrt(np.diag(P))
    return np.linalg.cholesky(P / np.outer(scale, scale))
