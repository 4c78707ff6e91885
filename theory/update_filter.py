"""Phase noise of a Kalman carrier loop with one update per interval: L 1.3, K 2.2.

State: phase, frequency, rate and jerk of the carrier, cycles/s^k. Between updates the oscillator
walks, L(29), L(30), and the highest derivative kept does, L(28) (`core.carrier_model`); an update
brings phase and frequency of a tone in the middle of the interval at the Cramér–Rao bound,
L(31–34), L(41).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_discrete_are

from deepgnss.core.carrier_model import carrier_covariance, transition
from deepgnss.core.records import FloatArray, Oscillator


def oscillator_step_sigma(
    oscillator: Oscillator, carrier_hz: float, interval_s: float
) -> tuple[float, float]:
    """1σ of phase, cycles, and frequency, Hz, that an oscillator adds in an interval, L 1.3.1.

    With q_b = h0/2 and q_d = 2π²·h₋₂, L(29), L(30). (L's own figures for 0.1 s, 0.086 Hz and
    0.0004 Hz, are √(h₋₂·T)·f0, without the 2π²; 0.0002 cycle is √(h0·T)·f0, without the ½.)
    """
    Q = carrier_covariance(2, interval_s, oscillator, carrier_hz, 0.0)
    return math.sqrt(Q[0, 0]), math.sqrt(Q[1, 1])


def tone_bounds(cn0_dbhz: float, interval_s: float, sums: int) -> tuple[float, float]:
    """Cramér–Rao 1σ of phase in the middle, cycles, and frequency, Hz, of a tone in `sums` sums.

    Rife and Boorstyn 1974. L(41) as scanned has N² where the bound has N(N² − 1) ≈ N³.
    """
    snr = 10.0 ** (cn0_dbhz / 10.0) * interval_s / sums
    step_s = interval_s / sums
    phase2 = 1.0 / (2.0 * snr * sums)
    frequency2 = 6.0 / (snr * sums * (sums**2 - 1) * step_s**2)
    return math.sqrt(phase2) / (2.0 * math.pi), math.sqrt(frequency2) / (2.0 * math.pi)


def steady_phase_sigma_cycles(
    cn0_dbhz: float, interval_s: float, Q: FloatArray, sums: int | None = None
) -> float:
    """1σ of the phase in the middle of an interval after its update, once the filter has settled.

    Q: of an interval, by `core.carrier_model.carrier_covariance`; sums: of one (None: of a
    millisecond each).
    """
    count = max(2, round(interval_s * 1e3)) if sums is None else sums
    n = len(Q)
    Phi = transition(n, interval_s)
    scale = np.diag(interval_s ** np.arange(n, dtype=np.float64))  # states of like size
    back = np.linalg.inv(scale)
    H = np.eye(n)[:2] @ back
    R = np.diag(np.square(tone_bounds(cn0_dbhz, interval_s, count)))
    P = solve_discrete_are((scale @ Phi @ back).T, H.T, scale @ Q @ scale, R)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return math.sqrt((P - gain @ H @ P)[0, 0])
