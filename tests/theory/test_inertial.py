"""Growth of inertial errors against the closed forms and figures of T 4.5, and a simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.records import ImuGrade
from deepgnss.theory.inertial import error_growth, total

DEG = math.pi / 180.0
HOUR = DEG / 3600.0
FSAS = ImuGrade(
    "FSAS", 0.1 * HOUR, 0.1 * HOUR, 10800.0, 0.15 * DEG / 60, 0.0, 50e-5, 100e-5, 10800.0,
    0.03 / 60, 300e-6, 0.008, 0.01 * DEG, 0.05 * DEG,
)  # fmt: skip
MTI_G = ImuGrade(
    "MTi-G", 15 * HOUR, 100 * HOUR, 600.0, 3 * DEG / 60, 0.0, 800e-5, 2000e-5, 600.0,
    0.12 / 60, 1000e-6, 0.05, 0.10 * DEG, 0.15 * DEG,
)  # fmt: skip
L1_M = 299_792_458.0 / 1_575.42e6
ACCELERATING = np.array([3.0, 4.0, -9.8])  # T 4.5.3: 3 m/s² north, 4 east


def test_closed_forms_of_a_random_walk_drift() -> None:
    grade = MTI_G._replace(gyro_drift_time_s=1e9, accel_drift_time_s=1e9)
    t, g = 20.0, 9.8
    terms = {term.name: term for term in error_growth(grade, np.array([0, 0, -g]), np.array([t]))}
    north = {name: (term.velocity_mps[0, 0], term.position_m[0, 0]) for name, term in terms.items()}
    expected = {  # T(4.102–4.123) and T(4.77–4.99), by the wavelength
        "initial velocity": (0.05, 0.05 * t),
        "initial attitude": (g * 0.1 * DEG * t, g * 0.1 * DEG * t**2 / 2),
        "accelerometer bias": (800e-5 * t, 800e-5 * t**2 / 2),
        "accelerometer scale": (0.0, 0.0),
        "gyro bias": (g * 15 * HOUR * t**2 / 2, g * 15 * HOUR * t**3 / 6),
        "accelerometer noise": (0.002 * math.sqrt(t), 0.002 * math.sqrt(t**3 / 3)),
        "accelerometer drift": (0.02 * math.sqrt(t**3 / 3), 0.02 * math.sqrt(t**5 / 20)),
        "gyro noise": (
            g * 3 * DEG / 60 * math.sqrt(t**3 / 3),
            g * 3 * DEG / 60 * math.sqrt(t**5 / 20),
        ),
        "gyro drift": (
            g * 100 * HOUR * math.sqrt(t**5 / 20),
            g * 100 * HOUR * math.sqrt(t**7 / 252),
        ),
    }
    assert set(north) == set(expected)
    for name, (velocity, position) in expected.items():
        assert north[name] == pytest.approx((velocity, position), rel=1e-6), name


def test_which_force_turns_which_tilt_into_which_velocity() -> None:
    """T(4.30–4.32) term by term: heading reaches N by f_E and E by f_N, tilts reach D likewise."""
    only = MTI_G._replace(tilt_rad=0.0, heading_rad=1e-3)
    attitude = error_growth(only, np.array([3.0, 4.0, -9.8]), np.array([1.0]))[1]
    np.testing.assert_allclose(attitude.velocity_mps[0], [4e-3, 3e-3, 0.0])
    only = MTI_G._replace(tilt_rad=1e-3, heading_rad=0.0)
    attitude = error_growth(only, np.array([3.0, 4.0, -9.8]), np.array([1.0]))[1]
    np.testing.assert_allclose(attitude.velocity_mps[0], [9.8e-3, 9.8e-3, 5e-3])


def test_figures_published_for_both_grades() -> None:
    """T 4.5.3, 4.5.5: what the text reads off its figures."""
    one = error_growth(MTI_G, ACCELERATING, np.array([1.0]))
    assert one[0].position_m[0, 0] / L1_M * 360.0 == pytest.approx(94.0, abs=1.0)  # degrees
    for grade, limit_hz in ((FSAS, 1.1), (MTI_G, 16.0)):
        velocity_mps, _ = total(error_growth(grade, ACCELERATING, np.array([20.0])))
        assert 0.4 * limit_hz < velocity_mps[0, 0] / L1_M < limit_hz
    terms = error_growth(MTI_G, ACCELERATING, np.array([20.0]))
    white_m = math.sqrt(sum(term.position_m[0, 0] ** 2 for term in terms if term.white))
    drawn_m = sum(term.position_m[0, 0] for term in terms if not term.white)
    assert white_m == pytest.approx(14.7, rel=0.03)  # T's drift walks, ours decays: 14.54 and 14.43
    assert drawn_m == pytest.approx(7.5, rel=0.15)  # T adds them with signs it does not print


@pytest.mark.parametrize("grade", [FSAS, MTI_G], ids=lambda grade: grade.name)
def test_simulated_spread(grade: ImuGrade) -> None:
    """δv̇ = f×φ + δf, φ̇ = −δω stepped with drawn errors: 60 s, 4000 runs, all terms together."""
    rng = np.random.default_rng(3)
    runs, dt, steps = 4000, 0.1, 600
    f = np.array([1.0, -2.0, -9.8])
    velocity = rng.normal(size=(runs, 3)) * grade.velocity_mps
    position = np.zeros((runs, 3))
    phi = rng.normal(size=(runs, 3)) * [grade.tilt_rad, grade.tilt_rad, grade.heading_rad]
    gyro = rng.normal(size=(runs, 3)) * grade.gyro_bias_radps
    accel = rng.normal(size=(runs, 3)) * grade.accel_bias_mps2
    accel += f * rng.normal(size=(runs, 3)) * grade.accel_scale
    gyro_drift, accel_drift = np.zeros((runs, 3)), np.zeros((runs, 3))
    for _ in range(steps):
        white = rng.normal(size=(4, runs, 3)) * math.sqrt(dt)
        d_omega = gyro + gyro_drift + grade.gyro_noise_rad_rts * white[0] / dt
        d_force = accel + accel_drift + grade.accel_noise_mps_rts * white[1] / dt
        middle = phi - 0.5 * dt * d_omega
        change = dt * (np.cross(f, middle) + d_force)
        position += dt * (velocity + 0.5 * change)
        velocity += change
        phi -= dt * d_omega
        gyro_drift += (
            grade.gyro_drift_radps2_rthz * white[2] - dt * gyro_drift / grade.gyro_drift_time_s
        )
        accel_drift += (
            grade.accel_drift_mps3_rthz * white[3] - dt * accel_drift / grade.accel_drift_time_s
        )
    velocity_sigma, position_sigma = total(error_growth(grade, f, np.array([dt * steps])))
    np.testing.assert_allclose(velocity.std(axis=0), velocity_sigma[0], rtol=0.04)
    np.testing.assert_allclose(position.std(axis=0), position_sigma[0], rtol=0.04)
