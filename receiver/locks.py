"""Lock detectors: carrier-to-noise density, phase lock, and false frequency lock (T 5.4.2)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepgnss.core.jit import brief_kernel, compilable
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.trackers import Accumulated

USUAL_S = 1.0  # averaging of the reported C/N0
FAINT_S = 3.0  # the same in frequency tracking: 0.3 dB at 20 dB-Hz
FAST_S = 0.1  # averaging that notices a blockage
RECENT = 5  # intervals that notice the blockage of a strong signal
RECENT_KEPT = 30  # intervals that notice that a weak one went or came
_INTERVAL_S = 0.02
_PLAIN_HZ = 10.0**3.2  # C/N0 of a signal whose absence is seen in a single interval …
_DARK = 0.25  # … by its power
PHASE_S = 0.4  # averaging of what tells phase lock from false lock


class LockState(NamedTuple):
    """Averages over past intervals; powers are those of one code period's correlation."""

    seconds: float
    signal: float
    fast_signal: float
    recent: tuple[float, ...]  # signal of the last intervals
    noise: float
    phase: float  # mean cos 2φ of a phase loop
    phase_seconds: float  # since its start
    shifted: tuple[float, float, float]  # mean power of symbols shifted down, as they are, up


NO_LOCK = LockState(0.0, 0.0, 0.0, (), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0))


def restart_phase(state: LockState) -> LockState:
    """Forget what was seen of an earlier phase lock.

    The next symbol outweighs powers averaged before: across symbol edges those are too low.
    """
    return state._replace(seconds=0.0, phase=0.0, phase_seconds=0.0, shifted=NO_LOCK.shifted)


@lru_cache(maxsize=8)
def half_shifts(periods: int) -> ComplexArray:
    """Replicas (periods, 3) half a turn per symbol below, at and above zero."""
    turns = 0.5 * np.arange(-1, 2) * np.arange(periods)[:, np.newaxis] / periods
    return np.asarray(np.exp(-2j * np.pi * turns))


def shifted_powers(symbols: ComplexArray) -> FloatArray:
    """Powers (n, 3) of symbols (n, periods) as if the generator ran ½/symbol lower, as is, higher.

    Costas loops and squares of symbol sums do not notice ½/symbol, 25 Hz (T 5.4.2): a sum keeps
    0.4 of its power there. Shifted to the true frequency it gains the rest.
    """
    sums = symbols @ half_shifts(symbols.shape[1])
    return np.asarray(sums.real**2 + sums.imag**2)


@brief_kernel
def interval_powers(taps: ComplexArray, size: int) -> tuple[float, float]:
    """Σ|p|² of prompts (n, taps ≥ 2), and Σ|s|²/size of their sums s over `size` each."""
    wide = narrow = 0.0
    for first in range(0, taps.shape[0] - size + 1, size):
        total = 0.0j
        for k in range(first, first + size):
            p = taps[k, 1]
            wide += p.real * p.real + p.imag * p.imag
            total += p
        narrow += total.real * total.real + total.imag * total.imag
    return wide, narrow / size


@brief_kernel
def neighbour_powers(taps: ComplexArray) -> tuple[float, float, float]:
    """Σ|p|² of prompts (n, taps ≥ 2), Σ Re z and Σ Re z² of products z of neighbours."""
    before = taps[0, 1]
    wide = before.real * before.real + before.imag * before.imag
    once = twice = 0.0
    for k in range(1, taps.shape[0]):
        p = taps[k, 1]
        z = before.conjugate() * p
        wide += p.real * p.real + p.imag * p.imag
        once += z.real
        twice += z.real * z.real - z.imag * z.imag
        before = p
    return wide, once, twice


@brief_kernel
def mean_shifted_powers(taps: ComplexArray, shifts: ComplexArray) -> tuple[float, float, float]:
    """Means of `shifted_powers` over the symbols of prompts (n, taps ≥ 2); shifts (size, 3)."""
    size = shifts.shape[0]
    down = same = up = 0.0
    for first in range(0, taps.shape[0] - size + 1, size):
        lower = straight = upper = 0.0j
        for k in range(size):
            p = taps[first + k, 1]
            lower += p * shifts[k, 0]
            straight += p * shifts[k, 1]
            upper += p * shifts[k, 2]
        down += lower.real * lower.real + lower.imag * lower.imag
        same += straight.real * straight.real + straight.imag * straight.imag
        up += upper.real * upper.real + upper.imag * upper.imag
    symbols = taps.shape[0] // size
    return down / symbols, same / symbols, up / symbols


