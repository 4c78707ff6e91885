"""Errors put on increments: Allan deviation against its closed form, scale, blocks, nothing."""

import numpy as np
import pytest
from scipy.signal import lfilter

from deepgnss.core.records import ImuBlock, ImuGrade
from deepgnss.core.time import GpsTime
from deepgnss.ins.imu_errors import ImuErrors, gauss_markov
from deepgnss.io.config import imu_grade, imu_grade_names

ORIGIN = GpsTime(2290, 0.0)
ZERO = ImuGrade("zero", 0, 0, 1e3, 0, 0, 0, 0, 1e3, 0, 0, 0, 0, 0)


def true_increments(seconds, rate_hz, seed=0):
    n = round(seconds * rate_hz)
    rng = np.random.default_rng(seed)
    dt = np.full(n, 1.0 / rate_hz)
    return ImuBlock(ORIGIN, np.arange(1, n + 1) / rate_hz, dt, *rng.normal(0, 1e-3, (2, n, 3)))


def at_rest(seconds, rate_hz):
    n = round(seconds * rate_hz)
    zero = np.zeros((n, 3))
    return ImuBlock(ORIGIN, np.arange(1, n + 1) / rate_hz, np.full(n, 1.0 / rate_hz), zero, zero)


def cut(block, sizes):
    ends = np.cumsum(sizes)
    for first, last in zip(ends - sizes, ends, strict=True):
        yield ImuBlock(block.origin, *(getattr(block, name)[first:last] for name in (
            "time_s", "dt_s", "dtheta_b_rad", "dv_b_mps",
        )))  # fmt: skip


# --- Allan deviation -----------------------------------------------------------------------------


def allan_variance(increments, dt, m):
    """Of clusters of m intervals, without overlap, averaged over axes: (1/2)·E[(ȳ₂ − ȳ₁)²]."""
    n = len(increments) // m
    means = increments[: n * m].reshape(n, m, -1).sum(axis=1) / (m * dt)
    return 0.5 * np.mean(np.diff(means, axis=0) ** 2)


def expected_variance(noise_rts, drift_rthz, time_s, tau, clusters):
    """White noise: N²/τ. Drift from zero: that in its steady state less what its start takes off.

    Steady state (IEEE 952 C.21): (q²T²/τ)·(1 − (T/2τ)·(3 − 4e^(−τ/T) + e^(−2τ/T))). A process that
    starts at zero has the covariance of the steady one minus (q²T/2)·e^(−(t+s)/T), which is a
    product: the cluster means of e^(−t/T), differenced, squared.
    """
    x = tau / time_s
    bracket = 1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x)
    if x < 1e-3:  # where that loses its digits
        bracket = x**2 / 3.0 - x**3 / 4.0
    steady = drift_rthz**2 * time_s**2 / tau * bracket
    means = np.exp(-np.arange(clusters) * x) * -np.expm1(-x) / x
    start = 0.5 * drift_rthz**2 * time_s * 0.5 * np.mean(np.diff(means) ** 2)
    return noise_rts**2 / tau + steady - start


@pytest.mark.parametrize("name", imu_grade_names())
def test_allan_deviation_of_an_hour_is_that_of_the_grade(name):
    grade, rate_hz, seconds, seeds = imu_grade(name), 5.0, 3600.0, 30
    rest = at_rest(seconds, rate_hz)
    runs = [ImuErrors(grade, np.random.default_rng(seed)).apply(rest)[0] for seed in range(seeds)]
    sensors = (
        ("dtheta_b_rad", grade.gyro_noise_rad_rts, grade.gyro_drift_radps2_rthz,
         grade.gyro_drift_time_s),
        ("dv_b_mps", grade.accel_noise_mps_rts, grade.accel_drift_mps3_rthz,
         grade.accel_drift_time_s),
    )  # fmt: skip
    for field, noise, drift, time_s in sensors:
        for tau in (0.4, 2.0, 10.0, 100.0, 600.0, 1200.0):
            m = round(tau * rate_hz)
            found = [allan_variance(getattr(run, field), 1.0 / rate_hz, m) for run in runs]
            clusters = len(rest.dt_s) // m
            expected = expected_variance(noise, drift, time_s, tau, clusters)
            # the runs themselves say how far their mean may lie off
            sigma = np.std(found, ddof=1) / np.sqrt(seeds)
            assert abs(np.mean(found) - expected) < 4.0 * sigma, (field, tau)
            assert sigma < 0.15 * expected


