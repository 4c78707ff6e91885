"""Lock detectors: carrier-to-noise density, phase lock, and false frequency lock (T 5.4.2)."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray
from deepgnss.receiver.trackers import Accumulated

_SLOW_S = 1.0  # averaging of the reported C/N0
_FAST_S = 0.1  # averaging that notices a blockage
_RECENT = 5  # intervals that notice the blockage of a strong signal
_PHASE_S = 0.4  # averaging of the phase-lock indicator


class LockState(NamedTuple):
    """Averages over past intervals; powers are those of one code period's correlation."""

    seconds: float
    signal: float
    fast_signal: float
    recent: tuple[float, ...]  # signal of the last intervals
    noise: float
    phase: float  # mean cos 2φ of a phase loop
    phase_seconds: float  # since its start
    products: complex  # mean product of neighbouring prompts within symbols


NO_LOCK = LockState(0.0, 0.0, 0.0, (), 0.0, 0.0, 0.0, 0j)


def restart_phase(state: LockState) -> LockState:
    """Forget what was seen of an earlier phase lock.

    The next symbol outweighs powers averaged before: across symbol edges those are too low.
    """
    return state._replace(seconds=0.0, phase=0.0, phase_seconds=0.0, products=0j)


def update_locks(state: LockState, seen: Accumulated) -> LockState:
    """Take one interval into the averages.

    Inside a symbol the signal's power is that of the coherent sum less its noise, the noise that
    of the scatter about the mean; the ratio of narrow- to wide-band power, T(5.9–5.15), written
    so that it stays exact at high C/N0. Across symbol edges the products of neighbours serve.
    """
    prompts = seen.periods[:, 1]
    count = prompts.size
    if count < 2:
        return state
    wide = float(np.vdot(prompts, prompts).real)
    neighbours = prompts[:-1].conj() * prompts[1:]
    products = complex(neighbours.sum()) / (count - 1)
    if seen.coherent:
        narrow = abs(seen.prompt) ** 2 / count
        noise = (wide - narrow) / (count - 1)
        signal = (narrow - noise) / count
    else:
        signal = _blind_power(neighbours) if seen.blind else products.real
        noise = max(wide / count - max(signal, 0.0), 0.0)
    seconds = state.seconds + seen.seconds
    slow = seen.seconds / min(seconds, _SLOW_S)
    fast = seen.seconds / min(seconds, _FAST_S)
    phase, phase_seconds, rotation = state.phase, state.phase_seconds, state.products
    if seen.coherent and seen.prompt:
        phase_seconds += seen.seconds
        gain = seen.seconds / min(phase_seconds, _PHASE_S)
        phase += gain * ((seen.prompt * seen.prompt).real / abs(seen.prompt) ** 2 - phase)
        rotation += slow * (products - rotation)
    return LockState(
        seconds,
        state.signal + slow * (signal - state.signal),
        state.fast_signal + fast * (signal - state.fast_signal),
        (*state.recent, signal)[-_RECENT:],
        state.noise + slow * (noise - state.noise),
        phase,
        phase_seconds,
        rotation,
    )


def _blind_power(products: ComplexArray) -> float:
    """Signal power from products of neighbours of unknown signs: E z² = A⁴, noise has no mean."""
    return math.sqrt(max(float((products * products).sum().real) / products.size, 0.0))


def _cn0_dbhz(signal: float, noise: float, period_s: float) -> float:
    if signal <= 0.0 or noise <= 0.0:
        return 0.0
    return max(0.0, 10.0 * math.log10(signal / (noise * period_s)))


def cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 averaged over about a second; 0 where no signal is seen."""
    return _cn0_dbhz(state.signal, state.noise, period_s)


def fast_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the last tenth of a second against the noise of the last second."""
    return _cn0_dbhz(state.fast_signal, state.noise, period_s)


def recent_cn0_dbhz(state: LockState, period_s: float) -> float:
    """C/N0 of the last five intervals alone.

    It falls within 0.1 s where a forgetting average of a strong signal needs half a second, and
    scatters more: for signals far above the limit only.
    """
    if not state.recent:
        return 0.0
    return _cn0_dbhz(sum(state.recent) / len(state.recent), state.noise, period_s)


def residual_frequency_hz(state: LockState, period_s: float) -> float:
    """Mean rotation of the prompt within symbols: a loop locked 25 Hz off shows here."""
    return cmath.phase(state.products) / (2.0 * math.pi * period_s) if state.products else 0.0
