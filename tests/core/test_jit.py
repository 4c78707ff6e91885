"""The kernel decorator: a cache that follows the sources, threads, numpy's division, NaN."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features, llvm_version_info

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


def _told_numba(name: str, **given: str) -> str:
    """What a new process sets for numba, with other settings given beforehand."""
    code = f"import deepgnss.core.jit, os; print(os.environ.get({name!r}, ''))"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_C")}
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=environment | given,
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout.strip()


def test_kernels_are_compiled_for_this_processor_without_gathers() -> None:
    """The features are all that it has, and the user's own word counts more."""
    has, told = get_host_cpu_features(), _told_numba("NUMBA_CPU_FEATURES")
    if has.get("avx2", False) and llvm_version_info[0] >= 18:
        assert told == f"{has.flatten()},+prefer-no-gather"
    else:
        assert told == ""
    assert _told_numba("NUMBA_CPU_FEATURES", NUMBA_CPU_FEATURES="+sse2") == "+sse2"


def test_cache_lies_in_a_user_folder_named_by_the_sources(tmp_path: Path) -> None:
    """Another user cache: another place; the same sources: the same name."""
    told = [_told_numba("NUMBA_CACHE_DIR", XDG_CACHE_HOME=str(tmp_path)) for _ in range(2)]
    folders = [Path(folder) for folder in told]
    assert folders[0] == folders[1]
    assert folders[0].parent == tmp_path / "deepgnss" / "kernels"
    assert len(folders[0].name) == 16


_AFTER_SUMS = """
import inspect, pkgutil
from importlib import import_module
import numba
import deepgnss.receiver

summing = [
    one
    for module in pkgutil.iter_modules(deepgnss.receiver.__path__, "deepgnss.receiver.")
    for one in vars(import_module(module.name)).values()
    if getattr(one, "targetoptions", {}).get("fastmath") and one.__module__ == module.name
]
array, complexes = numba.float64[::1], numba.complex128[::1]
kinds = {"float": numba.float64, "int": numba.int64, "FloatArray": array, "ComplexArray": complexes}
kinds["NDArray[np.int64]"] = numba.int64[::1]
for one in summing:
    given = inspect.signature(one.py_func).parameters.values()
    one.compile(tuple(kinds[argument.annotation] for argument in given))
product = numba.njit(nogil=True, error_model="numpy")(lambda a, b: a * b)  # as kernels are
product(1j, 1j)
print(len(summing), "reassoc" in next(iter(product.inspect_llvm().values())))
"""


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_sums_leave_others_their_arithmetic(tmp_path: Path) -> None:
    """numba compiles a product of complex numbers once, with the liberties of the first kernel."""
    run = subprocess.run(
        [sys.executable, "-c", _AFTER_SUMS],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.split() == ["2", "False"]
