"""S(1.3): what a turn does to a difference, by the turn itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.attitude import quaternion_from_rotation_vector, rotate
from deepgnss.theory.slips import (
    attitude_limit_rad,
    rounding_limit_rad,
    share_right,
    value_sigma_cycles,
)

L1_M = 0.190293672798365


def test_published_limit_is_the_formula_rounded_up() -> None:
    limit = attitude_limit_rad(1.0, L1_M)
    assert round(limit, 3) == 0.024 and math.degrees(0.024) == pytest.approx(1.375, abs=5e-4)
    assert math.degrees(limit) == pytest.approx(1.363, abs=5e-4)
    assert attitude_limit_rad(2.535, L1_M) == pytest.approx(limit / 2.535)
    assert rounding_limit_rad(1.0, L1_M) == pytest.approx(2.0 * limit)


def test_no_turn_below_the_limits_moves_a_value_further() -> None:
    """A quarter and a half of a cycle, for satellites opposite to each other at the worst."""
    rng = np.random.default_rng(1)
    axis, sight, baseline = (rng.standard_normal((20_000, 3)) for _ in range(3))
    for v in (axis, sight, baseline):
        v /= np.linalg.norm(v, axis=1, keepdims=True)
    for limit, cycles in ((attitude_limit_rad, 0.25), (rounding_limit_rad, 0.5)):
        turned = rotate(quaternion_from_rotation_vector(limit(1.0, L1_M) * axis), baseline)
        values = np.sum((turned - baseline) * 2.0 * sight, axis=1) / L1_M
        assert 0.97 * cycles < np.abs(values).max() <= cycles


def test_sigma_and_share_are_those_of_random_turns() -> None:
    rng = np.random.default_rng(2)
    baseline, sights, sigma_rad = np.array([0.6, -0.7, 0.4]), np.array([0.9, 1.1, -0.3]), 0.03
    phi = sigma_rad * rng.standard_normal((40_000, 3))
    turned = rotate(quaternion_from_rotation_vector(phi), np.tile(baseline, (len(phi), 1)))
    values = (turned - baseline) @ sights / L1_M
    values += np.sqrt(8.0) * 0.003 / L1_M * rng.standard_normal(len(values))
    sigma = value_sigma_cycles(sigma_rad, baseline, sights, L1_M, 0.003)
    assert float(values.std()) == pytest.approx(float(sigma), rel=0.015)
    right = float(np.mean(np.round(values) == 0.0))
    assert right == pytest.approx(float(share_right(sigma)), abs=4.0 * 0.5 / np.sqrt(len(values)))
    assert share_right(np.array([0.0, 1e9])) == pytest.approx([1.0, 0.0], abs=1e-6)
