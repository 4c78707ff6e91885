"""Residual test: false alarms as stated, faults found, nothing claimed that cannot be known."""

import numpy as np
import pytest
from scipy.special import chdtri

from deepgnss.receiver.raim import RaimResult, check_residuals


def adjusted(
    H: np.ndarray, y: np.ndarray, sigma: np.ndarray, false_alarm: float = 1e-5
) -> RaimResult:
    weight = 1.0 / sigma
    x = np.linalg.lstsq(H * weight[:, np.newaxis], y * weight)[0]
    return check_residuals(H, y - H @ x, sigma, false_alarm)


def geometry(rows: int, rng: np.random.Generator) -> np.ndarray:
    azimuth = 2 * np.pi * (np.arange(rows) / rows + rng.uniform(0, 0.05, rows))
    elevation = rng.uniform(0.2, 1.4, rows)
    return np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.ones(rows),
        ]
    )


def test_false_alarms_come_as_often_as_stated() -> None:
    rng = np.random.default_rng(1)
    sigma = rng.uniform(1.0, 3.0, 9)
    H = geometry(9, rng)
    runs, stated = 3000, 0.05
    alarms = sum(
        bool((v := adjusted(H, rng.normal(0, sigma), sigma, stated)).excluded) or not v.passed
        for _ in range(runs)
    )
    assert abs(alarms / runs - stated) < 4 * np.sqrt(stated / runs)


@pytest.mark.parametrize("faults", [1, 2, 3, 4])
def test_faults_are_found_even_when_they_pull_the_same_way(faults: int) -> None:
    rng = np.random.default_rng(faults)
    for _ in range(40):
        H, sigma = geometry(16, rng), np.full(16, 2.0)
        wrong = rng.choice(16, faults, replace=False)
        y = H @ [100.0, -50.0, 20.0, 1e3] + rng.normal(0, sigma)
        y[wrong] += rng.choice([60.0, 90.0], faults) * (rng.random() < 0.5 or -1.0)
        verdict = adjusted(H, y, sigma)
        assert verdict.passed
        assert set(verdict.excluded) == set(wrong)
        assert verdict.limit == pytest.approx(chdtri(12 - faults, 1e-5))
        kept = np.delete(np.arange(16), verdict.excluded)
        again = adjusted(H[kept], y[kept], sigma[kept])
        assert again.statistic == pytest.approx(verdict.statistic, rel=1e-6)


def test_one_fault_in_five_is_seen_but_not_named() -> None:
    H, sigma = geometry(5, np.random.default_rng(3)), np.ones(5)
    y = H @ np.ones(4)
    y[2] += 100.0
    verdict = adjusted(H, y, sigma)
    assert not verdict.passed
    assert verdict.excluded == ()


def test_four_rows_are_not_testable() -> None:
    H = geometry(4, np.random.default_rng(3))
    assert adjusted(H, np.array([1.0, 2.0, 300.0, 4.0]), np.ones(4)) == (
        True,
        pytest.approx(0),
        np.inf,
        (),
    )


def test_prior_knowledge_is_never_excluded() -> None:
    """A row of prior knowledge that contradicts two others: they go, or the test fails."""
    H = np.ones((6, 1))
    y = np.array([0.0, 0.1, -0.1, 0.0, 500.0, 500.0])
    x = y.mean()
    verdict = check_residuals(H, y - x, np.ones(6), 1e-5, excludable=4)
    assert verdict.passed
    assert sorted(verdict.excluded) == [0, 1, 2, 3]
