"""A drive without samples: ranges and increments of the simulator, and a navigation on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.frames import C_ne
from deepgnss.core.records import (
    SIGNAL_IDS,
    Counter,
    Epoch,
    FloatArray,
    NavData,
    NavSolution,
    Observation,
    SampleInstant,
)
from deepgnss.core.time import GpsTime
from deepgnss.deep.inertial import clock_sigmas
from deepgnss.deep.navigation import InertialInputs, Navigation
from deepgnss.deep.placing import Placing
from deepgnss.deep.screening import Flag, Screening, ScreenSettings
from deepgnss.deep.tight import CLOCK_NOISE
from deepgnss.ins import AlignmentSettings, Layout, Settings
from deepgnss.ins.imu_errors import ImuErrors
from deepgnss.ins.increments import joined
from deepgnss.ins.updates import Innovation
from deepgnss.io.config.imu_grade import imu_grade
from deepgnss.receiver import pvt
from deepgnss.receiver.measured import measure
from deepgnss.receiver.receiver import Fix
from deepgnss.receiver.signals import BDS_B1I_D1, GPS_L1CA_SIGNAL
from deepgnss.sim.constellation import nominal
from deepgnss.sim.delays import receive
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import EllipseAttitude
from deepgnss.sim.motion.paths import Ellipse
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, Scenario
from deepgnss.sim.sky import elevations

START = GpsTime(2290, 382_300.0)
LEVER_M = (0.4, 0.1, -1.2)
RATE_HZ = 4e6
BETWEEN_M = 100.0  # BeiDou's clock ahead of GPS time
DRIFT_SPS = 1.5e-7  # of the counter; tags follow it but for 3 cm/s
LEFT_MPS = 0.03
PARAMETERS = pvt.PvtParameters()

Fault = Callable[[str, float], float | None]
"""Metres a satellite's range is too long at a time; None: blocked."""

Bend = Callable[[float], tuple[float, float]]
"""How far the tags are steered off their line at a time, m behind the counter, and its rate."""


def sound(_satellite: str, _time_s: float) -> float | None:
    return 0.0


def straight(_time_s: float) -> tuple[float, float]:
    return 0.0, 0.0


@dataclass(frozen=True)
class World:
    """Truth at tags: ranges (tags, satellites) with a sound receiver's noise, increments."""

    names: list[str]
    nav: NavData
    vehicle: Vehicle
    inputs: InertialInputs
    times_s: FloatArray
    ranges_m: FloatArray
    dopplers_hz: FloatArray

    def antenna_e_m(self, time_s: float) -> FloatArray:
        r_e_m: FloatArray = self.vehicle.point(np.array([time_s]), LEVER_M).r_m[0]
        return r_e_m

    def epoch(self, k: int, fault: Fault, bend: Bend = straight) -> Epoch:
        """Observations of a tag."""
        t = float(self.times_s[k])
        bent_m, bent_mps = bend(t)
        counter = (t * (1.0 + DRIFT_SPS)) * RATE_HZ
        tag = START.plus(t)
        seen = []
        for column, name in enumerate(self.names):
            error_m = fault(name, t)
            if error_m is None:
                continue
            range_m = float(self.ranges_m[k, column]) + error_m - bent_m
            signal = "GPS_L1CA" if name[0] == "G" else "BDS_B1I"
            bent_hz = bent_mps * SIGNAL_IDS[signal].carrier_hz / C
            seen.append(
                Observation(
                    name, signal, range_m, 0.0,
                    float(self.dopplers_hz[k, column]) + bent_hz, 45.0, 10.0, False, False, False,
                    tag.plus(-range_m / C),
                )
            )  # fmt: skip
        instant = SampleInstant(int(counter), counter % 1.0)
        counter = Counter(t * DRIFT_SPS + bent_m / C, DRIFT_SPS + bent_mps / C)
        return Epoch(tag, instant, tuple(seen), counter)


