"""The section `trajectory` of a scenario: how the vehicle moves."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, Literal, Self

import pymap3d
from pydantic import BeforeValidator, Field, model_validator
from scipy.interpolate import PPoly

from deepgnss.core.errors import ConfigError
from deepgnss.io.config.quantity import Choice, ExistingFile, Quantity, Section, Switch, misfit
from deepgnss.sim.motion.attitude import Attitude, EllipseAttitude, Steady, along
from deepgnss.sim.motion.paths import Ellipse, Line, Path, Sine, SineFromRest, Static
from deepgnss.sim.motion.profile import acceleration_profile, smooth_profile
from deepgnss.sim.motion.road import Waypoint, lay_road
from deepgnss.sim.motion.street import Limits, Stop, StreetAttitude, StreetPath, Zone, drive
from deepgnss.sim.motion.table import Place, read_track
from deepgnss.sim.motion.vehicle import Vehicle

_LARGEST_JERK_MPS3 = 1000.0  # 100 g/s and a little

Degrees = Annotated[float, Quantity(-360.0, 360.0, "deg")]
Second = Annotated[float, Quantity(-1e5, 1e6, "s")]
Metres = Annotated[float, Quantity(-1e5, 1e5, "m")]
Chainage = Annotated[float, Quantity(0.0, 1e6, "m")]
Length = Annotated[float, Quantity(0.0, 1e5, "m", above=True)]
Speed = Annotated[float, Quantity(-1e4, 1e4, "m/s")]
Forward = Annotated[float, Quantity(0.0, 1e3, "m/s", above=True)]
Acceleration = Annotated[float, Quantity(-1e3, 1e3, "m/s^2")]
Jerk = Annotated[float, Quantity(0.0, _LARGEST_JERK_MPS3, "m/s^3", above=True)]
Share = Annotated[float, Quantity(-1.0, 1.0, "")]
Speeds = Annotated[tuple[tuple[Second, Speed], ...], Field(min_length=1)]

_Laid = tuple[Path, Attitude]


class AttitudeConfig(Section):
    """A constant attitude against the local NED frame."""

    roll: Degrees = 0.0
    """deg, right side down."""
    pitch: Annotated[float, Quantity(-90.0, 90.0, "deg")] = 0.0
    """deg, nose up."""
    yaw: Degrees = 0.0
    """deg, from north over east."""

    def build(self) -> Steady:
        """Return the record."""
        return Steady(math.radians(self.roll), math.radians(self.pitch), math.radians(self.yaw))


class StaticConfig(AttitudeConfig):
    """At rest at the place."""

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        return Static(), self.build()


class _Straight(Section):
    azimuth: Degrees = 0.0
    """Direction, deg from north over east."""
    elevation: Annotated[float, Quantity(-90.0, 90.0, "deg")] = 0.0
    """Direction, deg above the horizon."""
    attitude: AttitudeConfig | None = None
    """Attitude; omitted: forward along the direction."""

    def direction_n(self) -> tuple[float, float, float]:
        """Return the unit vector in NED."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        level = math.cos(elevation)
        return level * math.cos(azimuth), level * math.sin(azimuth), -math.sin(elevation)

    def pointed(self, path: Path) -> _Laid:
        """Return a path along the direction with its attitude."""
        return path, self.attitude.build() if self.attitude else along(self.direction_n())


class LineConfig(_Straight):
    """Along a straight line at given speeds."""

    speeds: Speeds
    """[second, m/s] points; the speed passes from one to the next by smooth steps."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_rising(self.speeds, "speeds")
        return self

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        return self.pointed(Line(self.direction_n(), smooth_profile(self.speeds)))


class StepsConfig(_Straight):
    """Along a straight line by steps of acceleration with a limited jerk."""

    steps: Annotated[tuple[tuple[Second, Acceleration], ...], Field(min_length=1)]
    """[second, m/s^2]: from this second on the acceleration goes to this value."""
    jerk: Jerk = 980.665
    """m/s^3, at which the acceleration changes."""
    speed: Speed = 0.0
    """m/s, at second 0."""

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        distance = acceleration_profile(self.steps, self.jerk, self.speed)
        return self.pointed(Line(self.direction_n(), distance))

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_rising(self.steps, "steps")
        try:
            acceleration_profile(self.steps, self.jerk)
        except ConfigError as error:
            raise misfit(f"expected steps apart: {error}", "steps") from error
        return self


class SineConfig(_Straight):
    """To and fro along a straight line."""

    amplitude: Length
    """m, to either side."""
    frequency: Annotated[float, Quantity(0.0, 100.0, "Hz", above=True)]
    """Hz."""
    rest: Annotated[float, Quantity(0.0, 1e6, "s")] | None = None
    """s at rest, from which it sets out with the sine's accelerations and never turns back."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        most_m = _LARGEST_JERK_MPS3 / (2.0 * math.pi * self.frequency) ** 3
        if self.amplitude > most_m:
            raise misfit(
                f"expected up to {most_m:.4g} m at {self.frequency:g} Hz"
                f" (a jerk of {_LARGEST_JERK_MPS3:g} m/s^3)",
                "amplitude",
            )
        return self

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        sine = (self.direction_n(), self.amplitude, self.frequency)
        return self.pointed(Sine(*sine) if self.rest is None else SineFromRest(*sine, self.rest))


