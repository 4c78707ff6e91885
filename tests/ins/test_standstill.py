"""The standstill detector, and what rest tells the filter."""

from __future__ import annotations

import numpy as np
import pytest
from driving import LEVER_B_M, MTI_G, START, Drive, sensed, started

from deepgnss.core.records import ImuBlock
from deepgnss.ins.error_model import process_noise
from deepgnss.ins.error_state import Layout, difference
from deepgnss.ins.increments import joined
from deepgnss.ins.integration import Settings, integrate
from deepgnss.ins.standstill import StandstillLimits, standing, standstill_limits
from deepgnss.ins.updates import counts
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import EllipseAttitude, Steady
from deepgnss.sim.motion.paths import Ellipse, Line
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

RATE_HZ = 100.0
STOP_S = (20.0, 50.0)


def stop_and_go() -> Drive:
    """Northwards, with a stop of half a minute."""
    speeds = [(0.0, 10.0), (10.0, 10.0), (20.0, 0.0), (50.0, 0.0), (60.0, 10.0)]
    vehicle = Vehicle(0.53, 1.99, 30.0, Line((1.0, 0.0, 0.0), smooth_profile(speeds)), Steady())
    return Drive(vehicle, joined(*increments(vehicle, START, RATE_HZ, 7000, highest_hz=1.0)))


def noisy(seconds: float, gyro_radps: float, accel_mps2: float) -> ImuBlock:
    rng, n = np.random.default_rng(0), round(seconds * RATE_HZ)
    gravity = np.array([0.3, -0.2, -9.8])
    return ImuBlock(
        START,
        np.arange(1, n + 1) / RATE_HZ,
        np.full(n, 1 / RATE_HZ),
        (0.02 + rng.normal(size=(n, 3)) * gyro_radps) / RATE_HZ,  # a bias is no motion
        (gravity + rng.normal(size=(n, 3)) * accel_mps2) / RATE_HZ,
    )


@pytest.mark.parametrize(
    ("gyro", "accel", "stands"), [(0.8, 0.8, True), (1.3, 0.8, False), (0.8, 1.3, False)]
)
def test_spread_against_limits(gyro: float, accel: float, stands: bool) -> None:
    limits = StandstillLimits(1.0, 0.01, 0.1)
    found = standing(noisy(30.0, gyro * 0.01, accel * 0.1), limits)
    assert not np.any(found[:95])  # no whole window yet
    assert np.mean(found[100:]) == pytest.approx(float(stands), abs=0.02)


def test_a_window_with_a_gap_says_nothing() -> None:
    block = noisy(10.0, 0.001, 0.01)
    keep = (block.time_s < 4.0) | (block.time_s > 4.5)
    block = ImuBlock(
        START,
        *(part[keep] for part in (block.time_s, block.dt_s, block.dtheta_b_rad, block.dv_b_mps)),
    )
    found = standing(block, StandstillLimits(1.0, 0.01, 0.1))
    assert not np.any(found[(block.time_s > 4.5) & (block.time_s < 5.4)])
    assert np.all(found[block.time_s > 5.6])


def test_rest_is_found_and_pulling_away_is_not_taken_for_it() -> None:
    block, _ = sensed(stop_and_go(), MTI_G, 1)
    found = standing(block, standstill_limits(MTI_G, RATE_HZ, engine_radps=0.0, engine_mps2=0.0))
    time_s = block.time_s
    assert np.mean(found[(time_s > STOP_S[0] + 1.1) & (time_s < STOP_S[1])]) > 0.95
    assert not np.any(found[(time_s > 50.9) & (time_s < 52.5)])  # the jerk of pulling away
    assert not np.any(found[(time_s > 18.5) & (time_s < 20.2)])


def test_rest_stops_the_drift_and_shows_the_gyro_bias() -> None:
    truth = stop_and_go()
    block, errors = sensed(truth, MTI_G, 2)
    rng = np.random.default_rng(2)
    start = started(truth, MTI_G, errors, Layout(15), rng)
    fixes = truth.fixes(np.arange(1.0, 21.0), rng)  # none from the stop on
    found = {}
    for name, limits in (
        ("free", None),
        ("rest", standstill_limits(MTI_G, RATE_HZ, engine_radps=0.0, engine_mps2=0.0)),
    ):
        run = integrate(
            block,
            fixes,
            lambda _: start,
            process_noise(MTI_G),
            Settings(LEVER_B_M, standstill=limits),
        )
        (estimate,) = [
            epoch.estimate
            for epoch in run.epochs
            if abs(epoch.estimate.ins.time.since(START) - 49.5) < 1e-3
        ]
        found[name] = difference(estimate.ins, truth.state(49.5, errors)), estimate, run
    free, rest = found["free"][0], found["rest"][0]
    tally = counts(found["rest"][2].innovations)
    assert tally["zero velocity"].tested > 50
    # driving on at a steady 10 m/s is as quiet as rest, and not taken for it
    late = [i for i in found["rest"][2].innovations if i.time.since(START) > 52.0]
    assert not any(i.accepted for i in late)
    sigma = np.sqrt(np.diagonal(found["rest"][1].P))
    assert np.linalg.norm(rest[:2]) < 0.1 * np.linalg.norm(free[:2])
    assert np.all(np.abs(rest[3:6]) < 4.0 * sigma[3:6])
    assert np.all(np.abs(rest[9:12]) < 4.0 * sigma[9:12])
    assert np.all(sigma[9:12] < 0.3 * np.sqrt(np.diagonal(found["free"][1].P))[9:12])


def test_wheels_at_rest_are_believed_at_once() -> None:
    truth = stop_and_go()
    block, errors = sensed(truth, MTI_G, 3)
    rng = np.random.default_rng(3)
    start = started(truth, MTI_G, errors, Layout(15), rng)
    wheels = truth.wheels(np.arange(0.25, 60.0, 0.5), rng, 0.0, 0.0)
    run = integrate(block, [], lambda _: start, process_noise(MTI_G), Settings(LEVER_B_M), wheels)
    times = [i.time.since(START) for i in run.innovations if i.kind == "zero velocity"]
    assert times
    assert STOP_S[0] <= min(times) < STOP_S[0] + 0.5
    assert max(times) <= STOP_S[1]


@pytest.mark.parametrize(("radius_m", "speed_mps"), [(10.0, 2.5), (2000.0, 12.0)])
def test_neither_a_steady_turn_nor_a_cruise_is_rest(radius_m: float, speed_mps: float) -> None:
    """On a smooth road both are as quiet, and after a long outage any speed is likely."""
    rate = speed_mps / radius_m
    path = Ellipse(radius_m, radius_m, smooth_profile([(0.0, rate), (100.0, rate)]))
    vehicle = Vehicle(0.53, 1.99, 30.0, path, EllipseAttitude(path, 0.2))
    blocks = increments(vehicle, START, RATE_HZ, round(60.0 * RATE_HZ), highest_hz=1.0)
    truth = Drive(vehicle, joined(*blocks))
    block, errors = sensed(truth, MTI_G, 4)
    start = started(truth, MTI_G, errors, Layout(15), np.random.default_rng(4))
    limits = standstill_limits(MTI_G, RATE_HZ)
    run = integrate(
        block, [], lambda _: start, process_noise(MTI_G), Settings(LEVER_B_M, standstill=limits)
    )
    assert np.mean(standing(block, limits)[200:]) > 0.9  # quiet it is
    assert "zero velocity" not in counts(run.innovations)
