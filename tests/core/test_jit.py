"""The kernel decorator: a cache that follows the sources, threads, numpy's division, NaN."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.jit import kernel, summing_kernel
from deepgnss.core.records import FloatArray

pytestmark = pytest.mark.kernel


@kernel
def _ratio(a: float, b: float) -> float:
    """Quotient."""
    return a / b


@summing_kernel
def _total(values: FloatArray) -> float:
    """Sum."""
    total = 0.0
    for value in values:
        total += value
    return total


def test_sums_and_not_a_number() -> None:
    values = np.arange(1000.0)
    assert _total(values) == pytest.approx(499_500.0)
    values[500] = np.nan
    assert np.isnan(_total(values))


def test_division_by_zero_is_numpy_s() -> None:
    with np.errstate(divide="ignore"):
        assert _ratio(np.float64(1.0), np.float64(0.0)) == np.inf


def test_cache_lies_in_a_user_folder_named_by_the_sources(tmp_path: Path) -> None:
    """Another user cache: another place; the same sources: the same name."""
    code = "import deepgnss.core.jit, os; print(os.environ['NUMBA_CACHE_DIR'])"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    folders = []
    for _ in range(2):
        run = subprocess.run(
            [sys.executable, "-c", code],
            env=environment | {"XDG_CACHE_HOME": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        folders.append(Path(run.stdout.strip()))
    assert folders[0] == folders[1]
    assert folders[0].parent == tmp_path / "deepgnss" / "kernels"
    assert len(folders[0].name) == 16
