"""Observations of receivers that track without loops: a base station and the perfect rover.

Their clock is perfect, their phases carry whole cycles that change wherever the signal was lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.core.records import Epoch, FloatArray, Observation, SampleInstant
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.sim.delays import Place, place_of
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import Orbit
from deepgnss.sim.output.columns import instants
from deepgnss.sim.output.sight import Places, in_sight, orbits_of, places_of, sight
from deepgnss.sim.scenario import Antenna, Emitter, Scenario
from deepgnss.sim.schema.outputs import BaseConfig, MeasurementNoise, RoverConfig
from deepgnss.sim.seeds import random_stream

_LOOK_EVERY_S: Final = 0.05  # for blockages between two epochs
_MOST_CYCLES: Final = 1_000_000
_EPOCHS: Final = 500  # computed at a time


class Station(NamedTuple):
    """A receiver and its errors, 1σ."""

    file: str
    marker_type: str
    interval_s: float
    code_noise_m: float
    phase_noise_m: float
    doppler_noise_hz: float


def perfect_rover(config: RoverConfig) -> Station:
    """The rover, at the first antenna of the vehicle."""
    return _station("rover.obs", "GROUND_CRAFT", config.interval, config)


def base_station(
    config: BaseConfig, scenario: Scenario, unblocked: tuple[Emitter, ...]
) -> tuple[Station, Scenario]:
    """The base, and the scenario as it sees it: at rest, nothing in the way."""
    v = scenario.vehicle
    C = C_ne(v.latitude_rad, v.longitude_rad)
    r_e_m = ecef(v.latitude_rad, v.longitude_rad, v.height_m) + np.array(config.offset) @ C
    around = replace(
        scenario,
        vehicle=Vehicle(*geodetic(r_e_m)),
        antennas=(Antenna(),),
        surroundings=None,
        emitters=unblocked,
        streams=(),
    )
    return _station("base.obs", "GEODETIC", config.interval, config), around


def _station(file: str, kind: str, interval_s: float, errors: MeasurementNoise) -> Station:
    return Station(
        file, kind, interval_s, errors.code_noise, errors.phase_noise, errors.doppler_noise
    )


def write_observations(folder: Path, station: Station, scenario: Scenario) -> Path:
    """Write the RINEX file of a station at the first antenna of a scenario."""
    first_e_m = scenario.vehicle.point(np.zeros(1), scenario.antennas[0].lever_b_m).r_m[0]
    signals = {emitter.signal.id.name: emitter.signal.id for emitter in scenario.emitters}
    header = ObsHeader(
        signals=list(signals.values()),
        interval_s=station.interval_s,
        duration_s=scenario.seconds,
        position_e_m=first_e_m,
        utc=scenario.nav.utc,
        marker=Path(station.file).stem.upper(),
        marker_type=station.marker_type,
        name=station.file,
    )
    with RinexObsWriter(folder, header) as file:
        for epoch in epochs(station, scenario):
            file.write(epoch)
    return folder / station.file


def epochs(station: Station, scenario: Scenario) -> Iterator[Epoch]:
    """The observations of a station, epoch by epoch."""
    trackers = [
        _Tracker(station, scenario, emitter, orbit)
        for emitter, orbit in zip(scenario.emitters, orbits_of(scenario), strict=True)
    ]
    rate_hz = scenario.streams[0].front_end.sample_rate_hz if scenario.streams else 1.0
    for t_s in instants(scenario.start, scenario.seconds, station.interval_s, _EPOCHS):
        places = places_of(scenario, t_s)
        looks = place_of(scenario, _looks(t_s, station.interval_s))
        rows = [tracker.observe(places, looks) for tracker in trackers]
        for k, t in enumerate(t_s):
            observed = tuple(row[k] for row in rows)
            yield Epoch(
                scenario.start.plus(float(t)),
                SampleInstant(max(int(t * rate_hz), 0), 0.0),
                tuple(one for one in observed if one is not None),
            )


@dataclass
class _Tracker:
    """One emitter at one station; its arcs of phase go on from chunk to chunk."""

    station: Station
    scenario: Scenario
    emitter: Emitter
    orbit: Orbit
    arc: int = 0
    since_s: float = 0.0  # start of the arc
    cycles: int = 0  # its ambiguity
    noise: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.noise = self._random(0)

    def _random(self, purpose: int) -> np.random.Generator:
        """Of this satellite: 0 for noise, the number of an arc for its ambiguity."""
        return random_stream(
            self.scenario.seed, f"{self.station.file} {self.emitter.satellite}", purpose
        )

    def observe(self, places: Places, looks: Place) -> list[Observation | None]:
        """Observations at consecutive epochs (n,), None where the satellite is out of sight.

        looks: places at the instants since the epoch before each (`_looks`).
        """
        station, t_s = self.station, places.now.t_s
        seen = sight(self.scenario, self.emitter, self.orbit, places)
        between = in_sight(self.scenario, self.emitter, self.orbit, looks)
        held = np.all(between.reshape(t_s.size, -1), axis=1)
        wavelength_m = SPEED_OF_LIGHT_MPS / self.emitter.signal.id.carrier_hz
        code, phase, doppler = self.noise.standard_normal((t_s.size, 3)).T
        pseudorange_m = seen.reception.pseudorange_m + station.code_noise_m * code
        carrier = seen.reception.carrier_cycles + station.phase_noise_m / wavelength_m * phase
        doppler_hz = seen.doppler_hz + station.doppler_noise_hz * doppler
        observed: list[Observation | None] = []
        for k, t in enumerate(t_s):
            if not seen.visible[k]:
                observed.append(None)
                continue
            slip = self.arc == 0 or not held[k]
            if slip:
                self.arc, self.since_s = self.arc + 1, float(t)
                self.cycles = int(self._random(self.arc).integers(-_MOST_CYCLES, _MOST_CYCLES))
            observed.append(
                Observation(
                    satellite=self.emitter.satellite,
                    signal=self.emitter.signal.id.name,
                    pseudorange_m=float(pseudorange_m[k]),
                    carrier_cycles=float(carrier[k]) + self.cycles,
                    doppler_hz=float(doppler_hz[k]),
                    cn0_dbhz=float(seen.cn0_dbhz[k]),
                    lock_time_s=float(t) - self.since_s,
                    slip=slip,
                    half_cycle=False,
                    carrier_valid=True,
                    transmit=self.scenario.start.plus(
                        float(t - pseudorange_m[k] / SPEED_OF_LIGHT_MPS)
                    ),
                )
            )
        return observed


def _looks(t_s: FloatArray, interval_s: float) -> FloatArray:
    """Instants from the epoch before each of (n,) on, all in one array, as many for each."""
    count = max(round(interval_s / _LOOK_EVERY_S), 1)
    before_s = interval_s * np.arange(1, count + 1) / count
    return np.maximum(t_s[:, None] - before_s, 0.0).reshape(-1)
