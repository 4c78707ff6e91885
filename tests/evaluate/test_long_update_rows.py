"""The rows of the long-update loop, in their quick version."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.evaluate.reproduce import chirps, long_updates
from deepgnss.evaluate.reproduce.table import verdict


def test_spread_is_in_bounds_of_its_level() -> None:
    """A strong chirp's errors are as large as the bound says, whatever the level."""
    one = chirps.spread(45.0, 60, np.random.default_rng(1), squared=False)
    assert one.lost == 0
    assert one.ratios == pytest.approx((1.0, 1.0), abs=0.3)


def test_motion_of_a_slope_is_the_scenarios_own() -> None:
    """The scenario file holds what LU-DYN asks for."""
    assert "amplitude: 23786" in long_updates.motion(64.0)
    assert "frequency: 0.01273240" in long_updates.motion(64.0)


@pytest.mark.slow
def test_hard_motion_from_samples() -> None:
    """LU-DYN and LU-PHASE, quick."""
    assert verdict(long_updates.measure_dynamics(True, [1]))
    assert verdict(long_updates.measure_phase(True, [1]))
