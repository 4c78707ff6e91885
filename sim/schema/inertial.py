"""Sections `imu` and `odometer` of a scenario: the logs beside the samples."""

from __future__ import annotations

import math
from typing import Annotated, Self, get_args

from pydantic import model_validator

from deepgnss.io.config.aids import NovatelModel
from deepgnss.io.config.axes import Axes
from deepgnss.io.config.imu_grade import NamedImuGrade
from deepgnss.io.config.quantity import Quantity, Section, misfit
from deepgnss.io.imu import ImuFormat, ImuKind
from deepgnss.sim.imu.carried import VibrationLine
from deepgnss.sim.imu.odometer import OdometerErrors

Swing = Annotated[float, Quantity(0.0, 0.1, "m")]
Tilt = Annotated[float, Quantity(0.0, 10.0, "deg")]


class VibrationConfig(Section):
    """One line of the vibration the unit feels on its mount; the antenna does not."""

    frequency: Annotated[float, Quantity(0.0, 1000.0, "Hz", above=True)]
    """Hz."""
    position: tuple[Swing, Swing, Swing] = (0.0, 0.0, 0.0)
    """Amplitudes forward, right, down, m; their phases are random."""
    angle: tuple[Tilt, Tilt, Tilt] = (0.0, 0.0, 0.0)
    """Amplitudes about these axes, deg."""

    def build(self) -> VibrationLine:
        """Return the record, phases still zero."""
        roll, pitch, yaw = (math.radians(angle) for angle in self.angle)
        return VibrationLine(self.frequency, self.position, (roll, pitch, yaw))


class ImuLogConfig(Section):
    """The inertial unit, at the point that follows the trajectory, and its log.

    The log begins a second before the recording and ends a second after it.
    """

    rate: Annotated[float, Quantity(50.0, 2000.0, "Hz")] = 200.0
    """Rows per second."""
    grade: NamedImuGrade | None = None
    """Errors: a name in configs/imu, or their values; omitted: none."""
    format: ImuFormat = "csv"
    """Format of the log."""
    kind: ImuKind = "increments"
    """Angle and velocity increments, or rates and accelerations (means over the intervals)."""
    axes: Axes = "FRD"
    """Directions of the log's axes in the vehicle, or the 3×3 matrix that turns them to FRD."""
    model: NovatelModel | None = None
    """Unit whose counts a NovAtel log holds, with `format: novatel_rawimu`."""
    vibration: tuple[VibrationConfig, ...] = ()
    """Lines of vibration."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.model is not None) != (self.format == "novatel_rawimu"):
            known = ", ".join(get_args(NovatelModel))
            raise misfit(f"expected one of {known} with `format: novatel_rawimu` only", "model")
        if self.kind == "rates" and self.format in ("kfgins", "novatel_rawimu"):
            raise misfit(f"expected increments: {self.format} holds nothing else", "kind")
        return self


class OdometerLogConfig(Section):
    """Wheel speed along the vehicle's forward axis."""

    rate: Annotated[float, Quantity(0.1, 1000.0, "Hz")] = 10.0
    """Rows per second."""
    scale_error: Annotated[float, Quantity(-0.5, 0.5, "")] = 0.0
    """It reads (1 + this) times the distance rolled."""
    noise: Annotated[float, Quantity(0.0, 10.0, "m/s")] = 0.0
    """White, 1σ of a row, m/s."""
    pulse: Annotated[float, Quantity(0.0, 10.0, "m")] = 0.0
    """Distance is counted in whole pulses of this length, m; 0: not counted."""

    def build(self) -> OdometerErrors:
        """Return the record."""
        return OdometerErrors(self.scale_error, self.noise, self.pulse)
