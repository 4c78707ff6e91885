"""Thermal noise of the tracking loops: what σ a measured one is to be held against (T 2.2.5)."""

from __future__ import annotations

import math

import numpy as np

from deepgnss.core.loops import loop_gains
from deepgnss.core.records import FloatArray


def pll_thermal_sigma_cycles(cn0_dbhz: float, bandwidth_hz: float, coherent_s: float) -> float:
    """Carrier phase σ, cycles, of a Costas loop of any order, T(2.20).

    Parameters: one-sided noise bandwidth, Hz; coherent time, s. The bracket is the squaring loss.
    """
    cn0_hz = 10.0 ** (cn0_dbhz / 10.0)
    squaring = 1.0 + 1.0 / (2.0 * coherent_s * cn0_hz)
    return math.sqrt(bandwidth_hz / cn0_hz * squaring) / (2.0 * math.pi)


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


def root_sum_square(*sigmas: float) -> float:
    """Spread of a sum of independent errors, T(2.24): thermal, vibration, oscillator."""
    return math.hypot(*sigmas)
