"""Carrier-smoothed pseudoranges (Hatch 1983; T 2.2.6, 6.4.1).

Without phase lock the generator's carrier still runs with the signal's frequency: noise of that
frequency lets it walk away, but slowly against the noise of a weak signal's code.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import SIGNAL_IDS, Observation
from deepgnss.core.time import GpsTime

_LONGEST_S = 100.0  # of averaging: code and phase drift apart with the ionosphere …
_WALKING_S = 20.0  # … and sooner where only the frequency is tracked


class HatchState(NamedTuple):
    """Running mean of code minus carrier of one satellite."""

    time: GpsTime | None = None
    offset_m: float = 0.0
    seconds: float = 0.0  # averaged over
    slips: int = -1
    phase: bool = False  # in phase lock


def smooth(
    state: HatchState, observation: Observation, time: GpsTime, slips: int
) -> tuple[HatchState, Observation]:
    """Observation with a smoothed pseudorange; starts anew at every possible cycle slip.

    slips: count of possible slips of the channel so far.
    """
    phase = observation.carrier_valid
    wavelength_m = SPEED_OF_LIGHT_MPS / SIGNAL_IDS[observation.signal].carrier_hz
    phase_m = observation.carrier_cycles * wavelength_m
    offset_m = observation.pseudorange_m - phase_m
    if state.time is None or (state.slips, state.phase) != (slips, phase):
        return HatchState(time, offset_m, 0.0, slips, phase), observation
    elapsed_s = time.since(state.time)
    seconds = min(state.seconds + elapsed_s, _LONGEST_S if phase else _WALKING_S)
    weight = elapsed_s / (seconds + elapsed_s) if seconds > 0.0 else 1.0
    mean_m = state.offset_m + weight * (offset_m - state.offset_m)
    smoothed = replace(observation, pseudorange_m=phase_m + mean_m)
    return HatchState(time, mean_m, seconds, slips, phase), smoothed
