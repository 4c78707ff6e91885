"""Error states of the navigation, their dynamics and what noise adds (T 2.4.3, T(4.7–4.12)).

Error = estimate − truth throughout. Position and velocity errors are metres and m/s in NED, the
attitude error is the phi-angle: C_nb_estimated = (I − [φ×])·C_nb_true. Sensor states are the errors
of the *estimated* bias and scale, a sensor reading (1 + scale)·true + bias: what is overestimated
is taken off too much, hence minus where T has plus for the sensor's own error.

Where T as scanned differs from the derivative of the mechanization, the derivative counts: T(4.9)
has R_N for R_M below v_N², T(2.58) has −1 for ∂ḣ/∂h, which is 0. As there, the growth of gravity
towards the poles (8e-9 m/s² per metre) is left out.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.attitude import Vector, cross, matrix, rotated
from deepgnss.core.earth import (
    earth_rate_n,
    gravity_mps2,
    meridian_radius_m,
    transport_rate_n,
    transverse_radius_m,
)
from deepgnss.core.errors import ConfigError
from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, ImuGrade

POSITION: Final = slice(0, 3)
VELOCITY: Final = slice(3, 6)
ATTITUDE: Final = slice(6, 9)
GYRO_BIAS: Final = slice(9, 12)
ACCEL_BIAS: Final = slice(12, 15)
GYRO_SCALE: Final = slice(15, 18)
ACCEL_SCALE: Final = slice(18, 21)

WITH_BIASES: Final = 15
"""Size of the inertial error state without scale factors."""

WITH_SCALES: Final = 21
"""Size of the inertial error state with scale factors."""

SUB_INTERVAL_S: Final = 0.05
"""Longest stretch over which F is held constant (unless a single increment is longer)."""


class ProcessNoise(NamedTuple):
    """White noise of the sensors and the Gauss–Markov process of each bias, the same on all axes.

    Densities are amplitudes, two-sided: noise n on a rate adds n²·t to the variance of its
    integral.
    """

    gyro_rad_rts: float
    accel_mps_rts: float
    gyro_drift_radps2_rthz: float
    accel_drift_mps3_rthz: float
    gyro_time_s: float
    accel_time_s: float


def process_noise(grade: ImuGrade) -> ProcessNoise:
    """Noise of a grade with one Gauss–Markov state per axis for constant bias b and drift d both.

    The state keeps the driving density q of the drift, which rules short times, and the variance
    S² = b² + q²T/2 of the sum, which rules long ones; its correlation time is therefore
    2S²/q² = T + 2b²/q². A state of the drift's own T would forget the constant: a unit of
    250 deg/h with a drift of 0.5 would lose 4 deg/h of its known bias per minute.
    """
    return ProcessNoise(
        grade.gyro_noise_rad_rts,
        grade.accel_noise_mps_rts,
        grade.gyro_drift_radps2_rthz,
        grade.accel_drift_mps3_rthz,
        _correlation_s(
            grade.gyro_bias_radps, grade.gyro_drift_radps2_rthz, grade.gyro_drift_time_s
        ),
        _correlation_s(
            grade.accel_bias_mps2, grade.accel_drift_mps3_rthz, grade.accel_drift_time_s
        ),
    )


def bias_sigmas(grade: ImuGrade, running_s: float = 0.0) -> tuple[float, float]:
    """1σ of gyro (rad/s) and accelerometer (m/s²) bias, constant and drift, a while after turn-on.

    T counts the drift's start into the constant; a unit that has run for long has running_s inf.
    """
    return (
        _bias_sigma(
            grade.gyro_bias_radps,
            grade.gyro_drift_radps2_rthz,
            grade.gyro_drift_time_s,
            running_s,
        ),
        _bias_sigma(
            grade.accel_bias_mps2,
            grade.accel_drift_mps3_rthz,
            grade.accel_drift_time_s,
            running_s,
        ),
    )


class InitialSigmas(NamedTuple):
    """What is known of the navigation at its start: 1σ per axis."""

    position_m: float
    velocity_mps: float
    tilt_rad: float
    heading_rad: float


def initial_covariance(
    grade: ImuGrade, sigmas: InitialSigmas, states: int = WITH_BIASES, running_s: float = 0.0
) -> FloatArray:
    """Diagonal covariance (states, states) of a start; that of the sensors from their grade."""
    if states not in (WITH_BIASES, WITH_SCALES):
        raise ConfigError(f"inertial error states: {states}; {WITH_BIASES} or {WITH_SCALES} fit")
    gyro_bias, accel_bias = bias_sigmas(grade, running_s)
    sigma = np.empty(WITH_SCALES)
    sigma[POSITION] = sigmas.position_m
    sigma[VELOCITY] = sigmas.velocity_mps
    sigma[ATTITUDE] = sigmas.tilt_rad, sigmas.tilt_rad, sigmas.heading_rad
    sigma[GYRO_BIAS], sigma[ACCEL_BIAS] = gyro_bias, accel_bias
    sigma[GYRO_SCALE], sigma[ACCEL_SCALE] = grade.gyro_scale, grade.accel_scale
    return np.diag(sigma[:states] ** 2)


@kernel
def system_matrix(
    lat_rad: float,
    height_m: float,
    v_n_mps: Vector,
    C_nb: FloatArray,
    f_n_mps2: FloatArray,
    omega_ib_b_radps: FloatArray,
    noise: ProcessNoise,
    states: int,
) -> FloatArray:
    """F (states, states) of ẋ = F·x + w, by blocks.

    δṙ: T(2.55) with δr = ((R_M + h)·δφ, (R_N + h)·cosφ·δλ, −δh), whose metres change on the way;
    δv̇ = f×φ − (2ω_ie + ω_en)×δv − (2δω_ie + δω_en)×v + δg + C_nb·δf_b, T(2.60);
    φ̇ = −ω_in×φ + δω_in − C_nb·δω_b, T(2.67);
    biases decay by −b/T; δf_b = −b_a − f_b·s_a, δω_b = −b_g − ω_b·s_g.
    """
    v_north, v_east, v_down = v_n_mps
    meridian_m = meridian_radius_m(lat_rad) + height_m
    transverse_m = transverse_radius_m(lat_rad) + height_m
    tan = math.tan(lat_rad)
    omega_ie = earth_rate_n(lat_rad)
    omega_en = transport_rate_n(lat_rad, height_m, v_north, v_east)
    omega_in = (omega_ie[0] + omega_en[0], omega_ie[1] + omega_en[1], omega_ie[2] + omega_en[2])
    coriolis = (omega_in[0] + omega_ie[0], omega_in[1] + omega_ie[1], omega_in[2] + omega_ie[2])

    ie_by_r = np.zeros((3, 3))  # ∂ω_ie/∂r, T(2.61)
    ie_by_r[0, 0] = omega_ie[2] / meridian_m
    ie_by_r[2, 0] = -omega_ie[0] / meridian_m
    en_by_v = np.zeros((3, 3))  # ∂ω_en/∂v, T(2.62)
    en_by_v[0, 1] = 1.0 / transverse_m
    en_by_v[1, 0] = -1.0 / meridian_m
    en_by_v[2, 1] = -tan / transverse_m
    en_by_r = np.zeros((3, 3))  # ∂ω_en/∂r, T(2.62); down is minus height
    en_by_r[0, 2] = v_east / transverse_m**2
    en_by_r[1, 2] = -v_north / meridian_m**2
    en_by_r[2, 2] = -v_east * tan / transverse_m**2
    en_by_r[2, 0] = -v_east * (1.0 + tan * tan) / (transverse_m * meridian_m)
    v_cross = cross_matrix(v_n_mps)

    F = np.zeros((states, states))
    F[0, 0] = -v_down / meridian_m
    F[0, 2] = v_north / meridian_m
    F[1, 0] = v_east * tan / meridian_m
    F[1, 1] = -v_down / transverse_m - v_north * tan / meridian_m
    F[1, 2] = v_east / transverse_m
    F[0, 3] = F[1, 4] = F[2, 5] = 1.0

    F[3:6, 0:3] = v_cross @ (2.0 * ie_by_r + en_by_r)
    F[5, 2] += 2.0 * gravity_mps2(lat_rad, height_m) / (math.sqrt(meridian_m * transverse_m))
    F[3:6, 3:6] = v_cross @ en_by_v - cross_matrix(coriolis)
    F[3:6, 6:9] = cross_matrix((f_n_mps2[0], f_n_mps2[1], f_n_mps2[2]))
    F[3:6, 12:15] = -C_nb

    F[6:9, 0:3] = ie_by_r + en_by_r
    F[6:9, 3:6] = en_by_v
    F[6:9, 6:9] = -cross_matrix(omega_in)
    F[6:9, 9:12] = C_nb

    for axis in range(3):
        F[9 + axis, 9 + axis] = -1.0 / noise.gyro_time_s
        F[12 + axis, 12 + axis] = -1.0 / noise.accel_time_s
    if states == 21:
        F[6:9, 15:18] = C_nb * omega_ib_b_radps
        F[3:6, 18:21] = -C_nb * (f_n_mps2 @ C_nb)
    return F


@kernel
def noise_density(noise: ProcessNoise, states: int) -> FloatArray:
    """Diagonal (states,) of the noise density of F's right-hand side, the same in any axes."""
    density = np.zeros(states)
    density[3:6] = noise.accel_mps_rts**2
    density[6:9] = noise.gyro_rad_rts**2
    density[9:12] = noise.gyro_drift_radps2_rthz**2
    density[12:15] = noise.accel_drift_mps3_rthz**2
    return density


