"""Section `ins`: how the inertial navigation is run and what else a vehicle tells it."""

from __future__ import annotations

from typing import Annotated, Literal

from deepgnss.io.config.aids import Degrees, Metres
from deepgnss.io.config.quantity import Quantity, Section, Switch

Speed = Annotated[float, Quantity(0.0, 100.0, "m/s", above=True)]


class VehicleConfig(Section):
    """A car, that moves where its rear axle points (non-holonomic constraint)."""

    axle: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """m, from the IMU to the middle of the rear axle, in body FRD."""
    mounting: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the body axes against those of the vehicle, deg."""
    lateral: Speed = 0.1
    """1σ of the axle's lateral velocity, as a mean over a second, m/s."""
    vertical: Speed = 0.1
    """1σ of its vertical velocity, as a mean over a second, m/s."""


class WheelConfig(Section):
    """How well the odometer tells the speed of the rear axle."""

    sigma: Speed = 0.1
    """1σ of a speed, m/s."""
    scale: Annotated[float, Quantity(0.0, 1.0, "", above=True)] = 0.02
    """1σ of the scale it is off by at the start; the filter finds it."""


class GnssErrorConfig(Section):
    """Errors of the GNSS solution beside those its own σ tells."""

    position: Annotated[float, Quantity(0.0, 1000.0, "m")] = 0.0
    """m, 1σ per axis on top of each fix's own."""
    velocity: Annotated[float, Quantity(0.0, 100.0, "m/s")] = 0.0
    """m/s, 1σ per axis on top of each fix's own."""
    velocities: Switch = True
    """Use the solution's velocities; not where they are differences of its own positions."""
    correlation: Annotated[float, Quantity(0.0, 3600.0, "s")] = 0.0
    """Time for which errors of positions last, s: fixes closer than twice that count the less."""


class InsConfig(Section):
    """Inertial navigation: the filter and what it believes (`deepgnss ins`)."""

    states: Literal[15, 21] = 15
    """Errors estimated: navigation and biases, or scale factors as well."""
    epoch: Annotated[float, Quantity(0.01, 10.0, "s")] = 0.5
    """Time between constraints and rows of the trajectory, beside those of the fixes, s."""
    gnss: GnssErrorConfig = GnssErrorConfig()
    vehicle: VehicleConfig | None = None
    """Omitted: nothing but the GNSS solution (and rest) holds the navigation."""
    odometer: WheelConfig = WheelConfig()
    standstill: Switch = True
    """Take quiet sensors at low speed for rest: no velocity, no turning."""
    smoother: Switch = True
    """Go back over the run as well (Rauch–Tung–Striebel)."""
    false_alarm: Annotated[float, Quantity(1e-12, 0.5, "")] = 1e-3
    """Probability with which a sound measurement is refused."""
    restart_after: Annotated[int, Quantity(1, 100_000, "fixes", whole=True)] = 10
    """Fixes refused in a row after which the filter starts anew."""
