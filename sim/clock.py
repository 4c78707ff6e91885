"""The receiver's clock: offset, drift, and an oscillator of given power law that feels force.

The noise is made second by second, each from a random stream of its own and from the state the
second before it left: a few numbers per second are kept, so that hours cost no memory, and a
second is the same whichever was asked for before.

White frequency noise makes the phase a Wiener process of density h0/2, the random walk of
frequency makes the frequency one of density 2π²·h₋₂. Flicker noise is a sum of first-order
Gauss–Markov processes whose time constants rise by a constant factor: those of variance
h₋₁·ln(factor) add up to h₋₁/f between the reciprocals of the shortest and the longest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import Final, NamedTuple

import numpy as np
import scipy.constants
import scipy.signal

from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.sim.imu.increments import sensed
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.scenario import ReceiverClock
from deepgnss.sim.seeds import random_stream

NODES_PER_SECOND: Final = 1000
_MARGIN_S: Final = 2  # seconds of noise before sample 0
_STEP_S: Final = 1.0 / NODES_PER_SECOND
_FLICKER_FACTOR: Final = math.sqrt(10.0)
_FLICKER_S: Final = 1.0e-5 * _FLICKER_FACTOR ** np.arange(23)  # time constants, to 1e6 s

ClockError = Callable[[int], FloatArray]
"""Second number (−2 or later) → clock error, s, at its thousand nodes."""


class _State(NamedTuple):
    """Where a second begins: phase, random-walk frequency, frequencies that make flicker noise."""

    phase_s: float
    walk: float
    flicker: FloatArray


def clock_error(clock: ReceiverClock, seed: int, vehicle: Vehicle | None = None) -> ClockError:
    """Clock reading − GPST at nodes 1 ms apart on the clock's own count, second by second.

    The noise is zero at sample 0. Without a vehicle the oscillator feels no force.
    """
    noise = None if clock.oscillator is None else _noise(clock, clock.oscillator, seed, vehicle)

    def second(number: int) -> FloatArray:
        t_s = number + np.arange(NODES_PER_SECOND) * _STEP_S
        error_s = np.asarray(clock.offset_s + clock.drift_sps * t_s, dtype=np.float64)
        return error_s if noise is None else error_s + noise(number)

    return second


def _noise(
    clock: ReceiverClock, oscillator: Oscillator, seed: int, vehicle: Vehicle | None
) -> ClockError:
    """The oscillator's part; it may be asked from several threads."""
    random = random_stream(seed, "clock, initial flicker")
    start_flicker = random.standard_normal(_FLICKER_S.size) * _flicker_sigma(oscillator)
    starts = [_State(0.0, 0.0, start_flicker)]  # of each second from −2 on
    lock = Lock()

    @lru_cache(maxsize=8)
    def steps(number: int) -> FloatArray:
        """Phase at the nodes of a second and at its end; earlier seconds are known."""
        state = starts[number + _MARGIN_S]
        random = random_stream(seed, "clock", number + _MARGIN_S)
        phase_s, after = _second(oscillator, state, random)
        if vehicle is not None and oscillator.g_sensitivity:
            t_s = np.asarray(number - clock.offset_s + np.arange(NODES_PER_SECOND + 1) * _STEP_S)
            pull = oscillator.g_sensitivity * force_g(vehicle, clock, t_s)
            phase_s[1:] += np.cumsum(0.5 * (pull[:-1] + pull[1:])) * _STEP_S
        if number + _MARGIN_S + 1 == len(starts):
            starts.append(after._replace(phase_s=float(phase_s[-1])))
        return phase_s

    def phase(number: int) -> FloatArray:
        with lock:
            while len(starts) <= number + _MARGIN_S:
                steps(len(starts) - 1 - _MARGIN_S)
            return steps(number)[:-1]

    origin_s = float(phase(0)[0])
    return lambda number: phase(number) - origin_s


def _flicker_sigma(oscillator: Oscillator) -> float:
    """Standard deviation of each of the processes that make flicker noise."""
    return math.sqrt(oscillator.h_1 * math.log(_FLICKER_FACTOR))


def _second(
    oscillator: Oscillator, state: _State, random: np.random.Generator
) -> tuple[FloatArray, _State]:
    """Phase at nodes 0 … 1000 of a second that starts in `state`, and the state it leaves."""
    n, dt = NODES_PER_SECOND, _STEP_S
    rise = random.standard_normal(n) * math.sqrt(oscillator.h0_s * dt / 2.0)
    # Random walk: step of the frequency w, and what it adds to the phase within the step, of
    # variance q·dt³/3 and covariance q·dt²/2 with w.
    sigma = math.sqrt(2.0 * math.pi**2 * oscillator.h_2_hz * dt)
    w = random.standard_normal(n) * sigma
    walk = state.walk + np.concatenate([[0.0], np.cumsum(w)])
    rise += (walk[:-1] + 0.5 * w) * dt + random.standard_normal(n) * (sigma * dt / math.sqrt(12.0))
    flicker = state.flicker
    if oscillator.h_1 > 0.0:
        more, flicker = _flicker(_flicker_sigma(oscillator), flicker, random)
        rise += more
    phase_s = state.phase_s + np.concatenate([[0.0], np.cumsum(rise)])
    return phase_s, _State(float(phase_s[-1]), float(walk[-1]), flicker)


def _flicker(
    sigma: float, start: FloatArray, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Phase steps of all Gauss–Markov processes together, and the frequency each ends with.

    Exact for y' = −y/τ + white: y after dt is a·y + u with a = e^(−dt/τ), the phase rises by
    τ(1 − a)·y + v; (u, v) normal with the covariance of the two integrals.
    """
    n, dt = NODES_PER_SECOND, _STEP_S
    rise, ends = np.zeros(n), np.empty_like(start)
    for k, tau in enumerate(_FLICKER_S):
        x = dt / tau
        a, one_less_a = math.exp(-x), -math.expm1(-x)
        uu = -math.expm1(-2.0 * x)
        uv = tau * one_less_a**2
        # below x of 1e-2 the closed form loses its digits: 2x³/3 − x⁴/2 is its series
        vv = 2.0 * x - 3.0 + 4.0 * a - a * a if x > 1.0e-2 else x**3 * (2.0 / 3.0 - x / 2.0)
        u, v = random.standard_normal((2, n)) * sigma
        v = v * math.sqrt(max(tau**2 * vv - uv**2 / uu, 0.0)) + u * (uv / math.sqrt(uu))
        u *= math.sqrt(uu)
        y, _ = scipy.signal.lfilter([1.0], [1.0, -a], u, zi=[a * start[k]])
        before = np.concatenate([start[k : k + 1], y[:-1]])
        rise += tau * one_less_a * before + v
        ends[k] = y[-1]
    return rise, ends


def force_g(vehicle: Vehicle, clock: ReceiverClock, t_s: FloatArray) -> FloatArray:
    """Specific force along the oscillator's axis less that at rest and level, g, at times (n,)."""
    _, f_ib_b_mps2 = sensed(vehicle.pose(t_s))
    axis = np.asarray(clock.axis_b)
    return np.asarray(f_ib_b_mps2 @ axis / scipy.constants.g + axis[2])