@kernel
def discretize(F: FloatArray, density: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Φ and Q of a step with constant F: Φ = e^(F·dt), Q = ∫ Φ(τ)·diag(density)·Φ(τ)ᵀ dτ.

    Φ by its series to the third order, with which the chain gyro bias → tilt → velocity → position
    ends; Q by Simpson's rule, exact to the third order in τ, symmetric and positive by its form.
    """
    states = F.shape[0]
    whole, half = np.eye(states), np.eye(states)
    F1 = F * dt_s
    F2 = F1 @ F1
    F3 = F2 @ F1
    whole += F1 + F2 / 2.0 + F3 / 6.0
    half += F1 / 2.0 + F2 / 8.0 + F3 / 48.0
    Q = (half * density) @ half.T * (4.0 * dt_s / 6.0)
    Q += (whole * density) @ whole.T * (dt_s / 6.0)
    for k in range(states):
        Q[k, k] += density[k] * dt_s / 6.0
    return whole, 0.5 * (Q + Q.T)


@kernel
def predicted(P: FloatArray, Phi: FloatArray, Q: FloatArray) -> FloatArray:
    """Covariance a step later, Φ·P·Φᵀ + Q, symmetric to the last bit."""
    later = Phi @ P @ Phi.T + Q
    return 0.5 * (later + later.T)


@kernel
def transition(
    lat_rad: FloatArray,
    height_m: FloatArray,
    v_n_mps: FloatArray,
    q_nb: FloatArray,
    dt_s: FloatArray,
    dtheta_b_rad: FloatArray,
    dv_b_mps: FloatArray,
    noise: ProcessNoise,
    states: int,
) -> tuple[FloatArray, FloatArray]:
    """Φ and Q (states, states) over consecutive increments, in sub-intervals of SUB_INTERVAL_S.

    Row k of the arrays (n,), (n, 3), (n, 4): pose at the end of increment k, the increment's
    length and its values freed of sensor errors. No increment: the identity and zero.
    """
    Phi, Q = np.eye(states), np.zeros((states, states))
    density = noise_density(noise, states)
    first = 0
    while first < dt_s.size:
        last, length_s = first, dt_s[first]
        while last + 1 < dt_s.size and length_s + dt_s[last + 1] <= SUB_INTERVAL_S * 1.001:
            last += 1
            length_s += dt_s[last]
        f_n, omega_b = np.zeros(3), np.zeros(3)
        for k in range(first, last + 1):
            theta = (dtheta_b_rad[k, 0], dtheta_b_rad[k, 1], dtheta_b_rad[k, 2])
            dv = (dv_b_mps[k, 0], dv_b_mps[k, 1], dv_b_mps[k, 2])
            turn = cross(theta, dv)  # half of it lies after the middle of the increment
            q = (q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3])
            dv_n = rotated(q, (dv[0] - 0.5 * turn[0], dv[1] - 0.5 * turn[1], dv[2] - 0.5 * turn[2]))
            for axis in range(3):
                f_n[axis] += dv_n[axis] / length_s
                omega_b[axis] += theta[axis] / length_s
        middle = (first + last) // 2
        v_n, q_middle = v_n_mps[middle], q_nb[middle]
        F = system_matrix(
            lat_rad[middle],
            height_m[middle],
            (v_n[0], v_n[1], v_n[2]),
            np.array(matrix((q_middle[0], q_middle[1], q_middle[2], q_middle[3]))),
            f_n,
            omega_b,
            noise,
            states,
        )
        Phi_step, Q_step = discretize(F, density, length_s)
        Phi = Phi_step @ Phi
        Q = predicted(Q, Phi_step, Q_step)
        first = last + 1
    return Phi, Q


@kernel
def cross_matrix(v: Vector) -> FloatArray:
    """As `attitude.skew`, of three numbers."""
    cross = np.zeros((3, 3))
    cross[0, 1], cross[0, 2], cross[1, 2] = -v[2], v[1], -v[0]
    cross[1, 0], cross[2, 0], cross[2, 1] = v[2], -v[1], v[0]
    return cross


def _correlation_s(bias: float, drift_density: float, drift_time_s: float) -> float:
    if drift_density <= 0.0:
        return math.inf  # a constant
    return drift_time_s + 2.0 * bias**2 / drift_density**2


def _bias_sigma(bias: float, density: float, time_s: float, running_s: float) -> float:
    drift2 = -0.5 * density**2 * time_s * math.expm1(-2.0 * running_s / time_s)
    return math.sqrt(bias**2 + drift2)
