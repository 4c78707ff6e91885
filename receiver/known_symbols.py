"""Symbols known before they are received: from an earlier pass, or told by somebody."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray


class KnownSymbols(NamedTuple):
    """Symbols decoded before, upright: what a satellite sent from a code period on."""

    first: int  # code periods since the GPS epoch
    symbols: bytes  # 0/1


def signs(known: KnownSymbols, first: int, count: int, symbol_periods: int) -> FloatArray | None:
    """Signs ±1 of `count` symbols from a code period on; None where not all are known."""
    skip = (first - known.first) // symbol_periods
    if skip < 0 or skip + count > len(known.symbols):
        return None
    bits = np.frombuffer(known.symbols, dtype=np.int8, count=count, offset=skip)
    return np.asarray(1.0 - 2.0 * bits.astype(np.float64))
