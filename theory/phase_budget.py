"""Phase error of a carrier loop by its causes, and the bandwidth that suits it: T 2.2.5, K 1.

K(1) and the rule it comes from (Kaplan and Hegarty 2006): 1σ of thermal noise, vibration and
oscillator together, and a third of the error that motion leaves, are to stay within 15°, a third
of the quarter of a turn by which a Costas discriminator may be off.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from deepgnss.core.records import Oscillator
from deepgnss.theory.loop_response import carrier_loop
from deepgnss.theory.oscillators import pll_oscillator_sigma_cycles, pll_vibration_sigma_cycles
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles, root_sum_square

THRESHOLD_CYCLES: Final = 15.0 / 360.0
_BANDWIDTHS_HZ: Final = (0.05, 200.0)


class Stress(NamedTuple):
    """What a loop has to bear."""

    cn0_dbhz: float
    coherent_s: float
    carrier_hz: float
    oscillator: Oscillator
    vibration_g2phz: float = 0.0  # one-sided density, flat
    rate: float = 0.0  # derivative of phase, cycles/s^order, that the loop follows with a lag


class PhaseBudget(NamedTuple):
    """1σ, cycles; `dynamic` is a bias."""

    thermal: float
    vibration: float
    oscillator: float
    dynamic: float

    @property
    def jitter(self) -> float:
        """Spread, T(2.24)."""
        return root_sum_square(self.thermal, self.vibration, self.oscillator)

    @property
    def total(self) -> float:
        """What K(1) holds against `THRESHOLD_CYCLES`."""
        return self.jitter + self.dynamic / 3.0


def lag_cycles(order: int, bandwidth_hz: float, rate: float) -> float:
    """Phase error that lasts while the derivative of that order does, K(9): rate/ω^order.

    Parameters: the derivative of phase of order `order`, cycles/s^order.
    """
    return abs(rate) / float(carrier_loop(order, bandwidth_hz).omega_radps ** order)


def phase_budget(order: int, bandwidth_hz: float, stress: Stress) -> PhaseBudget:
    """Errors of a Costas loop of order 2 or 3 with the prototypes of `core.loops`."""
    carrier_hz, oscillator = stress.carrier_hz, stress.oscillator
    return PhaseBudget(
        pll_thermal_sigma_cycles(stress.cn0_dbhz, bandwidth_hz, stress.coherent_s),
        pll_vibration_sigma_cycles(
            order, bandwidth_hz, carrier_hz, oscillator.g_sensitivity, stress.vibration_g2phz
        ),
        pll_oscillator_sigma_cycles(order, bandwidth_hz, carrier_hz, oscillator),
        lag_cycles(order, bandwidth_hz, stress.rate),
    )


def best_bandwidth_hz(order: int, stress: Stress) -> float:
    """Bandwidth with the least total between 0.05 and 200 Hz."""
    low, high = (math.log(b) for b in _BANDWIDTHS_HZ)

    def logarithm(x: float) -> float:
        return math.log(phase_budget(order, math.exp(x), stress).total)

    found = minimize_scalar(logarithm, bounds=(low, high), method="bounded")
    return float(np.exp(found.x))
