"""Lock detectors: carrier-to-noise density, phase lock, and false frequency lock (T 5.4.2)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.trackers import Accumulated

USUAL_S = 1.0  # averaging of the reported C/N0
FAINT_S = 3.0  # the same in frequency tracking: 0.3 dB at 20 dB-Hz
_FAST_S = 0.1  # averaging that notices a blockage
_RECENT = 5  # intervals that notice the blockage of a strong signal
_FAINT = 30  # intervals that notice that a weak one went or came
_INTERVAL_S = 0.02
_PHASE_S = 0.4  # averaging of what tells phase lock from false lock


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
def _half_shifts(periods: int) -> ComplexArray:
    """Replicas (periods, 3) half a turn per symbol below, at and above zero."""
    turns = 0.5 * np.arange(-1, 2) * np.arange(periods)[:, np.newaxis] / periods
    return np.asarray(np.exp(-2j * np.pi * turns))


def shifted_powers(symbols: ComplexArray) -> FloatArray:
    """Powers (n, 3) of symbols (n, periods) as if the generator ran ½/symbol lower, as is, higher.

    Costas loops and squares of symbol sums do not notice ½/symbol, 25 Hz (T 5.4.2): a sum keeps
    0.4 of its power there. Shifted to the true frequency it gains the rest.
    """
    sums = symbols @ _half_shifts(symbols.shape[1])
    return np.asarray(sums.real**2 + sums.imag**2)


def update_powers(
    state: LockState, seen: Accumulated, slow_s: float = USUAL_S, symbol_periods: int = 0
) -> LockState:
    """Take one interval into the averages of signal and noise.

    symbol_periods: of the parts of the interval that may be summed; 0: all of it.

    Inside a symbol the signal's power is that of the coherent sum less its noise, the noise that
    of the scatter about the mean; the ratio of narrow- to wide-band power, T(5.9–5.15), written
    so that it stays exact at high C/N0. Across symbol edges the products of neighbours serve.
    """
    prompts = seen.periods[:, 1]
    count = prompts.size
    if count < 2:
        return state
    wide = float(np.vdot(prompts, prompts).real)
    if seen.coherent:
        size = symbol_periods or count
        sums = prompts.reshape(-1, size).sum(axis=1) if size < count else np.array([seen.prompt])
        narrow = float(np.vdot(sums, sums).real) / size
        noise = (wide - narrow) / (count - sums.size)
        signal = (narrow / sums.size - noise) / size
    else:
        neighbours = prompts[:-1].conj() * prompts[1:]
        signal = _blind_power(neighbours) if seen.blind else float(neighbours.real.mean())
        noise = max(wide / count - max(signal, 0.0), 0.0)
    seconds = state.seconds + seen.seconds
    slow = seen.seconds / min(seconds, slow_s)
    fast = seen.seconds / min(seconds, _FAST_S)
    return state._replace(
        seconds=seconds,
        signal=state.signal + slow * (signal - state.signal),
        fast_signal=state.fast_signal + fast * (signal - state.fast_signal),
        recent=(*state.recent, signal)[-_FAINT:],
        noise=state.noise + slow * (noise - state.noise),
    )


def update_locks(state: LockState, seen: Accumulated, symbol_periods: int = 0) -> LockState:
    """Take one interval, of one symbol or of several so long, into all averages."""
    prompts = seen.periods[:, 1]
    count = prompts.size
    if count < 2:
        return state
    state = update_powers(state, seen)
    if not (seen.coherent and seen.prompt):
        return state
    phase_seconds = state.phase_seconds + seen.seconds
    gain = seen.seconds / min(phase_seconds, _PHASE_S)
    double = (seen.prompt * seen.prompt).real / abs(seen.prompt) ** 2
    shifted, size = state.shifted, symbol_periods or count
    if count % size == 0:  # before the first edge a part of a symbol
        powers = shifted_powers(prompts.reshape(-1, size)).mean(axis=0)
        down, same, up = ((1.0 - gain) * np.array(shifted) + gain * powers).tolist()
        shifted = (down, same, up)
    return state._replace(
        phase=state.phase + gain * (double - state.phase),
        phase_seconds=phase_seconds,
        shifted=shifted,
    )


def _blind_power(products: ComplexArray) -> float:
    """Signal power from products of neighbours of unknown signs: E z² = A⁴, noise has no mean."""
    return math.sqrt(max(float((products * products).sum().real) / products.size, 0.0))


def _cn0_dbhz(signal: float, noise: float, period_s: float) -> float:
    if signal <= 0.0 or noise <= 0.0:
        return 0.0
    return max(0.0, 10.0 * math.log10(signal / (noise * period_s)))


def cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 averaged over the slow time; 0 where no signal is seen."""
    return _cn0_dbhz(state.signal, state.noise, period_s)


def fast_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the fast time against the noise of the slow one."""
    return _cn0_dbhz(state.fast_signal, state.noise, period_s)


def recent_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the last five intervals alone.

    It falls within 0.1 s where a forgetting average of a strong signal needs half a second, and
    scatters more: for signals far above the limit only.
    """
    if not state.recent:
        return 0.0
    recent = state.recent[-_RECENT:]
    return _cn0_dbhz(sum(recent) / len(recent), state.noise, period_s)


def faint_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the last 0.6 s or so alone: 0.9 dB at 20 dB-Hz, and next to nothing for nothing."""
    return _cn0_dbhz(sum(state.recent) / _FAINT, state.noise, period_s)


def surely_seen_dbhz(symbol_periods: int, period_s: float) -> float:
    """What `faint_cn0_dbhz` of noise alone does not reach: six times its spread."""
    symbols = _FAINT * _INTERVAL_S / (symbol_periods * period_s)
    return 10.0 * math.log10(6.0 / (symbol_periods * math.sqrt(symbols) * period_s))


def false_lock_side(state: LockState) -> int:
    """−1 or +1 when symbols are stronger ½/symbol lower or higher, else 0.

    A loop locked that far off loses 0.6 of the power; half of that must be seen.
    """
    down, same, up = state.shifted
    side = 1 if up > down else -1
    return side if max(down, up) > 1.5 * same else 0
