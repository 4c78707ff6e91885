"""Rows OL-*: what their measuring makes of phases put in, and what theory expects of them."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.reproduce import open_loop, verdict
from deepgnss.evaluate.reproduce.carried_phase import (
    CARRIER_HZ,
    Carried,
    Hidden,
    Phases,
    TrueTime,
    blocked_setting,
    carried,
    thermal_cycles,
    toward_n,
)
from deepgnss.evaluate.reproduce.table import Measure
from deepgnss.sim.clock import clock_error
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import PUBLISHED, build, load_scenario
from deepgnss.theory.open_loop import best_fit, clock_growth, share_below
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles, reported_share

ONE = Hidden("G03", 30.0, 50.0)


def scenario(*settings: str) -> Scenario:
    return build(load_scenario(PUBLISHED + "open_loop_static", settings)).scenario


def table(errors: dict[str, FloatArray], time_s: FloatArray, gap: tuple[float, float]):
    """Tags of satellites; those named coast through the gap."""
    rows = []
    for name, own in errors.items():
        inside = (time_s > gap[0]) & (time_s < gap[1])
        rows.append(
            pd.DataFrame(
                {
                    "time_s": time_s,
                    "satellite": name,
                    "error_cycles": own,
                    "coasting": inside,
                    "valid": True,
                    "arc": 1,
                    "half_cycle": False,
                    "cn0_dbhz": 48.0,
                }
            )
        )
    return pd.concat(rows, ignore_index=True)


# --- time and hiding ------------------------------------------------------------------------------


def test_true_time_is_the_reading_less_the_clock_error() -> None:
    """Between its nodes, and where a clock that runs ahead reads before the start."""
    sim = scenario("clock={offset: 2.0e-3, drift: 1.0e-6}", "oscillator=TCXO")
    true_time, error = TrueTime(sim), clock_error(sim.clock, sim.seed, sim.vehicle)
    for second, node in ((0, 0), (3, 250), (7, 999)):
        reading_s = second + node / 1000.0
        assert true_time(reading_s) == pytest.approx(reading_s - error(second)[node], abs=1e-15)
    half = 0.5 * (error(3)[250] + error(3)[251])
    assert true_time(3.2505) == pytest.approx(3.2505 - half, abs=1e-15)
    assert true_time(-0.0005) == pytest.approx(
        -0.0005 - 0.5 * (error(-1)[999] + error(0)[0]), abs=1e-15
    )


def test_hidden_satellites_are_silent_in_the_scenario() -> None:
    hidden = [ONE, Hidden("G03", 53.0, 58.0), Hidden("G04", 31.0, 36.0)]
    emitters = {e.satellite: e for e in scenario(blocked_setting(hidden)).emitters}
    for name, quiet in (("G03", {30.0: True, 50.0: False, 53.0: True, 58.0: False}),):
        steps = {second: math.isinf(level) for second, level in emitters[name].cn0_dbhz}
        assert {second: steps[second] for second in quiet} == quiet
    assert any(math.isinf(level) for _, level in emitters["G04"].cn0_dbhz)
    assert not any(math.isinf(level) for _, level in emitters["G20"].cn0_dbhz)


# --- errors ---------------------------------------------------------------------------------------


def test_an_error_carried_is_its_growth_since_the_last_tag_before() -> None:
    time_s = np.round(np.arange(20.0, 60.0, 0.1), 3)
    growing = 17.25 + np.where(time_s > 30.0, 0.02 * (time_s - 30.0), 0.0)
    run = Phases(scenario(), table({"G03": growing}, time_s, (30.05, 50.0)), [])
    (found,) = carried(run, [ONE])
    assert found.kept
    assert found.last_cycles == pytest.approx(0.02 * 19.9, abs=1e-6)
    assert found.time_s[-1] == pytest.approx(49.9 - 29.9)


def test_a_polarity_given_up_with_its_arc_is_no_error_and_a_lost_channel_is() -> None:
    time_s = np.round(np.arange(20.0, 60.0, 0.1), 3)
    given_up = time_s > 40.0
    errors = table({"G03": np.where(given_up, 2.5 - 0.5, 2.5)}, time_s, (30.05, 50.0))
    errors.loc[given_up, ["arc", "valid"]] = [2, False]
    (found,) = carried(Phases(scenario(), errors, []), [ONE])
    assert found.last_cycles == pytest.approx(0.0)
    assert not found.kept
    within = errors.assign(arc=1)  # the same step within an arc is one
    (found,) = carried(Phases(scenario(), within, []), [ONE])
    assert found.last_cycles == pytest.approx(-0.5)
    short = errors[~errors["coasting"] | (errors["time_s"] < 45.0)]
    (found,) = carried(Phases(scenario(), short, []), [ONE])
    assert math.isinf(found.last_cycles)


def test_shares_count_lost_phases_and_ratios_each_by_its_own_sigma() -> None:
    def one(error: float, sigma: float) -> Carried:
        return Carried(ONE, np.array([20.0]), np.array([error]), True, sigma, sigma)

    found = [one(0.4, 0.4), one(-0.6, 0.3), one(0.1, 0.2)]
    assert open_loop.spread_ratio(found) == pytest.approx(math.sqrt((1.0 + 4.0 + 0.25) / 3.0))
    lost = Carried(ONE, np.empty(0), np.empty(0), False, math.nan, math.nan)
    figure = open_loop._share_figure("x", [*found, lost], 0.5, 0.5)
    assert figure.ours.startswith("50.00 % of 4")
    assert "lost" in figure.ours
    assert figure.met
    assert not open_loop._share_figure("x", [*found, lost], 0.5, 0.51).met


def test_where_nothing_is_predicted_no_share_is_enough() -> None:
    """OL-SALL asks for a part of the predicted share, which is none of phases never tracked."""
    lost = Carried(ONE, np.empty(0), np.empty(0), False, math.nan, math.nan)
    assert open_loop._expected([lost], 0.5) == 0.0
    assert open_loop._share_figure("x", [lost], 0.5, 0.0).met is False


# --- theory ---------------------------------------------------------------------------------------


def test_prediction_for_all_is_the_clock_and_for_one_what_others_tell() -> None:
    time_s = np.round(np.arange(20.0, 60.0, 0.1), 3)
    sim = scenario()
    names = [emitter.satellite for emitter in sim.emitters]
    run = Phases(sim, table(dict.fromkeys(names, np.zeros(400)), time_s, (30.05, 50.0)), [])
    every = carried(run, [Hidden(name, 30.0, 50.0) for name in names])
    thermal = pll_thermal_sigma_cycles(48.0, 7.0, 0.020) * reported_share(3, 7.0, 0.020)
    assert sim.clock.oscillator is not None
    fit = best_fit(sim.clock.oscillator, CARRIER_HZ, 20.0, thermal / math.sqrt(len(names)))
    clock = clock_growth(sim.clock.oscillator, CARRIER_HZ, fit, np.array([20.0])).phase_cycles[0]
    for one in every:
        assert one.sigma_cycles == pytest.approx(math.hypot(clock, thermal), rel=1e-6)
    (alone,) = carried(run, [ONE])
    others = len(names) - 1  # an antenna at rest: the clock by the others' mean, …
    noise = thermal / math.sqrt(others)
    tags_s = 0.1 * np.arange(1.0, 201.0)
    soon = best_fit(sim.clock.oscillator, CARRIER_HZ, 0.1, noise)
    wander = clock_growth(sim.clock.oscillator, CARRIER_HZ, soon, tags_s).phase_cycles
    alike = int(np.sum(wander < thermal))  # … of as many tags as it does not wander by as much
    assert 2 < alike < 10
    told = 2.0 / others / alike
    assert alone.sigma_cycles == pytest.approx(thermal * math.sqrt(1.0 + told), rel=1e-6)


def test_direction_is_against_the_growth_of_the_range() -> None:
    """The range falls by the way towards the satellite: over a move of 10 m north and up."""
    start, moved = (scenario(f"place.height={height}") for height in (120.0, 130.0))
    emitter = start.emitters[0]
    up = toward_n(start, emitter, 5.0)
    assert np.linalg.norm(up) == pytest.approx(1.0)
    ranges = [
        receive(
            sim, emitter, orbit_of(sim.orbit_set(emitter.satellite), sim.start), np.array([5.0])
        ).range_m[0]
        for sim in (start, moved)
    ]
    assert ranges[1] - ranges[0] == pytest.approx(10.0 * up[2], abs=1e-3)


def test_the_published_clock_leaves_half_by_the_mean_and_more_by_the_best_fit() -> None:
    clock = open_loop.published_clock()
    assert 1e-24 < clock.h_2_hz < 4.2e-24  # that of a drift known exactly, which nobody can beat
    fit = best_fit(clock, CARRIER_HZ, 20.0, 0.001)
    sigma = clock_growth(clock, CARRIER_HZ, fit, np.array([20.0])).phase_cycles[0]
    assert 0.62 < share_below(0.5, float(sigma)) < 0.70


# --- returns --------------------------------------------------------------------------------------


def test_settling_ignores_half_cycles_and_common_errors_but_no_missing_channel() -> None:
    sim = scenario()
    names = [emitter.satellite for emitter in sim.emitters]
    time_s = np.round(np.arange(50.05, 57.0, 0.1), 3)
    rng = np.random.default_rng(1)
    thermal = thermal_cycles(sim, sim.emitters[0])
    errors = {
        name: 0.5 * k + 3.0 * np.sin(time_s) + rng.normal(0.0, thermal, time_s.size)
        for k, name in enumerate(names)
    }
    late = table(errors, time_s, (0.0, 0.0))
    off = late["satellite"].eq(names[2]) & late["time_s"].lt(51.0)
    late.loc[off, "error_cycles"] += 0.1
    assert open_loop.settling(Phases(sim, late, []), 50.0).seconds == pytest.approx(1.05, abs=0.01)
    missing = late[~(late["satellite"].eq(names[3]) & late["time_s"].lt(51.5))]
    found = open_loop.settling(Phases(sim, missing, []), 50.0)
    assert found.seconds == pytest.approx(1.55, abs=0.01)
    never = late.copy()
    last = never["satellite"].eq(names[1]) & (np.mod(np.floor(never["time_s"] * 10.0), 2.0) == 0.0)
    never.loc[last, "error_cycles"] += 0.2
    assert open_loop.settling(Phases(sim, never, []), 50.0).seconds > 5.0


# --- whole rows -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "measure",
    [
        open_loop.measure_rest_one,
        open_loop.measure_rest_all,
        open_loop.measure_drive_one,
        open_loop.measure_drive_all,
        open_loop.measure_prediction,
        open_loop.measure_settling,
    ],
)
def test_quick_rows_reach_their_targets(measure: Measure) -> None:
    figures = measure(True, [1])
    assert verdict(figures), figures
