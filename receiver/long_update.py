"""Carrier loop of long updates, L: one measurement of some 100 ms, a Kalman filter of four states.

Over an update the carrier is measured as a whole: signs of its symbols, then phase and frequency
(and their rate, while the filter does not know it better) in its middle, by maximum likelihood
near where the filter expects them. The filter's states are phase, frequency, rate and the rate's
slope, L(19–39), in the middle of updates. The first three are the generator's own, so that their
errors are zero after each correction; the slope and the covariance are what the loop remembers.

Where L does otherwise: symbols are decided by a fit to the squares of whole symbols, whose loss,
L(7), is 0.5 dB at 23 dB-Hz where that of 1 ms is 5.4 dB. The squares tell the phase to half a
cycle; it is taken next to what the frequency just seen lets expect, which bears a rate that was
wrong by 1/(2T²). The rate is measured as well as long as that tells something, so that the loop
settles within two updates whatever the rate's slope. R is that of the bounds, L(41) with N³;
L(34) calls variances σ. Q is that of `core.carrier_model`.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.carrier_model import carrier_covariance, transition, wander_covariance
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, ComplexArray, FloatArray, Oscillator
from deepgnss.receiver.chirp import climbed, find_chirp, find_squared_chirp, turns
from deepgnss.receiver.modes import IDEAL_OSCILLATOR
from deepgnss.receiver.phase_loops import Settled
from deepgnss.receiver.trackers import Accumulated, Correction

_TURN: Final = 2.0 * math.pi
_STATES: Final = 4
_CLIMBS: Final = 3
# What is not known when a loop is closed, 1σ: cycles, Hz, Hz/s, Hz/s².
_FRESH: Final = (0.1, 3.0, 30.0, 60.0)
_WIDE: Final = 0.15  # lines by which the frequency may be off, 1σ, before it is searched for …
_WIDEST_HZPS: Final = 100.0  # … among rates up to this
_LEAST_CN0_HZ: Final = 30.0  # a C/N0 that fell lower is not believed
_TOLD: Final = 0.5  # a rate less well known than this is measured, in its measurement's σ
_SURPRISE: Final = 25.0  # normalized innovation per value that no noise makes: the motion changed
_OPENED: Final = (0.0, 1.0, 20.0, 60.0)  # then so much is added to what is not known
_BANDWIDTH: Final = 0.35  # of a loop of fixed gains as noisy as this one, times the update


class Memory(NamedTuple):
    """What the loop knows in the middle of its last update."""

    jerk_hzps2: float  # slope of the rate
    P: FloatArray  # (4, 4) of phase, frequency, rate and slope
    updates: int
    cn0_hz: float


class Measured(NamedTuple):
    """Received less foreseen, in the middle of an update."""

    z: FloatArray  # (2,) or (3,): cycles, Hz and Hz/s
    R: FloatArray
    cn0_hz: float = 0.0


class Filtered(NamedTuple):
    """A filter's step."""

    x: FloatArray  # (4,) errors of the states
    P: FloatArray
    surprise: float  # normalized innovation squared, per value


def measurement_covariance(
    cn0_hz: float,
    count: int,
    interval_s: float,
    values: int,
    oscillator: Oscillator = IDEAL_OSCILLATOR,
) -> FloatArray:
    """R of phase, frequency (and rate) of `count` sums: the inverse of their information, L(34).

    And what the oscillator does within them, which L leaves out: at 45 dB-Hz a TCXO's frequency
    wanders by ten times what noise makes of it in 200 ms, and its rate by as much.
    """
    inverse, wander = _fit(count, interval_s, values, oscillator)
    return np.asarray(inverse / (2.0 * _TURN**2 * cn0_hz * interval_s) + wander)


@lru_cache(maxsize=32)
def _fit(
    count: int, interval_s: float, values: int, oscillator: Oscillator
) -> tuple[FloatArray, FloatArray]:
    """Of a fit to `count` phases: (GGᵀ)⁻¹ of its gradient, and the oscillator's part of R."""
    t: FloatArray = interval_s * (np.arange(count, dtype=np.float64) - 0.5 * (count - 1))
    gradient = np.array([np.ones(count), t, 0.5 * t * t])[:values]
    inverse = np.linalg.inv(gradient @ gradient.T)
    solved = inverse @ gradient
    wander = solved @ wander_covariance(t, oscillator, GPS_L1CA.carrier_hz) @ solved.T
    return inverse, wander


