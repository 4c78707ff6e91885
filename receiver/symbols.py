"""Doppler from consecutive correlations whose symbol edges and signs are not known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import ComplexArray, FloatArray


class SymbolFit(NamedTuple):
    """Most likely Doppler and division of code periods into symbols."""

    score: float  # power of the coherent sum, or a sum of powers over far apart symbols
    doppler_hz: float  # against the one wiped off
    starts: NDArray[np.int64]  # first period of every symbol
    signs: FloatArray  # ±1 of every code period: its symbol's, times its secondary chip

    def strip(self, sums: ComplexArray, times_s: FloatArray) -> ComplexArray:
        """Sums (periods, …) without Doppler and signs."""
        turn = np.exp(-2j * np.pi * self.doppler_hz * times_s) * self.signs
        return np.asarray(sums * turn.reshape(-1, *[1] * (sums.ndim - 1)))


def fit_symbols(
    prompt: ComplexArray, times_s: FloatArray, secondary: FloatArray, span_hz: float
) -> SymbolFit:
    """Most likely Doppler over all places the symbol edges may have.

    Each symbol adds up coherently, and neighbours do with the better of their two relative signs:
    powers alone would mistake a change of sign for a frequency (±1/2T) as often as not.

    Parameters: prompt correlations of consecutive code periods and the times of their middles,
    shape (periods,); secondary chips of a symbol's periods, all 1 where there is no such code.
    Doppler is sought within ±span_hz.
    """
    count = prompt.size
    symbol_periods = secondary.size
    longest = min(count, symbol_periods)
    period_s = (times_s[-1] - times_s[0]) / (count - 1) if count > 1 else 1e-3
    step_hz = min(0.125 / (longest * period_s), max(span_hz, 1e-3))
    reach = int(np.ceil(span_hz / step_hz)) + 1
    dopplers = np.arange(-reach, reach + 1) * step_hz
    turned = prompt * np.exp(-2j * np.pi * dopplers[:, np.newaxis] * times_s)
    fits = []
    coded = bool(np.any(secondary != 1.0))
    for edge in range(symbol_periods if coded else longest):
        starts = np.arange(edge, count, symbol_periods)
        if edge:
            starts = np.concatenate([[0], starts]).astype(np.int64)
        chips = np.resize(np.roll(secondary, edge), count)
        symbols = np.add.reduceat(turned * chips if coded else turned, starts, axis=1)
        pairs = (symbols[:, 1:] * symbols[:, :-1].conj()).real
        score = (symbols.real**2 + symbols.imag**2).sum(axis=1) + 2.0 * abs(pairs).sum(axis=1)
        top = int(score[1:-1].argmax()) + 1
        left, mid, right = score[top - 1 : top + 2]
        curvature = left - 2.0 * mid + right
        offset = 0.5 * (left - right) / curvature if curvature < 0.0 and mid >= left else 0.0
        doppler_hz = float(dopplers[top] + min(max(offset, -1.0), 1.0) * step_hz)
        signs = np.cumprod(np.append(1.0, np.where(pairs[top] < 0.0, -1.0, 1.0)))
        lengths = np.diff(np.append(starts, count))
        fits.append(SymbolFit(float(mid), doppler_hz, starts, chips * np.repeat(signs, lengths)))
    return max(fits, key=lambda fit: fit.score)
