"""The one decorator for compiled kernels, and where their cache lives.

numba keys its cache by the file of a kernel alone: it goes stale when a callee in another file
changes. The cache therefore lies in a user folder named by a hash of all sources of the package.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _cache_folder() -> Path:
    package = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for room in ("core", "ins", "io", "receiver", "sim"):
        for source in sorted((package / room).rglob("*.py")):
            digest.update(str(source.relative_to(package)).encode())
            digest.update(source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser()
    return root / "deepgnss" / "kernels" / digest.hexdigest()[:16]


os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache_folder()))

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when imported)


def kernel(function: _Function) -> _Function:
    """Compile a plain function over arrays and scalars: cached, without the GIL."""
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def brief_kernel(function: _Function) -> _Function:
    """As `kernel`, but holding the GIL: for calls shorter than handing it over takes."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


def summing_kernel(function: _Function) -> _Function:
    """As `kernel`, with sums that may be reassociated and contracted; NaN keeps its meaning."""
    return cast(
        _Function,
        numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})(
            function
        ),
    )
