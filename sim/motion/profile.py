"""Profiles: a scalar along the path over time, as exact piecewise polynomials of finite jerk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import PPoly

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray

# From 0 to 1 over u in [0, 1], coefficients of u⁰, u¹, …: the named number of derivatives vanish
# at both ends.
_BLENDS: Final = {1: (0.0, 0.0, 3.0, -2.0), 2: (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)}

STEEPNESS: Final = 1.875
"""Largest slope of the step 10u³ − 15u⁴ + 6u⁵."""

BENDING: Final = 10.0 / math.sqrt(3.0)
"""Largest second derivative of it."""


def smooth_profile(points: Sequence[tuple[float, float]], flat: int = 1) -> PPoly:
    """Integral of a rate that passes through (time, rate) points by smooth steps.

    At the points the rate's first (`flat` = 1: steps 3u² − 2u³) or first two (`flat` = 2: steps
    10u³ − 15u⁴ + 6u⁵) derivatives are zero; before the first point and after the last the rate is
    constant, however far. Where two points have one rate it is held to the last bit. The integral
    is zero at t = 0.

    Raises
    ------
    ConfigError: the times do not rise.
    """
    times, rates = (np.array(column, dtype=np.float64) for column in zip(*points, strict=True))
    left, right = np.concatenate([rates[:1], rates]), np.concatenate([rates, rates[-1:]])
    knots = _with_ends(times)
    width, blend = np.diff(knots), _BLENDS[flat]
    rate = np.array([(right - left) * c / width**power for power, c in enumerate(blend)])
    rate[0] += left
    return _zeroed(PPoly(rate[::-1], knots).antiderivative())


def acceleration_profile(
    steps: Sequence[tuple[float, float]], jerk_mps3: float, speed_mps: float = 0.0
) -> PPoly:
    """Distance of an acceleration that goes to each (time, acceleration) at a constant jerk.

    A step begins at its time and takes |change| / jerk; the acceleration is zero before the first
    and stays what it is after the last. Distance zero and `speed_mps` hold at t = 0.

    Raises
    ------
    ConfigError: a step begins before the one before it is done.
    """
    times, values = [steps[0][0]], [0.0]
    for begin_s, value in steps:
        if begin_s < times[-1]:
            raise ConfigError(
                f"the step at {begin_s:g} s begins before the one before it is done at"
                f" {times[-1]:g} s with a jerk of {jerk_mps3:g} m/s³"
            )
        ramp_s = abs(value - values[-1]) / jerk_mps3
        for second, reached in ((begin_s, values[-1]), (begin_s + ramp_s, value)):
            if second > times[-1]:
                times.append(second)
                values.append(reached)
    knots = _with_ends(np.array(times))
    held = np.array([0.0, *values, values[-1]])
    slopes = np.diff(held) / np.diff(knots)
    speed = _zeroed(PPoly(np.array([slopes, held[:-1]]), knots).antiderivative())
    speed.c[-1] += speed_mps
    return _zeroed(speed.antiderivative())


def constant_rate(rate: float) -> PPoly:
    """Integral of a constant rate."""
    return smooth_profile([(0.0, rate)])


def derivatives(profile: PPoly, x: FloatArray, count: int) -> list[FloatArray]:
    """The profile and its first derivatives, `count` arrays in all."""
    return [profile(x, order) for order in range(count)]


def breaks(profile: PPoly) -> tuple[float, ...]:
    """Instants at which a derivative of a profile may jump."""
    return tuple(float(x) for x in profile.x[1:-1])


def _with_ends(times: FloatArray) -> FloatArray:
    """Knots with a piece before and one after; beyond them PPoly carries these pieces on."""
    if not (np.diff(times) > 0.0).all():
        late = int(np.argmin(np.diff(times)))
        raise ConfigError(f"{times[late + 1]:g} after {times[late]:g}: expected rising values")
    return np.concatenate([[times[0] - 1.0], times, [times[-1] + 1.0]])


def _zeroed(profile: PPoly) -> PPoly:
    """The profile, shifted so that it is zero at zero."""
    profile.c[-1] -= profile(0.0)
    return profile
