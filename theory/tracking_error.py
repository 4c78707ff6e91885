"""Thermal noise of the tracking loops: what σ a measured one is to be held against (T 2.2.5)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from deepgnss.core.loops import loop_gains
from deepgnss.core.records import FloatArray


def pll_thermal_sigma_cycles(cn0_dbhz: float, bandwidth_hz: float, coherent_s: float) -> float:
    """Carrier phase σ, cycles, of a Costas loop of any order, T(2.20).

    Parameters: one-sided noise bandwidth, Hz; coherent time, s. The bracket is the squaring loss.
    """
    cn0_hz = 10.0 ** (cn0_dbhz / 10.0)
    squaring = 1.0 + 1.0 / (2.0 * coherent_s * cn0_hz)
    return math.sqrt(bandwidth_hz / cn0_hz * squaring) / (2.0 * math.pi)


@lru_cache(maxsize=64)
def reported_share(order: int, bandwidth_hz: float, interval_s: float) -> float:
    """σ of the phase that a receiver reports over T(2.20), which is that of the loop's prediction.

    A tag's phase comes from the loop's estimate for the symbol that holds it, that symbol's own
    measurement taken in: 0.89 with 7 Hz and 20 ms, 0.99 with 1 ms (order 3). Root mean square over
    the symbol, by the covariance of the sampled loop.
    """
    gain = np.array(loop_gains(order, bandwidth_hz, interval_s))[:order] * (
        interval_s ** np.arange(order)  # states in units of the interval: well conditioned
    )
    forward = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    kept = np.eye(order)
    kept[:, 0] -= gain
    drive = forward @ gain
    before = solve_discrete_lyapunov(forward @ kept, np.outer(drive, drive))
    after = kept @ before @ kept.T + np.outer(gain, gain)
    points, weights = np.polynomial.legendre.leggauss(4)
    row = (0.5 * points[:, np.newaxis]) ** np.arange(order) / [1.0, 1.0, 2.0][:order]
    variance = 0.5 * weights @ np.einsum("ni,ij,nj->n", row, after, row)
    return math.sqrt(variance / before[0, 0])


def dll_thermal_sigma_chips(
    cn0_dbhz: float,
    bandwidth_hz: float,
    coherent_s: float,
    spacing_chips: float,
    front_end_hz: float,
    chip_rate_hz: float,
) -> float:
    """Code phase σ, chips, of a normalized early-minus-late power loop, T(2.25).

    The approximation of Betz and Kolodziejski (2000) for BPSK, in three regions of the spacing D
    against the front end's two-sided bandwidth b in chip rates; the root covers every factor
    (T's text closes it before the last two). Within 10 % of the integral it stands for when
    b ≥ 4, within 20 % at b = 2.5.

    Parameters: one-sided noise bandwidth, Hz; coherent time, s; early-to-late spacing D, chips;
    two-sided front-end bandwidth, Hz (math.inf: an ideal one).
    """
    cn0_hz = 10.0 ** (cn0_dbhz / 10.0)
    width = _effective_spacing_chips(spacing_chips, front_end_hz / chip_rate_hz)
    squaring = 1.0 + 2.0 / ((2.0 - spacing_chips) * coherent_s * cn0_hz)
    return math.sqrt(bandwidth_hz / (2.0 * cn0_hz) * width * squaring)


def _effective_spacing_chips(spacing_chips: float, band: float) -> float:
    """D as the noise sees it: never less than the front end's own resolution 1/b."""
    if spacing_chips >= math.pi / band:
        return spacing_chips
    if spacing_chips <= 1.0 / band:
        return 1.0 / band
    return 1.0 / band + band / (math.pi - 1.0) * (spacing_chips - 1.0 / band) ** 2


def loop_states(
    phase_cycles: FloatArray, order: int, bandwidth_hz: float, interval_s: float
) -> FloatArray:
    """What a loop without noise estimates of a moving phase: its own dynamic error, by running it.

    Parameters: mean phase over each of n consecutive intervals, cycles (the loop starts on the
    first ones); order 1–3; one-sided noise bandwidth, Hz; update interval, s.

    Returns: (n, 3) phase, frequency and rate at each interval's middle, that interval's own
    measurement included: cycles, Hz, Hz/s.
    """
    T = interval_s
    forward = np.array([[1.0, T, 0.5 * T * T], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    gains = np.array(loop_gains(order, bandwidth_hz, T))
    start_hz = (phase_cycles[1] - phase_cycles[0]) / T if order > 1 else 0.0
    state = np.array([phase_cycles[0], start_hz, 0.0])
    states = np.empty((len(phase_cycles), 3))
    for k, phase in enumerate(phase_cycles):
        state = state + gains * (phase - state[0])
        states[k] = state
        state = forward @ state
    return states


def acceleration_response(time_s: FloatArray, order: int, bandwidth_hz: float) -> FloatArray:
    """Phase error of a carrier loop after a step of frequency rate, cycles per Hz/s.

    The inverse transform of H_e(s)/s³ for the loops of `core.loops` updated without end: order 2
    with damping √½, ω = B/0.53, T(4.44); order 3 with H_e = s³/(s³ + 2ωs² + 2ω²s + ω³), ω = 1.2 B,
    whose poles are −ω and −ω/2 ± jω√¾.

    Parameters: time since the step; one-sided noise bandwidth, Hz.
    """
    if order == 2:
        omega = bandwidth_hz * 4.0 * math.sqrt(2.0) / 3.0
        t = time_s * (omega / math.sqrt(2.0))
        response = 1.0 - np.exp(-t) * (np.cos(t) + np.sin(t))
    elif order == 3:
        omega = 1.2 * bandwidth_hz
        t = time_s * omega
        turn = math.sqrt(0.75) * t
        swing = np.cos(turn) - np.sin(turn) / math.sqrt(3.0)
        response = np.exp(-t) - np.exp(-0.5 * t) * swing
    else:
        raise ValueError(f"loop order {order}: 2 or 3")
    return np.asarray(np.where(time_s > 0.0, response, 0.0) / omega**2)


def acceleration_peak_cycles(rate_hzps: float, order: int, bandwidth_hz: float) -> float:
    """Largest phase error after a step of frequency rate: T(4.47) for order 2.

    (1 + e^-π)/ω² = 0.2934/B² there; 0.4045/ω² = 0.2809/B² for order 3, which comes back to zero.
    """
    time_s = np.linspace(0.0, 6.0 / bandwidth_hz, 6001)
    return float(rate_hzps * acceleration_response(time_s, order, bandwidth_hz).max())


def root_sum_square(*sigmas: float) -> float:
    """Spread of a sum of independent errors, T(2.24): thermal, vibration, oscillator."""
    return math.hypot(*sigmas)
