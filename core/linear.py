"""Small dense linear algebra, where NumPy's own front ends take longer than LAPACK."""

from __future__ import annotations

import numpy as np

from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray


@brief_kernel
def least_squares(A: FloatArray, b: FloatArray) -> tuple[FloatArray, int]:
    """x that minimizes |A·x − b|, and the rank of A (n, p), as NumPy's `lstsq` finds them."""
    x, _, rank, _ = np.linalg.lstsq(A, b, np.finfo(np.float64).eps * max(A.shape))
    return x, rank  # type: ignore[return-value]


@brief_kernel
def inverse(normal: FloatArray) -> FloatArray:
    """Inverse of a normal matrix or a covariance."""
    return np.linalg.inv(normal)  # type: ignore[return-value]


@brief_kernel
def whitening(covariance: FloatArray) -> FloatArray:
    """L⁻¹ of a covariance LLᵀ: errors times it are independent and of unit variance."""
    return np.linalg.inv(np.linalg.cholesky(covariance))
