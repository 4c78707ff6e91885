"""Sums of inertial errors: signs of T(4.30–4.32), nothing from nothing, more from more, units."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.records import ImuGrade
from deepgnss.io.config import imu_grade
from deepgnss.theory.discriminator_range import (
    aided_rise_hz,
    largest_acceleration_mps2,
    largest_rate_hzps,
    largest_rise_hz,
)
from deepgnss.theory.inertial import error_growth, error_sums, sources, total
from deepgnss.theory.loop_response import OPEN, carrier_loop

NOTHING = ImuGrade("none", 0, 0, 1e3, 0, 0, 0, 0, 1e3, 0, 0, 0, 0, 0)
NORTH = np.array([1.0, 0.0, 0.0])
FORCE = np.array([3.0, 4.0, -9.80665])  # T 4.5.3
AT = np.array([1.0, 5.0, 20.0])
L1_M = 299_792_458.0 / 1_575.42e6


def test_signs_of_the_velocity_error_north() -> None:
    """T(4.30) term by term: −f_D·φ_pitch + f_E·φ_yaw + b + f_N·s + f_D·b_gE − f_E·b_gD."""
    grade = imu_grade("MTi-G")
    gains = {(s.name, s.axis): s.gain[0] for s in sources(grade, FORCE, NORTH[np.newaxis])}
    f_n, f_e, f_d = FORCE
    assert gains["initial velocity", "north"] == grade.velocity_mps
    assert gains["initial attitude", "east"] == pytest.approx(-f_d * grade.tilt_rad)
    assert gains["initial attitude", "down"] == pytest.approx(f_e * grade.heading_rad)
    assert gains["accelerometer bias", "north"] == grade.accel_bias_mps2
    assert gains["accelerometer scale", "north"] == pytest.approx(f_n * grade.accel_scale)
    assert gains["gyro bias", "east"] == pytest.approx(f_d * grade.gyro_bias_radps)
    assert gains["gyro bias", "down"] == pytest.approx(-f_e * grade.gyro_bias_radps)
    others = [("initial velocity", "east"), ("initial attitude", "north"), ("gyro bias", "north")]
    assert all(gains[name] == 0.0 for name in others)


def test_units_of_the_table() -> None:
    """T table 4.1 in SI: deg/h, mGal (1e-5 m/s²), deg/√h, m/s/√h, ppm."""
    grade = imu_grade("FSAS")
    assert grade.gyro_bias_radps == pytest.approx(4.848137e-7, rel=1e-6)  # 0.1 deg/h
    assert grade.gyro_drift_radps2_rthz == pytest.approx(4.848137e-7, rel=1e-6)
    assert grade.gyro_noise_rad_rts == pytest.approx(math.radians(0.15) / 60.0)
    assert grade.accel_bias_mps2 == pytest.approx(5e-4)  # 50 mGal, 51 µg
    assert grade.accel_noise_mps_rts == pytest.approx(5e-4)
    assert grade.accel_scale == pytest.approx(3e-4)


def test_nothing_comes_of_nothing() -> None:
    for loop in (OPEN, carrier_loop(3, 7.0)):
        for sums in error_sums(NOTHING, FORCE, AT, NORTH, loop):
            assert not np.any(sums.largest) and not np.any(sums.sigma)
    assert aided_rise_hz(NOTHING, 1000.0, AT, L1_M) == pytest.approx(np.zeros(3))


@pytest.mark.parametrize("field", [f for f in ImuGrade._fields if f not in {"name", "gyro_scale"}])
def test_a_worse_unit_is_worse_and_linear(field: str) -> None:
    grade = imu_grade("MTi-G")
    if field.endswith("time_s"):  # a drift that forgets later
        more = grade._replace(**{field: 2.0 * getattr(grade, field)})
    else:
        alone = NOTHING._replace(**{field: getattr(grade, field)})
        double = NOTHING._replace(**{field: 2.0 * getattr(grade, field)})
        one, two = (error_sums(g, FORCE, AT, NORTH)[1] for g in (alone, double))
        np.testing.assert_allclose(two.sigma, 2.0 * one.sigma)
        assert np.all(one.sigma > 0.0)
        more = grade._replace(**{field: 1.1 * getattr(grade, field)})
    for less, larger in zip(
        error_sums(grade, FORCE, AT, NORTH), error_sums(more, FORCE, AT, NORTH), strict=True
    ):
        assert np.all(larger.sigma >= less.sigma) and np.any(larger.sigma > less.sigma)


@pytest.mark.parametrize("loop", [OPEN, carrier_loop(2, 3.0)], ids=["open", "closed"])
def test_sums_are_those_of_the_terms(loop) -> None:
    grade, sight = imu_grade("FSAS"), np.array([0.6, 0.48, -0.64])
    velocity, position = total(error_growth(grade, FORCE, AT, sight[np.newaxis], loop))
    by_sum = error_sums(grade, FORCE, AT, sight, loop)
    np.testing.assert_allclose(by_sum[0].sigma, velocity[:, 0])
    np.testing.assert_allclose(by_sum[1].sigma, position[:, 0])
    assert np.all(np.abs(by_sum[1].signed) <= by_sum[1].largest * (1.0 + 1e-12))
    assert np.all(by_sum[1].drawn <= by_sum[1].largest * (1.0 + 1e-12))


def test_range_of_the_discriminator() -> None:
    """T(4.126), T(4.127); 3 of 16 lines of 320 ms have 3/16 of the range."""
    assert largest_rise_hz(0.020) == 12.5
    assert largest_rise_hz(0.020, 3, 0.320) == pytest.approx(12.5 * 3 / 16)
    assert largest_rate_hzps(0.020, 0.320) == pytest.approx(1.0 / (4.0 * 0.020 * 0.320))
    fsas, mti_g = imu_grade("FSAS"), imu_grade("MTi-G")
    for window_s in (0.1, 0.32, 1.0):
        limits = [largest_acceleration_mps2(fsas, x, window_s, L1_M) for x in (1.0, 3.0, 12.5)]
        assert limits == sorted(limits)
        at = largest_acceleration_mps2(mti_g, 12.5, window_s, L1_M)
        assert aided_rise_hz(mti_g, at, np.array([window_s]), L1_M)[0] == pytest.approx(12.5)
        assert at < limits[2]
    assert largest_acceleration_mps2(mti_g, 1e-3, 1.0, L1_M) == 0.0
    assert math.isinf(largest_acceleration_mps2(NOTHING, 1.0, 1.0, L1_M))


def test_regions_of_figure_4_12() -> None:
    """FSAS: 1000 m/s² over 1 s within 40 ms' range, not 80 ms'; MTi-G: not even 20 ms'."""
    for name, inside_s, outside_s in (("FSAS", 0.04, 0.08), ("MTi-G", 0.01, 0.02)):
        grade = imu_grade(name)
        inside, outside = (
            largest_acceleration_mps2(grade, largest_rise_hz(s), 1.0, L1_M)
            for s in (inside_s, outside_s)
        )
        assert outside < 1000.0 < inside