@lru_cache(maxsize=4)
def world(
    seconds: float = 45.0,
    coupling: Literal["loose", "tight"] = "loose",
    step_s: float = 0.2,
    grade: str = "MTi-G",
) -> World:
    """Rounds of 10 m/s; ten satellites of both systems."""
    path = Ellipse(150.0, 100.0, smooth_profile([(0.0, 0.1)]))
    vehicle = Vehicle(0.91, 0.18, 120.0, path, EllipseAttitude(path))
    nav = nominal(START, seconds, "GC")
    seen = elevations(nav, START, vehicle)
    high = [s for s in sorted(seen, key=lambda s: -seen[s]) if seen[s] > np.radians(15.0)]
    beidou = [s for s in high if s[0] == "C" and 5 < int(s[1:]) < 59]
    names = sorted([s for s in high if s[0] == "G"][:6] + beidou[:4])
    emitters = tuple(
        Emitter(s, ((0.0, 45.0),), GPS_L1CA_SIGNAL if s[0] == "G" else BDS_B1I_D1) for s in names
    )
    scenario = Scenario("tags", START, seconds, vehicle, emitters, nav, ())
    scenario = replace(scenario, antennas=(scenario.antennas[0]._replace(lever_b_m=LEVER_M),))
    times_s = np.arange(3, round(seconds / step_s)) * step_s
    random = np.random.default_rng(5)
    ranges, dopplers = [], []
    for emitter in emitters:
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), START)
        one = receive(scenario, emitter, orbit, times_s)
        later, before = (
            receive(scenario, emitter, orbit, times_s + s).carrier_cycles for s in (0.01, -0.01)
        )
        carrier_hz = emitter.signal.id.carrier_hz
        clock_m = LEFT_MPS * times_s + (BETWEEN_M if emitter.satellite[0] == "C" else 0.0)
        ranges.append(one.pseudorange_m + clock_m + random.normal(0.0, 0.3, times_s.size))
        noise_hz = random.normal(0.0, 0.05, times_s.size) * carrier_hz / C
        dopplers.append((before - later) / 0.02 - LEFT_MPS * carrier_hz / C + noise_hz)
    error_free = joined(*increments(vehicle, START, 100.0, round(seconds * 100), highest_hz=2.0))
    unit = imu_grade(grade)
    block, _ = ImuErrors(unit, np.random.default_rng(3)).apply(error_free)
    systems = ("G", "C") if coupling == "tight" else ()
    layout = Layout(systems=systems)
    alignment = AlignmentSettings(
        "motion",
        np.array(LEVER_M),
        None,
        layout=layout,
        extras=np.zeros(layout.extras),
        extra_sigmas=clock_sigmas(systems) if systems else np.zeros(0),
    )
    settings = Settings(np.array(LEVER_M), keep_epochs=False, restart_after=100, clock=CLOCK_NOISE)
    tight = PARAMETERS if systems else None
    inputs = InertialInputs(block, unit, alignment, settings, None, tight, systems)
    return World(names, nav, vehicle, inputs, times_s, np.array(ranges).T, np.array(dopplers).T)


@dataclass
class Driven:
    """What came out, tag by tag."""

    time_s: list[float] = field(default_factory=list)
    refused: list[dict[str, str]] = field(default_factory=list)
    error_n_m: list[FloatArray] = field(default_factory=list)  # navigation less truth; NaN: none
    sigma_n_m: list[FloatArray] = field(default_factory=list)
    flags: list[Flag] = field(default_factory=list)
    events: list[str] = field(default_factory=list)
    innovations: list[Innovation] = field(default_factory=list)
    alone: list[NavSolution] = field(default_factory=list)  # by ranges only
    placed: list[NavSolution] = field(default_factory=list)  # with the navigation, where asked for

    def ever_refused(self, since_s: float = 0.0, until_s: float = np.inf) -> set[str]:
        """Satellites refused at some time."""
        return {
            name
            for t, refused in zip(self.time_s, self.refused, strict=True)
            if since_s <= t <= until_s
            for name in refused
        }

    def first_refused_s(self, name: str, since_s: float) -> float:
        """Time of a satellite's first refusal from a time on."""
        pairs = zip(self.time_s, self.refused, strict=True)
        return min(t for t, refused in pairs if t >= since_s and name in refused)

    def error_m(self, time_s: float) -> FloatArray:
        """Error of the navigation at a time."""
        return self.error_n_m[int(np.searchsorted(self.time_s, time_s - 1e-6))]


def drive(
    given: World,
    fault: Fault = sound,
    settings: ScreenSettings | None = None,
    placing: Placing | None = None,
    *,
    bend: Bend = straight,
    drift_sigma_mps: float | None = None,
) -> Driven:
    """Run navigation, outlier test and positions through all tags, as the engine does.

    drift_sigma_mps: of the counter's drift as the test is told it, if it is.
    """
    known_mps = C * DRIFT_SPS + LEFT_MPS
    drift = None if drift_sigma_mps is None else (known_mps, drift_sigma_mps)
    navigation = Navigation(given.inputs)
    screening = Screening(PARAMETERS, settings or ScreenSettings())
    out, previous = Driven(), None
    to_n = C_ne(given.vehicle.latitude_rad, given.vehicle.longitude_rad)
    lever_b_m = np.array(LEVER_M)
    for k, time_s in enumerate(given.times_s):
        epoch = given.epoch(k, fault, bend)
        measured = measure(epoch, given.nav)
        refused = {}
        way = navigation.ahead(epoch.time.plus(0.02)) if navigation.running else None
        if way is None:
            screening.forget()
        else:
            screen = screening.along(way, lever_b_m, drift)
            refused = dict(screen(measured)) if epoch.observations else {}
        solution = pvt.solve_measured(measured, PARAMETERS, previous, refused)
        previous = solution if solution.valid else previous
        fix = Fix(measured, solution, True)
        states = navigation.take([fix])
        if placing is not None and states:
            out.placed.append(placing.take(fix, states[0]))
        out.alone.append(solution)
        off, sigma = np.full(3, np.nan), np.full(3, np.nan)
        if states:
            off = to_n @ (states[0].antenna.r_e_m - given.antenna_e_m(float(time_s)))
            sigma = np.sqrt(np.diagonal(states[0].antenna.covariance)[:3])
        told, innovations = navigation.news()
        out.innovations += innovations
        out.events += [event.what for event in told]
        out.time_s.append(float(time_s))
        out.refused.append(refused)
        out.error_n_m.append(off)
        out.sigma_n_m.append(sigma)
        out.flags += screening.news()
    return out
