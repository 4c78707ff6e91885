"""Biases of a log's first seconds: none in a right log, ten times those of a grade, their σ."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driving import START, Drive, sensed

from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.ins.imu_errors import gauss_markov
from deepgnss.ins.increments import between, joined
from deepgnss.ins.turn_on import TurnOn, first_mean, turn_on
from deepgnss.io.config.imu_grade import imu_grade, imu_grade_names
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import Steady
from deepgnss.sim.motion.paths import Line
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

RATE_HZ = 100.0
REST_S = 8.0
BEYOND = 4.0


@cache
def _drive(*speeds: tuple[float, float]) -> Drive:
    """Northwards, rolled and pitched by a degree or two."""
    path = Line((1.0, 0.0, 0.0), smooth_profile(list(speeds)))
    vehicle = Vehicle(0.53, 1.99, 30.0, path, Steady(0.02, -0.03, 0.4))
    blocks = increments(vehicle, START, RATE_HZ, round(20.0 * RATE_HZ), highest_hz=1.0)
    return Drive(vehicle, joined(*blocks))


def _resting() -> Drive:
    return _drive((0.0, 0.0), (REST_S + 1.0, 0.0), (20.0, 15.0))


def _found(truth: Drive, log: ImuBlock, grade: ImuGrade, at_s: float = REST_S) -> TurnOn | None:
    (fix,) = truth.fixes(np.array([at_s]), np.random.default_rng(0), velocity_mps=0.02)
    return turn_on(log, fix, grade)


def _tenfold(log: ImuBlock, grade: ImuGrade) -> ImuBlock:
    """Ten times the biases of its grade on top."""
    signs = np.array([1.0, -1.0, 1.0])
    per_s = log.dt_s[:, np.newaxis] * signs
    return replace(
        log,
        dtheta_b_rad=log.dtheta_b_rad + 10.0 * grade.gyro_bias_radps * per_s,
        dv_b_mps=log.dv_b_mps + 10.0 * grade.accel_bias_mps2 * per_s,
    )


@pytest.mark.parametrize("name", imu_grade_names())
def test_right_logs_are_within_their_grade(name: str) -> None:
    """Of the accelerometers' 1σ everything is known: it is as large as it says."""
    grade, truth = imu_grade(name), _resting()
    found = [_found(truth, sensed(truth, grade, seed)[0], grade) for seed in range(100)]
    gyros = np.array([f.gyro.largest / f.gyro.sigma for f in found if f])
    accels = np.array([f.accel.largest / f.accel.sigma for f in found if f])
    assert accels.size == len(found)
    assert gyros.max() < BEYOND
    assert accels.max() < BEYOND
    assert 0.8 < np.sqrt(np.mean(accels**2)) < 1.2


@pytest.mark.parametrize(
    ("name", "gyros", "accels"),
    [("MTi-G", 0.0, 0.94), ("STIM300", 1.0, 1.0), ("automotive", 1.0, 1.0), ("FSAS", 0.0, 0.01)],
)
def test_ten_times_the_biases_are_told_where_they_can_be(
    name: str, gyros: float, accels: float
) -> None:
    """Shares by Gauss: what is left of ten biases beyond 4σ of everything the grade allows."""
    grade, truth = imu_grade(name), _resting()
    found = []
    for seed in range(60):
        log, _ = sensed(truth, grade, seed)
        found.append(_found(truth, _tenfold(log, grade), grade))
    told = np.array(
        [[one.largest > BEYOND * one.sigma for one in (f.gyro, f.accel)] for f in found if f]
    )
    assert len(told) == len(found)
    assert np.mean(told, axis=0) == pytest.approx([gyros, accels], abs=0.08)


def test_only_rest_up_to_the_fix_tells() -> None:
    """As quiet are a cruise and steady braking: the fix shows both; what moves off is not quiet."""
    grade = imu_grade("MTi-G")
    resting = _resting()
    log, _ = sensed(resting, grade, 1)
    assert _found(resting, log, grade) is not None
    assert _found(resting, log, grade, 0.5) is None  # less than a window
    assert _found(resting, log, grade, 12.0) is None
    holed = joined(between(log, 0.0, 2.0), between(log, 2.5))
    assert _found(resting, holed, grade) is None
    for speeds in (((0.0, 9.0), (20.0, 9.0)), ((0.0, 30.0), (20.0, 0.0))):
        moving = _drive(*speeds)
        assert _found(moving, sensed(moving, grade, 1)[0], grade) is None


@pytest.mark.parametrize(("noise", "drift"), [(0.002, 0.02), (0.002, 1e-4), (0.01, 0.0)])
def test_a_first_mean_has_the_least_error_and_says_so(noise: float, drift: float) -> None:
    """Against drawn errors, and against a mean over all and over the first tenth of a second."""
    n, step_s = 1500, 0.002
    dt_s, root_s = np.full(n, step_s), np.sqrt(step_s)
    rng = np.random.default_rng(3)
    errors: dict[str, list[FloatArray]] = {"best": [], "all": [], "first": []}
    for _ in range(300):
        steps, white = rng.normal(size=(2, n, 3)) * root_s
        walk = gauss_markov(np.zeros(3), np.ones(n), drift * steps)
        read = 0.5 * (walk[1:] + walk[:-1]) * step_s + noise * white
        mean, sigma = first_mean(read, dt_s, noise, drift)
        errors["best"].append(mean)
        errors["all"].append(read.mean(axis=0) / step_s)
        errors["first"].append(read[:50].mean(axis=0) / step_s)
    rms = {name: float(np.sqrt(np.mean(np.square(e)))) for name, e in errors.items()}
    assert rms["best"] == pytest.approx(sigma, rel=0.1)
    assert rms["best"] < 1.02 * min(rms["all"], rms["first"])
