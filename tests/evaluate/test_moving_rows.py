"""Rows of carrier phase in motion: what their measuring makes of errors put in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.records import Correlations, FloatArray
from deepgnss.evaluate.reproduce import carrier_phase, turns, verdict
from deepgnss.evaluate.reproduce.carrier_phase import D26, D35, D47, Differences, differences
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.table import Measure
from deepgnss.evaluate.reproduce.turns import LOOPS, Heard, Loop
from deepgnss.evaluate.reproduce.whole_receiver import Recording
from deepgnss.sim.motion.vehicle import geographic
from deepgnss.sim.output import Written
from deepgnss.sim.schema import PUBLISHED, build, load_scenario
from deepgnss.theory.tracking_error import acceleration_peak_cycles, acceleration_response

WAVELENGTH_M = 0.1903


def _recording(name: str, *settings: str) -> Recording:
    """Without samples: what is measured needs the scenario only."""
    nowhere = Path("nowhere")
    simulation = build(load_scenario(PUBLISHED + name, settings))
    return Recording(simulation, Written((), nowhere, nowhere), (0.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "measure",
    [
        carrier_phase.measure_drive_47,
        carrier_phase.measure_drive_35,
        carrier_phase.measure_drive_26,
        turns.measure,
    ],
)
def test_quick_rows_reach_their_targets(measure: Measure) -> None:
    figures = measure(True, [1])
    assert verdict(figures), figures


# --- the drive ------------------------------------------------------------------------------------


def test_the_drive_reaches_2_g_and_40_mps_and_is_gentle_at_first() -> None:
    vehicle = build(load_scenario(PUBLISHED + "drive")).scenario.vehicle
    t_s = np.arange(0.0, 130.0, 0.02)
    v_n_mps = geographic(vehicle.pose(t_s)).v_n_mps
    level_mps2 = np.linalg.norm(np.gradient(v_n_mps, t_s, axis=0), axis=1)
    assert np.linalg.norm(v_n_mps, axis=1).max() == pytest.approx(40.0, abs=0.1)
    assert level_mps2.max() == pytest.approx(19.6, abs=0.2)
    assert level_mps2[t_s < 20.0].max() < 6.0
    assert np.mean(level_mps2[t_s > 30.0] > 5.0) > 0.3


@pytest.mark.parametrize("row", [D47, D35, D26])
def test_levels_of_the_drive_stand_behind_the_converter(row: carrier_phase.Drive) -> None:
    recording = _recording("drive", carrier_phase._levels(row.dbhz))
    for emitter in recording.scenario.emitters:
        loss = loss_db(recording.scenario.streams[0].front_end)
        assert emitter.cn0_dbhz[0][1] - loss == pytest.approx(47.0, abs=1e-3)
        assert carrier_phase.behind_dbhz(recording, emitter) == pytest.approx(row.dbhz, abs=1e-3)


def _errors(recording: Recording, sigma_m: float, seconds: int = 60) -> pd.DataFrame:
    """White phase errors of the scenario's satellites, 10 Hz, a common clock on top."""
    rng = np.random.default_rng(7)
    time_ms = 1000 + 100 * np.arange(10 * seconds)
    clock_m = rng.normal(0.0, 1.0, time_ms.size)
    parts = [
        pd.DataFrame(
            {
                "time_ms": time_ms,
                "satellite": emitter.satellite,
                "elevation_deg": 50.0 - k,
                "cn0_dbhz": 47.0,
                "code_m": 0.0,
                "phase_m": 3.7 * k + clock_m + rng.normal(0.0, sigma_m, time_ms.size),
                "arc": 1,
            }
        )
        for k, emitter in enumerate(recording.scenario.emitters)
    ]
    return pd.concat(parts, ignore_index=True)


def test_double_differences_of_the_drive_leave_the_first_half_minute_out() -> None:
    recording = _recording("drive")
    errors = _errors(recording, 0.5e-3)
    errors.loc[errors["time_ms"] < 30_000, "phase_m"] *= 1.5
    found = differences(recording, errors, 30.0)
    assert not found.lost
    assert found.sigma["epochs"].tolist() == [300] * 5
    assert found.sigma["measured_m"].mean() == pytest.approx(math.sqrt(2.0) * 0.5e-3, rel=0.1)
    # √2 σ_th of 47 dB-Hz, 7 Hz and 20 ms is 0.0506 cm.
    assert found.sigma["thermal_m"].tolist() == pytest.approx([5.06e-4] * 5, rel=0.01)
    assert 2.0e-3 < found.sigma["largest_m"].max() < 3.5e-3


@pytest.mark.parametrize("cycles", [0.5, -1.0])
@pytest.mark.parametrize("reference", [False, True])
def test_slips_nobody_flags_are_found_against_truth(cycles: float, reference: bool) -> None:
    recording = _recording("drive")
    errors = _errors(recording, 5e-3)
    names = [emitter.satellite for emitter in recording.scenario.emitters]
    bad = names[0] if reference else names[3]
    late = (errors["satellite"] == bad) & (errors["time_ms"] > 50_000)
    errors.loc[late, "phase_m"] += cycles * WAVELENGTH_M
    lost = differences(recording, errors, 30.0).lost
    assert set(lost) == (set(names) if reference else {bad})


