"""Frequency discriminators on spectra of symbol-long prompt sums (T 3.2.2, 3.4, 5.4.1).

Each takes n consecutive prompt sums whose symbols are known and stripped (FFT, PFFT), or their
squares, which have no symbols (SFFT, PSFFT: twice the frequency, so that ± half the symbol rate
looks like zero). What comes out is received − local, frequency in Hz and phase in cycles, both
in the *middle* of the sums: with time counted from there every bin of the main lobe has the
tone's own phase, whatever its frequency.

Frequencies inside are in bins, 1/(n·interval) wide. The kernel of a sum of n is
sin(πu)/sin(πu/n) at u bins off the tone; T writes sinc, its limit for many sums.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray

_TURN = 2.0 * math.pi
REFINEMENT_STEP_BINS = 2.0 / 3.0
"""Step of the frequency refinement, T(3.38)."""


class Tone(NamedTuple):
    """A tone seen in prompt sums, received − local, in their middle."""

    frequency_hz: float
    phase_cycles: float  # within ±½, of squares ±¼
    peak: int  # bin of the largest line


SILENCE = Tone(0.0, 0.0, 0)

Interpolation = Callable[[ComplexArray], float]
"""From sums turned to the bin of their peak to the tone's offset from it, bins."""


@lru_cache(maxsize=64)
def _replicas(count: int, each_side: int, step_bins: float) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of the bins above the middle one, shape (each_side, count)."""
    bins = step_bins * np.arange(1, each_side + 1)[:, np.newaxis]
    angles = _TURN * bins * (np.arange(count) - 0.5 * (count - 1)) / count
    return np.cos(angles), np.sin(angles)


def lines(sums: ComplexArray, each_side: int, step_bins: float = 1.0) -> ComplexArray:
    """Spectral lines about zero, the lowest first, shape (2·each_side + 1,), T(5.8).

    Lines equally far above and below zero share the two correlations, with cosine and sine, of
    which they are difference and sum: two correlators in place of two complex ones.
    """
    parts = np.ascontiguousarray(sums, dtype=np.complex128).view(np.float64).reshape(-1, 2)
    cosine, sine = _replicas(sums.size, each_side, step_bins)
    in_phase = (cosine @ parts).view(np.complex128)[:, 0]
    quadrature = 1j * (sine @ parts).view(np.complex128)[:, 0]
    above, below = in_phase - quadrature, in_phase + quadrature
    return np.concatenate([below[::-1], [sums.sum()], above])


def turned(sums: ComplexArray, bins: float) -> ComplexArray:
    """Sums with the carrier moved down by some bins about their middle."""
    from_middle = np.arange(sums.size) - 0.5 * (sums.size - 1)
    return np.asarray(sums * np.exp(-1j * _TURN * bins / sums.size * from_middle))


# --- between the bins ----------------------------------------------------------------------------


def amplitude_ratio(sums: ComplexArray) -> float:
    """T(3.13): the larger neighbour's share of the two amplitudes, towards that neighbour.

    Exact for sinc lines. Where the tone is near a bin both neighbours are noise, and its sign is
    theirs: the error does not go to zero there.
    """
    below, peak, above = np.abs(lines(sums, 1)).tolist()
    total = peak + max(below, above)
    return math.copysign(max(below, above), above - below) / total if total > 0.0 else 0.0


def neighbours(sums: ComplexArray) -> float:
    """All three lines with their phases (Jacobsen and Kootsookos 2007; Candan 2011), exact."""
    return three_lines_bins(lines(sums, 1), sums.size, 1.0)


def half_bins(sums: ComplexArray) -> float:
    """Lines half a bin either side, taken once more about the first result.

    Aboutanios and Mulgrew (2005): 1.5 % above the Cramér–Rao bound, whatever the offset.
    """
    first = three_lines_bins(lines(sums, 1, 0.5), sums.size, 0.5)
    return first + three_lines_bins(lines(turned(sums, first), 1, 0.5), sums.size, 0.5)


def three_lines_bins(three: ComplexArray, count: int, step_bins: float) -> float:
    """Tone's offset, bins, from the lines `step_bins` below, at and above zero, of `count` sums.

    With a = πu/n, b = π·step/n, d = π·step and the kernel D(u) = sin(πu)/sin(πu/n):
    sin(a+b)·D(u+step) + sin(a−b)·D(u−step) = 2 cos d · sin a · D(u). Lines enter with the sign
    they have against the middle one. The quotient is near ½ − cos d/2 > 0 times the amplitude.
    """
    below, middle, above = three.tolist()
    unit = middle.conjugate()
    if abs(middle) == 0.0:
        return 0.0
    lower, upper = (below * unit).real, (above * unit).real
    b = math.pi * step_bins / count
    weight = math.cos(b) * (lower + upper) - 2.0 * math.cos(math.pi * step_bins) * abs(middle) ** 2
    if weight <= 0.0:  # no tone has such lines
        return 0.0
    a = math.atan(math.sin(b) * (upper - lower) / weight)
    return a * count / math.pi


# --- FFT discriminators --------------------------------------------------------------------------


def fft_tone(
    sums: ComplexArray,
    interval_s: float,
    bins: int | None = None,
    interpolate: Interpolation = half_bins,
) -> Tone:
    """Tone in stripped sums (n,): FFT, T(3.5–3.9), or PFFT of the `bins` lines about zero.

    Parameters: seconds from sum to sum; number of lines searched, odd, or None for all n.
    The frequency is within ±1/(2·interval), or half a bin beyond the outermost line.
    """
    count = sums.size
    if bins is None or bins >= count:
        powers = np.abs(np.fft.fft(sums))
        peak = int(np.argmax(powers))
        peak -= count if 2 * peak >= count else 0
    else:
        powers = np.abs(lines(sums, bins // 2))
        peak = int(np.argmax(powers)) - bins // 2
    if powers.max() == 0.0:
        return SILENCE
    about = turned(sums, peak) if peak else sums
    place = peak + min(max(interpolate(about), -1.0), 1.0)
    line = complex(about.sum())
    if abs(place) > 0.5 * count:  # beyond the last line: it is the other side's first
        place -= math.copysign(count, place)
        line *= (-1) ** (count - 1)
    return Tone(place / (count * interval_s), cmath.phase(line) / _TURN, peak)


def squared_tone(
    sums: ComplexArray,
    interval_s: float,
    bins: int | None = None,
    interpolate: Interpolation = half_bins,
) -> Tone:
    """Tone in sums whose symbols are not known: SFFT, T(3.7, 3.8), or PSFFT of `bins` lines.

    The frequency is within ±1/(4·interval) and repeats from there; the phase within ±¼ cycle.
    """
    double = fft_tone(sums * sums, interval_s, bins, interpolate)
    return Tone(0.5 * double.frequency_hz, 0.5 * double.phase_cycles, double.peak)


# --- energy discriminators: three lines, closer than bins ----------------------------------------


def early_minus_late_hz(sums: ComplexArray, interval_s: float, step_bins: float = 0.5) -> float:
    """Early minus late frequency, T(3.36), lines ±step about zero: right near zero only.

    T's Δω is the step, not the distance of early and late; its P̂ is the prompt line's power.
    """
    late, prompt, early = (np.abs(lines(sums, 1, step_bins)) ** 2).tolist()
    if prompt == 0.0:
        return 0.0
    d = math.pi * step_bins
    slope = 2.0 * math.pi * (1.0 - math.cos(2.0 * d) - d * math.sin(2.0 * d)) / d**3
    return float((early - late) / (slope * prompt * sums.size * interval_s))


def refinement_hz(sums: ComplexArray, interval_s: float) -> float:
    """Mean of three frequencies weighted by their amplitudes, T(3.37); step 2/3 bin, T(3.38).

    It is the two-stage discriminator where cos(π·step) = −½, exact for sinc lines within ±⅓ bin.
    """
    late, prompt, early = np.abs(lines(sums, 1, REFINEMENT_STEP_BINS)).tolist()
    total = late + prompt + early
    if total == 0.0:
        return 0.0
    return float(REFINEMENT_STEP_BINS * (early - late) / (total * sums.size * interval_s))


def two_stage_hz(sums: ComplexArray, interval_s: float, step_bins: float = 0.5) -> float:
    """Two-stage NCO, T(3.39): exact for any step.

    Derived, T's quotient is of upper less lower line and without the factor ½.
    """
    offset = three_lines_bins(lines(sums, 1, step_bins), sums.size, step_bins)
    return offset / (sums.size * interval_s)
