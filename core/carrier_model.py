"""A carrier as a chain of integrators: phase, frequency, rate … each the integral of the next.

Units are cycles and seconds. Noise comes in white on a state's derivative: motion at the end of
the chain, an oscillator's on phase and on frequency.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from deepgnss.core.records import FloatArray, Oscillator


@lru_cache(maxsize=64)
def transition(states: int, seconds: float) -> FloatArray:
    """Φ of the chain: T^k/k! on the k-th diagonal above, K(16), L(20)."""
    found = np.zeros((states, states))
    for i in range(states):
        for j in range(i, states):
            found[i, j] = seconds ** (j - i) / math.factorial(j - i)
    found.flags.writeable = False
    return found


def driven_covariance(states: int, seconds: float, driven: int, density: float) -> FloatArray:
    """What white noise of a (two-sided) density on the derivative of one state adds in a time.

    With a, b steps from states i, j down to the driven one: q·T^(a+b+1) / ((a+b+1)·a!·b!).
    L(28)'s last matrix is that for four states, the last one driven; L(25) has T² for T³.
    """
    found = np.zeros((states, states))
    for i in range(driven + 1):
        for j in range(driven + 1):
            a, b = driven - i, driven - j
            scale = (a + b + 1) * math.factorial(a) * math.factorial(b)
            found[i, j] = density * seconds ** (a + b + 1) / scale
    return found


def wander_covariance(t_s: FloatArray, oscillator: Oscillator, carrier_hz: float) -> FloatArray:
    """Covariance (n, n) of what an oscillator adds to the phase at times before and after 0.

    Beyond phase and frequency at 0. Its noise before and after is independent; on one side, with
    a ≤ b from 0, q_b·a + q_d·(a²·b/2 − a³/6), q as of `carrier_covariance`.
    """
    size = np.abs(t_s)
    a, b = np.minimum.outer(size, size), np.maximum.outer(size, size)
    phase = carrier_hz**2 * oscillator.h0_s / 2.0
    frequency = carrier_hz**2 * 2.0 * math.pi**2 * oscillator.h_2_hz
    same = np.multiply.outer(t_s, t_s) > 0.0
    return np.asarray(same * (phase * a + frequency * a * a * (b / 2.0 - a / 6.0)))


def carrier_covariance(
    states: int, seconds: float, oscillator: Oscillator, carrier_hz: float, density: float
) -> FloatArray:
    """Q of the chain, L(28): oscillator on phase and frequency, motion on the last state.

    q_b = f0²·h0/2 cycles²/s and q_d = f0²·2π²·h₋₂ Hz²/s, L(29), L(30). L's figures beside table 1
    do not follow from them: 100 ms of its TCXO are 0.16 cycle and 0.38 Hz (L: 0.228, 0.086), of
    its OCXO 0.00016 cycle and 0.0017 Hz (L: 0.0002, 0.0004); the frequencies lack 2π².

    density: of the noise on the last state, (Hz/s^(states−1))²/s.
    """
    phase = carrier_hz**2 * oscillator.h0_s / 2.0
    frequency = carrier_hz**2 * 2.0 * math.pi**2 * oscillator.h_2_hz
    return (
        driven_covariance(states, seconds, 0, phase)
        + driven_covariance(states, seconds, 1, frequency)
        + driven_covariance(states, seconds, states - 1, density)
    )
