"""Carrier and code trackers: interchangeable, correlations in, correction out.

A tracker holds parameters only. What a loop remembers (phase, frequency, rate) is the generator's
own state, `NcoState`; a correction refers to the middle of the interval it was measured on.
Aiding never passes through here: it is added to the command (see `channel`). Loops of the phase,
which may remember more, are in `phase_loops`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from deepgnss.core.jit import brief_kernel, compilable
from deepgnss.core.loops import LoopGains, loop_gains, settling_time_s
from deepgnss.core.records import ComplexArray
from deepgnss.receiver.discriminators import (
    early_late_slope,
    early_minus_late_envelope,
    frequency_arctan,
    frequency_squared,
)

_NARROWING = 0.25  # log of the ratio of bandwidths from step to step


class Accumulated(NamedTuple):
    """What one interval gave: correlations of its code periods, and their sums over it."""

    periods: ComplexArray  # (n, taps): early, prompt, late, extras
    early: complex
    prompt: complex
    late: complex
    seconds: float
    period_s: float
    coherent: bool  # the sums may be used: no symbol edge lies inside
    blind: bool = False  # every code period may have another sign
    noise: float = 0.0  # power of noise in each of the periods, as far as it is to be taken off
    cn0_hz: float = 0.0  # carrier to noise density of the last second; 0: not known


def accumulate(
    periods: ComplexArray,
    period_s: float,
    coherent: bool,
    blind: bool = False,
    cn0_hz: float = 0.0,
) -> Accumulated:
    """Sums over the code periods (n, taps) of an interval."""
    early, prompt, late = totals(periods)
    seconds = periods.shape[0] * period_s
    return Accumulated(
        periods, early, prompt, late, seconds, period_s, coherent, blind, cn0_hz=cn0_hz
    )


def straightened(seen: Accumulated, left: Correction) -> Accumulated:
    """An interval with the carrier turned by what its generator lacked in the middle."""
    count = seen.periods.shape[0]
    t = seen.period_s * (np.arange(count) - 0.5 * (count - 1))
    cycles = left.phase + t * (left.frequency + 0.5 * t * left.rate)
    turns = np.exp(-2j * np.pi * cycles)[:, np.newaxis]
    return accumulate(seen.periods * turns, seen.period_s, seen.coherent, seen.blind, seen.cn0_hz)


def pieces(seen: Accumulated, periods: int) -> Iterator[Accumulated]:
    """An interval cut into shorter ones, whole ones only."""
    for first in range(0, seen.periods.shape[0] - periods + 1, periods):
        taps = seen.periods[first : first + periods]
        yield accumulate(taps, seen.period_s, seen.coherent, seen.blind, seen.cn0_hz)


@brief_kernel
def totals(periods: ComplexArray) -> tuple[complex, complex, complex]:
    """Sums of early, prompt and late over code periods (n, taps)."""
    early = prompt = late = 0.0j
    for k in range(periods.shape[0]):
        early += periods[k, 0]
        prompt += periods[k, 1]
        late += periods[k, 2]
    return early, prompt, late


class Correction(NamedTuple):
    """Change of a generator's state at the middle of the interval (cycles or chips and per s)."""

    phase: float
    frequency: float
    rate: float


NO_CORRECTION = Correction(0.0, 0.0, 0.0)


class NcoState(NamedTuple):
    """Phase, frequency and rate of a generator (cycles or chips, s)."""

    phase: float
    frequency: float
    rate: float


@compilable
def advance(state: NcoState, seconds: float) -> NcoState:
    """State `seconds` later."""
    return NcoState(
        state.phase + seconds * (state.frequency + 0.5 * seconds * state.rate),
        state.frequency + seconds * state.rate,
        state.rate,
    )


@compilable
def corrected(state: NcoState, correction: Correction, since_middle_s: float) -> NcoState:
    """State with a correction that was due `since_middle_s` ago."""
    frequency, rate = correction.frequency, correction.rate
    return NcoState(
        state.phase
        + (correction.phase + since_middle_s * (frequency + 0.5 * since_middle_s * rate)),
        state.frequency + (frequency + since_middle_s * rate),
        state.rate + rate,
    )


