"""Code and carrier delay of every emitter over the receiver's own time: what the samples follow.

delay = receiver clock reading − satellite clock reading of the signal received, in s. The code's
is pseudorange / c; the carrier's differs by the ionosphere, which delays one and advances the
other. Nodes lie 1 ms apart on the sample axis and are computed second by second, so that a node's
value depends on nothing but its number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
import pymap3d

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.sim.atmosphere import ionosphere_m, troposphere_m
from deepgnss.sim.orbits import Orbit, Travel, orbit_of, travel
from deepgnss.sim.scenario import Emitter, ReceiverClock, Scenario
from deepgnss.sim.trajectory import Trajectory

NODES_PER_SECOND: Final = 1000
_MARGIN_S: Final = 2  # seconds of clock noise known before the start and after the end


class Reception(NamedTuple):
    """Truth of one emitter at true times (n,), as a perfect receiver with a perfect clock has it.

    Pseudorange and carrier grow with range; the carrier has no ambiguity (cycles = m / λ).
    """

    pseudorange_m: FloatArray
    carrier_cycles: FloatArray
    range_m: FloatArray
    satellite_clock_m: FloatArray
    ionosphere_m: FloatArray
    troposphere_m: FloatArray
    azimuth_rad: FloatArray
    elevation_rad: FloatArray


class Nodes(NamedTuple):
    """Delays at consecutive nodes, s, each (emitters, nodes)."""

    code_s: FloatArray
    carrier_s: FloatArray


def receive(
    scenario: Scenario, emitter: Emitter, orbit: Orbit, t_s: FloatArray, antenna: int = 0
) -> Reception:
    """What reaches an antenna at true times (n,), in s from the start."""
    r_e_m = scenario.vehicle.point(t_s, scenario.antennas[antenna].lever_b_m).r_m
    path = travel(orbit, t_s, r_e_m)
    lat, lon, height = pymap3d.ecef2geodetic(*r_e_m.T, deg=False)
    azimuth, elevation = look(scenario.vehicle, path, r_e_m)
    carrier_hz = emitter.signal.id.carrier_hz
    nothing = np.zeros(t_s.size)
    iono = tropo = nothing
    if scenario.ionosphere:
        tow_s = scenario.start.tow_s + t_s
        model = scenario.nav.klobuchar["G"]
        iono = ionosphere_m(model, lat, lon, azimuth, elevation, tow_s, carrier_hz)
    if scenario.troposphere:
        tropo = troposphere_m(lat, height, elevation)
    clock_m = SPEED_OF_LIGHT_MPS * path.satellite_clock_s
    neutral_m = path.range_m - clock_m + tropo
    return Reception(
        pseudorange_m=neutral_m + iono,
        carrier_cycles=(neutral_m - iono) * (carrier_hz / SPEED_OF_LIGHT_MPS),
        range_m=path.range_m,
        satellite_clock_m=clock_m,
        ionosphere_m=iono,
        troposphere_m=tropo,
        azimuth_rad=azimuth,
        elevation_rad=elevation,
    )


def look(place: Trajectory, path: Travel, r_e_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth in [0, 2π) and elevation, rad, in the local frame of the trajectory's origin."""
    los = (path.satellite_e_m - r_e_m) @ C_ne(place.latitude_rad, place.longitude_rad).T
    azimuth = np.mod(np.arctan2(los[:, 1], los[:, 0]), 2.0 * np.pi)
    return azimuth, np.arctan2(-los[:, 2], np.hypot(los[:, 0], los[:, 1]))


def clock_error(clock: ReceiverClock, seconds: float, seed: int) -> FloatArray:
    """Clock error, s, at every node from 2 s before sample 0 to 2 s after the end.

    White frequency noise adds steps of variance h0·dt/2 to the phase, the random walk steps of
    2π²·h₋₂·dt to the frequency.
    """
    dt = 1.0 / NODES_PER_SECOND
    nodes = (math.ceil(seconds) + 2 * _MARGIN_S) * NODES_PER_SECOND
    t_s = np.arange(nodes) * dt - _MARGIN_S
    error = np.asarray(clock.offset_s + clock.drift_sps * t_s, dtype=np.float64)
    if clock.oscillator is not None:
        _, h0_s, _, h_2_hz, _ = clock.oscillator
        random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 0xC10C])))
        white = random.standard_normal(nodes) * math.sqrt(h0_s * dt / 2.0)
        walk = random.standard_normal(nodes) * math.sqrt(2.0 * math.pi**2 * h_2_hz * dt)
        noise = np.cumsum(white + np.cumsum(walk) * dt)
        error = error + noise - noise[_MARGIN_S * NODES_PER_SECOND]
    return error


def node_source(scenario: Scenario) -> Callable[[int, int], Nodes]:
    """Function that gives the delays at nodes [first, end); node k lies at k ms of `sample_s`.

    It keeps the last few seconds, so that walking through a recording computes each once; it may
    be called from several threads.
    """
    clock_s = clock_error(scenario.clock, scenario.seconds, scenario.seed)
    orbits = [orbit_of(scenario.orbit_set(e.satellite), scenario.start) for e in scenario.emitters]

    @lru_cache(maxsize=6)
    def second(number: int) -> Nodes:
        sample_s = number + np.arange(NODES_PER_SECOND) / NODES_PER_SECOND
        at = (number + _MARGIN_S) * NODES_PER_SECOND
        error_s = clock_s[at : at + NODES_PER_SECOND]
        code_s = np.empty((len(scenario.emitters), NODES_PER_SECOND))
        carrier_s = np.empty_like(code_s)
        for row, (emitter, orbit) in enumerate(zip(scenario.emitters, orbits, strict=True)):
            truth = receive(scenario, emitter, orbit, sample_s - error_s)
            code_s[row] = error_s + truth.pseudorange_m / SPEED_OF_LIGHT_MPS
            carrier_s[row] = error_s + truth.carrier_cycles / emitter.signal.id.carrier_hz
        return Nodes(code_s, carrier_s)

    def window(first: int, end: int) -> Nodes:
        numbers = range(first // NODES_PER_SECOND, (end - 1) // NODES_PER_SECOND + 1)
        parts = [second(number) for number in numbers]
        cut = slice(first - numbers[0] * NODES_PER_SECOND, end - numbers[0] * NODES_PER_SECOND)
        return Nodes(*(np.concatenate(rows, axis=1)[:, cut] for rows in zip(*parts, strict=True)))

    return window


def hermite_cubics(nodes: FloatArray) -> FloatArray:
    """Cubics in u in [0, 1) between nodes, slopes from five neighbours: C¹, error O(h⁴).

    nodes: (rows, n) at unit spacing. Returns (rows, n − 5, 4): coefficients c0 … c3 of the
    intervals from node 2 to node n − 3.
    """
    slope = (nodes[:, :-4] - nodes[:, 4:] + 8.0 * (nodes[:, 3:-1] - nodes[:, 1:-3])) / 12.0
    left, right = nodes[:, 2:-3], nodes[:, 3:-2]
    rise, a, b = right - left, slope[:, :-1], slope[:, 1:]
    return np.stack([left, a, 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise], axis=2)
