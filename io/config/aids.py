"""Sections on what helps the receiver: IMU, odometer, truth, oscillator, deep integration."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator, Field, model_validator

from deepgnss.core.records import Oscillator
from deepgnss.io.config.axes import Axes
from deepgnss.io.config.imu_grade import NamedImuGrade
from deepgnss.io.config.quantity import ExistingFile, Quantity, Section, Switch, misfit
from deepgnss.io.config.shipped import by_name, shipped_names

NovatelModel = Literal[
    "FSAS", "STIM300", "HG1700-AG11", "HG1700-AG17", "HG1700-AG58", "HG1700-AG62", "HG1900",
    "HG1930", "HG4930", "LN200", "ADIS16488", "uIMU", "ISA100C", "KVH1750", "CPT",
]  # fmt: skip
"""Units whose RAWIMU counts we know (NovAtel OEM7 reference, log RAWIMUSX)."""

Metres = Annotated[float, Quantity(-100.0, 100.0, "m")]
Degrees = Annotated[float, Quantity(-360.0, 360.0, "deg")]


class ImuUnitsConfig(Section):
    """Units of the IMU columns."""

    gyro: Literal["rad", "deg", "rad/s", "deg/s"] = "rad"
    """Of the gyro columns; per second for rates."""
    accel: Literal["m/s", "m/s^2", "g"] = "m/s"
    """Of the accelerometer columns."""


class AlignmentConfig(Section):
    """How the first attitude is found."""

    method: Literal["motion", "static", "config"] = "motion"
    """From motion, from rest (levelling) plus course, or as given here."""
    roll: Degrees | None = None
    """deg, with `method: config`."""
    pitch: Degrees | None = None
    """deg, with `method: config`."""
    yaw: Degrees | None = None
    """deg, with `method: config`."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for name in ("roll", "pitch", "yaw"):
            given = getattr(self, name) is not None
            if given != (self.method == "config"):
                raise misfit("expected an angle with `method: config`, and only then", name)
        return self


class ImuConfig(Section):
    """The inertial unit's log and mounting."""

    file: ExistingFile | None = None
    """Log; omitted: the `/imu` group of an HDF5 recording."""
    format: Literal["csv", "kfgins", "novatel_rawimu", "hdf5"] = "csv"
    """Format of the log."""
    kind: Literal["increments", "rates"] = "increments"
    """Angle and velocity increments, or rates and accelerations."""
    columns: Annotated[tuple[str, ...], Field(min_length=7)] | None = None
    """Names in file order, for files without a header we know."""
    units: ImuUnitsConfig = ImuUnitsConfig()
    model: NovatelModel | None = None
    """Unit behind a NovAtel log (its RAWIMU counts differ), with `format: novatel_rawimu`."""
    rate: Annotated[float, Quantity(1.0, 10_000.0, "Hz")] | None = None
    """Rate of the log, Hz, to hold it against; omitted: as found."""
    time: Literal["gpst", "sample", "tick"] = "gpst"
    """GPST seconds, samples of the IF clock, or ticks (with `tick` and `start` or `tag_file`)."""
    tick: Annotated[float, Quantity(0.0, 10.0, "s", above=True)] | None = None
    """Length of a tick, s, with `time: tick`."""
    start: Annotated[float, Quantity(0.0, 604_800.0, "s")] | None = None
    """GPST second of week of tick 0, with `time: tick`."""
    tag_file: ExistingFile | None = None
    """RTKLIB time tag file, with `time: tick`."""
    stamp: Literal["end", "start"] = "end"
    """The time stamp ends or starts its interval."""
    time_offset: Annotated[float, Quantity(-1e5, 1e5, "s")] | Literal["auto"] = 0.0
    """Added to IMU time, s; or auto."""
    axes: Axes = "FRD"
    """Directions of the log's axes in the vehicle (NovAtel: mostly RFU), or the 3×3 matrix that
    turns them to FRD."""
    grade: NamedImuGrade = Field(default="MTi-G", validate_default=True)
    """Error model: a name in configs/imu, or its values."""
    lever_arm: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """m, from the IMU to the antenna phase centre, in body FRD."""
    alignment: AlignmentConfig = AlignmentConfig()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.file is None and self.format != "hdf5":
            raise misfit("expected the IMU's log (only an HDF5 recording can hold one)", "file")
        if (self.tick is not None) != (self.time == "tick"):
            raise misfit("expected a length in s with `time: tick`, and only then", "tick")
        if self.time == "tick" and (self.start is None) == (self.tag_file is None):
            raise misfit("expected either `start` or `tag_file` with `time: tick`", "start")
        if (self.model is not None) != (self.format == "novatel_rawimu"):
            known = ", ".join(get_args(NovatelModel))
            raise misfit(f"expected one of {known} with `format: novatel_rawimu` only", "model")
        if self.format in ("kfgins", "novatel_rawimu"):
            if self.kind != "increments":
                raise misfit(f"expected increments: {self.format} holds nothing else", "kind")
            if (self.units.gyro, self.units.accel) != ("rad", "m/s"):
                raise misfit(f"expected rad and m/s: {self.format} holds nothing else", "units")
        rates = {"rad/s", "deg/s"}
        if (self.units.gyro in rates) != (self.kind == "rates"):
            raise misfit(f"expected a unit of {self.kind}", "units.gyro")
        if (self.units.accel == "m/s") != (self.kind == "increments"):
            raise misfit(f"expected a unit of {self.kind}", "units.accel")
        return self


