"""Carrier loop whose gains follow from noise and motion: a Kalman filter of three states, K.

Its states are errors of phase, frequency and frequency rate (cycles, s). They are the generator's
own, so that they are zero after every correction, and what the filter remembers is how well they
are known. They count in the middle of intervals, where the mean phase that a discriminator sees is

    φ + T²/24 · a,

K(21) moved from the beginning of the interval: with its row [1, T/2, T²/6] the oscillator's noise
within the interval is left out of the measurement, four times as much as from the middle.

- Q is K(18), whose three matrices are right as printed (`core.carrier_model`): oscillator on phase
  and frequency, a random walk of the acceleration. Flicker noise has no place in it.
- R is the discriminator's, K(3) for one interval, or what innovations show, K(22–25): their
  variance less the prediction's, in running means of some length. Their mean is taken off first:
  K(25) counts a lag behind a motion as noise, which narrows the loop and lets it lag more.
- A memory that fades: P⁻ = s·Φ P Φᵀ + Q, K(27).
- P as it is, by Joseph's form, or as a root, K(28), by Potter's; K(28) is cut off in print. The
  root is made triangular where the noise comes in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from deepgnss.core.carrier_model import carrier_covariance, transition
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.jit import brief_kernel
from deepgnss.core.loops import LoopGains, noise_bandwidth_hz
from deepgnss.core.records import GPS_L1CA, FloatArray, Oscillator
from deepgnss.receiver.discriminators import costas_arctan
from deepgnss.receiver.modes import IDEAL_OSCILLATOR
from deepgnss.receiver.phase_loops import PlainLoop, Settled
from deepgnss.receiver.trackers import Accumulated, Correction

_STATES: Final = 3
_FRESH: Final = (0.1, 3.0, 30.0)  # 1σ where phase lock begins: cycles, Hz, Hz/s
_PLAIN_DBHZ: Final = 40.0  # of a signal in the mean
_UNKNOWN_HZ: Final = 1e4  # C/N0 before there is one
_BELIEVED: Final = 25.0  # intervals that the discriminator's own noise stands for at the start
_RANGE: Final = 4.0  # of what innovations show: between its fourth and four times that
_STEP_DB: Final = 0.5  # of R, between loops whose bandwidth is worked out


# --- the filter ----------------------------------------------------------------------------------


@brief_kernel
def predict(P: FloatArray, F: FloatArray, root_Q: FloatArray, fading: float) -> FloatArray:
    """P⁻ = s·F P Fᵀ + Q, K(27); all (n, n)."""
    n = P.shape[0]
    FP = np.zeros((n, n))
    found = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                FP[i, j] += F[i, k] * P[k, j]
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(n):
                value += fading * FP[i, k] * F[j, k] + root_Q[i, k] * root_Q[j, k]
            found[i, j] = found[j, i] = value
    return found


@brief_kernel
def predict_root(S: FloatArray, F: FloatArray, root_Q: FloatArray, fading: float) -> FloatArray:
    """Lower triangular root of s·F S Sᵀ Fᵀ + Q by Gram and Schmidt on [√s·F S, √Q]."""
    n = S.shape[0]
    A = np.zeros((n, 2 * n))
    scale = math.sqrt(fading)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                A[i, j] += scale * F[i, k] * S[k, j]
            A[i, n + j] = root_Q[i, j]
    root = np.zeros((n, n))
    for i in range(n):
        square = 0.0
        for k in range(2 * n):
            square += A[i, k] * A[i, k]
        root[i, i] = math.sqrt(square)
        if square == 0.0:
            continue
        for j in range(i + 1, n):
            dot = 0.0
            for k in range(2 * n):
                dot += A[j, k] * A[i, k]
            root[j, i] = dot / root[i, i]
            for k in range(2 * n):
                A[j, k] -= dot / square * A[i, k]
    return root


@brief_kernel
def update(P: FloatArray, H: FloatArray, R: float) -> tuple[FloatArray, FloatArray]:
    """Gain (n,) and covariance after a measurement of row H (n,), by Joseph's form."""
    n = P.shape[0]
    PH = np.zeros(n)
    C = R
    for i in range(n):
        for j in range(n):
            PH[i] += P[i, j] * H[j]
        C += H[i] * PH[i]
    K = PH / C
    found = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            found[i, j] = P[i, j] - K[i] * PH[j] - PH[i] * K[j] + K[i] * K[j] * C
            found[j, i] = found[i, j]
    return K, found


