"""Wheel speed log: distance rolled along the forward axis, counted in pulses, with its errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.sim.imu.carried import Moving

_NODES = 8


class OdometerErrors(NamedTuple):
    """What a wheel speed log gets wrong."""

    scale_error: float = 0.0  # it reads (1 + scale_error) times the distance rolled
    noise_mps: float = 0.0  # white, 1σ of one reading
    pulse_m: float = 0.0  # distance is counted in whole pulses; 0: not counted


def wheel_speed(
    vehicle: Moving,
    rate_hz: float,
    seconds: float,
    errors: OdometerErrors,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Times of readings, s since the start, and speeds in m/s, (n,) each; backwards is negative.

    A reading is the distance rolled since the one before it over the time between them; the first
    comes one interval after the start. Distance is the integral of the velocity's forward part at
    the vehicle's reference point, the middle of an axle that does not steer.
    """
    edges_s = np.arange(int(seconds * rate_hz * (1.0 + 1e-12)) + 1) / rate_hz
    breaks_s = np.asarray(vehicle.breaks_s, dtype=np.float64)
    inside = breaks_s[(breaks_s > 0.0) & (breaks_s < edges_s[-1])]
    cuts_s = np.union1d(edges_s, inside)
    points, weights = np.polynomial.legendre.leggauss(_NODES)
    half_s = 0.5 * np.diff(cuts_s)
    times_s = (cuts_s[:-1] + half_s)[:, np.newaxis] + half_s[:, np.newaxis] * points
    pose = vehicle.pose(times_s.ravel())
    forward = np.einsum("ni,ni->n", pose.C_eb[:, :, 0], pose.v_e_mps).reshape(times_s.shape)
    parts = half_s * (forward @ weights)
    steps_m = np.add.reduceat(parts, np.searchsorted(cuts_s, edges_s[:-1]))
    rolled_m = np.append(0.0, np.cumsum(steps_m * (1.0 + errors.scale_error)))
    if errors.pulse_m:
        rolled_m = np.floor(rolled_m / errors.pulse_m) * errors.pulse_m
    noise_mps = errors.noise_mps * rng.standard_normal(edges_s.size - 1)
    return edges_s[1:], np.diff(rolled_m) * rate_hz + noise_mps
