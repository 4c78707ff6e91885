"""Section on the errors of an inertial unit: units as its table and data sheets have them."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final

from pydantic import BeforeValidator

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import ImuGrade
from deepgnss.io.config.quantity import Quantity, Section
from deepgnss.io.config.shipped import by_name, shipped_names

_DEG: Final = math.pi / 180.0
_DEG_PER_HOUR: Final = _DEG / 3600.0
_PER_ROOT_HOUR: Final = 1.0 / 60.0
_MGAL: Final = 1e-5  # m/s²
_PPM: Final = 1e-6

CorrelationTime = Annotated[float, Quantity(0.0, 1e7, "s", above=True)]
Scale = Annotated[float, Quantity(0.0, 1e5, "ppm")]


class GyroErrorConfig(Section):
    """Errors of each gyro, 1σ."""

    bias: Annotated[float, Quantity(0.0, 1e5, "deg/h")]
    """Turn-on bias, deg/h."""
    drift: Annotated[float, Quantity(0.0, 1e5, "deg/h/s/√Hz")] = 0.0
    """Root of the power density that drives the Gauss–Markov drift, deg/h/s/√Hz."""
    drift_time: CorrelationTime = 3600.0
    """Correlation time of the drift, s."""
    noise: Annotated[float, Quantity(0.0, 1e3, "deg/√h")]
    """Angle random walk, deg/√h."""
    scale: Scale = 0.0
    """Scale factor error, ppm."""


class AccelerometerErrorConfig(Section):
    """Errors of each accelerometer, 1σ."""

    bias: Annotated[float, Quantity(0.0, 1e6, "mGal")]
    """Turn-on bias, mGal (10⁻⁵ m/s²)."""
    drift: Annotated[float, Quantity(0.0, 1e6, "mGal/s/√Hz")] = 0.0
    """Root of the power density that drives the Gauss–Markov drift, mGal/s/√Hz."""
    drift_time: CorrelationTime = 3600.0
    """Correlation time of the drift, s."""
    noise: Annotated[float, Quantity(0.0, 1e2, "m/s/√h")]
    """Velocity random walk, m/s/√h."""
    scale: Scale = 0.0
    """Scale factor error, ppm."""


class InitialErrorConfig(Section):
    """Errors a navigation with the unit starts with, 1σ."""

    velocity: Annotated[float, Quantity(0.0, 100.0, "m/s")] = 0.1
    """Each horizontal velocity, m/s."""
    tilt: Annotated[float, Quantity(0.0, 90.0, "deg")] = 1.0
    """Roll and pitch, deg."""
    heading: Annotated[float, Quantity(0.0, 180.0, "deg")] = 5.0
    """Heading, deg."""


class ImuGradeConfig(Section):
    """Error model of an inertial unit (T table 4.1), the same for its three axes."""

    name: str = "custom"
    """Name in reports."""
    gyro: GyroErrorConfig
    accelerometer: AccelerometerErrorConfig
    initial: InitialErrorConfig = InitialErrorConfig()

    def build(self) -> ImuGrade:
        """Return the record the error models work with, in SI units."""
        gyro, accel, initial = self.gyro, self.accelerometer, self.initial
        return ImuGrade(
            name=self.name,
            gyro_bias_radps=gyro.bias * _DEG_PER_HOUR,
            gyro_drift_radps2_rthz=gyro.drift * _DEG_PER_HOUR,
            gyro_drift_time_s=gyro.drift_time,
            gyro_noise_rad_rts=gyro.noise * _DEG * _PER_ROOT_HOUR,
            gyro_scale=gyro.scale * _PPM,
            accel_bias_mps2=accel.bias * _MGAL,
            accel_drift_mps3_rthz=accel.drift * _MGAL,
            accel_drift_time_s=accel.drift_time,
            accel_noise_mps_rts=accel.noise * _PER_ROOT_HOUR,
            accel_scale=accel.scale * _PPM,
            velocity_mps=initial.velocity,
            tilt_rad=initial.tilt * _DEG,
            heading_rad=initial.heading * _DEG,
        )


def imu_grade_names() -> list[str]:
    """Names of the inertial units that ship with the package."""
    return shipped_names("imu")


def _grade_of_name(value: object) -> object:
    return by_name("imu", value, "its values")


NamedImuGrade = Annotated[
    ImuGradeConfig,
    BeforeValidator(_grade_of_name, json_schema_input_type=str | dict[str, Any]),
]
"""A name in configs/imu, or the values."""


def imu_grade(name: str) -> ImuGrade:
    """Return the error model of a unit that ships with the package.

    Raises
    ------
    ConfigError: there is no unit of that name.
    """
    if name not in imu_grade_names():
        raise ConfigError(f"IMU grade {name!r}: expected one of {', '.join(imu_grade_names())}")
    return ImuGradeConfig.model_validate(_grade_of_name(name)).build()