def update_powers(
    state: LockState,
    seen: Accumulated,
    slow_s: float = USUAL_S,
    symbol_periods: int = 0,
    fast_s: float = FAST_S,
) -> LockState:
    """Take one interval into the averages of signal and noise, slow and fast ones.

    symbol_periods: of the parts of the interval that may be summed; 0: all of it.

    Inside a symbol the signal's power is that of the coherent sum less its noise, the noise that
    of the scatter about the mean; the ratio of narrow- to wide-band power, T(5.9–5.15), written
    so that it stays exact at high C/N0. Across symbol edges the products of neighbours serve.
    """
    if seen.periods.shape[0] < 2:
        return state
    phase = state.phase, state.phase_seconds, state.shifted
    return LockState(*_averages(state, seen, slow_s, fast_s, symbol_periods), *phase)


def _averages(
    state: LockState, seen: Accumulated, slow_s: float, fast_s: float, symbol_periods: int
) -> tuple[float, float, float, tuple[float, ...], float]:
    """The first five of a new `LockState`."""
    signal, noise = _powers(seen, symbol_periods)
    means = state.seconds, state.signal, state.fast_signal, state.noise
    seconds, slow, fast, scatter = averaged(means, signal, noise, seen.seconds, slow_s, fast_s)
    return seconds, slow, fast, (*state.recent, signal)[-RECENT_KEPT:], scatter


@compilable
def averaged(
    means: tuple[float, float, float, float],
    signal: float,
    noise: float,
    interval_s: float,
    slow_s: float,
    fast_s: float,
) -> tuple[float, float, float, float]:
    """Averages with an interval's powers: seconds, signal, fast signal, noise of `LockState`."""
    before_s, slow_signal, fast_signal, slow_noise = means
    seconds = before_s + interval_s
    slow = interval_s / min(seconds, slow_s)
    fast = interval_s / min(seconds, fast_s)
    return (
        seconds,
        slow_signal + slow * (signal - slow_signal),
        fast_signal + fast * (signal - fast_signal),
        slow_noise + slow * (noise - slow_noise),
    )


def _powers(seen: Accumulated, symbol_periods: int) -> tuple[float, float]:
    """Power of signal and noise in a code period of an interval."""
    count = seen.periods.shape[0]
    if seen.coherent:
        return coherent_powers(seen.periods, min(symbol_periods or count, count))
    wide, once, twice = neighbour_powers(seen.periods)
    # Of unknown signs: E z² = A⁴, noise has no mean.
    signal = math.sqrt(max(twice / (count - 1), 0.0)) if seen.blind else once / (count - 1)
    return signal, max(wide / count - max(signal, 0.0), 0.0)


@compilable
def coherent_powers(periods: ComplexArray, size: int) -> tuple[float, float]:
    """Power of signal and noise in a code period, of sums over `size` each, (n, taps ≥ 2)."""
    count = periods.shape[0]
    wide, narrow = interval_powers(periods, size)
    sums = count // size
    noise = (wide - narrow) / (count - sums)
    return (narrow / sums - noise) / size, noise


@compilable
def phase_averaged(
    phase: float, phase_seconds: float, prompt: complex, interval_s: float, phase_s: float
) -> tuple[float, float, float]:
    """Mean cos 2φ with an interval's sum, the seconds it is of, and the interval's share."""
    seconds = phase_seconds + interval_s
    share = interval_s / min(seconds, phase_s)
    i2, q2 = prompt.real * prompt.real, prompt.imag * prompt.imag  # exact alike, compiled or not
    double = (i2 - q2) / (i2 + q2)
    return phase + share * (double - phase), seconds, share


@compilable
def shifted_averaged(
    shifted: tuple[float, float, float], now: tuple[float, float, float], share: float
) -> tuple[float, float, float]:
    """Mean powers of symbols shifted down, as they are, up, with an interval's."""
    keep = 1.0 - share
    return (
        keep * shifted[0] + share * now[0],
        keep * shifted[1] + share * now[1],
        keep * shifted[2] + share * now[2],
    )