def test_targets_of_the_drive_are_judged_one_by_one() -> None:
    def figures(row: carrier_phase.Drive, sigma_m: float, largest_m: float, lost: list[str]):
        sigma = pd.DataFrame(
            {"epochs": 9, "measured_m": sigma_m, "thermal_m": 5e-4, "largest_m": largest_m},
            index=["G03"],
        )
        found = carrier_phase._drive_figures(row, "FSAS", [Differences(sigma, 47.0, lost)])
        return [figure.met for figure in found]

    assert figures(D47, 5.9e-4, 2.4e-3, []) == [True, True, True]
    assert figures(D47, 6.1e-4, 2.6e-3, ["G03"]) == [False, False, False]
    assert figures(D35, 6.1e-4, 1.0, []) == [False, None, True]
    assert figures(D35, 5.9e-4, 1.0, []) == [True, None, True]


# --- steps of acceleration ------------------------------------------------------------------------


def _turning(loop: Loop, steps: int) -> Recording:
    return _recording("turns", *turns.course(loop.step_mps2, steps))


@pytest.mark.parametrize("loop", [LOOPS[0], LOOPS[3]])
def test_steps_have_their_size_along_the_line_of_sight(loop: Loop) -> None:
    rates = turns.step_rates_hzps(_turning(loop, 4), turns.step_times_s(4))
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    assert rates["G11"] == pytest.approx(signs * loop.step_hzps, rel=0.01)
    assert (rates["G03"] * signs < 0.0).all()  # behind the vehicle
    seen = [max(abs(own)) > 0.4 / 0.96 * loop.step_hzps for own in rates.values()]
    assert sum(seen) == 4


def _heard(loop: Loop, response: FloatArray, rates: FloatArray, noise: float) -> Heard:
    """A discriminator that says `response` (of the loop's own step) after each step."""
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0005, 22.0, loop.coherent_s)
    cycles = 0.01 + noise * rng.standard_normal(time_s.size)
    for begin_s, rate in zip(turns.step_times_s(4), rates, strict=True):
        after = (time_s >= begin_s) & (time_s < begin_s + 0.5)
        cycles[after] += rate / loop.step_hzps * response[: after.sum()]
    return Heard(time_s, cycles)


def test_responses_of_all_satellites_make_one_of_the_loops_own_size() -> None:
    loop = LOOPS[0]
    recording = _turning(loop, 4)
    t_s = np.arange(0.0005, 0.56, loop.coherent_s)
    shape = loop.step_hzps * acceleration_response(t_s, loop.order, loop.bandwidth_hz)
    rates = turns.step_rates_hzps(recording, turns.step_times_s(4))
    heard = {name: _heard(loop, shape, own, 0.004) for name, own in rates.items()}
    found = turns.response(recording, loop, 4, heard)
    assert (found.steps, found.slipped) == (16, 0)
    expected = acceleration_peak_cycles(loop.step_hzps, 2, 5.0)
    assert found.peak_cycles == pytest.approx(expected, rel=0.03)
    before = found.cycles[found.time_s < 0.0]
    assert np.abs(before).max() < 0.003
    wild = {name: replace_cycles(told, 0.249) for name, told in heard.items()}
    assert turns.response(recording, loop, 4, wild).slipped == 16


def replace_cycles(told: Heard, cycles: float) -> Heard:
    return told._replace(cycles=np.full(told.cycles.size, cycles))


def test_a_discriminator_speaks_of_the_middle_of_its_interval() -> None:
    taps = np.exp(2j * np.pi * 0.1) * np.array([[0.5, 1.0, 0.5]] * 20)
    time_s, cycles = turns._told(Correlations(2_610_000, 0.001, taps), 2.61e6)
    assert (time_s, cycles) == (pytest.approx(1.01), pytest.approx(0.1))


def test_the_loop_integrated_is_that_of_theory_where_updates_are_short() -> None:
    for order in (2, 3):
        loop = Loop(order, 5.0, 0.001, 2.5)
        theory = acceleration_peak_cycles(loop.step_hzps, order, 5.0)
        # The discriminator compares with what the loop knew an update ago: B·T/3 more.
        assert turns.integrated_peak_cycles(loop) == pytest.approx(1.016 * theory, rel=0.01)
    slow = turns.integrated_peak_cycles(Loop(3, 10.0, 0.020, 10.0))
    assert slow == pytest.approx(1.6 * theory, rel=0.1)


def test_loops_are_those_of_the_thesis() -> None:
    assert {loop[:3] for loop in LOOPS} == {
        (order, *rest) for order in (2, 3) for rest in ((5.0, 0.001), (10.0, 0.001), (10.0, 0.02))
    }
    assert turns.theory_cycles(LOOPS[0])[1] == "T(4.47)"
