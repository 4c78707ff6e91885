"""F and Q of the error states against perturbed mechanizations, Van Loan and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from deepgnss.core.attitude import quaternion_from_euler, rotation_matrix
from deepgnss.core.records import ImuGrade, InsState
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    WITH_BIASES,
    WITH_SCALES,
    InitialSigmas,
    ProcessNoise,
    bias_sigmas,
    discretize,
    initial_covariance,
    noise_density,
    predicted,
    process_noise,
    system_matrix,
    transition,
)
from deepgnss.ins.error_state import corrected, difference
from deepgnss.ins.filter import check_covariance
from deepgnss.ins.mechanization import NOTHING_BEFORE, calibration_of, mechanize, pose_of

DEG = np.pi / 180.0
MTI_G = ImuGrade(
    "MTi-G",
    15 * DEG / 3600,
    100 * DEG / 3600,
    600.0,
    3 * DEG / 60,
    1e-3,
    800e-5,
    2000e-5,
    600.0,
    0.12 / 60,
    1e-3,
    0.05,
    0.1 * DEG,
    0.15 * DEG,
)
NO_DRIFT = ProcessNoise(0.0, 0.0, 0.0, 0.0, np.inf, np.inf)
FAST = InsState(
    GpsTime(2200, 0.0),
    0.6,
    -1.2,
    1500.0,
    np.array([180.0, -120.0, 15.0]),
    quaternion_from_euler(np.array([0.1, -0.2, 2.0])),
    np.zeros(3),
    np.zeros(3),
    np.zeros(3),
    np.zeros(3),
)


def turning_flight(seconds: float, rate_hz: float = 200.0):
    """Readings of a lively motion: all axes turn and accelerate."""
    count = round(seconds * rate_hz)
    t = (np.arange(count) + 0.5) / rate_hz
    omega = np.column_stack([0.4 * np.sin(2 * t), 0.3 * np.cos(3 * t), 0.5 + 0.2 * np.sin(t)])
    force = np.column_stack([3 * np.cos(t), 2 * np.sin(2 * t), -9.8 + np.sin(3 * t)])
    return np.full(count, 1 / rate_hz), omega / rate_hz, force / rate_hz


def flown(start: InsState, readings) -> tuple[InsState, object]:
    poses, end, _ = mechanize(pose_of(start), NOTHING_BEFORE, calibration_of(start), *readings)
    state = replace(
        start,
        lat_rad=end.lat_rad,
        lon_rad=end.lon_rad,
        height_m=end.height_m,
        v_n_mps=np.array(end.v_n_mps),
        q_nb=np.array(end.q_nb),
    )
    return state, poses


def over(poses, dt_s, noise, states):
    """Transition over poses of the mechanization."""
    return transition(
        poses.lat_rad,
        poses.height_m,
        poses.v_n_mps,
        poses.q_nb,
        dt_s,
        poses.dtheta_b_rad,
        poses.dv_b_mps,
        noise,
        states,
    )


# Small enough to be linear, large enough to stand above rounding (6e-10 m of latitude).
STEP = np.concatenate(
    [[50.0] * 3, [0.05] * 3, [1e-5] * 3, [1e-6] * 3, [1e-4] * 3, [1e-5] * 3, [1e-5] * 3]
)


@pytest.mark.parametrize("column", range(WITH_SCALES))
def test_transition_predicts_how_a_perturbed_mechanization_departs(column: int) -> None:
    readings = turning_flight(10.0)
    error = np.zeros(WITH_SCALES)
    error[column] = STEP[column]
    nominal, poses = flown(FAST, readings)
    up, _ = flown(corrected(FAST, -error), readings)
    down, _ = flown(corrected(FAST, error), readings)
    departed = (difference(up, nominal) - difference(down, nominal)) / (2.0 * STEP[column])
    Phi, _ = over(poses, readings[0], NO_DRIFT, WITH_SCALES)
    # Each block of states against the largest of that block's entries in this column.
    for block in range(0, WITH_SCALES, 3):
        rows = slice(block, block + 3)
        scale = max(np.abs(Phi[rows, column]).max(), 3e-8 / STEP[column])
        atol = 0.004 * scale
        if column == 0:  # left out of F: gravity grows polewards, 8e-9 m/s² per metre north
            atol += {3: 8e-9 * 10.0, 0: 8e-9 * 50.0}.get(block, 0.0)
        np.testing.assert_allclose(departed[rows], Phi[rows, column], rtol=0, atol=atol)


def test_slow_couplings_of_earth_and_frame_are_all_there() -> None:
    """F by position, velocity and attitude against the derivative of one fine step each."""
    readings = (np.array([0.02]), np.array([[0.002, -0.004, 0.006]]), np.array([[0.1, 0.05, -0.2]]))
    _, poses = flown(FAST, readings)
    C_nb = rotation_matrix(poses.q_nb[0])
    F = system_matrix(
        FAST.lat_rad,
        FAST.height_m,
        tuple(FAST.v_n_mps),
        C_nb,
        C_nb @ poses.dv_b_mps[0] / 0.02,
        poses.dtheta_b_rad[0] / 0.02,
        NO_DRIFT,
        WITH_BIASES,
    )
    size = np.concatenate([[5e4] * 3, [20.0] * 3, [2e-3] * 3])
    slope = np.empty((9, 9))
    for column in range(9):
        error = np.zeros(WITH_BIASES)
        error[column] = size[column]
        up, down = corrected(FAST, -error), corrected(FAST, error)
        grown = difference(flown(up, readings)[0], flown(down, readings)[0])[:9]
        slope[:, column] = (grown - difference(up, down)[:9]) / (2 * size[column] * 0.02)
    # 1/R terms are 1e-7 and below: compared in their own units, not beside specific force.
    for rows, columns, atol in (
        (POSITION, POSITION, 2e-7),
        (VELOCITY, POSITION, 2e-8),
        (VELOCITY, VELOCITY, 1e-6),
        (ATTITUDE, POSITION, 1e-13),
        (ATTITUDE, VELOCITY, 1e-10),
        (ATTITUDE, ATTITUDE, 1e-6),
    ):
        np.testing.assert_allclose(slope[rows, columns], F[rows, columns], rtol=0.01, atol=atol)


@pytest.mark.parametrize("states", [WITH_BIASES, WITH_SCALES])
@pytest.mark.parametrize("dt_s", [0.005, 0.05])
def test_step_is_van_loans(states: int, dt_s: float) -> None:
    noise = process_noise(MTI_G)
    F = system_matrix(
        0.6,
        100.0,
        (20.0, -10.0, 1.0),
        rotation_matrix(FAST.q_nb),
        np.array([4.0, 3.0, -9.8]),
        np.array([0.1, 0.2, 0.5]),
        noise,
        states,
    )
    density = noise_density(noise, states)
    Phi, Q = discretize(F, density, dt_s)
    twin = expm(np.block([[-F, np.diag(density)], [np.zeros_like(F), F.T]]) * dt_s)  # Van Loan 1978
    Phi_exact = twin[states:, states:].T
    Q_exact = Phi_exact @ twin[:states, states:]
    np.testing.assert_allclose(Phi, Phi_exact, rtol=0, atol=1e-6)
    sigma = np.sqrt(np.diagonal(Q_exact))[:WITH_BIASES]  # scales have no noise
    Q, Q_exact = Q[:WITH_BIASES, :WITH_BIASES], Q_exact[:WITH_BIASES, :WITH_BIASES]
    scale = np.outer(sigma, sigma)
    np.testing.assert_array_equal(Q, Q.T)
    # In units of each pair's σ: Simpson leaves the fourth order in τ (position by gyro noise).
    np.testing.assert_allclose(Q / scale, Q_exact / scale, rtol=0, atol=0.005)
    np.testing.assert_allclose(np.diagonal(Q)[3:], np.diagonal(Q_exact)[3:], rtol=1e-3)


def test_pieces_add_up_to_the_whole() -> None:
    readings = turning_flight(1.0)
    noise = process_noise(MTI_G)
    _, poses = flown(FAST, readings)
    Phi, Q = over(poses, readings[0], noise, WITH_SCALES)
    early = type(poses)(*(part[:100] for part in poses))
    late = type(poses)(*(part[100:] for part in poses))
    Phi_early, Q_early = over(early, readings[0][:100], noise, WITH_SCALES)
    Phi_late, Q_late = over(late, readings[0][100:], noise, WITH_SCALES)
    np.testing.assert_allclose(Phi_late @ Phi_early, Phi, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(predicted(Q_early, Phi_late, Q_late), Q, rtol=1e-9, atol=1e-24)


@pytest.mark.parametrize("states", [WITH_BIASES, WITH_SCALES])
def test_covariance_stays_positive_and_bounded_through_an_hour_without_aid(states: int) -> None:
    readings = turning_flight(60.0, 50.0)
    noise = process_noise(MTI_G)
    start = replace(FAST, v_n_mps=np.array([10.0, 5.0, 0.0]), height_m=50.0)
    _, poses = flown(start, readings)
    Phi, Q = over(poses, readings[0], noise, states)
    P = initial_covariance(MTI_G, InitialSigmas(1.0, 0.05, 0.1 * DEG, 0.15 * DEG), states)
    for _ in range(60):
        P = predicted(P, Phi, Q)
        np.testing.assert_array_equal(P, P.T)
        check_covariance(P)
    sigma = np.sqrt(np.diagonal(P))
    steady = bias_sigmas(MTI_G, np.inf)
    np.testing.assert_allclose(sigma[GYRO_BIAS], steady[0], rtol=0.01)
    np.testing.assert_allclose(sigma[ACCEL_BIAS], steady[1], rtol=0.01)
    assert np.all(np.isfinite(sigma))


def test_bias_state_keeps_the_drifts_density_and_the_sums_variance() -> None:
    grade = MTI_G._replace(gyro_bias_radps=1e-3, gyro_drift_radps2_rthz=1e-6)
    noise = process_noise(grade)
    assert noise.gyro_drift_radps2_rthz == 1e-6
    steady2 = noise.gyro_drift_radps2_rthz**2 * noise.gyro_time_s / 2.0
    assert steady2 == pytest.approx(1e-6 + 1e-12 * 600.0 / 2.0, rel=1e-12)
    assert bias_sigmas(grade)[0] == pytest.approx(1e-3)
    assert bias_sigmas(grade, np.inf)[0] ** 2 == pytest.approx(steady2)
    constant = process_noise(grade._replace(gyro_drift_radps2_rthz=0.0))
    assert constant.gyro_time_s == np.inf
