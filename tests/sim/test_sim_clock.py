"""The oscillator's noise against its power law, and its pull under force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.constants
from pydantic import TypeAdapter

from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.io.config.aids import NamedOscillator, OscillatorConfig, oscillator_names
from deepgnss.sim.clock import NODES_PER_SECOND, clock_error
from deepgnss.sim.motion.attitude import Steady
from deepgnss.sim.motion.paths import Line
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.scenario import ReceiverClock
from deepgnss.theory.oscillators import allan_deviation, free_running_phase_sigma_cycles

PLACE = (0.91, 0.18, 120.0)
TCXO = Oscillator("TCXO", 1.0e-21, 1.0e-21, 2.0e-20, 0.0)


def _named(name: str) -> Oscillator:
    config: OscillatorConfig = TypeAdapter(NamedOscillator).validate_python(name)
    return config.oscillator()


def _phase_s(oscillator: Oscillator, seconds: int, seed: int) -> FloatArray:
    second = clock_error(ReceiverClock(oscillator=oscillator), seed)
    return np.concatenate([second(number) for number in range(seconds)])


@pytest.mark.parametrize("name", oscillator_names())
def test_allan_deviation_is_that_of_the_oscillator(name: str) -> None:
    """Non-overlapping, several seeds together; four standard deviations of the estimate."""
    oscillator, seconds, seeds = _named(name), 400, range(4)
    runs = [_phase_s(oscillator, seconds, seed) for seed in seeds]
    for tau_ms in (10, 100, 1_000, 10_000, 100_000):
        steps = np.concatenate([np.diff(run[::tau_ms], 2) for run in runs])
        measured = math.sqrt(0.5 * np.mean(steps**2)) / (tau_ms * 1.0e-3)
        limit = 4.0 / math.sqrt(steps.size) + 0.01
        assert measured == pytest.approx(allan_deviation(oscillator, tau_ms * 1e-3), rel=limit)


def test_flicker_alone_has_a_floor_at_every_time() -> None:
    flicker = Oscillator("flicker", 0.0, 1.0e-21, 0.0, 0.0)
    runs = [_phase_s(flicker, 300, seed) for seed in range(3)]
    for tau_ms in (4, 20, 100, 700, 5_000, 30_000):
        steps = np.concatenate([np.diff(run[::tau_ms], 2) for run in runs])
        variance = 0.5 * np.mean(steps**2) / (tau_ms * 1.0e-3) ** 2
        limit = 4.0 * math.sqrt(2.0 / steps.size) + 0.02
        assert variance == pytest.approx(2.0 * math.log(2.0) * 1.0e-21, rel=limit)


def test_phase_runs_away_over_an_ensemble_as_it_should() -> None:
    """White and random-walk noise of a bad oscillator: 300 clocks, phase after 5 s."""
    oscillator = Oscillator("x", 2.0e-20, 0.0, 1.0e-21, 0.0)
    clocks = [clock_error(ReceiverClock(oscillator=oscillator), seed) for seed in range(300)]
    # the walk has run for two seconds before sample 0: its frequency there is taken off
    ends = np.array([[clock(4)[-1], *clock(0)[[0, 100]]] for clock in clocks])
    assert np.all(ends[:, 1] == 0.0)
    frequency = 2.0 * math.pi**2 * oscillator.h_2_hz * 2.0  # variance of it at sample 0
    expected = math.hypot(
        free_running_phase_sigma_cycles(oscillator, 1.0, 4.999), math.sqrt(frequency) * 4.999
    )
    assert ends[:, 0].std() == pytest.approx(expected, rel=4.0 / math.sqrt(600.0))


def test_a_second_is_the_same_whatever_was_asked_before() -> None:
    clock = ReceiverClock(2.0e-4, 1.0e-7, TCXO)
    forward = clock_error(clock, 5)
    in_order = [forward(number) for number in range(-2, 30)]
    jumping = clock_error(clock, 5)
    for number in (29, 3, -2, 17, 3):
        np.testing.assert_array_equal(jumping(number), in_order[number + 2])
    assert forward(0)[0] == 2.0e-4
    joints = np.diff(np.concatenate(in_order))[NODES_PER_SECOND - 1 :: NODES_PER_SECOND]
    assert np.abs(joints - 1.0e-10).max() < 6.0 * math.sqrt(TCXO.h0_s * 5e-4 + 3e-24)
    assert not np.array_equal(clock_error(clock, 6)(3), in_order[5])


def test_offset_and_drift_alone() -> None:
    second = clock_error(ReceiverClock(2.0e-4, 1.0e-7), 1)
    assert second(3)[[0, 500]] == pytest.approx([2.003e-4, 2.0035e-4], abs=1e-16)


@pytest.mark.parametrize(
    ("axis_b", "direction_n"),
    [((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))],
    ids=["forward", "down"],
)
def test_force_along_the_axis_pulls_the_frequency(
    axis_b: tuple[float, float, float], direction_n: tuple[float, float, float]
) -> None:
    """∫ a/g dt = v/g: a car that goes east at 30 m/s, a stone that falls at 30 m/s."""
    quiet = Oscillator("quiet", 0.0, 0.0, 0.0, 2.0e-9)
    clock = ReceiverClock(oscillator=quiet, axis_b=axis_b)
    path = Line(direction_n, smooth_profile([(1.0, 0.0), (4.0, 30.0)]))
    vehicle = Vehicle(*PLACE, path, Steady(yaw_rad=math.pi / 2.0))
    second = clock_error(clock, 1, vehicle)
    gained_s = second(4)[0] - second(1)[0]
    resting_s = 2.0e-9 * 3.0 * axis_b[2] * (1.0 - 9.8128 / scipy.constants.g)  # gravity at 52°
    assert gained_s - resting_s == pytest.approx(2.0e-9 * 30.0 / scipy.constants.g, rel=1e-3)


def test_upside_down_is_two_g() -> None:
    clock = ReceiverClock(oscillator=Oscillator("quiet", 0.0, 0.0, 0.0, 1.0e-9))
    level, turned = (
        clock_error(clock, 1, Vehicle(*PLACE, attitude=Steady(roll_rad=roll)))
        for roll in (0.0, math.pi)
    )
    assert abs(level(2)[0]) < 2.0 * 1.0e-9 * 1.5e-3  # gravity here is not standard
    assert turned(2)[0] == pytest.approx(2.0 * 2.0e-9, rel=1e-3)
    assert not np.any(clock_error(replace(clock, oscillator=None), 1)(2))
