"""From a scenario file to the records that the generator and the writers work with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray, NavData
from deepgnss.core.time import from_utc
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver.signals import signal_of
from deepgnss.sim.constellation import nominal_gps
from deepgnss.sim.motion.street import StreetPath
from deepgnss.sim.orbits import nearest_set
from deepgnss.sim.scenario import Antenna, Emitter, Scenario, Stream
from deepgnss.sim.schema.document import ScenarioConfig
from deepgnss.sim.schema.sky import EVERY, SatellitesConfig
from deepgnss.sim.sky import elevations_over
from deepgnss.sim.surroundings.schema import build_surroundings

_LETTERS = {"GPS": "G", "BDS": "C"}
_SIGNALS = {"G": "GPS_L1CA", "C": "BDS_B1I"}
_OLDEST_S = 4 * 3600.0  # of an ephemeris that still tells an orbit
_STEP_S = 10.0  # between steps of a C/N0 that follows the elevation


@dataclass(frozen=True, slots=True)
class Simulation:
    """Everything a folder of outputs is made from."""

    config: ScenarioConfig
    scenario: Scenario


def build(config: ScenarioConfig) -> Simulation:
    """Make the records of a scenario file.

    Raises
    ------
    ConfigError: what it asks for cannot be, in one line that names the key.
    """
    start = from_utc(config.start)
    vehicle = config.vehicle()
    nav = _nav(config)
    times_s = np.unique(np.append(np.arange(0.0, config.seconds, _STEP_S), config.seconds))
    seen = elevations_over(nav, start, vehicle, times_s)
    chosen = _chosen(config.satellites, seen)
    names = [antenna.name for antenna in config.antennas]
    scenario = Scenario(
        name=config.name,
        start=start,
        seconds=config.seconds,
        vehicle=vehicle,
        emitters=tuple(_emitter(config, sat, times_s, seen[sat]) for sat in chosen),
        nav=nav,
        streams=tuple(
            Stream(one.name, one.front_end(), names.index(one.antenna or names[0]))
            for one in config.streams
        ),
        antennas=tuple(Antenna(one.name, one.lever_arm) for one in config.antennas),
        clock=config.receiver_clock(),
        surroundings=build_surroundings(
            config.surroundings,
            road=vehicle.path.road if isinstance(vehicle.path, StreetPath) else None,
            seed=config.seed,
            seconds=config.seconds,
            antenna_height_m=max(-antenna.lever_arm[2] for antenna in config.antennas),
        ),
        ionosphere=config.atmosphere.ionosphere,
        troposphere=config.atmosphere.troposphere,
        noise=config.noise,
        seed=config.seed,
    )
    return Simulation(config, scenario)


def _nav(config: ScenarioConfig) -> NavData:
    start, satellites = from_utc(config.start), config.satellites
    letters = {_LETTERS[system] for system in satellites.systems}
    letters |= {satellite[0] for satellite in satellites.only or ()}
    if satellites.nav is None:
        return nominal_gps(start, config.seconds)
    nav = read_nav(satellites.nav)
    middle = start.plus(config.seconds / 2.0)
    fresh = {
        satellite: sets
        for satellite, sets in nav.ephemerides.items()
        if satellite[0] in letters and abs(nearest_set(sets, middle).toe.since(middle)) <= _OLDEST_S
    }
    if not fresh:
        raise ConfigError(
            f"satellites.nav: {satellites.nav}: no ephemeris of {', '.join(satellites.systems)}"
            f" within {_OLDEST_S / 3600.0:g} h of {middle.utc():%Y-%m-%d %H:%M} UTC"
        )
    return NavData(fresh, nav.klobuchar, nav.utc)


def _chosen(satellites: SatellitesConfig, elevation_rad: dict[str, FloatArray]) -> list[str]:
    """Satellites that transmit, by name."""
    mask_rad = math.radians(satellites.mask)
    if satellites.only is not None:
        for satellite in satellites.only:
            if satellite not in elevation_rad:
                known = ", ".join(sorted(elevation_rad)) or "none"
                raise ConfigError(f"satellites.only: no ephemeris of {satellite}; known: {known}")
            lowest_deg = math.degrees(float(elevation_rad[satellite].min()))
            if lowest_deg <= 0.0:
                up = [name for name, angle in sorted(elevation_rad.items()) if angle.min() > 0.0]
                raise ConfigError(
                    f"satellites.only: {satellite} is below the horizon (elevation"
                    f" {lowest_deg:.1f}°); above it: {', '.join(up) or 'none'}"
                )
        return sorted(satellites.only)
    chosen: list[str] = []
    for system in satellites.systems:
        own = {
            name: float(angle[0])
            for name, angle in elevation_rad.items()
            if name[0] == _LETTERS[system] and angle[0] > mask_rad and angle.min() > 0.0
        }
        chosen += sorted(own, key=lambda name: (-own[name], name))[: satellites.limit]
    if not chosen:
        raise ConfigError(
            f"satellites.mask: no satellite of {', '.join(satellites.systems)} above"
            f" {satellites.mask:g}° at this place and time"
        )
    return sorted(chosen)


def _emitter(
    config: ScenarioConfig, satellite: str, times_s: FloatArray, elevation_rad: FloatArray
) -> Emitter:
    satellites = config.satellites
    steps = satellites.schedule.get(satellite) or satellites.schedule.get(EVERY)
    if steps is None:
        zenith, horizon = satellites.cn0.zenith, satellites.cn0.horizon
        values = horizon + (zenith - horizon) * np.sin(elevation_rad)
        steps = tuple(zip(times_s.tolist(), values.tolist(), strict=True))
    spans = (*satellites.blocked.get(satellite, ()), *satellites.blocked.get(EVERY, ()))
    signal = signal_of(_SIGNALS[satellite[0]], int(satellite[1:]))
    return Emitter(satellite, _without(steps, spans), signal)


def _without(
    steps: tuple[tuple[float, float], ...], spans: tuple[tuple[float, float], ...]
) -> tuple[tuple[float, float], ...]:
    """Steps of C/N0 with −inf inside of the spans."""
    seconds = sorted({second for second, _ in steps} | {edge for span in spans for edge in span})

    def value(second: float) -> float:
        if any(low <= second < high for low, high in spans):
            return -math.inf
        return [level for start, level in steps if start <= second][-1]

    levels = [(second, value(second)) for second in seconds]
    return tuple(step for k, step in enumerate(levels) if k == 0 or step[1] != levels[k - 1][1])
