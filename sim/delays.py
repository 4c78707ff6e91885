"""Code and carrier delay of every emitter over the receiver's own time: what the samples follow.

delay = receiver clock reading − satellite clock reading of the signal received, in s. The code's
is pseudorange / c; the carrier's differs by the ionosphere, which delays one and advances the
other. Nodes lie 1 ms apart on the sample axis and are computed second by second, so that a node's
value depends on nothing but its number.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import NamedTuple

import numpy as np
import pymap3d

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray
from deepgnss.sim.atmosphere import ionosphere_of, troposphere_m
from deepgnss.sim.clock import NODES_PER_SECOND, clock_error
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import Orbit, Travel, orbit_of, travel
from deepgnss.sim.scenario import Emitter, Scenario, View


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


class Place(NamedTuple):
    """Where an antenna is at true times (n,)."""

    t_s: FloatArray
    r_e_m: FloatArray  # (n, 3)
    lat_rad: FloatArray
    lon_rad: FloatArray
    height_m: FloatArray


class Nodes(NamedTuple):
    """Delays at consecutive nodes, and what arrives on each path from a node to the next.

    Path 0 is the line of sight, the others are reflected rays, in the order of `Arrivals`.
    """

    code_s: FloatArray  # (emitters, nodes), of the line of sight
    carrier_s: FloatArray
    factor: FloatArray  # (emitters, paths, nodes), amplitude against the free line of sight
    excess_s: FloatArray  # (emitters, paths, nodes), further delay of code and carrier


def place_of(scenario: Scenario, t_s: FloatArray, antenna: int = 0) -> Place:
    """Where an antenna is at true times (n,), in s from the start."""
    r_e_m = scenario.vehicle.point(t_s, scenario.antennas[antenna].lever_b_m).r_m
    geodetic = pymap3d.ecef2geodetic(*r_e_m.T, deg=False)  # a single point comes back as scalars
    return Place(t_s, r_e_m, *(np.reshape(x, t_s.shape) for x in geodetic))


def receive(
    scenario: Scenario, emitter: Emitter, orbit: Orbit, t_s: FloatArray, antenna: int = 0
) -> Reception:
    """What reaches an antenna on the line of sight at true times (n,), in s from the start."""
    return receive_at(scenario, emitter, orbit, place_of(scenario, t_s, antenna))


def receive_at(scenario: Scenario, emitter: Emitter, orbit: Orbit, place: Place) -> Reception:
    """What reaches an antenna on the line of sight where it is known to be."""
    t_s, r_e_m, lat, lon, height = place
    path = travel(orbit, t_s, r_e_m)
    azimuth, elevation = look(scenario.vehicle, path, r_e_m)
    carrier_hz = emitter.signal.id.carrier_hz
    nothing = np.zeros(t_s.size)
    iono = tropo = nothing
    if scenario.ionosphere:
        tow_s = scenario.start.tow_s + t_s
        seen = lat, lon, azimuth, elevation
        iono = ionosphere_of(scenario.nav.klobuchar, emitter.signal.id, *seen, tow_s)
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


def look(vehicle: Vehicle, path: Travel, r_e_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth in [0, 2π) and elevation, rad, in the local frame of the vehicle's place."""
    los = (path.satellite_e_m - r_e_m) @ C_ne(vehicle.latitude_rad, vehicle.longitude_rad).T
    azimuth = np.mod(np.arctan2(los[:, 1], los[:, 0]), 2.0 * np.pi)
    return azimuth, np.arctan2(-los[:, 2], np.hypot(los[:, 0], los[:, 1]))


def view_of(scenario: Scenario, emitter: Emitter, place: Place, truth: Reception) -> View:
    """What surroundings ask about a satellite seen from a place."""
    vehicle = scenario.vehicle
    origin_e_m = ecef(vehicle.latitude_rad, vehicle.longitude_rad, vehicle.height_m)
    r_n_m = (place.r_e_m - origin_e_m) @ C_ne(vehicle.latitude_rad, vehicle.longitude_rad).T
    return View(emitter.satellite, place.t_s, r_n_m, truth.azimuth_rad, truth.elevation_rad)


def node_source(scenario: Scenario, antenna: int = 0) -> Callable[[int, int], Nodes]:
    """Function that gives an antenna's nodes [first, end); node k lies at k ms of `sample_s`.

    It keeps the last few seconds, so that walking through a recording computes each once; it may
    be called from several threads.
    """
    clock = clock_error(scenario.clock, scenario.seed, scenario.vehicle)
    orbits = [orbit_of(scenario.orbit_set(e.satellite), scenario.start) for e in scenario.emitters]
    lock = Lock()

    @lru_cache(maxsize=6)
    def second(number: int) -> Nodes:
        sample_s = number + np.arange(NODES_PER_SECOND) / NODES_PER_SECOND
        error_s = clock(number)
        place = place_of(scenario, sample_s - error_s, antenna)
        paths = 1 if scenario.surroundings is None else 1 + scenario.surroundings.rays
        shape = (len(scenario.emitters), NODES_PER_SECOND)
        out = Nodes(np.empty(shape), np.empty(shape), *np.zeros((2, shape[0], paths, shape[1])))
        for row, (emitter, orbit) in enumerate(zip(scenario.emitters, orbits, strict=True)):
            carrier_hz = emitter.signal.id.carrier_hz
            truth = receive_at(scenario, emitter, orbit, place)
            out.code_s[row] = error_s + truth.pseudorange_m / SPEED_OF_LIGHT_MPS
            out.carrier_s[row] = error_s + truth.carrier_cycles / carrier_hz
            if scenario.surroundings is None:
                out.factor[row] = 1.0
                continue
            view = view_of(scenario, emitter, place, truth)
            arrivals = scenario.surroundings.arrivals(view, carrier_hz)
            out.factor[row, 0], out.factor[row, 1:] = arrivals.direct, arrivals.ray_amplitude
            out.excess_s[row, 1:] = arrivals.ray_excess_m / SPEED_OF_LIGHT_MPS
        return out

    def window(first: int, end: int) -> Nodes:
        numbers = range(first // NODES_PER_SECOND, (end - 1) // NODES_PER_SECOND + 1)
        with lock:  # whoever comes second finds it done
            parts = [second(number) for number in numbers]
        cut = slice(first - numbers[0] * NODES_PER_SECOND, end - numbers[0] * NODES_PER_SECOND)
        return Nodes(
            *(np.concatenate(rows, axis=-1)[..., cut] for rows in zip(*parts, strict=True))
        )

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
