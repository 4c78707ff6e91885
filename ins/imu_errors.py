"""Errors of an inertial unit drawn by its grade (T 4.3, T(4.24), T(4.25)), put on true increments.

A reading is (1 + scale)·true + bias + noise. The bias is a constant drawn at turn-on plus a
Gauss–Markov drift that starts at zero (its start is part of the constant, as T has it); noise is
white on the rate. Everything follows the increments' own intervals exactly, so the result does not
depend on how they are cut into blocks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade


class SensorErrors(NamedTuple):
    """True errors of the sensors at the ends of a block's intervals."""

    gyro_bias_radps: FloatArray  # (n, 3), turn-on bias and drift
    accel_bias_mps2: FloatArray  # (n, 3)
    gyro_scale: FloatArray  # (3,)
    accel_scale: FloatArray  # (3,)


class ImuErrors:
    """The errors of one unit over one run; blocks are to be given in order.

    Parameters
    ----------
    grade: 1σ of what is drawn. The same generator state gives the same draws for any grade, each
        in proportion to its σ, so that runs with two grades can be compared.
    rng: parent of the streams of turn-on errors, gyros and accelerometers.
    """

    def __init__(self, grade: ImuGrade, rng: np.random.Generator) -> None:
        turn_on, gyro, accel = rng.spawn(3)
        bias, accel_bias, scale, accel_scale = turn_on.standard_normal((4, 3))
        self.gyro_scale: FloatArray = scale * grade.gyro_scale
        self.accel_scale: FloatArray = accel_scale * grade.accel_scale
        self._gyro = _Triad(
            bias * grade.gyro_bias_radps,
            grade.gyro_drift_radps2_rthz,
            grade.gyro_drift_time_s,
            grade.gyro_noise_rad_rts,
            gyro,
        )
        self._accel = _Triad(
            accel_bias * grade.accel_bias_mps2,
            grade.accel_drift_mps3_rthz,
            grade.accel_drift_time_s,
            grade.accel_noise_mps_rts,
            accel,
        )

    def apply(self, block: ImuBlock) -> tuple[ImuBlock, SensorErrors]:
        """Put the errors on true increments; also return what they truly were."""
        dtheta, gyro_bias = self._gyro.increments(block.dt_s)
        dv, accel_bias = self._accel.increments(block.dt_s)
        read = replace(
            block,
            dtheta_b_rad=block.dtheta_b_rad * (1.0 + self.gyro_scale) + dtheta,
            dv_b_mps=block.dv_b_mps * (1.0 + self.accel_scale) + dv,
        )
        return read, SensorErrors(gyro_bias, accel_bias, self.gyro_scale, self.accel_scale)


class _Triad:
    """Additive errors of three like sensors: constant, drift and noise, in the rate's unit."""

    def __init__(
        self,
        constant: FloatArray,
        drift_rthz: float,
        drift_time_s: float,
        noise_rts: float,
        rng: np.random.Generator,
    ) -> None:
        self._constant = constant
        self._drift_rthz = drift_rthz
        self._drift_time_s = drift_time_s
        self._noise_rts = noise_rts
        self._rng = rng
        self._drift: FloatArray = np.zeros(3)

    def increments(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrals of the error over consecutive intervals (n, 3), and biases at their ends."""
        draws = self._rng.standard_normal((dt_s.size, 2, 3))
        time_s, density = self._drift_time_s, self._drift_rthz
        decay = np.exp(-dt_s / time_s)
        step = density * np.sqrt(-0.5 * time_s * np.expm1(-2.0 * dt_s / time_s))
        drift = gauss_markov(self._drift, decay, step[:, np.newaxis] * draws[:, 0])
        self._drift = drift[-1] if drift.size else self._drift
        # Between its known ends the drift has the mean ∫ = T·tanh(Δt/2T)·(start + end) and a
        # variance of density²·Δt³/12 (1 − Δt²/10T²…), white from interval to interval like noise.
        mean_s = time_s * np.tanh(0.5 * dt_s / time_s)
        noise = np.sqrt(self._noise_rts**2 * dt_s + density**2 * dt_s**3 / 12.0)
        integral = (
            self._constant * dt_s[:, np.newaxis]
            + mean_s[:, np.newaxis] * (drift[:-1] + drift[1:])
            + noise[:, np.newaxis] * draws[:, 1]
        )
        return integral, self._constant + drift[1:]


@kernel
def gauss_markov(start: FloatArray, decay: FloatArray, steps: FloatArray) -> FloatArray:
    """First-order process x[k+1] = decay[k]·x[k] + steps[k] from `start` (m,): (n + 1, m)."""
    n, m = steps.shape
    out = np.empty((n + 1, m))
    out[0] = start
    for k in range(n):
        for i in range(m):
            out[k + 1, i] = decay[k] * out[k, i] + steps[k, i]
    return out