def test_angle_random_walk_grows_with_the_root_of_time():
    grade = imu_grade("MTi-G")._replace(gyro_bias_radps=0.0, gyro_drift_radps2_rthz=0.0)
    rest = at_rest(100.0, 50.0)
    angles = [
        ImuErrors(grade, np.random.default_rng(seed)).apply(rest)[0].dtheta_b_rad.sum(axis=0)
        for seed in range(300)
    ]
    expected = np.radians(3.0) / 60.0 * 10.0  # 3 deg/√h over 100 s
    assert np.std(angles) == pytest.approx(expected, rel=0.1)


# --- what is put on and what is told -------------------------------------------------------------


def test_an_ideal_unit_changes_nothing():
    block = true_increments(10.0, 100.0)
    read, errors = ImuErrors(ZERO, np.random.default_rng(1)).apply(block)
    np.testing.assert_array_equal(read.dtheta_b_rad, block.dtheta_b_rad)
    np.testing.assert_array_equal(read.dv_b_mps, block.dv_b_mps)
    assert not any(np.any(part) for part in errors)


def test_the_result_does_not_depend_on_the_blocks():
    block = true_increments(50.0, 200.0)
    whole, told = ImuErrors(imu_grade("MTi-G"), np.random.default_rng(7)).apply(block)
    unit = ImuErrors(imu_grade("MTi-G"), np.random.default_rng(7))
    parts = [unit.apply(part) for part in cut(block, np.array([1, 999, 0, 4321, 4679]))]
    np.testing.assert_array_equal(
        whole.dtheta_b_rad, np.concatenate([read.dtheta_b_rad for read, _ in parts])
    )
    np.testing.assert_array_equal(
        told.accel_bias_mps2, np.concatenate([errors.accel_bias_mps2 for _, errors in parts])
    )


def test_told_errors_account_for_all_but_the_noise():
    grade = imu_grade("MTi-G")._replace(gyro_noise_rad_rts=0.0, accel_noise_mps_rts=0.0)
    block = true_increments(100.0, 100.0)
    read, errors = ImuErrors(grade, np.random.default_rng(3)).apply(block)
    for got, true, bias, scale, density in (
        (read.dtheta_b_rad, block.dtheta_b_rad, errors.gyro_bias_radps, errors.gyro_scale,
         grade.gyro_drift_radps2_rthz),
        (read.dv_b_mps, block.dv_b_mps, errors.accel_bias_mps2, errors.accel_scale,
         grade.accel_drift_mps3_rthz),
    ):  # fmt: skip
        mean_bias = 0.5 * (bias[:-1] + bias[1:])
        rest = (got - true * (1.0 + scale))[1:] - mean_bias * block.dt_s[1:, np.newaxis]
        assert np.std(rest) == pytest.approx(density * 0.01**1.5 / np.sqrt(12.0), rel=0.03)


def test_what_is_drawn_once_has_the_grade_s_size():
    grade = imu_grade("STIM300")
    units = [ImuErrors(grade, np.random.default_rng(seed)) for seed in range(400)]
    assert np.std([unit.gyro_scale for unit in units]) == pytest.approx(500e-6, rel=0.1)
    assert np.std([unit.accel_scale for unit in units]) == pytest.approx(300e-6, rel=0.1)
    tick = at_rest(0.01, 100.0)
    biases = [unit.apply(tick)[1] for unit in units]
    gyro, accel = ([getattr(b, name)[0] for b in biases] for name in (
        "gyro_bias_radps", "accel_bias_mps2",
    ))  # fmt: skip
    assert np.std(gyro) == pytest.approx(grade.gyro_bias_radps, rel=0.1)
    assert np.std(accel) == pytest.approx(grade.accel_bias_mps2, rel=0.1)


def test_a_grade_scales_the_same_draws():
    block = at_rest(10.0, 100.0)
    twice = ZERO._replace(gyro_noise_rad_rts=2.0, accel_bias_mps2=1.0)
    once = ZERO._replace(gyro_noise_rad_rts=1.0, accel_noise_mps_rts=1.0)
    (a, _), (b, _) = (ImuErrors(g, np.random.default_rng(5)).apply(block) for g in (twice, once))
    np.testing.assert_allclose(a.dtheta_b_rad, 2.0 * b.dtheta_b_rad)


@pytest.mark.kernel
def test_gauss_markov_kernel_is_the_filter():
    rng = np.random.default_rng(2)
    steps, start = rng.normal(size=(500, 3)), rng.normal(size=3)
    got = gauss_markov(start, np.full(500, 0.9), steps)
    filtered, _ = lfilter([1.0], [1.0, -0.9], steps, axis=0, zi=0.9 * start[np.newaxis])
    np.testing.assert_allclose(got[1:], filtered, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(got[0], start)
