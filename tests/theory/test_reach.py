"""How far off a signal may come back, against the correlation and the sums themselves."""

from __future__ import annotations

import cmath

import numpy as np
import pytest

from deepgnss.io.config.imu_grade import imu_grade
from deepgnss.theory.inertial import error_sums
from deepgnss.theory.multipath import triangle
from deepgnss.theory.open_loop import way_bound
from deepgnss.theory.reach import SIGMAS, reach


def test_products_of_sums_tell_a_frequency_within_reach_and_not_beyond() -> None:
    sum_s = 0.005
    edge_hz = SIGMAS * reach(sum_s, 0.25).frequency_hz
    for off_hz, told in ((0.98 * edge_hz, True), (1.02 * edge_hz, False)):
        sums = np.exp(2j * np.pi * off_hz * sum_s * np.arange(8))
        found_hz = cmath.phase(np.vdot(sums[:-1], sums[1:])) / (2.0 * np.pi * sum_s)
        assert (found_hz == pytest.approx(off_hz)) is told


@pytest.mark.parametrize("spacing", [0.1, 0.25, 1.0])
def test_early_and_late_tell_the_side_within_reach_and_not_beyond(spacing: float) -> None:
    edge = SIGMAS * reach(0.02, spacing).code_chips

    def told(off: float) -> float:
        early, late = triangle(np.array([off - 0.5 * spacing, off + 0.5 * spacing]))
        return float(early - late)

    assert told(0.99 * edge) > 0.0 > told(-0.99 * edge)
    assert told(1.01 * edge) == told(-1.01 * edge) == 0.0


@pytest.mark.parametrize("grade", ["FSAS", "MTi-G"])
def test_a_way_added_up_from_its_rate_is_bounded_closely(grade: str) -> None:
    """Against the way itself, after a minute: never less, and hardly more."""
    step_s = 0.1
    at_s = np.arange(1, 601) * step_s
    force = np.array([1.0, 2.0, -9.81])
    velocity, way = error_sums(imu_grade(grade), force, at_s, np.array([0.8, 0.0, -0.6]))
    bound, ratios = 0.0, []
    for k, sigma_mps in enumerate(velocity.sigma):
        bound = way_bound(bound, float(sigma_mps), step_s)
        ratios.append(bound / way.sigma[k])
    assert min(ratios[10:]) >= 1.0
    assert max(ratios[100:]) < 1.2
