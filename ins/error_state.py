"""What the filter carries: nominal navigation, extra parameters, covariance of their errors.

Error vectors are laid out as `error_model` has them; behind the inertial errors follow, where
asked for, the scale of an odometer, the receiver clock (bias m, drift m/s, both times c) and one
inter-system bias (m) for every system but the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.attitude import attitude_corrected, attitude_error_n, skew
from deepgnss.core.earth import meridian_radius_m, transverse_radius_m
from deepgnss.core.records import FloatArray, InsState
from deepgnss.ins.error_model import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATTITUDE,
    GYRO_BIAS,
    GYRO_SCALE,
    POSITION,
    VELOCITY,
    WITH_BIASES,
    WITH_SCALES,
)


class Layout(NamedTuple):
    """Which errors the filter carries, and where."""

    inertial: int = WITH_BIASES  # or WITH_SCALES
    odometer: bool = False
    systems: tuple[str, ...] = ()  # of tight coupling; the clock is that of the first

    @property
    def size(self) -> int:
        """Length of the error vector."""
        return self.inertial + self.extras

    @property
    def extras(self) -> int:
        """Number of errors behind the inertial ones."""
        return int(self.odometer) + (1 + len(self.systems) if self.systems else 0)

    @property
    def vehicle(self) -> int:
        """Number of the first errors, which are the vehicle's own: inertial ones and odometer."""
        return self.inertial + int(self.odometer)

    @property
    def odometer_scale(self) -> int:
        """Index of the odometer's scale error."""
        return self.inertial

    @property
    def clock(self) -> int:
        """Index of the clock bias; the drift follows."""
        return self.vehicle

    def inter_system(self, system: str) -> int | None:
        """Index of a system's bias against the first; None for the first."""
        place = self.systems.index(system)
        return self.clock + 1 + place if place else None


@dataclass(frozen=True, slots=True)
class Estimate:
    """Nominal navigation state, nominal extra parameters, covariance of the errors of both."""

    layout: Layout
    ins: InsState
    extras: FloatArray  # (layout.extras,) in the layout's order
    P: FloatArray  # (layout.size, layout.size)

    def corrected(self, x: FloatArray, P: FloatArray) -> Estimate:
        """The estimate freed of an estimated error (size,), with the covariance that remains."""
        inertial = self.layout.inertial
        return replace(
            self,
            ins=corrected(self.ins, x[:inertial]),
            extras=self.extras - x[inertial:],
            P=P,
        )

    def extra(self, index: int) -> float:
        """Nominal value at an index of the error vector behind the inertial ones."""
        return float(self.extras[index - self.layout.inertial])


def turned_along(x_velocity_mps: FloatArray, size: int) -> FloatArray:
    """M (size, size): errors about the new estimate after body velocities corrected v by x (3,).

    Wheels and road say how fast the body moves along its own axes, nothing of where it heads: a
    wrong attitude leaves η = δv − v̂×φ alone (the invariant error, Barrau and Bonnabel 2017). When
    such a correction moves v̂, δv = η + v̂×φ has to move along, or the filter gains heading from
    nothing: after a MEMS unit's minute on wheels and road alone it stood off by five of its σ.
    """
    M = np.eye(size)
    M[VELOCITY, ATTITUDE] = -skew(x_velocity_mps)
    return M


def corrected(state: InsState, x: FloatArray) -> InsState:
    """Navigation state freed of an error (15,) or (21,): truth = estimate − error."""
    north_m = meridian_radius_m(state.lat_rad) + state.height_m
    east_m = transverse_radius_m(state.lat_rad) + state.height_m
    r_north, r_east, r_down = x[POSITION]
    scales = x.size == WITH_SCALES
    return replace(
        state,
        lat_rad=float(state.lat_rad - r_north / north_m),
        lon_rad=float(state.lon_rad - r_east / (east_m * np.cos(state.lat_rad))),
        height_m=float(state.height_m + r_down),
        v_n_mps=state.v_n_mps - x[VELOCITY],
        q_nb=attitude_corrected(state.q_nb, x[ATTITUDE]),
        gyro_bias_radps=state.gyro_bias_radps - x[GYRO_BIAS],
        accel_bias_mps2=state.accel_bias_mps2 - x[ACCEL_BIAS],
        gyro_scale=state.gyro_scale - x[GYRO_SCALE] if scales else state.gyro_scale,
        accel_scale=state.accel_scale - x[ACCEL_SCALE] if scales else state.accel_scale,
    )


def difference(estimate: InsState, truth: InsState) -> FloatArray:
    """Error vector (21,) of an estimate against the truth of the same instant."""
    north_m = meridian_radius_m(truth.lat_rad) + truth.height_m
    east_m = (transverse_radius_m(truth.lat_rad) + truth.height_m) * np.cos(truth.lat_rad)
    turn_rad = np.remainder(estimate.lon_rad - truth.lon_rad + np.pi, 2.0 * np.pi) - np.pi
    return np.concatenate(
        [
            [
                (estimate.lat_rad - truth.lat_rad) * north_m,
                turn_rad * east_m,
                truth.height_m - estimate.height_m,
            ],
            estimate.v_n_mps - truth.v_n_mps,
            attitude_error_n(estimate.q_nb, truth.q_nb),
            estimate.gyro_bias_radps - truth.gyro_bias_radps,
            estimate.accel_bias_mps2 - truth.accel_bias_mps2,
            estimate.gyro_scale - truth.gyro_scale,
            estimate.accel_scale - truth.accel_scale,
        ]
    )


def side_by_side(first: FloatArray, second: FloatArray) -> FloatArray:
    """Matrix of two on its diagonal: what SciPy makes of any number takes twenty times as long."""
    n, m = first.shape[0], second.shape[0]
    both = np.zeros((n + m, n + m))
    both[:n, :n], both[n:, n:] = first, second
    return both
