"""A wrong inertial log ends in one clear warning, and in results no worse than without any."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

_BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SECONDS = 60.0


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """The benchmark whose runs these are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(_BENCHMARKS)
        return importlib.import_module("wrong_imu")


@pytest.fixture(scope="module")
def drive(bench: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive through a city."""
    return Path(bench.simulated(tmp_path_factory.mktemp("city"), 1))


@pytest.mark.slow
def test_wrong_logs_cost_nothing_and_are_named(bench: ModuleType, drive: Path) -> None:
    alone = bench.processed(drive, None, SECONDS)
    assert alone.aided_s == 0.0
    named = {
        "axes RFU for FRD": "axis: imu.axes",
        "axes left-handed": "imu.axes",
        "0.1 s late": "imu.time_offset: -0.1",
        "biases ×10": "biases at its start",  # later within the drift of its grade
        "another drive's": "contradicts the satellites",
    }
    for name, words in named.items():
        run = bench.processed(drive, bench.LOGS[name], SECONDS)
        print(name, run.row())
        (warning,) = run.warnings
        assert words in warning, name
        assert run.aided_s == 0.0 or "contradicts" not in warning, name
        assert run.fixed >= alone.fixed - 0.01, name
        # Where both have positions, T 6.5.1: at a tunnel's mouths either has some the other lacks.
        both = run.errors_m.index.intersection(alone.errors_m.index)
        now_m, before_m = run.errors_m[both], alone.errors_m[both]
        assert len(both) > 0.95 * len(alone.errors_m), name
        assert (now_m**2).mean() ** 0.5 <= 1.1 * (before_m**2).mean() ** 0.5 + 0.05, name
        assert now_m.quantile(0.95) <= 1.1 * before_m.quantile(0.95) + 0.1, name
        assert run.lost <= alone.lost, name
        assert run.arcs <= alone.arcs, name
        assert run.phase_mm <= 1.1 * alone.phase_mm, name
