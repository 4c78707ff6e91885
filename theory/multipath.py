"""Code error that one reflected ray causes in an early-minus-late loop (T 5.5.3, figure 5.27)."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from deepgnss.core.records import FloatArray

Correlation = Callable[[FloatArray], FloatArray]
"""Correlation of the received code with its replica by delay in chips; 1 at 0."""

_STEP_CHIPS = 0.01


def triangle(chips: FloatArray) -> FloatArray:
    """Correlation of an endless random code without any filter."""
    return np.maximum(0.0, 1.0 - np.abs(chips))


def multipath_error_chips(
    spacing_chips: float,
    amplitude: float,
    delay_chips: float,
    phase_cycles: float,
    correlation: Correlation = triangle,
) -> float:
    """Where |E| = |L| settles that was locked before the ray came; positive: measured too long.

    Parameters: early-to-late spacing D; the ray's amplitude against the direct signal, its delay
    and its carrier phase at arrival (0: in phase, it lengthens; ½: against it).

    Raises ValueError: no balance within the reach of the ray.
    """
    ray = amplitude * cmath.exp(2j * math.pi * phase_cycles)

    def late_minus_early(error_chips: FloatArray) -> FloatArray:
        late, early = (
            np.abs(correlation(at) + ray * correlation(at - delay_chips))
            for at in (error_chips + 0.5 * spacing_chips, error_chips - 0.5 * spacing_chips)
        )
        return np.asarray(late - early)

    # The balance that moved out of zero as the ray grew is the falling crossing nearest to it.
    reach = 0.5 * spacing_chips * (1.0 + amplitude) + 10.0 * _STEP_CHIPS
    grid = np.arange(-reach, reach + _STEP_CHIPS, _STEP_CHIPS)
    values = late_minus_early(grid)
    falls = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not falls.size:
        raise ValueError(f"no balance within {reach:.3g} chips of the direct signal")
    k = falls[np.argmin(np.abs(grid[falls]))]
    found = brentq(lambda x: float(late_minus_early(np.array(x))), grid[k], grid[k + 1], xtol=1e-9)
    return float(found)
