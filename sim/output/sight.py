"""What of a satellite reaches an antenna: range, phase, strength, and whether it is in sight."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.sim.delays import Place, Reception, place_of, receive_at, view_of
from deepgnss.sim.orbits import Orbit, orbit_of
from deepgnss.sim.scenario import Arrivals, Emitter, Scenario
from deepgnss.sim.surroundings.sight import STATES, Seen

IN_SIGHT: Final = 0.1
"""Amplitude factor (−20 dB) below which a line of sight counts as blocked."""

SILENT: Final = "silent"
"""State of an emitter that is off, or below the mask."""

_HALF_S: Final = 0.5e-3  # either side of an instant, for the rates there


class Sight(NamedTuple):
    """One emitter at one antenna, each (n,)."""

    reception: Reception  # of the free line of sight
    doppler_hz: FloatArray
    range_rate_mps: FloatArray
    cn0_dbhz: FloatArray  # of the line of sight as it is, −inf where nothing comes
    direct: FloatArray  # amplitude factor of the line of sight
    ray: FloatArray  # amplitude factor of the strongest reflection
    ray_excess_m: FloatArray  # its extra path
    visible: NDArray[np.bool_]
    state: NDArray[np.str_]  # of the line of sight: free … blocked, or silent
    cause: NDArray[np.str_]  # what stands in it, empty when it is free


def orbits_of(scenario: Scenario) -> list[Orbit]:
    """The orbit of every emitter, in their order."""
    return [orbit_of(scenario.orbit_set(e.satellite), scenario.start) for e in scenario.emitters]


class Places(NamedTuple):
    """Where the first antenna is at instants, and shortly before and after each."""

    now: Place
    before: Place
    after: Place


def places_of(scenario: Scenario, t_s: FloatArray) -> Places:
    """The first antenna about true times (n,), s from the start: shared by all emitters."""
    return Places(*(place_of(scenario, t_s + shift) for shift in (0.0, -_HALF_S, _HALF_S)))


def sight(scenario: Scenario, emitter: Emitter, orbit: Orbit, places: Places) -> Sight:
    """What an antenna at these places sees of an emitter."""
    now, before, after = (receive_at(scenario, emitter, orbit, place) for place in places)
    t_s = places.now.t_s
    direct, ray, excess_m = np.ones(t_s.size), np.zeros(t_s.size), np.zeros(t_s.size)
    arrivals = _arrivals(scenario, emitter, places.now, now)
    if arrivals is not None:
        direct = arrivals.direct
        if len(arrivals.ray_amplitude):
            strongest = np.argmax(arrivals.ray_amplitude, axis=0), np.arange(t_s.size)
            ray = arrivals.ray_amplitude[strongest]
            excess_m = np.where(ray > 0.0, arrivals.ray_excess_m[strongest], 0.0)
    free_dbhz = free_cn0(emitter, t_s)
    state, cause = _told(scenario, emitter, places.now, now)
    with np.errstate(divide="ignore"):
        cn0_dbhz = free_dbhz + 20.0 * np.log10(direct)
    return Sight(
        reception=now,
        doppler_hz=-(after.carrier_cycles - before.carrier_cycles) / (2.0 * _HALF_S),
        range_rate_mps=(after.range_m - before.range_m) / (2.0 * _HALF_S),
        cn0_dbhz=cn0_dbhz,
        direct=direct,
        ray=ray,
        ray_excess_m=excess_m,
        visible=(direct >= IN_SIGHT) & np.isfinite(free_dbhz),
        state=np.where(np.isfinite(free_dbhz), state, SILENT),
        cause=cause,
    )


def in_sight(scenario: Scenario, emitter: Emitter, orbit: Orbit, place: Place) -> NDArray[np.bool_]:
    """Whether an emitter is on and its line of sight free enough, (n,): `visible` of a Sight."""
    free = np.isfinite(free_cn0(emitter, place.t_s))
    if scenario.surroundings is None:
        return free
    truth = receive_at(scenario, emitter, orbit, place)
    arrivals = _arrivals(scenario, emitter, place, truth)
    return free if arrivals is None else free & (arrivals.direct >= IN_SIGHT)


def _arrivals(
    scenario: Scenario, emitter: Emitter, place: Place, truth: Reception
) -> Arrivals | None:
    if scenario.surroundings is None:
        return None
    view = view_of(scenario, emitter, place, truth)
    return scenario.surroundings.arrivals(view, emitter.signal.id.carrier_hz)


def _told(
    scenario: Scenario, emitter: Emitter, place: Place, truth: Reception
) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """State of a line of sight and what stands in it, in words."""
    count = place.t_s.size
    if not isinstance(scenario.surroundings, Seen):
        return np.full(count, STATES[0]), np.full(count, "")
    view = view_of(scenario, emitter, place, truth)
    state, cause, names = scenario.surroundings.visibility(view, emitter.signal.id.carrier_hz)
    return np.array(STATES)[state], np.array([*names, ""])[cause]  # −1: the last, nothing


def free_cn0(emitter: Emitter, t_s: FloatArray) -> FloatArray:
    """C/N0 of the free line of sight, dB-Hz, −inf while the emitter is switched off."""
    starts, values = np.array(emitter.cn0_dbhz).T
    return np.asarray(values[np.maximum(np.searchsorted(starts, t_s, side="right") - 1, 0)])
