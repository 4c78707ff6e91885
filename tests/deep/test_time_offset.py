"""The log's time offset: its sign, its size, its σ, and what it must not be taken for."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.loops import loop_gains
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.deep.time_offset import CarrierLoop, Offset, OffsetEstimator, StretchFit, fit_stretch
from deepgnss.ins import GnssFix
from deepgnss.ins.imu_errors import ImuErrors
from deepgnss.ins.increments import joined
from deepgnss.io.config.imu_grade import imu_grade
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.schema import build, load_scenario

LOOP = CarrierLoop(3, 7.0, 0.02)
LEVER_B_M = np.array([0.4, 0.1, -1.2])
GRADE = imu_grade("MTi-G")
BEGIN_S, END_S = 104.0, 172.0  # a street corner, a stop of 20 s, another corner


@cache
def _street() -> tuple[ImuBlock, FloatArray, FloatArray, FloatArray]:
    """Error-free increments; millisecond times, antenna velocities in NED and places."""
    scenario = build(load_scenario("urban", ("satellites={systems: [GPS], mask: 60}",))).scenario
    vehicle = scenario.vehicle
    block = joined(*increments(vehicle, scenario.start, 200.0, round(END_S * 200.0)))
    dense_s = np.arange(BEGIN_S - 3.0, END_S - 2.0, 1e-3)
    motion = vehicle.point(dense_s, (0.4, 0.1, -1.2))
    lat, lon, _ = geodetic(motion.r_m[0])
    return block, dense_s, motion.v_mps @ C_ne(lat, lon).T, motion.r_m


def _followed(dense_s: FloatArray, v_n: FloatArray, tags_s: FloatArray) -> FloatArray:
    """Velocities a loop gives at tags, by the recursion its gains are meant for."""
    way = np.cumsum(v_n, axis=0) * 1e-3
    gains, T = loop_gains(*LOOP), LOOP.interval_s
    state, found, middles = np.zeros((3, 3)), [], []
    state[0], state[1] = way[0], v_n[0]
    for k in range(dense_s.size // 20):
        middle = state.copy()
        middle[0] += 0.5 * T * state[1] + 0.125 * T**2 * state[2]
        middle[1] += 0.5 * T * state[2]
        error = way[20 * k : 20 * k + 20].mean(axis=0) - middle[0]
        middle += np.outer(gains, error)
        found.append(middle[1])
        middles.append(dense_s[20 * k] + 0.5 * T)
        state = middle.copy()
        state[0] += 0.5 * T * middle[1] + 0.125 * T**2 * middle[2]
        state[1] += 0.5 * T * middle[2]
    return np.column_stack([np.interp(tags_s, middles, column) for column in np.array(found).T])


@cache
def _fixes(seed: int) -> tuple[GnssFix, ...]:
    """Fixes at 10 Hz as an unaided receiver gives them; σ as generous as its own."""
    block, dense_s, v_n, r_e = _street()
    tags_s = np.arange(BEGIN_S, END_S - 2.5, 0.1)
    rng = np.random.default_rng([seed, 3])
    seen = _followed(dense_s, v_n, tags_s) + 0.006 * rng.standard_normal((tags_s.size, 3))
    place = r_e[np.searchsorted(dense_s, tags_s)]
    return tuple(
        GnssFix(block.origin.plus(t), r, np.eye(3), v, 0.08**2 * np.eye(3))
        for t, r, v in zip(tags_s, place, seen, strict=True)
    )


def _log(seed: int, late_s: float) -> ImuBlock:
    block, _ = ImuErrors(GRADE, np.random.default_rng([seed, 1])).apply(_street()[0])
    return replace(block, origin=block.origin.plus(late_s))


def _found(seed: int, late_s: float) -> tuple[OffsetEstimator, Offset]:
    estimator = OffsetEstimator(GRADE, LEVER_B_M, LOOP)
    log = _log(seed, late_s)
    for fix in _fixes(seed):
        estimator.take(log, fix, aided=False)
    return estimator, estimator.offset


@pytest.mark.parametrize("late_s", [0.0, 0.1, -0.1, -0.8])
def test_an_offset_is_found_with_its_sign(late_s: float) -> None:
    """Late stamps are positive: what is to be taken off."""
    estimator, offset = _found(1, late_s)
    assert offset.sure is offset.significant is (late_s != 0.0)
    assert 0.001 < offset.sigma_s < 0.01
    assert abs(offset.late_s - late_s) < 0.01
    if late_s:
        assert ("late" if late_s > 0.0 else "early") in str(offset)
    estimator.shifted(-offset.late_s)
    assert not estimator.offset.significant


@pytest.mark.slow
def test_a_minute_in_a_city_tells_three_milliseconds() -> None:
    """Twelve drives with a unit as noisy as they come; errors as large as their σ say.

    Of the minute 45 s move, with two corners: each tells 3 to 4 ms to a unit whose gyros tilt by
    a milliradian a second; a livelier drive tells more.
    """
    found = [_found(seed, 0.1)[1] for seed in range(12)]
    errors_s = np.array([offset.late_s - 0.1 for offset in found])
    ratio = np.mean([(e / o.sigma_s) ** 2 for e, o in zip(errors_s, found, strict=True)])
    print(f"errors {1e3 * errors_s.mean():+.1f} ± {1e3 * errors_s.std():.1f} ms, NEES {ratio:.2f}")
    assert np.sqrt(np.mean(errors_s**2)) < 0.004
    assert 0.2 < ratio < 2.5


def test_a_loop_is_modelled_as_it_runs() -> None:
    """The filter is the recursion."""
    _, dense_s, v_n, _ = _street()
    moving = v_n - v_n[0]
    tags_s = dense_s[::20][1:] + 0.01
    direct = _followed(dense_s, moving, tags_s)
    way = np.cumsum(moving, axis=0)[: dense_s.size // 20 * 20] * 1e-3
    means = way.reshape(-1, 20, 3).mean(axis=1)
    modelled = LOOP.frequency(means / LOOP.interval_s)
    np.testing.assert_allclose(modelled[1:200], direct[:199], atol=1e-6)


def test_no_motion_no_offset() -> None:
    """At rest nothing tells; a log that does not reach that far neither."""
    log, fixes = _log(1, 0.0), _fixes(1)
    still = [replace(f, v_n_mps=np.zeros(3)) for f in fixes[:60]]
    rest = replace(log, dtheta_b_rad=0.0 * log.dtheta_b_rad, dv_b_mps=log.dv_b_mps * 0.0)
    rest.dv_b_mps[:, 2] = -9.81 * rest.dt_s
    assert isinstance(fit_stretch(rest, still, GRADE, LEVER_B_M, LOOP), str)
    short = replace(
        log,
        **{
            name: getattr(log, name)[:1000]
            for name in ("time_s", "dt_s", "dtheta_b_rad", "dv_b_mps")
        },
    )
    assert isinstance(fit_stretch(short, fixes[:60], GRADE, LEVER_B_M, LOOP), str)


def test_direction_of_travel_and_biases_come_with_it() -> None:
    """What tells swapped axes and a wrong grade."""
    log = _log(2, 0.0)
    bias_radps = np.array([0.004, -0.003, 0.002])
    log = replace(log, dtheta_b_rad=log.dtheta_b_rad + bias_radps * log.dt_s[:, np.newaxis])
    estimator = OffsetEstimator(GRADE, LEVER_B_M, LOOP)
    fits = [f for fix in _fixes(2) if (f := estimator.take(log, fix, aided=False)) is not None]
    assert len(fits) >= 3
    ahead = np.median([fit.forward_b for fit in fits], axis=0)
    assert ahead[0] > 0.8  # yaw by two corners
    level = np.median([fit.gyro_bias_radps[:2] for fit in fits], axis=0)
    np.testing.assert_allclose(level, bias_radps[:2], atol=2.5e-3)  # it drifts by 1.2e-3


def test_contradicting_stretches_are_not_sure() -> None:
    """A log of another drive fits by chance here and there."""
    estimator = OffsetEstimator(GRADE, LEVER_B_M, LOOP)
    zero = np.zeros(3)
    for k, late_s in enumerate((0.3, -0.2, 0.05, -0.4)):
        estimator.fits.append(StretchFit(6.0 * k, late_s, 0.004, 0.05, 1.0, zero, zero, zero))
    assert not estimator.offset.significant