@compilable
def smoothed_hz(error_hz: float, correction_hz: float, updates: float) -> float:
    """Mean frequency error of a loop with what an interval of so many updates has corrected."""
    share: float = 1.0 - 0.7 ** max(1.0, updates)
    return error_hz + share * (correction_hz - error_hz)


def scheduled_bandwidth_hz(schedule: tuple[float, ...], seconds: float) -> float:
    """Bandwidth of a code loop some time after it was closed.

    Each bandwidth serves until its step response first crosses zero, T(5.22). The step to the
    last one is taken in small ones, as 1/t, like the running mean it stands for: switched at
    once, the noise of the wider loop would stay for the many seconds the last one needs.
    """
    *wide, last = schedule
    for bandwidth in wide:
        settling_s = settling_time_s(bandwidth)
        if seconds < settling_s:
            return bandwidth
        seconds -= settling_s
    if not wide:
        return last
    steps = int(math.log1p(seconds / settling_time_s(wide[-1])) / _NARROWING)
    return max(last, wide[-1] * math.exp(-steps * _NARROWING))


class Tracker(Protocol):
    """A strategy of carrier or code tracking that remembers nothing (see `phase_loops`)."""

    def correct(self, seen: Accumulated) -> Correction:
        """Correction of the generator from one interval's correlations."""
        ...


@dataclass(frozen=True, slots=True)
class FrequencyLock:
    """FLL on products of neighbouring sums of a few code periods: needs no bit edges.

    A first-order loop in frequency (the estimate is the mean over the interval). One symbol edge
    spoils one of the products, which a four-quadrant angle of their total bears; where every
    period's sign may flip (secondary codes) products are squared. Longer sums bear more noise and
    less range, ± half their rate.
    """

    bandwidth_hz: float
    sum_periods: int = 1
    squared: bool = False

    def correct(self, seen: Accumulated) -> Correction:
        """Frequency from products of neighbouring prompts."""
        prompts, interval_s = seen.periods[:, 1], seen.period_s
        if self.squared:
            error_hz = frequency_squared(prompts, interval_s)
        else:
            size = max(1, min(self.sum_periods, prompts.size // 2))
            sums = prompts[: prompts.size // size * size].reshape(-1, size).sum(axis=1)
            error_hz = frequency_arctan(complex(np.vdot(sums[:-1], sums[1:])), size * interval_s)
        gain = loop_gains(1, self.bandwidth_hz, seen.seconds).phase
        return Correction(0.0, gain * error_hz, 0.0)


@dataclass(frozen=True, slots=True)
class DelayLock:
    """Carrier-aided DLL of order 1 or 2, normalized early minus late."""

    order: int
    bandwidth_hz: float
    spacing_chips: float
    sample_chips: float
    neighbour: float = 0.0  # the code's correlation a chip off
    discriminator: Callable[[float, float, float], float] = early_minus_late_envelope

    @property
    def slope(self) -> float:
        """Of the discriminator on this code, 1/chip."""
        return early_late_slope(self.spacing_chips, self.sample_chips, self.neighbour)

    def gains(self, seconds: float) -> LoopGains:
        """Of an update so long."""
        return loop_gains(self.order, self.bandwidth_hz, seconds)

    def correct(self, seen: Accumulated) -> Correction:
        """Delay (and its rate) from envelopes, coherent where no symbol edge lies inside."""
        if seen.coherent:
            early, late = abs(seen.early), abs(seen.late)
        else:
            power = (seen.periods.real**2 + seen.periods.imag**2).sum(axis=0)
            # Noise in the normalization would take from the loop's gain, so from its bandwidth.
            signal = np.maximum(power - seen.periods.shape[0] * seen.noise, 0.2 * power)
            early, late = float(signal[0]) ** 0.5, float(signal[2]) ** 0.5
        error = self.discriminator(early, late, self.slope)
        gains = self.gains(seen.seconds)
        return Correction(gains.phase * error, gains.frequency * error, 0.0)
