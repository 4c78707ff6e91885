"""The whole scenario file: the typed schema of what `deepgnss simulate` makes."""

from __future__ import annotations

import math
from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from deepgnss.io.config.aids import NamedOscillator
from deepgnss.io.config.quantity import Quantity, Section, Switch, misfit
from deepgnss.io.config.recording import UtcTime
from deepgnss.sim.motion.schema import TrajectoryConfig
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.scenario import ReceiverClock
from deepgnss.sim.schema.inertial import ImuLogConfig, OdometerLogConfig
from deepgnss.sim.schema.outputs import BaseConfig, RoverConfig, TruthConfig
from deepgnss.sim.schema.receiver import AntennaConfig, ClockConfig, SampleStreamConfig
from deepgnss.sim.schema.sky import AtmosphereConfig, SatellitesConfig
from deepgnss.sim.surroundings.schema import ObstacleConfig

REFERENCE_HEAD: Final = """# Scenarios

One YAML file (YAML 1.2) says what `deepgnss simulate` makes; every key has a default. Relative
paths start from the file's folder. `deepgnss simulate SCENARIO --show` prints it with all defaults
filled in, `--schema` the JSON schema, `--list` the ready ones in `configs/scenarios`.
[simulator.md](simulator.md) says what is modelled and what comes out.

This page is written from the schema (`make docs`).
"""


class PlaceConfig(Section):
    """Origin of the trajectory: its local frame is the tangent plane there (WGS-84)."""

    latitude: Annotated[float, Quantity(-89.9, 89.9, "deg")] = 52.264
    """deg, north positive."""
    longitude: Annotated[float, Quantity(-180.0, 360.0, "deg")] = 10.526
    """deg, east positive."""
    height: Annotated[float, Quantity(-1000.0, 50_000.0, "m")] = 120.0
    """m, above the ellipsoid."""


class ScenarioConfig(Section):
    """Everything `deepgnss simulate` can be told."""

    name: Annotated[str, Field(min_length=1, max_length=64)] = "custom"
    """Name in reports."""
    seed: Annotated[int, Quantity(0, 1_000_000_000, "", whole=True)] = 1
    """Of everything random; each random part draws from a stream of its own."""
    start: UtcTime = Field("2023-11-30T10:10:38Z", validate_default=True)
    """UTC that the receiver's clock reads at sample 0."""
    seconds: Annotated[float, Quantity(0.0, 604_800.0, "s", above=True)] = 60.0
    """Length, s."""
    place: PlaceConfig = PlaceConfig()
    trajectory: TrajectoryConfig = TrajectoryConfig()
    antennas: Annotated[tuple[AntennaConfig, ...], Field(min_length=1, max_length=8)] = (
        AntennaConfig(),
    )
    """Antennas; base and rover observations, ranges and truth are those of the first."""
    satellites: SatellitesConfig = SatellitesConfig()
    surroundings: tuple[ObstacleConfig, ...] = ()
    """What stands along the road, each entry one obstacle; positions in m along the trajectory."""
    atmosphere: AtmosphereConfig = AtmosphereConfig()
    oscillator: NamedOscillator | None = None
    """The receiver's oscillator: a name in configs/oscillators, or its h-parameters; omitted: no
    noise."""
    clock: ClockConfig = ClockConfig()
    streams: Annotated[tuple[SampleStreamConfig, ...], Field(min_length=1)] = (
        SampleStreamConfig(),
    )
    """Streams of samples."""
    noise: Switch = True
    """Thermal noise; without it the samples are the signals alone."""
    container: Switch = False
    """Samples in one HDF5 file (rec.h5), and with `imu.format: hdf5` the inertial log in it."""
    imu: ImuLogConfig | None = None
    """Log of an inertial unit; omitted: none."""
    odometer: OdometerLogConfig | None = None
    """Log of wheel speed; omitted: none."""
    base: BaseConfig | None = None
    """Observations of a base station; omitted: none."""
    rover: RoverConfig = RoverConfig()
    truth: TruthConfig = TruthConfig()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        antennas = [antenna.name for antenna in self.antennas]
        for key, names in (("antennas", antennas), ("streams", [s.name for s in self.streams])):
            for place, name in enumerate(names):
                if name in names[:place]:
                    raise misfit("expected a name of its own for each", f"{key}[{place}].name")
        for place, stream in enumerate(self.streams):
            if stream.antenna is not None and stream.antenna not in antennas:
                raise misfit(
                    f"expected an antenna: {', '.join(antennas)}", f"streams[{place}].antenna"
                )
        return self

    def receiver_clock(self) -> ReceiverClock:
        """Return the record of the receiver's clock."""
        oscillator = self.oscillator.oscillator() if self.oscillator else None
        return ReceiverClock(self.clock.offset, self.clock.drift, oscillator)

    def vehicle(self) -> Vehicle:
        """Return the record of the vehicle's motion."""
        return self.trajectory.build(
            math.radians(self.place.latitude),
            math.radians(self.place.longitude),
            self.place.height,
            self.seconds,
        )
