"""The Kalman update against its textbook form and its statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from deepgnss.core.errors import NumericalError
from deepgnss.ins.filter import check_covariance, correct, innovation_limit


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.integers(0, 10_000), st.integers(1, 8), st.integers(1, 4))
def test_update_is_the_textbooks_in_information_form(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    root, noise = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    P, R = root @ root.T + np.eye(n), noise @ noise.T + np.eye(m)
    H, x, z = rng.normal(size=(m, n)), rng.normal(size=n), rng.normal(size=m)
    after = correct(x, P, z, H, R)
    information = np.linalg.inv(P) + H.T @ np.linalg.solve(R, H)
    np.testing.assert_allclose(after.P, np.linalg.inv(information), rtol=1e-8, atol=1e-9)
    mean = np.linalg.solve(information, np.linalg.solve(P, x) + H.T @ np.linalg.solve(R, z))
    np.testing.assert_allclose(after.x, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(after.P, after.P.T)
    S = H @ P @ H.T + R
    assert after.nis == pytest.approx((z - H @ x) @ np.linalg.solve(S, z - H @ x))
    np.testing.assert_allclose(after.innovation, z - H @ x)


def test_joseph_form_survives_a_measurement_far_better_than_the_prior() -> None:
    P = np.diag([1e8, 1e8, 1e-12])
    H = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 + 1e-6, 0.0]])
    after = correct(np.zeros(3), P, np.zeros(2), H, 1e-6 * np.eye(2))
    check_covariance(after.P)
    assert np.all(np.diagonal(after.P) <= np.diagonal(P) * (1 + 1e-9))


def test_limit_is_exceeded_as_often_as_asked() -> None:
    rng = np.random.default_rng(2)
    nis = np.sum(rng.normal(size=(100_000, 3)) ** 2, axis=1)
    assert np.mean(nis > innovation_limit(3, 0.01)) == pytest.approx(0.01, rel=0.1)
    assert innovation_limit(1, 0.05) == pytest.approx(chi2.ppf(0.95, 1))


def test_what_cannot_be_weighed_is_refused() -> None:
    one = np.eye(2)
    with pytest.raises(NumericalError, match="not positive"):
        correct(np.zeros(2), -one, np.zeros(1), np.ones((1, 2)), np.zeros((1, 1)))
    with pytest.raises(NumericalError):
        correct(np.zeros(2), one, np.array([np.nan]), np.ones((1, 2)), np.eye(1))
    with pytest.raises(NumericalError, match="positive definite"):
        check_covariance(np.array([[1.0, 2.0], [2.0, 1.0]]))
