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


def test_nothing_above_threshold_is_a_miss(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = chirps.Spread(50.0, np.array([99.0]), np.array([99.0]))
    monkeypatch.setattr(chirps, "_pooled", lambda *_, **__: lost)
    assert not verdict(chirps.measure(False, [1]))


def test_motion_of_a_slope_is_the_scenarios_own() -> None:
    """The scenario file holds what LU-DYN asks for."""
    assert "amplitude: 23786" in long_updates.motion(64.0)
    assert "frequency: 0.01273240" in long_updates.motion(64.0)


def _heard(begin_s: float, end_s: float, error_cycles: float = 0.0, lost: bool = False):
    """A phase, valid for a part of a recording of 10 s, ten instants to each update."""
    time_s = np.arange(begin_s, end_s, long_updates.UPDATE_S / 10.0) + 0.01
    error = np.full(time_s.size, error_cycles)
    return long_updates.Heard(time_s, error, np.zeros(time_s.size), 1.0, lost, 64.0, 10.0)


def test_a_phase_is_held_only_where_there_is_one_to_the_end() -> None:
    assert _heard(0.6, 9.6).held(1.5)
    assert _heard(0.6, 9.6).held(7.0)
    assert not _heard(0.6, 9.6, lost=True).held(7.0)
    assert not _heard(0.6, 9.6, error_cycles=0.3).held(7.0)
    assert not _heard(0.6, 7.0).held(7.0)
    assert not _heard(0.6, 8.6).held(7.0)
    assert not _heard(2.4, 9.6).held(1.5)
    assert not _heard(0.6, 0.6).held(7.0)
    assert _heard(0.6, 9.6).seconds(7.0, 10.0) == pytest.approx(2.6)


@pytest.mark.slow
def test_hard_motion_from_samples() -> None:
    """LU-DYN and LU-PHASE, quick."""
    assert verdict(long_updates.measure_dynamics(True, [1]))
    assert verdict(long_updates.measure_phase(True, [1]))
