"""Carrier-smoothed pseudoranges (Hatch 1983; T 2.2.6, 6.4.1).

Without phase lock the generator's carrier still runs with the signal's frequency: noise of that
frequency lets it walk away, but slowly against the noise of a weak signal's code. A loop on
windows T long whose frequencies err by σ_f walks by q = λ²σ_f²T, m²/s; code of density
S = σ²/2B, m²/Hz, averaged over τ leaves S/2τ of noise and lets the carrier's qτ/2 in. They balance
at τ = √(S/q), where C/N0 cancels but for squaring losses: 870 windows where symbols are known,
more where they are squared, so 280 s and more of windows of 0.32 s. The ionosphere
asks for less. Forgetting does what T's regular resets do; it starts anew with every possible slip.
"""

from __future__ import annotations

from typing import NamedTuple

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import SIGNAL_IDS, Observation
from deepgnss.core.time import GpsTime

_LONGEST_S = 100.0  # of averaging: code and phase drift apart with the ionosphere …
# … and sooner where only the frequency is tracked and nothing says how the antenna moves: each
# change of acceleration then shifts the carrier by several squares of the window times as much.
_UNAIDED_S = 20.0


class HatchState(NamedTuple):
    """Running mean of code minus carrier of one satellite."""

    time: GpsTime | None = None
    offset_m: float = 0.0
    seconds: float = 0.0  # averaged over
    arc: int = -1
    phase: bool = False  # in phase lock


def smooth(
    state: HatchState, observation: Observation, time: GpsTime, *, aided: bool
) -> tuple[HatchState, Observation]:
    """Observation with a smoothed pseudorange; starts anew at every possible cycle slip.

    aided: whether predictions lead the carrier's generator.
    """
    phase, arc = observation.carrier_valid, observation.arc
    wavelength_m = SPEED_OF_LIGHT_MPS / SIGNAL_IDS[observation.signal].carrier_hz
    phase_m = observation.carrier_cycles * wavelength_m
    offset_m = observation.pseudorange_m - phase_m
    if state.time is None or (state.arc, state.phase) != (arc, phase):
        return HatchState(time, offset_m, 0.0, arc, phase), observation
    elapsed_s = time.since(state.time)
    longest_s = _LONGEST_S if phase or aided else _UNAIDED_S
    seconds = min(state.seconds + elapsed_s, longest_s)
    weight = elapsed_s / (seconds + elapsed_s) if seconds > 0.0 else 1.0
    mean_m = state.offset_m + weight * (offset_m - state.offset_m)
    smoothed = observation._replace(pseudorange_m=phase_m + mean_m)
    return HatchState(time, mean_m, seconds, arc, phase), smoothed