def filtered(P: FloatArray, measured: Measured) -> Filtered:
    """Kalman's correction of a predicted error of zero, L(37–39), covariance by Joseph's form."""
    z, R, _ = measured
    H = np.eye(z.size, _STATES)
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    I_KH = np.eye(_STATES) - K @ H
    surprise = float(z @ np.linalg.solve(S, z)) / z.size
    return Filtered(K @ z, I_KH @ P @ I_KH.T + K @ R @ K.T, surprise)


def bent(jerk_hzps2: float, seconds: float, t_s: FloatArray) -> FloatArray:
    """Cycles of the slope's part that a generator of constant rate leaves, `t_s` into an update.

    The generator is given the rate that makes this zero at the end, see `LongUpdateLoop.foreseen`:
    j·(t³ − T·t²)/6.
    """
    return np.asarray(jerk_hzps2 * t_s * t_s * (t_s - seconds) / 6.0)


@dataclass(frozen=True, slots=True)
class LongUpdateLoop:
    """The loop's parameters."""

    interval_s: float = 0.2  # of an update, whole symbols
    dynamics_mps3: float = 0.75  # by which the jerk in the line of sight changes in 1 s, 1σ
    oscillator: Oscillator = IDEAL_OSCILLATOR

    @property
    def settled(self) -> Settled:
        """About as noisy a loop of order 3."""
        return Settled(3, _BANDWIDTH / self.interval_s, self.interval_s)

    def start(self) -> Memory:
        """Nothing is known but that the phase is near."""
        return Memory(0.0, np.diag(np.square(_FRESH)), 0, 0.0)

    def predicted(self, memory: Memory, seconds: float) -> FloatArray:
        """Covariance in the middle of the next update, L(36)."""
        if memory.updates == 0:
            return memory.P
        F = transition(_STATES, seconds)
        density = (self.dynamics_mps3 * GPS_L1CA.carrier_hz / SPEED_OF_LIGHT_MPS) ** 2
        noise = carrier_covariance(_STATES, seconds, self.oscillator, GPS_L1CA.carrier_hz, density)
        return np.asarray(F @ memory.P @ F.T + noise)

    def signs(self, memory: Memory, sums: ComplexArray, interval_s: float) -> FloatArray:
        """Signs ±1 of an update's symbols (n,), next to the phase that is expected."""
        seconds = sums.size * interval_s
        P, cn0_hz = self.predicted(memory, seconds), max(memory.cn0_hz, _LEAST_CN0_HZ)
        R = measurement_covariance(cn0_hz, sums.size, interval_s, 3, self.oscillator)
        straight = _straightened(sums, interval_s, memory.jerk_hzps2)
        squares = straight * straight
        frequency = rate = 0.0
        if _is_wide(P, seconds):
            _, frequency, rate, _ = find_squared_chirp(straight, interval_s, _WIDEST_HZPS)
        for _ in range(_CLIMBS):
            double = climbed(squares, interval_s, 2.0 * frequency, 2.0 * rate)
            frequency = 0.5 * double[0]
            rate = 0.5 * double[1] if _tells_rate(P, R) else 0.0
        line = complex((squares * turns(sums.size, interval_s, 2 * frequency, 2 * rate)).sum())
        if not _is_wide(P, seconds):
            unlikely = frequency**2 / (2.0 * float(P[1, 1] + R[1, 1]))
            if _gain(squares, line) < unlikely:  # a line of noise, of a weak signal
                frequency = rate = 0.0
                line = complex(squares.sum())
        expected = float(P[0, 1] / (P[1, 1] + R[1, 1])) * frequency
        phase = expected + math.remainder(0.5 * cmath.phase(line) / _TURN - expected, 0.5)
        turned = straight * turns(sums.size, interval_s, frequency, rate)
        return np.where((turned * cmath.rect(1.0, -_TURN * phase)).real < 0.0, -1.0, 1.0)

    def step(self, memory: Memory, seen: Accumulated) -> tuple[Memory, Correction]:
        """Measure, filter; the correction counts in the update's middle."""
        T = seen.seconds
        P = self.predicted(memory, T)
        jerk = memory.jerk_hzps2
        prompts = _straightened(seen.periods[:, 1], seen.period_s, jerk)
        measured = self._measured(prompts, seen.period_s, P, seen.cn0_hz or math.inf)
        x, after, surprise = filtered(P, measured)
        if surprise > _SURPRISE:
            x, after, _ = filtered(P + np.diag(np.square(_OPENED)), measured)
        correction = Correction(
            float(x[0]) - jerk * T**3 / 48.0,
            float(x[1]) - jerk * T**2 / 24.0,
            float(x[2]) + jerk * T / 6.0,
        )
        return Memory(jerk + float(x[3]), after, memory.updates + 1, measured.cn0_hz), correction

    def _measured(
        self, prompts: ComplexArray, interval_s: float, P: FloatArray, cn0_hz: float
    ) -> Measured:
        """Phase, frequency and, where that tells something, rate of prompts (n,) of known signs.

        cn0_hz: of the last second; the update's own is believed where it is lower.
        """
        frequency = rate = 0.0
        if _is_wide(P, prompts.size * interval_s):
            _, frequency, rate, _ = find_chirp(prompts, interval_s, _WIDEST_HZPS)
        for _ in range(_CLIMBS):
            frequency, _ = climbed(prompts, interval_s, frequency, rate)
        line = complex((prompts * turns(prompts.size, interval_s, frequency, rate)).sum())
        cn0_hz = max(min(cn0_hz, _strength_hz(prompts, interval_s, abs(line))), _LEAST_CN0_HZ)
        R = measurement_covariance(cn0_hz, prompts.size, interval_s, 3, self.oscillator)
        if _tells_rate(P, R):
            for _ in range(_CLIMBS):
                frequency, rate = climbed(prompts, interval_s, frequency, rate)
            line = complex((prompts * turns(prompts.size, interval_s, frequency, rate)).sum())
            return Measured(np.array([cmath.phase(line) / _TURN, frequency, rate]), R, cn0_hz)
        line = complex((prompts * turns(prompts.size, interval_s, frequency, 0.0)).sum())
        R = measurement_covariance(cn0_hz, prompts.size, interval_s, 2, self.oscillator)
        return Measured(np.array([cmath.phase(line) / _TURN, frequency]), R, cn0_hz)

    def foreseen(self, memory: Memory, seconds: float) -> Correction:
        """What the slope of the rate changes by the end of an update, with the next in mind.

        From the middle to the end jτ³/6, jτ²/2 and jτ, τ = T/2, and of the rate jT/3 more: so the
        generator, whose rate does not change in the next update, ends that one right (`bent`).
        """
        half, jerk = 0.5 * seconds, memory.jerk_hzps2
        return Correction(jerk * half**3 / 6.0, jerk * half**2 / 2.0, jerk * (half + seconds / 3.0))

    def turned(self, memory: Memory, cycles: float) -> Memory:
        """No correlations are kept."""
        return memory

    def bandwidth_hz(self, memory: Memory) -> float:
        """Of a loop with thermal noise, B/(C/N0)/(2π)², as the phase's variance."""
        if memory.updates == 0:
            return self.settled.bandwidth_hz
        return float(memory.P[0, 0]) * _TURN**2 * memory.cn0_hz