class _Round(Section):
    speeds: Speeds
    """[second, m/s] points; on an ellipse the speed is its root mean square over a turn."""
    turn: Literal["right", "left"] = "right"
    """Which way round, from northwards at the place."""
    bank: Share = 0.0
    """Roll into the turn, as share of the angle at which the lateral acceleration is not felt."""
    attitude: AttitudeConfig | None = None
    """Attitude; omitted: forward along the course."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_rising(self.speeds, "speeds")
        return self

    def around(self, north_m: float, east_m: float) -> _Laid:
        """Return path and attitude on an ellipse of these semi-axes."""
        distance = smooth_profile(self.speeds)
        angle = PPoly(distance.c / math.sqrt((north_m**2 + east_m**2) / 2.0), distance.x)
        path = Ellipse(north_m, east_m if self.turn == "right" else -east_m, angle)
        return path, self.attitude.build() if self.attitude else EllipseAttitude(path, self.bank)


class CircleConfig(_Round):
    """A level circle through the place."""

    radius: Length
    """m."""

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        return self.around(self.radius, self.radius)


class EllipseConfig(_Round):
    """A level ellipse through the place."""

    north: Length
    """Semi-axis north–south, m."""
    east: Length
    """Semi-axis east–west, m."""

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        return self.around(self.north, self.east)


def _check_rising(points: tuple[tuple[float, float], ...], key: str) -> None:
    for number, (before, after) in enumerate(itertools.pairwise(points), 1):
        if after[0] <= before[0]:
            raise misfit(f"expected a second after {before[0]:g}", f"{key}[{number}]")


# --- streets -------------------------------------------------------------------------------------


class WaypointConfig(Section):
    """A corner of the road, from the place or on the globe."""

    north: Metres | None = None
    """m."""
    east: Metres | None = None
    """m."""
    latitude: Annotated[float, Quantity(-90.0, 90.0, "deg")] | None = None
    """deg."""
    longitude: Annotated[float, Quantity(-180.0, 360.0, "deg")] | None = None
    """deg."""
    height: Annotated[float, Quantity(-1e4, 1e4, "m")] | None = None
    """m above the place's level; omitted: between those of the neighbours that have one."""
    radius: Length | None = None
    """m, of the bend here; omitted: by the radius of the road."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        given = [
            name
            for name in ("north", "east", "latitude", "longitude")
            if getattr(self, name) is not None
        ]
        if given not in (["north", "east"], ["latitude", "longitude"]):
            raise misfit("expected north and east, or latitude and longitude")
        return self

    def build(self, place: Place) -> Waypoint:
        """Return the record, in the local frame."""
        north, east = self.north, self.east
        if self.latitude is not None and self.longitude is not None:
            point = (math.radians(self.latitude), math.radians(self.longitude), place.height_m)
            north, east, _ = (float(x) for x in pymap3d.geodetic2ned(*point, *place, deg=False))
        return Waypoint(north or 0.0, east or 0.0, self.height, self.radius)


def _named(value: object) -> Any:
    if isinstance(value, list) and len(value) in (2, 3):
        return dict(zip(("north", "east", "height"), value, strict=False))
    return value


class ZoneConfig(Section):
    """A stretch of road with a speed limit of its own."""

    begin: Chainage = Field(alias="from")
    """m along the road."""
    to: Chainage
    """m along the road."""
    speed: Forward
    """m/s."""


class StopConfig(Section):
    """A place to stand at for a while, on every lap."""

    at: Chainage
    """m along the road."""
    seconds: Annotated[float, Quantity(0.0, 1e5, "s", above=True)]
    """How long."""


class StreetConfig(Section):
    """A road through waypoints and a drive along it."""

    waypoints: Annotated[
        tuple[
            Annotated[
                WaypointConfig,
                BeforeValidator(_named, json_schema_input_type=list[float] | dict[str, float]),
            ],
            ...,
        ],
        Field(min_length=2),
    ]
    """Corners: [north, east] or [north, east, height] in m from the place, or a mapping with
    latitude and longitude or a radius."""
    closed: Switch = False
    """The road returns to its first waypoint; its metres count from the end of the bend there."""
    radius: Length = 15.0
    """m, of bends of 90° and more; slighter ones are wider."""
    heights: tuple[tuple[Chainage, Annotated[float, Quantity(-1e4, 1e4, "m")]], ...] = ()
    """[m along the road, height m] points of ramps, in place of the waypoints' heights."""
    speed: Forward = 13.9
    """m/s, where nothing else limits it."""
    zones: tuple[ZoneConfig, ...] = ()
    """Speed limits of stretches."""
    stops: tuple[StopConfig, ...] = ()
    """Stops, as at lights."""
    acceleration: Annotated[float, Quantity(0.0, 100.0, "m/s^2", above=True)] = 2.0
    """m/s^2, at most."""
    braking: Annotated[float, Quantity(0.0, 100.0, "m/s^2", above=True)] = 2.5
    """m/s^2, at most."""
    jerk: Jerk = 2.0
    """m/s^3, at most, along the road."""
    lateral: Annotated[float, Quantity(0.0, 100.0, "m/s^2", above=True)] = 2.5
    """m/s^2 in bends, and over crests and sags, at most."""
    bank: Share = 0.0
    """Roll into turns, as share of the angle at which the lateral acceleration is not felt;
    negative: out of them."""
    squat: Share = 0.0
    """Nose up under acceleration, as share of the angle whose tangent is the acceleration in g."""
    start: Chainage = 0.0
    """Where the drive begins, m along the road."""
    initial_speed: Annotated[float, Quantity(0.0, 1e3, "m/s")] = 0.0
    """m/s, at second 0 and before."""
    laps: Annotated[int, Quantity(1, 1000, "laps", whole=True)] = 1
    """Times round a closed road; then the vehicle stands."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.laps > 1 and not self.closed:
            raise misfit("expected 1 on a road that is not closed", "laps")
        return self

    def lay(self, place: Place) -> _Laid:
        """Return path and attitude."""
        road = lay_road(
            [waypoint.build(place) for waypoint in self.waypoints],
            radius_m=self.radius,
            closed=self.closed,
            heights=self.heights,
        )
        limits = Limits(self.speed, self.acceleration, self.braking, self.jerk, self.lateral)
        distance = drive(
            road,
            limits,
            zones=[Zone(zone.begin, zone.to, zone.speed) for zone in self.zones],
            stops=[Stop(stop.at, stop.seconds) for stop in self.stops],
            start_m=self.start,
            laps=self.laps,
            speed_mps=self.initial_speed,
        )
        path = StreetPath(road, distance)
        return path, StreetAttitude(path, self.bank, self.squat)


class TrajectoryConfig(Choice):
    """How the vehicle's reference point (the IMU) moves: one of these; at rest when none."""

    static: StaticConfig | None = None
    line: LineConfig | None = None
    steps: StepsConfig | None = None
    circle: CircleConfig | None = None
    ellipse: EllipseConfig | None = None
    sine: SineConfig | None = None
    street: StreetConfig | None = None
    file: ExistingFile | None = None
    """CSV of time, position and, if known, attitude."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        given = self.given
        if len(given) > 1:
            raise misfit(f"expected one of {', '.join(given)}, not several", given[1])
        return self

    def build(
        self,
        latitude_rad: float,
        longitude_rad: float,
        height_m: float,
        seconds: float | None = None,
    ) -> Vehicle:
        """Return the vehicle at a place (WGS-84).

        Raises
        ------
        ConfigError: the motion is not possible, or ends before `seconds`.
        InputFileError: the file does not hold a track.
        """
        place = Place(latitude_rad, longitude_rad, height_m)
        if self.file is not None:
            path, attitude = read_track(self.file, place)
            if seconds is not None and path.span_s[1] < seconds:
                raise ConfigError(
                    f"trajectory.file: {self.file} ends after {path.span_s[1]:g} s;"
                    f" expected at least the {seconds:g} s of the scenario"
                )
            return Vehicle(*place, path, attitude)
        name = next(iter(self.given), None)
        section = getattr(self, name) if name else StaticConfig()
        try:
            return Vehicle(*place, *section.lay(place))
        except ConfigError as error:
            raise ConfigError(f"trajectory.{name}.{error}") from error