def update_locks(
    state: LockState,
    seen: Accumulated,
    symbol_periods: int = 0,
    phase_s: float = PHASE_S,
    fast_s: float = FAST_S,
) -> LockState:
    """Take one interval, of one symbol or of several so long, into all averages.

    phase_s: averaging of the phase's indicator; fast_s: that of what notices a blockage.
    """
    count = seen.periods.shape[0]
    if count < 2:
        return state
    if not (seen.coherent and seen.prompt):
        return update_powers(state, seen, fast_s=fast_s)
    phase, phase_seconds, share = phase_averaged(
        state.phase, state.phase_seconds, seen.prompt, seen.seconds, phase_s
    )
    shifted, size = state.shifted, symbol_periods or count
    if count % size == 0:  # before the first edge a part of a symbol
        now = mean_shifted_powers(seen.periods, half_shifts(size))
        shifted = shifted_averaged(shifted, now, share)
    means = _averages(state, seen, USUAL_S, fast_s, 0)
    return LockState(*means, phase, phase_seconds, shifted)


@compilable
def strength_dbhz(signal: float, noise: float, period_s: float) -> float:
    """C/N0 of a signal's power per code period against that of noise; 0 where there is none."""
    if signal <= 0.0 or noise <= 0.0:
        return 0.0
    return max(0.0, 10.0 * math.log10(signal / (noise * period_s)))


def cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 averaged over the slow time; 0 where no signal is seen."""
    return strength_dbhz(state.signal, state.noise, period_s)


def fast_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the fast time against the noise of the slow one."""
    return strength_dbhz(state.fast_signal, state.noise, period_s)


def recent_cn0_dbhz(state: LockState, period_s: float, intervals: int = RECENT) -> float:
    """C/N0 of the last five intervals (or so many) alone.

    It falls within 0.1 s where a forgetting average of a strong signal needs half a second, and
    scatters more: for signals far above the limit only.
    """
    if not state.recent:
        return 0.0
    recent = state.recent[-intervals:]
    return strength_dbhz(sum(recent) / len(recent), state.noise, period_s)


def dark(state: LockState, period_s: float) -> bool:
    """Whether the last interval has next to nothing of a strong signal.

    At the least strength four sigma of the interval's noise lie between half the amplitude and
    all of it. A stronger signal may fall to that strength, and its phase is still one.
    """
    last = state.recent[-1] if state.recent else 0.0
    return next_to_nothing(last, state.signal, state.noise, period_s)


@compilable
def next_to_nothing(last: float, signal: float, noise: float, period_s: float) -> bool:
    """The same by the interval's power and the means of signal and noise."""
    plain = _PLAIN_HZ * noise * period_s
    return signal > plain and last < _DARK * plain


def faint_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the last 0.6 s or so alone: 0.9 dB at 20 dB-Hz, and next to nothing for nothing."""
    return strength_dbhz(sum(state.recent) / RECENT_KEPT, state.noise, period_s)


def faint_before_dbhz(state: LockState, period_s: float, intervals: int) -> float:
    """The same without the last intervals: whether a signal was there before they came."""
    before = state.recent[:-intervals]
    return strength_dbhz(sum(before) / max(1, RECENT_KEPT - intervals), state.noise, period_s)


def surely_seen_dbhz(symbol_periods: int, period_s: float) -> float:
    """What `faint_cn0_dbhz` of noise alone does not reach: six times its spread."""
    symbols = RECENT_KEPT * _INTERVAL_S / (symbol_periods * period_s)
    return 10.0 * math.log10(6.0 / (symbol_periods * math.sqrt(symbols) * period_s))


def false_lock_side(state: LockState) -> int:
    """−1 or +1 when symbols are stronger ½/symbol lower or higher, else 0."""
    return stronger_side(state.shifted)


@compilable
def stronger_side(shifted: tuple[float, float, float]) -> int:
    """The same by the mean powers shifted down, as they are, up.

    A loop locked that far off loses 0.6 of the power; half of that must be seen.
    """
    down, same, up = shifted
    side = 1 if up > down else -1
    return side if max(down, up) > 1.5 * same else 0