class OdometerConfig(Section):
    """Wheel speed log."""

    file: ExistingFile
    """CSV of time and speed."""
    scale: Annotated[float, Quantity(0.0, 100.0, "", above=True)] = 1.0
    """Factor from the log's speed to m/s."""


class TruthConfig(Section):
    """Reference trajectory; used for reports only, never for processing."""

    file: ExistingFile
    """Log of the reference."""
    format: Literal["csv", "rtklib_pos", "kfgins_nav"] = "csv"
    """Format of the log."""
    sections: ExistingFile | None = None
    """CSV of stretches of the way to tell errors of: name, from_tow_s, to_tow_s (GPST)."""


class OscillatorConfig(Section):
    """Power-law coefficients of the receiver's oscillator, S_y(f) = h0 + h₋₁/f + h₋₂/f²."""

    name: str = "custom"
    """Name in reports."""
    h0: Annotated[float, Quantity(0.0, 1e-12, "s")]
    """White frequency noise, s (1/Hz)."""
    h_1: Annotated[float, Quantity(0.0, 1e-12, "")] = Field(0.0, alias="h-1")
    """Flicker frequency noise, dimensionless."""
    h_2: Annotated[float, Quantity(0.0, 1e-12, "Hz")] = Field(alias="h-2")
    """Random walk of frequency, Hz."""
    g_sensitivity: Annotated[float, Quantity(0.0, 1e-6, "1/g")] = 0.0
    """Relative frequency change per g of acceleration."""

    def oscillator(self) -> Oscillator:
        """Return the record the error models work with."""
        return Oscillator(self.name, self.h0, self.h_1, self.h_2, self.g_sensitivity)


def oscillator_names() -> list[str]:
    """Names of the oscillators that ship with the package."""
    return shipped_names("oscillators")


def _oscillator_of_name(value: object) -> object:
    return by_name("oscillators", value, "h-parameters")


NamedOscillator = Annotated[
    OscillatorConfig,
    BeforeValidator(_oscillator_of_name, json_schema_input_type=str | dict[str, Any]),
]


class DeepConfig(Section):
    """Deep integration: the INS feeds the tracking loops forward."""

    enabled: Switch = True
    """Aid the loops whenever there is an IMU."""
    coupling: Literal["loose", "tight"] = "loose"
    """What the INS filter takes from the receiver: position and velocity, or ranges and rates."""
    epoch: Annotated[float, Quantity(0.01, 1.0, "s")] = 0.1
    """Navigation epoch, s: how often the loop through the INS closes."""
    phase_floor: Annotated[float, Quantity(0.0, 0.1, "cycle")] = 0.008
    """1σ of a tracked phase beside thermal noise: reflections, the loop's own errors, cycles."""