def _is_wide(P: FloatArray, seconds: float) -> bool:
    """Whether the likelihood's maximum may be too far to be climbed to."""
    return math.sqrt(float(P[1, 1])) * seconds > _WIDE


def _gain(squares: ComplexArray, line: complex) -> float:
    """Logarithm of the likelihood of a line in squares (n,) over that of the line foreseen."""
    count = squares.size
    power = abs(line) ** 2 / count
    noise = (float(np.vdot(squares, squares).real) - power) / (count - 1)
    return (power - abs(complex(squares.sum())) ** 2 / count) / noise if noise > 0.0 else math.inf


def _tells_rate(P: FloatArray, R: FloatArray) -> bool:
    return bool(P[2, 2] > _TOLD**2 * R[2, 2])


def _straightened(sums: ComplexArray, interval_s: float, jerk_hzps2: float) -> ComplexArray:
    """Sums (n,) of an update without what the slope of the rate is known to do in it."""
    t = interval_s * (np.arange(sums.size, dtype=np.float64) + 0.5)
    return np.asarray(sums * np.exp(-1j * _TURN * bent(jerk_hzps2, sums.size * interval_s, t)))


def _strength_hz(prompts: ComplexArray, interval_s: float, line: float) -> float:
    """C/N0 of prompts (n,) whose sum along the carrier is `line`."""
    count = prompts.size
    noise = (float(np.vdot(prompts, prompts).real) - line * line / count) / (count - 1)
    return (line * line / count - noise) / (count * noise * interval_s) if noise > 0.0 else math.inf
