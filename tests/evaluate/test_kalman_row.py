"""KF rows: what errors of ranges, phases and rates make of position and speed."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest

from deepgnss.evaluate.reproduce import kalman_loop, verdict
from deepgnss.evaluate.reproduce.kalman_loop import (
    DYNAMIC,
    STATIC,
    Errors,
    _against,
    errors_of,
)

AZ, EL = np.radians([10.0, 80.0, 150.0, 220.0, 290.0, 0.0]), np.radians([20, 35, 50, 25, 40, 80])
SIGHTS = pd.DataFrame(
    np.column_stack([np.cos(EL) * np.cos(AZ), np.cos(EL) * np.sin(AZ), -np.sin(EL), np.ones(6)]),
    index=[f"G{k:02d}" for k in range(6)],
)


def _table(position_m: np.ndarray, epochs: int = 140) -> pd.DataFrame:
    """Observations that put the receiver off by positions (epochs, 3), with clock and ambiguity."""
    rows = []
    for k in range(epochs):
        for n, (name, sight) in enumerate(SIGHTS.iterrows()):
            along = float(sight.to_numpy()[:3] @ position_m[k])
            clock = 7.0 * np.sin(k)
            rows.append((0.1 * k, name, clock + 3.0 * along, clock + along + n, along, 1))
    columns = ["time_s", "satellite", "range_m", "phase_m", "speed_mps", "arc"]
    return pd.DataFrame(rows, columns=columns)


def test_errors_of_position_and_speed() -> None:
    """North and east of what was put in; a phase's mean does not count, nor an arc before."""
    position_m = np.outer((-1.0) ** np.arange(140), [0.003, 0.004, 0.0])
    found = errors_of(_table(position_m), SIGHTS, STATIC)
    assert found.range_m == pytest.approx(0.015, rel=1e-3)
    assert found.phase_m == pytest.approx(0.005, rel=1e-3)
    assert found.speed_mps == pytest.approx(0.005, rel=1e-3)
    assert found.held == 1.0
    broken = _table(position_m)
    broken.loc[broken["time_s"] < 7.0, "arc"] = 9
    assert errors_of(broken, SIGHTS, STATIC).held == pytest.approx(70 / 80, abs=0.02)


def test_a_lag_counts() -> None:
    """Behind from the time it moves: ambiguities are those of the rest before."""
    t = 0.1 * np.arange(140)
    position_m = np.outer(t > 10.05, [0.02, 0.0, 0.0])
    assert errors_of(_table(position_m), SIGHTS, DYNAMIC).phase_m == pytest.approx(0.02, rel=1e-3)


def test_a_share_held_of_nothing_is_lost() -> None:
    assert Errors(np.nan, np.nan, np.nan, np.nan).lost()
    assert not Errors(0.001, 0.01, 0.5, 0.99).lost()


def test_a_loop_that_is_held_against_none_is_not_better(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, other = Errors(0.001, 0.01, 0.5, 1.0), Errors(0.0017, 0.021, 0.5, 1.0)
    for held, met in ((1.0, True), (0.5, False)):
        runs = iter([ours, *[other._replace(held=held)] * 2])
        monkeypatch.setattr(kalman_loop, "errors_of", lambda *_, runs=runs: next(runs))
        monkeypatch.setattr(kalman_loop, "recorded", lambda *_: nullcontext())
        monkeypatch.setattr(kalman_loop, "tracked", lambda *_: None)
        monkeypatch.setattr(kalman_loop, "sights_of", lambda *_: None)
        assert verdict(kalman_loop.measure_static(False, [1])) is met


def test_verdicts() -> None:
    ours = Errors(0.001, 0.01, 0.5, 1.0)
    assert _against(STATIC, ours, "PLL", Errors(0.0017, 0.021, 0.5, 1.0)).met
    assert _against(STATIC, ours, "PLL", Errors(0.0015, 0.021, 0.5, 1.0)).met is False
    assert _against(STATIC, ours, "PLL", Errors(0.0017, 0.019, 0.5, 1.0)).met is False
    assert _against(STATIC, ours, "PLL", Errors(0.1, 1.0, 0.5, 0.7)).met is None