@brief_kernel
def update_root(S: FloatArray, H: FloatArray, R: float) -> tuple[FloatArray, FloatArray]:
    """The same on a root, K(28): a = SᵀH, b = 1/(aᵀa + R), γ = 1/(1 + √(b·R)); S − γ·K aᵀ."""
    n = S.shape[0]
    a = np.zeros(n)
    square = 0.0
    for j in range(n):
        for i in range(n):
            a[j] += S[i, j] * H[i]
        square += a[j] * a[j]
    b = 1.0 / (square + R)
    share = 1.0 / (1.0 + math.sqrt(b * R))
    K = np.zeros(n)
    for i in range(n):
        for j in range(n):
            K[i] += b * S[i, j] * a[j]
    found = S.copy()
    for i in range(n):
        for j in range(n):
            found[i, j] -= share * K[i] * a[j]
    return K, found


def phase_variance(cn0_hz: float, seconds: float) -> float:
    """Variance of a discriminator's mean phase over an interval, cycles²: K(3) at B_L·T = ½."""
    snr = 2.0 * cn0_hz * seconds
    return (1.0 + 1.0 / snr) / (4.0 * math.pi**2 * snr)


# --- the loop ------------------------------------------------------------------------------------


class Innovations(NamedTuple):
    """Running means over the last innovations."""

    weight: float  # intervals that stand behind them
    mean: float
    square: float
    predicted: float  # the prediction's part of their variance

    def and_one(self, innovation: float, predicted: float, most: float) -> Innovations:
        """K(25), with a weight that stops growing."""
        weight = min(self.weight + 1.0, most)
        share = 1.0 / weight
        return Innovations(
            weight,
            self.mean + share * (innovation - self.mean),
            self.square + share * (innovation * innovation - self.square),
            self.predicted + share * (predicted - self.predicted),
        )

    @property
    def noise(self) -> float:
        """R that they show, K(24); may be anything, even negative, by chance."""
        return self.square - self.mean * self.mean - self.predicted


class Memory(NamedTuple):
    """What the filter knows in the middle of an interval."""

    spread: FloatArray  # (3, 3): covariance, or a root of it
    seconds: float  # length of that interval; 0: there was none yet
    R: float  # cycles²
    seen: Innovations


