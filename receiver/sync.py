"""Bit synchronization, T(5.16–5.17), and the bits that went by before it."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import i0e

from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import ComplexArray, FloatArray

_FIRST_SYMBOLS = 12  # whose rotation the demodulator starts with
_STEPS = 256  # of rotation tried …
_TURNS = np.exp(-2j * np.pi * np.arange(_STEPS) / _STEPS)  # … and they themselves


class BitSync(NamedTuple):
    """Log-likelihood of each possible edge, and what is not summed yet."""

    patterns: FloatArray  # (patterns, periods per symbol): signs that the periods may have
    likelihood: FloatArray  # (patterns, periods per symbol)
    symbols: int
    pending: ComplexArray  # prompts of the last, incomplete stretch


class Edge(NamedTuple):
    """Where symbols start."""

    period: int  # modulo the symbol's length, from the first prompt on
    alternating: bool  # every other period was upside down: the frequency is off by 1/2T


def start_bit_sync(secondary: FloatArray, *, coded: bool) -> BitSync:
    """Empty state for symbols whose code periods have these signs.

    With a secondary code (`coded`) the frequency was found blind to signs and may be off by half
    the period's rate, ±500 Hz, which turns every other sign: that is tried as well.
    """
    alternating = secondary * (-1.0) ** np.arange(secondary.size)
    patterns = np.array([secondary, alternating] if coded else [secondary])
    return BitSync(patterns, np.zeros(patterns.shape), 0, np.empty(0, dtype=np.complex128))


def add_prompts(
    state: BitSync, prompts: ComplexArray, signal_power: float, noise_power: float
) -> BitSync:
    """Add prompts (n,) of consecutive code periods; every symbol length adds one sum per edge.

    The likelihood of a symbol-long sum S of unknown phase is I₀(A|S|/σ²), A² the signal's and 2σ²
    the noise's power in one period. For weak signals its logarithm is their energy, T(5.16–5.17);
    for strong ones it counts the few symbol changes there were for what they are worth.
    likelihood[:, p] belongs to symbols that start at period p, counted from the first prompt.
    """
    size = state.likelihood.shape[1]
    waiting = np.concatenate([state.pending, prompts])
    likelihood, symbols = state.likelihood, state.symbols
    scale = 2.0 * math.sqrt(max(signal_power, 0.0)) / noise_power if noise_power > 0.0 else 0.0
    while waiting.size >= 2 * size:
        windows = sliding_window_view(waiting[: 2 * size - 1], size)
        argument = scale * np.abs(state.patterns @ windows.T)
        likelihood = likelihood + argument + np.log(i0e(argument))
        symbols += 1
        waiting = waiting[size:]
    return state._replace(likelihood=likelihood, symbols=symbols, pending=waiting)


def symbol_edge(state: BitSync, lead: float = 18.0, minimum: int = 6) -> Edge | None:
    """The symbol edge once it stands out, else None.

    `lead`: how much more likely (natural logarithm) it must be than any other.
    """
    if state.symbols < minimum:
        return None
    second, best = np.sort(state.likelihood, axis=None)[-2:]
    if best - second <= lead:
        return None
    pattern, period = np.unravel_index(np.argmax(state.likelihood), state.likelihood.shape)
    return Edge(int(period), bool(pattern))


def edge_energies(prompts: ComplexArray, secondary: FloatArray) -> FloatArray:
    """Energy of whole symbols, the secondary code stripped, for every edge, T(5.16–5.17).

    Parameters: prompts (n,) of consecutive code periods; secondary, signs of a symbol's periods.
    Each edge counts as many symbols as all can have. The likelihood of `add_prompts` says more
    of strong signals, and whether the highest stands out; this is the published decision.
    """
    size = secondary.size
    count = (prompts.size - size + 1) // size
    sums = np.correlate(prompts, secondary)[: count * size].reshape(count, size)
    return np.asarray((sums.real**2 + sums.imag**2).sum(axis=0))


class Demodulated(NamedTuple):
    """Symbols of a frequency-locked stretch and the carrier at its end."""

    symbols: bytearray  # 1: negative
    phase_cycles: float  # residual phase in the middle of the last symbol
    step_cycles: float  # its change from symbol to symbol


def demodulate(sums: ComplexArray, symbol_s: float = 0.02) -> Demodulated:
    """Follow the residual carrier through symbol sums (n,), deciding symbols on the way.

    A decision-directed loop of second order that starts with the rotation of the first symbols;
    the polarity is that of the phase it ends with, so a phase loop that takes over there continues
    the same stream of symbols.
    """
    symbols = bytearray()
    share = symbol_s / 0.02  # short symbols are noisier: the loop keeps its bandwidth
    phase, step = _rotation(sums[: round(_FIRST_SYMBOLS / share)])
    phase_gain, step_gain = 1.0 - 0.4**share, 0.15 * share**2
    for value in sums.tolist():
        turned = value * cmath.rect(1.0, -phase)
        negative = turned.real < 0.0
        symbols.append(int(negative))
        error = cmath.phase(-turned if negative else turned)
        phase += phase_gain * error + step
        step += step_gain * error
    turn = 2.0 * math.pi
    return Demodulated(symbols, (phase - step) / turn, step / turn)


@brief_kernel
def decided_signs(sums: ComplexArray) -> FloatArray:
    """Signs ±1 of consecutive symbol sums (n,) up to a common one, whatever their rotation."""
    phase, step = _rotation(sums)
    return _signs(sums, phase, step)


@brief_kernel
def _signs(sums: ComplexArray, phase: float, step: float) -> FloatArray:
    signs = np.ones(sums.size)
    for k in range(sums.size):
        angle = phase + step * k
        if sums[k].real * np.cos(angle) + sums[k].imag * np.sin(angle) < 0.0:
            signs[k] = -1.0
    return signs


@brief_kernel
def _rotation(sums: ComplexArray) -> tuple[float, float]:
    """Most likely phase of the first symbol and step per symbol, rad, whatever the signs.

    The step lies within ± a quarter turn: 12.5 Hz for symbols of 20 ms, 125 Hz for 2 ms.
    """
    if sums.size == 0:
        return 0.0, 0.0
    best, most, peak = 0.0j, -1.0, 0
    for k in range(_STEPS):  # a spectrum of few values: quicker than a transform
        line = 0.0j
        for n in range(min(sums.size, _STEPS)):
            line += sums[n] * sums[n] * _TURNS[k * n % _STEPS]
        power = line.real * line.real + line.imag * line.imag
        if power > most:
            best, most, peak = line, power, k
    step = 2.0 * math.pi * (peak if peak < _STEPS // 2 else peak - _STEPS) / _STEPS
    return 0.5 * cmath.phase(best), 0.5 * step
