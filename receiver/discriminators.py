"""Discriminators of carrier and code: correlations in, error in cycles, Hz or chips out.

Error here = received − local: a positive output means the generator is behind and must be moved
forward. Every one is zero at zero error and has unit slope there.
"""

from __future__ import annotations

import cmath
import math
from functools import lru_cache

import numpy as np

from deepgnss.core.jit import compilable
from deepgnss.core.records import ComplexArray

_TURN = 2.0 * math.pi


# --- carrier phase, blind to the sign of the bit (T table 2.1), cycles ---------------------------


@compilable
def costas_arctan(prompt: complex) -> float:
    """Two-quadrant arctangent: exact within ±¼ cycle, independent of amplitude."""
    if prompt.real == 0.0:
        return math.copysign(0.25, prompt.imag) if prompt.imag else 0.0
    return math.atan(prompt.imag / prompt.real) / _TURN


def costas_product(prompt: complex) -> float:
    """Q·I over the power: ½ sin 2φ, near the best at low SNR."""
    power = abs(prompt) ** 2
    return prompt.imag * prompt.real / (power * _TURN) if power else 0.0


def costas_decision(prompt: complex) -> float:
    """Q·sign(I) over the amplitude: sin φ, near the best at high SNR."""
    amplitude = abs(prompt)
    return math.copysign(1.0, prompt.real) * prompt.imag / (amplitude * _TURN) if amplitude else 0.0


# --- carrier frequency, Hz -----------------------------------------------------------------------


def frequency_arctan(products: complex, interval_s: float) -> float:
    """Four quadrants (T table 2.2): angle of Σ p(k+1)·p*(k), within ±1/(2T); no sign may flip."""
    return cmath.phase(products) / (_TURN * interval_s)


def frequency_squared(prompts: ComplexArray, interval_s: float) -> float:
    """Two quadrants (T 5.3.2): half the angle of Σ (p(k+1)·p*(k))², within ±1/(4T).

    prompts: consecutive correlations, shape (n,), whose signs may flip anywhere.
    """
    products = prompts[1:] * prompts[:-1].conj()
    return cmath.phase(complex(np.dot(products, products))) / (2.0 * _TURN * interval_s)


# --- code delay, chips ---------------------------------------------------------------------------


@lru_cache(maxsize=64)
def early_late_slope(spacing_chips: float, sample_chips: float, neighbour: float = 0.0) -> float:
    """d/dδ of (E − L)/(E + L) at δ = 0, 1/chip.

    The correlation falls straight from 1 to `neighbour`, its value a chip off (63/1023 for some
    C/A codes), and is smoothed by one sample's length, since taps off prompt split samples at chip
    edges (`baseband`). Without smoothing and neighbour it is 2/(2 − D).

    Parameters: early-to-late spacing D; length of a sample, both in chips; correlation a chip off.
    """
    offset, half, fall = spacing_chips / 2.0, sample_chips / 2.0, 1.0 - neighbour
    if offset >= half:
        return fall / (1.0 - fall * offset)
    value = 1.0 - fall * (offset * offset + half * half) / sample_chips
    return fall * (2.0 * offset / sample_chips) / value


@compilable
def early_minus_late_envelope(early: float, late: float, slope: float) -> float:
    """Normalized early minus late of amplitudes (T table 2.3)."""
    total = early + late
    return (early - late) / (total * slope) if total > 0.0 else 0.0


def early_minus_late_power(early: float, late: float, slope: float) -> float:
    """Normalized early minus late of powers, from amplitudes (T table 2.3)."""
    early_power, late_power = early * early, late * late
    total = early_power + late_power
    return (early_power - late_power) / (2.0 * total * slope) if total > 0.0 else 0.0


def dot_product(early: complex, prompt: complex, late: complex, slope: float) -> float:
    """Re((E − L)·P*) normalized by Re((E + L)·P*)."""
    conjugate = prompt.conjugate()
    total = ((early + late) * conjugate).real
    return ((early - late) * conjugate).real / (total * slope) if total > 0.0 else 0.0
