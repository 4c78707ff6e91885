"""Bit synchronization, T(5.16–5.17), and the bits that went by before it."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from scipy.special import i0e

from deepgnss.core.records import ComplexArray, FloatArray

_FIRST_SYMBOLS = 12  # whose rotation the demodulator starts with
_STEPS = 256  # of rotation tried


class BitSync(NamedTuple):
    """Log-likelihood of each possible edge, and what is not summed yet."""

    likelihood: FloatArray  # (periods per symbol,)
    symbols: int
    pending: ComplexArray  # prompts of the last, incomplete stretch


def start_bit_sync(symbol_periods: int) -> BitSync:
    """Empty state."""
    return BitSync(np.zeros(symbol_periods), 0, np.empty(0, dtype=np.complex128))


def add_prompts(
    state: BitSync, prompts: ComplexArray, signal_power: float, noise_power: float
) -> BitSync:
    """Add prompts (n,) of consecutive code periods; every symbol length adds one sum per edge.

    The likelihood of a symbol-long sum S of unknown phase is I₀(A|S|/σ²), A² the signal's and 2σ²
    the noise's power in one period. For weak signals its logarithm is their energy, T(5.16–5.17);
    for strong ones it counts the few symbol changes there were for what they are worth.
    likelihood[p] belongs to symbols that start at period p, counted from the first prompt.
    """
    size = state.likelihood.size
    waiting = np.concatenate([state.pending, prompts])
    likelihood, symbols = state.likelihood, state.symbols
    scale = 2.0 * math.sqrt(max(signal_power, 0.0)) / noise_power if noise_power > 0.0 else 0.0
    while waiting.size >= 2 * size:
        total = np.concatenate([[0.0], np.cumsum(waiting[: 2 * size])])
        argument = scale * np.abs(total[size : 2 * size] - total[:size])
        likelihood = likelihood + argument + np.log(i0e(argument))
        symbols += 1
        waiting = waiting[size:]
    return BitSync(likelihood, symbols, waiting)


def symbol_edge(state: BitSync, lead: float = 18.0, minimum: int = 6) -> int | None:
    """Period of the symbol edge (mod symbol length) once it stands out, else None.

    `lead`: how much more likely (natural logarithm) it must be than any other.
    """
    if state.symbols < minimum:
        return None
    second, best = np.sort(state.likelihood)[-2:]
    return int(np.argmax(state.likelihood)) if best - second > lead else None


class Demodulated(NamedTuple):
    """Symbols of a frequency-locked stretch and the carrier at its end."""

    symbols: bytearray  # 1: negative
    phase_cycles: float  # residual phase in the middle of the last symbol
    step_cycles: float  # its change from symbol to symbol


def demodulate(sums: ComplexArray) -> Demodulated:
    """Follow the residual carrier through symbol sums (n,), deciding symbols on the way.

    A decision-directed loop of second order that starts with the rotation of the first symbols;
    the polarity is that of the phase it ends with, so a phase loop that takes over there continues
    the same stream of symbols.
    """
    symbols = bytearray()
    phase, step = _rotation(sums[:_FIRST_SYMBOLS])
    for value in sums.tolist():
        turned = value * cmath.rect(1.0, -phase)
        negative = turned.real < 0.0
        symbols.append(int(negative))
        error = cmath.phase(-turned if negative else turned)
        phase += 0.6 * error + step
        step += 0.15 * error
    turn = 2.0 * math.pi
    return Demodulated(symbols, (phase - step) / turn, step / turn)


def _rotation(sums: ComplexArray) -> tuple[float, float]:
    """Most likely phase of the first symbol and step per symbol, rad, whatever the signs.

    The step lies within ± a quarter turn: 12.5 Hz for symbols of 20 ms.
    """
    if sums.size == 0:
        return 0.0, 0.0
    spectrum = np.fft.fft(sums * sums, _STEPS)
    peak = int(np.argmax(np.abs(spectrum)))
    step = 2.0 * math.pi * float(np.fft.fftfreq(_STEPS)[peak])
    return 0.5 * cmath.phase(complex(spectrum[peak])), 0.5 * step
