"""From a scenario file to the records that the generator and the writers work with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray, NavData
from deepgnss.core.time import from_utc
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver.signals import signal_of
from deepgnss.sim.constellation import nominal
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
    unblocked: tuple[Emitter, ...]  # the scenario's emitters as an open sky would show them


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
    unblocked = tuple(
        _emitter(config.satellites, satellite, times_s, seen[satellite])
        for satellite in _chosen(config.satellites, seen)
    )
    names = [antenna.name for antenna in config.antennas]
    scenario = Scenario(
        name=config.name,
        start=start,
        seconds=config.seconds,
        vehicle=vehicle,
        emitters=tuple(_blocked(config.satellites, emitter) for emitter in unblocked),
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
    return Simulation(config, scenario, unblocked)


def _nav(config: ScenarioConfig) -> NavData:
    start, satellites = from_utc(config.start), config.satellites
    letters = {_LETTERS[system] for system in satellites.systems}
    letters |= {satellite[0] for satellite in satellites.only or ()}
    if satellites.nav is None:
        return nominal(start, config.seconds, "".join(sorted(letters)))
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


def _chosen(satellites: SatellitesConfig, elevation_rad: Mapping[str, FloatArray]) -> list[str]:
    """Satellites that transmit, by name: those that are above the mask at some time."""
    if satellites.only is not None:
        for satellite in satellites.only:
            if satellite not in elevation_rad:
                known = ", ".join(sorted(elevation_rad)) or "none"
                raise ConfigError(f"satellites.only: no ephemeris of {satellite}; known: {known}")
            highest_deg = math.degrees(float(elevation_rad[satellite].max()))
            if highest_deg <= 0.0:
                up = [name for name, angle in sorted(elevation_rad.items()) if angle.max() > 0.0]
                raise ConfigError(
                    f"satellites.only: {satellite} is below the horizon (elevation"
                    f" {highest_deg:.1f}°); above it: {', '.join(up) or 'none'}"
                )
        return sorted(satellites.only)
    mask_rad = math.radians(satellites.mask)
    chosen: list[str] = []
    for system in satellites.systems:
        own = {
            name: float(angle.mean())
            for name, angle in elevation_rad.items()
            if name[0] == _LETTERS[system] and angle.max() > mask_rad
        }
        chosen += sorted(own, key=lambda name: (-own[name], name))[: satellites.limit]
    if not chosen:
        raise ConfigError(
            f"satellites.mask: no satellite of {', '.join(satellites.systems)} above"
            f" {satellites.mask:g}° at this place and time"
        )
    return sorted(chosen)


def _emitter(
    satellites: SatellitesConfig, satellite: str, times_s: FloatArray, elevation_rad: FloatArray
) -> Emitter:
    """A satellite with its C/N0 over time, −inf while it is below the mask."""
    steps = satellites.schedule.get(satellite) or satellites.schedule.get(EVERY)
    if steps is None:
        zenith, horizon = satellites.cn0.zenith, satellites.cn0.horizon
        starts, levels = times_s, horizon + (zenith - horizon) * np.sin(elevation_rad)
    else:
        starts, levels = np.array(steps).T
    mask_rad = 0.0 if satellites.only is not None else math.radians(satellites.mask)
    seconds = np.union1d(starts, times_s)
    values = levels[np.searchsorted(starts, seconds, side="right") - 1]
    values[np.interp(seconds, times_s, elevation_rad) <= mask_rad] = -math.inf
    signal = signal_of(_SIGNALS[satellite[0]], int(satellite[1:]))
    return Emitter(satellite, _steps(seconds, values), signal)


def _blocked(satellites: SatellitesConfig, emitter: Emitter) -> Emitter:
    """The emitter with −inf within the spans in which it is blocked."""
    own = satellites.blocked.get(emitter.satellite, ())
    spans = (*own, *satellites.blocked.get(EVERY, ()))
    starts, levels = np.array(emitter.cn0_dbhz).T
    seconds = np.union1d(starts, np.array(spans).reshape(-1))
    values = levels[np.searchsorted(starts, seconds, side="right") - 1]
    for low, high in spans:
        values[(seconds >= low) & (seconds < high)] = -math.inf
    return replace(emitter, cn0_dbhz=_steps(seconds, values))


def _steps(seconds: FloatArray, values: FloatArray) -> tuple[tuple[float, float], ...]:
    """(second, value) wherever the value changes."""
    changes = np.append(True, values[1:] != values[:-1])
    return tuple(zip(seconds[changes].tolist(), values[changes].tolist(), strict=True))
