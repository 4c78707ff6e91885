"""Scales of a chart: round ticks, and where a value lies between the ends."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepgnss.core.records import FloatArray

_MOST_TICKS: Final = 5  # more do not fit on a phone
_STEPS: Final = (1.0, 2.0, 2.5, 5.0, 10.0)
_TIME_STEPS: Final = (1.0, 1.5, 2.0, 3.0, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Axis:
    """Ends of a scale, in the unit shown, and its ticks."""

    low: float
    high: float
    ticks: tuple[float, ...]
    logarithmic: bool = False

    def share(self, value: FloatArray | float) -> FloatArray:
        """Place between the ends: 0 at the low one, 1 at the high one."""
        x = np.asarray(value, np.float64)
        if self.logarithmic:
            low, high = math.log10(self.low), math.log10(self.high)
            return np.asarray((np.log10(np.maximum(x, self.low)) - low) / (high - low))
        return np.asarray((x - self.low) / (self.high - self.low))


def linear(low: float, high: float, steps: Iterable[float] = _STEPS) -> Axis:
    """A scale from `low` to `high` with at most five round ticks inside."""
    high = high if high > low else low + 1.0
    step = _round_step((high - low) / _MOST_TICKS, tuple(steps))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return Axis(low, high, tuple(k * step for k in range(first, last + 1)))


def logarithmic(low: float, high: float) -> Axis:
    """A scale of whole decades that holds both ends, both positive."""
    first, last = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    last = max(last, first + 1)
    ticks = tuple(10.0**k for k in range(first, last + 1))
    return Axis(ticks[0], ticks[-1], ticks, True)


def around(values: FloatArray, share: float = 98.0, least: float = 0.1) -> Axis:
    """A scale about zero that one gross value does not flatten.

    Parameters: share, of the values in %, that certainly lie inside; least, half its height.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return linear(-least, least)
    low, middle, high = np.percentile(known, (100.0 - share, 50.0, share))
    low = max(middle - 1.8 * (middle - low), float(known.min()))
    high = min(middle + 1.8 * (high - middle), float(known.max()))
    room = 0.08 * max(high - low, least)
    return linear(min(low - room, -least), max(high + room, least))


def time_axis(low_s: float, high_s: float) -> tuple[Axis, float, str]:
    """A scale of time, the seconds in its unit, and the unit's name."""
    for unit_s, name in ((3600.0, "h"), (60.0, "min")):
        if high_s - low_s > 10.0 * unit_s or (unit_s == 3600.0 and high_s - low_s > 3.0 * unit_s):
            return linear(low_s / unit_s, high_s / unit_s, _TIME_STEPS), unit_s, name
    return linear(low_s, high_s, _TIME_STEPS), 1.0, "s"


def tick_text(value: float, axis: Axis) -> str:
    """A tick's number, as short as it can be."""
    if axis.logarithmic or abs(value) >= 1e4:
        return f"{value:.12g}" if 1e-3 <= abs(value) < 1e6 else f"{value:.0e}"
    return f"{value:.6g}".replace("-", "−")


def _round_step(least: float, steps: tuple[float, ...]) -> float:
    """The smallest round step not below `least`."""
    decade = 10.0 ** math.floor(math.log10(least))
    for factor in (1.0, 10.0):
        for step in steps:
            if step * decade * factor >= least * (1.0 - 1e-9):
                return step * decade * factor
    return 100.0 * decade
