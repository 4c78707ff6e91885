"""Jets: a quantity over time with its first two derivatives, carried exactly through formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepgnss.core.records import FloatArray


@dataclass(frozen=True, slots=True)
class Jet:
    """Values x (n,) of a quantity and its first and second derivatives by time."""

    x: FloatArray
    d: FloatArray
    dd: FloatArray

    def __add__(self, other: Jet) -> Jet:
        return Jet(self.x + other.x, self.d + other.d, self.dd + other.dd)

    def __mul__(self, other: Jet | float) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.x * other, self.d * other, self.dd * other)
        return Jet(
            self.x * other.x,
            self.d * other.x + self.x * other.d,
            self.dd * other.x + 2.0 * self.d * other.d + self.x * other.dd,
        )

    def through(self, f: FloatArray, f1: FloatArray, f2: FloatArray) -> Jet:
        """Jet of f(x), given f and its first two derivatives by x at the values."""
        return Jet(f, f1 * self.d, f2 * self.d**2 + f1 * self.dd)


def power(jet: Jet, exponent: float) -> Jet:
    """x to a constant exponent, x > 0."""
    f = jet.x**exponent
    f1 = exponent * f / jet.x
    return jet.through(f, f1, (exponent - 1.0) * f1 / jet.x)


def arctan(jet: Jet) -> Jet:
    """Angle whose tangent is x."""
    f1 = 1.0 / (1.0 + jet.x**2)
    return jet.through(np.arctan(jet.x), f1, -2.0 * jet.x * f1**2)


def constant(value: float, n: int) -> Jet:
    """A quantity that does not change."""
    zero = np.zeros(n)
    return Jet(zero + value, zero, zero)
