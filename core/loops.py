"""Loop coefficients that give the noise bandwidth asked for, at any update interval.

A loop here is a fixed-gain estimator of phase, frequency and frequency rate. The generator runs
on the prediction; after each interval T the discriminator's mean phase error δ, taken at the
middle of the interval, corrects the state there:

    x(k+1) = Φ(T) · (x(k) + K δ(k)),    Φ = [[1, T, T²/2], [0, 1, T], [0, 0, 1]].

The closed loop's poles are those of the analogue prototype mapped by z = e^{sT}, and the natural
frequency is solved from the noise bandwidth of the sampled loop itself, so that gains stay right
when bandwidth × interval is no longer small (the usual continuous formulas do not).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import brentq

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray

PROTOTYPES = {1: (1.0, 1.0), 2: (1.0, math.sqrt(2.0), 1.0), 3: (1.0, 2.0, 2.0, 1.0)}
"""Characteristic polynomials in s/ω: order 2 with damping √½; order 3 the Wiener optimum for a
random-walk acceleration (Jaffe and Rechtin 1955), the better damped of the usual choices."""


class LoopGains(NamedTuple):
    """Gains per cycle (or chip) of discriminator output, applied at the middle of the interval."""

    phase: float  # cycles per cycle
    frequency: float  # Hz per cycle
    rate: float  # Hz/s per cycle


def _observer(order: int, normalized_frequency: float) -> tuple[FloatArray, FloatArray]:
    """Gain K and transition of the error, states in units of T = 1, for ω·T given."""
    # z − 1 instead of z: with slow loops all poles crowd at 1.
    poles = np.expm1(np.roots(PROTOTYPES[order]) * normalized_frequency)
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    wanted = np.real(np.poly(poles))
    polynomial = np.zeros_like(transition)
    for coefficient in wanted:  # Horner; Ackermann's formula
        polynomial = polynomial @ (transition - np.eye(order)) + coefficient * np.eye(order)
    observability = np.vstack([np.linalg.matrix_power(transition, k)[0] for k in range(order)])
    unit = np.zeros(order)
    unit[-1] = 1.0
    predicted_gain = polynomial @ np.linalg.solve(observability, unit)
    gain = np.linalg.solve(transition, predicted_gain)
    measured = np.zeros(order)
    measured[0] = 1.0
    return gain, transition - np.outer(predicted_gain, measured)


def _sampled_bandwidth(order: int, normalized_frequency: float) -> float:
    """One-sided noise bandwidth × T of the predicted phase at the middle of the interval."""
    gain, error_transition = _observer(order, normalized_frequency)
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    scale: FloatArray = normalized_frequency ** -np.arange(order, dtype=np.float64)
    return _noise_bandwidth(error_transition, transition @ gain, scale)


def _noise_bandwidth(error_transition: FloatArray, drive: FloatArray, scale: FloatArray) -> float:
    """Of the first state, × T; scale: of states of like size, which are well conditioned."""
    drive = scale * drive
    error_transition = scale[:, np.newaxis] * error_transition / scale
    covariance = solve_discrete_lyapunov(error_transition, np.outer(drive, drive))
    return float(covariance[0, 0]) / 2.0


def noise_bandwidth_hz(gains: LoopGains, interval_s: float) -> float:
    """One-sided noise bandwidth of a sampled loop with these gains, as `loop_gains` counts it."""
    T = interval_s
    gain = np.array(gains) * [1.0, T, T * T]
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    order = np.flatnonzero(gain)[-1] + 1
    gain, transition = gain[:order], transition[:order, :order]
    kept = np.eye(order)
    kept[:, 0] -= gain
    scale: FloatArray = gain[0] ** -np.arange(order, dtype=np.float64)
    return _noise_bandwidth(transition @ kept, transition @ gain, scale) / T


@lru_cache(maxsize=256)
def loop_gains(order: int, bandwidth_hz: float, interval_s: float) -> LoopGains:
    """Gains of a loop of order 1–3 whose sampled noise bandwidth is the one asked for.

    Parameters: one-sided noise bandwidth in Hz; update interval in s.
    Raises ValueError when no natural frequency gives that bandwidth at that interval.
    """
    if order not in PROTOTYPES:
        raise ValueError(f"loop order {order}: 1, 2 or 3")
    target = bandwidth_hz * interval_s
    lower, upper = 0.4 * target, 8.0  # bandwidth / ω lies between 0.25 and 2
    if not 0.0 < target < _sampled_bandwidth(order, upper):
        raise ValueError(
            f"bandwidth {bandwidth_hz} Hz cannot be had with updates every {interval_s} s"
        )
    natural = brentq(lambda w: _sampled_bandwidth(order, w) - target, lower, upper, xtol=1e-12)
    gain, _ = _observer(order, float(natural))
    padded = np.zeros(3)
    padded[:order] = gain
    return LoopGains(
        float(padded[0]), float(padded[1]) / interval_s, float(padded[2]) / interval_s**2
    )


@lru_cache(maxsize=64)
def settling_time_s(bandwidth_hz: float) -> float:
    """First zero of the phase error after a step, order 2 with damping √½, T(5.22).

    ω_n = bandwidth / 0.53; 0.196 s at 3 Hz.
    """
    damping = math.sqrt(0.5)
    natural = bandwidth_hz * 8.0 * damping / (4.0 * damping**2 + 1.0)
    root = math.sqrt(1.0 - damping**2)
    return math.atan2(root, damping) / (natural * root)


@kernel
def follow(gain: FloatArray, phase: FloatArray, frequency: FloatArray) -> None:
    """Frequencies that a loop beginning at zero finds in mean phases, in units of T = 1.

    gain: (3,) of phase, frequency and rate. phase, frequency: (n, columns), each column by itself.
    """
    for column in range(phase.shape[1]):
        predicted = rate = turning = 0.0
        for k in range(phase.shape[0]):
            error = phase[k, column] - predicted
            turning += gain[2] * error
            rate += gain[1] * error
            frequency[k, column] = rate
            predicted += gain[0] * error + rate + 0.5 * turning
            rate += turning
