"""Ready scenarios: a car for the demonstration, an antenna at rest, a file to measure speed on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import GPS_L1CA, NavData, Oscillator
from deepgnss.core.time import GpsTime
from deepgnss.sim.constellation import nominal_gps
from deepgnss.sim.delays import look
from deepgnss.sim.motion.paths import Ellipse, Path, Static
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import nearest_set, orbit_of, travel
from deepgnss.sim.scenario import Emitter, FrontEnd, ReceiverClock, Scenario, Stream

_PLACE: Final = (math.radians(52.264), math.radians(10.526), 120.0)
# Four seconds before a frame that brings page 18: ephemeris, ionosphere and UTC within 28 s.
_START: Final = GpsTime(2290, 382_256.0)
_MASK_RAD: Final = math.radians(10.0)
_TCXO: Final = ReceiverClock(2.7e-4, 1.4e-7, Oscillator("TCXO", 1.0e-21, 0.0, 2.0e-20, 0.0))
_OCXO: Final = ReceiverClock(-4.1e-5, 2.0e-8, Oscillator("OCXO", 2.0e-25, 0.0, 6.0e-25, 0.0))


def preset(name: str, seconds: float | None, rate_hz: float | None, seed: int) -> Scenario:
    """A ready scenario; `seconds` and `rate_hz` replace its own length and sampling rate.

    Raises
    ------
    ConfigError: there is no preset of this name, or the values do not make a scenario.
    """
    if name not in PRESETS:
        raise ConfigError(f"preset: {name!r} is none of {', '.join(PRESETS)}")
    scenario = PRESETS[name](seconds, seed)
    if rate_hz is None:
        return scenario
    (stream,) = scenario.streams
    front_end = replace(stream.front_end, sample_rate_hz=rate_hz)
    return replace(scenario, streams=(replace(stream, front_end=front_end),))


def _demo(seconds: float | None, seed: int) -> Scenario:
    """A car on an oval of 200 m by 120 m, 10–15 m/s, with a start, a stop and another start."""
    angle = smooth_profile(
        [(4.0, 0.0), (10.0, 0.16), (20.0, 0.16), (24.0, 0.0), (27.0, 0.0), (33.0, 0.18)]
    )
    return _scenario(
        name="demo",
        seconds=seconds or 40.0,
        seed=seed,
        path=Ellipse(100.0, 60.0, angle),
        satellites=9,
        cn0_dbhz=lambda elevation_rad: 38.0 + 10.0 * math.sin(elevation_rad),
        front_end=FrontEnd(4.0e6, format="bits2"),
        clock=_TCXO,
    )


def _static48(seconds: float | None, seed: int) -> Scenario:
    """At rest, every satellite at 48 dB-Hz: thermal noise alone."""
    return _scenario(
        name="static48",
        seconds=seconds or 60.0,
        seed=seed,
        path=Static(),
        satellites=10,
        cn0_dbhz=lambda _: 48.0,
        front_end=FrontEnd(4.0e6),
        clock=_OCXO,
    )


def _bench(seconds: float | None, seed: int) -> Scenario:
    """Eight satellites at 45 dB-Hz in many samples."""
    return _scenario(
        name="bench",
        seconds=seconds or 10.0,
        seed=seed,
        path=Static(),
        satellites=8,
        cn0_dbhz=lambda _: 45.0,
        front_end=FrontEnd(16.0e6),
        clock=_TCXO,
    )


PRESETS: Final[Mapping[str, Callable[[float | None, int], Scenario]]] = {
    "demo": _demo,
    "static48": _static48,
    "bench": _bench,
}


def _scenario(
    *,
    name: str,
    seconds: float,
    seed: int,
    path: Path,
    satellites: int,
    cn0_dbhz: Callable[[float], float],
    front_end: FrontEnd,
    clock: ReceiverClock,
) -> Scenario:
    """The highest satellites over the common place, C/N0 by elevation."""
    nav = nominal_gps(_START, seconds)
    vehicle = Vehicle(*_PLACE, path)
    seen = elevations(nav, _START, vehicle)
    highest = sorted(seen, key=lambda satellite: -seen[satellite])[:satellites]
    visible = sorted(satellite for satellite in highest if seen[satellite] > _MASK_RAD)
    return Scenario(
        name=name,
        start=_START,
        seconds=seconds,
        vehicle=vehicle,
        emitters=tuple(Emitter(sat, ((0.0, cn0_dbhz(seen[sat])),)) for sat in visible),
        nav=nav,
        streams=(Stream("L1", front_end),),
        clock=clock,
        seed=seed,
    )


def elevations(nav: NavData, start: GpsTime, vehicle: Vehicle) -> dict[str, float]:
    """Elevation of every GPS satellite of `nav` at the start, rad."""
    at_start = np.zeros(1)
    r_e_m = vehicle.point(at_start).r_m
    seen = {}
    for satellite, sets in nav.ephemerides.items():
        if satellite[0] == GPS_L1CA.system:
            path = travel(orbit_of(nearest_set(sets, start), start), at_start, r_e_m)
            seen[satellite] = float(look(vehicle, path, r_e_m)[1][0])
    return seen
