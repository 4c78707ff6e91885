"""The one decorator for compiled kernels, what they are compiled for, and where their cache lives.

numba keys its cache by the file of a kernel alone: it goes stale when a callee in another file
changes. The cache therefore lies in a user folder named by a hash of all sources of the package.

The look-ups of the correlator are compiled as single loads: as gather instructions they take
twice as long on processors whose microcode guards against Downfall.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite.binding import get_host_cpu_features, llvm_version_info

__all__ = ["brief_kernel", "compilable", "kernel", "overload", "summing_kernel"]

_Function = TypeVar("_Function", bound=Callable[..., Any])

_KNOWS_GATHER = 18  # LLVM: first version with that choice


def _cache_folder() -> Path:
    package = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for room in ("core", "deep", "ins", "io", "receiver", "sim"):
        for source in sorted((package / room).rglob("*.py")):
            digest.update(str(source.relative_to(package)).encode())
            digest.update(source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser()
    return root / "deepgnss" / "kernels" / digest.hexdigest()[:16]


def _without_gather() -> dict[str, str]:
    """Settings of numba that keep gather instructions out, where there are any."""
    has = get_host_cpu_features()
    if llvm_version_info[0] < _KNOWS_GATHER or not has.get("avx2", False):
        return {}
    return {"NUMBA_CPU_FEATURES": f"{has.flatten()},+prefer-no-gather"}


for _name, _value in {"NUMBA_CACHE_DIR": str(_cache_folder()), **_without_gather()}.items():
    os.environ.setdefault(_name, _value)

import numba  # noqa: E402  (reads both when imported)
from numba.extending import overload, register_jitable  # noqa: E402


def kernel(function: _Function) -> _Function:
    """Compile a plain function over arrays and scalars: cached, without the GIL."""
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def brief_kernel(function: _Function) -> _Function:
    """As `kernel`, but holding the GIL: for calls shorter than handing it over takes."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


def summing_kernel(function: _Function) -> _Function:
    """As `kernel`, with sums that may be reassociated and contracted; NaN keeps its meaning.

    There must be no product of complex numbers in it: numba compiles that once for all kernels,
    with the liberties of whichever comes first, and their last bits would depend on that.
    """
    return cast(
        _Function,
        numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})(
            function
        ),
    )


def compilable(function: _Function) -> _Function:
    """Plain Python for whoever calls it from there, compiled along where a kernel calls it."""
    return cast(_Function, register_jitable(function))
