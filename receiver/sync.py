"""Bit synchronization by energy, T(5.16–5.17), and the bits that went by before it."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray


class BitSync(NamedTuple):
    """Energies of the symbol-long sums for each possible edge, and what is not summed yet."""

    energy: FloatArray  # (periods per symbol,)
    spread: FloatArray  # (edges, edges): sum of squared energy differences, for their noise
    symbols: int
    pending: ComplexArray  # prompts of the last, incomplete stretch


def start_bit_sync(symbol_periods: int) -> BitSync:
    """Empty state."""
    return BitSync(
        np.zeros(symbol_periods),
        np.zeros((symbol_periods, symbol_periods)),
        0,
        np.empty(0, dtype=np.complex128),
    )


def add_prompts(state: BitSync, prompts: ComplexArray) -> BitSync:
    """Add prompts (n,) of consecutive code periods; every symbol length adds one sum per edge.

    energy[p] belongs to symbols that start at period p, 2·… counted from the first prompt.
    """
    size = state.energy.size
    waiting = np.concatenate([state.pending, prompts])
    energy, spread, symbols = state.energy, state.spread, state.symbols
    while waiting.size >= 2 * size:
        total = np.concatenate([[0.0], np.cumsum(waiting[: 2 * size])])
        sums = total[size : 2 * size] - total[:size]
        power = sums.real**2 + sums.imag**2
        energy = energy + power
        difference = power[:, np.newaxis] - power[np.newaxis, :]
        spread = spread + difference**2
        symbols += 1
        waiting = waiting[size:]
    return BitSync(energy, spread, symbols, waiting)


def symbol_edge(state: BitSync, sigmas: float = 4.0, minimum: int = 8) -> int | None:
    """Period of the symbol edge (mod symbol length) once it stands out, else None.

    The best edge must exceed every other by `sigmas` standard deviations of their difference,
    which come from the scatter of the sums themselves: strong signals need few symbols.
    """
    if state.symbols < minimum:
        return None
    best = int(np.argmax(state.energy))
    others = np.arange(state.energy.size) != best
    lead = state.energy[best] - state.energy[others]
    mean = lead / state.symbols
    variance = state.spread[best, others] / state.symbols - mean**2
    sigma = np.sqrt(np.maximum(variance, 0.0) * state.symbols)
    return best if bool(np.all(lead > sigmas * sigma)) and bool(np.all(lead > 0.0)) else None


class Demodulated(NamedTuple):
    """Symbols of a frequency-locked stretch and the carrier at its end."""

    symbols: bytearray  # 1: negative
    phase_cycles: float  # residual phase in the middle of the last symbol
    step_cycles: float  # its change from symbol to symbol


def demodulate(sums: ComplexArray) -> Demodulated:
    """Follow the residual carrier through symbol sums (n,), deciding symbols on the way.

    A decision-directed loop of second order; the polarity is that of the phase it ends with, so
    a phase loop that takes over there continues the same stream of symbols.
    """
    symbols = bytearray()
    phase = cmath.phase(complex(sums[0])) if sums.size else 0.0
    step = 0.0
    for value in sums.tolist():
        turned = value * cmath.rect(1.0, -phase)
        negative = turned.real < 0.0
        symbols.append(int(negative))
        error = cmath.phase(-turned if negative else turned)
        phase += 0.6 * error + step
        step += 0.15 * error
    turn = 2.0 * math.pi
    return Demodulated(symbols, (phase - step) / turn, step / turn)
