"""Linear algebra in kernels against NumPy's, with what is singular among it."""

import numpy as np
import pytest

from deepgnss.core.linear import inverse, least_squares, whitening

RANDOM = np.random.default_rng(3)


def test_least_squares_are_numpys_in_value_and_rank() -> None:
    A, b = RANDOM.normal(size=(9, 4)), RANDOM.normal(size=9)
    x, rank = least_squares(A, b)
    wanted, _, wanted_rank, _ = np.linalg.lstsq(A, b)
    np.testing.assert_allclose(x, wanted, rtol=1e-12)
    assert rank == wanted_rank == 4
    A[:, 3] = A[:, 0] - 2.0 * A[:, 1]
    assert least_squares(A, b)[1] == 3


def test_inverses() -> None:
    A = RANDOM.normal(size=(5, 5))
    P = A @ A.T
    np.testing.assert_allclose(inverse(P) @ P, np.eye(5), atol=1e-9)
    white = whitening(P)
    np.testing.assert_allclose(white @ P @ white.T, np.eye(5), atol=1e-9)
    assert np.allclose(white, np.tril(white))


def test_a_singular_matrix_has_no_inverse() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        inverse(np.zeros((3, 3)))