@dataclass(frozen=True, slots=True)
class KalmanLoop(PlainLoop):
    """The loop's parameters."""

    interval_s: float = 0.020
    dynamics_mps2: float = 0.3  # by which an acceleration changes in 1 s, 1σ
    oscillator: Oscillator = IDEAL_OSCILLATOR
    adaptive: bool = True  # R from innovations
    memory_s: float = 1.0  # of these
    fading: float = 1.0
    square_root: bool = True
    discriminator: Callable[[complex], float] = costas_arctan

    @property
    def settled(self) -> Settled:
        """On a plain signal, R as the discriminator has it."""
        plain = phase_variance(10.0 ** (0.1 * _PLAIN_DBHZ), self.interval_s)
        return Settled(_STATES, self._bandwidth_hz(plain), self.interval_s)

    def start(self) -> Memory:
        """Phase, frequency and rate are about right."""
        fresh = np.diag(_FRESH if self.square_root else np.square(_FRESH))
        return Memory(fresh, 0.0, 0.0, Innovations(0.0, 0.0, 0.0, 0.0))

    def step(self, memory: Memory, seen: Accumulated) -> tuple[Memory, Correction]:
        """The error's best estimate, which goes to the generator as a whole."""
        H = measurement_row(seen.seconds)
        spread = memory.spread
        if memory.seconds:
            between_s = 0.5 * (memory.seconds + seen.seconds)
            F, root_Q = _dynamics(between_s, self.oscillator, self.dynamics_mps2)
            forward = predict_root if self.square_root else predict
            spread = forward(spread, F, root_Q, self.fading)
        thermal = phase_variance(seen.cn0_hz or _UNKNOWN_HZ, seen.seconds)
        innovation = self.discriminator(seen.prompt)
        innovations = memory.seen
        if not innovations.weight:
            innovations = Innovations(_BELIEVED, 0.0, thermal, 0.0)
        R = thermal
        if self.adaptive:
            predicted = self._predicted(spread, H)
            most = max(_BELIEVED, self.memory_s / seen.seconds)
            innovations = innovations.and_one(innovation, predicted, most)
            R = min(max(innovations.noise, thermal / _RANGE), thermal * _RANGE)
        K, spread = (update_root if self.square_root else update)(spread, H, R)
        phase, frequency, rate = (K * innovation).tolist()
        after = Memory(spread, seen.seconds, R, innovations)
        return after, Correction(phase, frequency, rate)

    def turned(self, memory: Memory, cycles: float) -> Memory:
        """It knows of errors only."""
        return memory

    def bandwidth_hz(self, memory: Memory) -> float:
        """What it would come to with the present R."""
        return self._bandwidth_hz(memory.R) if memory.R else self.settled.bandwidth_hz

    def covariance(self, memory: Memory) -> FloatArray:
        """P in the middle of the last interval."""
        spread = memory.spread
        return spread @ spread.T if self.square_root else spread

    def _predicted(self, spread: FloatArray, H: FloatArray) -> float:
        if self.square_root:
            a = H @ spread
            return float(a @ a)
        return float(H @ spread @ H)

    def _bandwidth_hz(self, R: float) -> float:
        steps = round(10.0 * math.log10(R) / _STEP_DB)
        gains = steady_gains(
            self.interval_s,
            self.oscillator,
            self.dynamics_mps2,
            self.fading,
            10.0 ** (0.1 * _STEP_DB * steps),
        )
        return noise_bandwidth_hz(gains, self.interval_s)


@lru_cache(maxsize=64)
def measurement_row(seconds: float) -> FloatArray:
    """What a state in the middle of an interval adds to its mean phase, K(21)·Φ(−T/2)."""
    H = np.array([1.0, 0.0, seconds**2 / 24.0])
    H.flags.writeable = False
    return H


@lru_cache(maxsize=256)
def _dynamics(
    seconds: float, oscillator: Oscillator, dynamics_mps2: float
) -> tuple[FloatArray, FloatArray]:
    """Φ over a time, and a root of Q."""
    density = (dynamics_mps2 * GPS_L1CA.carrier_hz / SPEED_OF_LIGHT_MPS) ** 2
    Q = carrier_covariance(_STATES, seconds, oscillator, GPS_L1CA.carrier_hz, density)
    values, vectors = np.linalg.eigh(Q)
    return transition(_STATES, seconds), vectors * np.sqrt(np.maximum(values, 0.0))


@lru_cache(maxsize=256)
def steady_gains(
    interval_s: float, oscillator: Oscillator, dynamics_mps2: float, fading: float, R: float
) -> LoopGains:
    """Gains the filter comes to when R stays: those of the algebraic Riccati equation."""
    F, root_Q = _dynamics(interval_s, oscillator, dynamics_mps2)
    H = measurement_row(interval_s)
    # Scaled to states and a measurement of like size: Q spans ten orders of magnitude.
    scale = interval_s ** np.arange(_STATES) / math.sqrt(R)
    F_scaled = scale[:, np.newaxis] * F / scale
    Q_scaled = (scale[:, np.newaxis] * root_Q) @ (scale[:, np.newaxis] * root_Q).T
    H_scaled = (H / scale / math.sqrt(R))[np.newaxis]
    P = solve_discrete_are(math.sqrt(fading) * F_scaled.T, H_scaled.T, Q_scaled, np.eye(1))
    K = P @ H_scaled[0] / (H_scaled[0] @ P @ H_scaled[0] + 1.0)
    return LoopGains(*(K / scale / math.sqrt(R)).tolist())
