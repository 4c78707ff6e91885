"""Rows that run the whole receiver on simulated samples, and what they are held against."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from deepgnss.core.records import BDS_B1I, GPS_L1CA, SignalId
from deepgnss.evaluate.reproduce import carrier_phase, code_noise, multipath, verdict
from deepgnss.evaluate.reproduce.front_end import code_noise_ratio, correlation, gain, loss_db
from deepgnss.evaluate.reproduce.table import Measure
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.quantization import quantization_loss_db
from deepgnss.sim.scenario import FrontEnd
from deepgnss.sim.schema import PUBLISHED, build, load_scenario, ready_scenarios
from deepgnss.theory.multipath import multipath_error_chips


@pytest.mark.slow
@pytest.mark.parametrize(
    "measure",
    [
        carrier_phase.measure_strong,
        carrier_phase.measure_weak,
        code_noise.measure,
        multipath.measure,
    ],
)
def test_quick_rows_reach_their_targets(measure: Measure) -> None:
    figures = measure(True, [1])
    assert verdict(figures), figures


def test_ready_scenarios_of_the_rows_say_where_they_belong() -> None:
    names = [ready.name for ready in ready_scenarios(PUBLISHED)]
    wanted = ("phase_48", "phase_33", "code_noise", "multipath")
    assert {PUBLISHED + name for name in wanted} <= set(names)
    for name in names:
        assert load_scenario(name).name == name


@pytest.mark.parametrize(("name", "dbhz"), [("phase_48", 48.5), ("phase_33", 33.0)])
def test_phase_scenarios_deliver_the_stated_level(name: str, dbhz: float) -> None:
    scenario = build(load_scenario(PUBLISHED + name)).scenario
    ends = {"G": scenario.streams[0].front_end, "C": scenario.streams[1].front_end}
    behind = [
        emitter.cn0_dbhz[0][1] - loss_db(ends[emitter.satellite[0]], emitter.signal.id)
        for emitter in scenario.emitters
    ]
    assert np.mean(behind) == pytest.approx(dbhz, abs=0.05)
    assert np.ptp(behind) < 0.4


def test_code_noise_scenario_delivers_the_stated_level() -> None:
    scenario = build(load_scenario(PUBLISHED + "code_noise")).scenario
    loss = loss_db(scenario.streams[0].front_end)
    assert scenario.emitters[0].cn0_dbhz[0][1] - loss == pytest.approx(48.5, abs=0.1)


def test_dopplers_of_the_code_noise_scenario_keep_apart() -> None:
    """Differences stay 60 Hz off multiples of 1 kHz, so that codes average each other out."""
    scenario = build(load_scenario(PUBLISHED + "code_noise")).scenario
    t_s = np.linspace(0.0, scenario.seconds, 7)
    t_s = np.sort(np.concatenate([t_s, t_s + 0.1]))
    dopplers = []
    for emitter in scenario.emitters:
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        cycles = receive(scenario, emitter, orbit, t_s).carrier_cycles
        dopplers.append(-(cycles[1::2] - cycles[::2]) / 0.1)
    for k, one in enumerate(dopplers):
        for other in dopplers[:k]:
            off_hz = np.abs((one - other + 500.0) % 1000.0 - 500.0)
            assert off_hz.min() > 60.0


def test_gain_of_the_filter_is_its_response() -> None:
    end = FrontEnd(28.31e6, bandwidth_hz=25.8e6)
    assert gain(end, np.array([0.0, 5.0e6, -5.0e6])) == pytest.approx(1.0, abs=0.02)
    assert gain(end, np.array([12.9e6])) == pytest.approx(0.5, abs=0.03)
    assert gain(FrontEnd(4.0e6), np.array([1.0e6])) == pytest.approx(1.0)


@pytest.mark.parametrize("signal", [GPS_L1CA, BDS_B1I])
def test_loss_of_a_wide_front_end_is_the_converters(signal: SignalId) -> None:
    wide = FrontEnd(60.0e6, bandwidth_hz=55.0e6)
    narrow = FrontEnd(60.0e6, bandwidth_hz=signal.chip_rate_hz, filter_taps=1023)
    assert loss_db(wide, signal) - quantization_loss_db(wide, signal) == pytest.approx(0.0, abs=0.1)
    # Within ± half a chip rate lie 77 % of the power: 1.1 dB.
    lost = loss_db(narrow, signal) - quantization_loss_db(narrow, signal)
    assert lost == pytest.approx(1.11, abs=0.1)


def test_a_filter_rounds_the_correlation_and_leaves_its_flanks() -> None:
    front_end = FrontEnd(320.0e6, bandwidth_hz=32.0e6, filter_taps=1023)
    chips, value = correlation(front_end, GPS_L1CA, 14)
    at = dict(zip(chips.round(6).tolist(), value.tolist(), strict=True))
    outside = 2.0 * GPS_L1CA.chip_rate_hz / (32.0e6 * np.pi**2)  # of sinc², beyond the band
    assert at[0.0] == pytest.approx(1.0 - outside, abs=1e-3)
    assert at[0.5] == pytest.approx(0.5, abs=0.01)
    assert at[-0.5] == pytest.approx(at[0.5], abs=1e-9)
    assert at[1.5] == pytest.approx(0.0, abs=0.01)


def test_rays_come_in_both_phases_and_never_two_to_a_satellite() -> None:
    """The mirror's half cycle included: half a wavelength over whole ones arrives in phase."""
    cast = multipath.rays([0.25, 0.5, 0.75, 1.2])
    for ray in cast:
        turns = ray.delay_m / multipath.WAVELENGTH_M + 0.5
        assert np.cos(2.0 * np.pi * turns) == pytest.approx(1.0 if ray.in_phase else -1.0)
    by_satellite: dict[str, Sequence[multipath.Ray]] = {}
    for ray in cast:
        by_satellite[ray.satellite] = [*by_satellite.get(ray.satellite, []), ray]
    for own in by_satellite.values():
        for before, after in pairwise(own):
            assert before.end_s <= after.begin_s
    delays = sorted(ray.delay_m / multipath.CHIP_M for ray in cast if ray.in_phase)
    assert delays == pytest.approx([0.25, 0.5, 0.75, 1.2], abs=1e-3)


def test_loops_of_the_thesis_are_among_the_settings() -> None:
    wanted = {(1.0, 0.001, 1.0), (0.125, 0.001, 0.1), (0.125, 0.020, 0.1)}
    assert wanted <= {loop[:3] for loop in code_noise.LOOPS}


@pytest.mark.parametrize("spacing", multipath.SPACINGS)
@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_the_short_row_has_the_delays_of_the_largest_errors(spacing: float, phase: float) -> None:
    """Either way: they are not the same for a ray in phase and one against it."""
    sizes = [
        max(abs(multipath_error_chips(spacing, 0.5, delay, phase)) for delay in delays)
        for delays in (multipath._QUICK_DELAYS, multipath._DELAYS)
    ]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.01)


def test_theory_through_a_wide_filter_is_near_that_of_the_triangle() -> None:
    curve = multipath._curve(FrontEnd(34.71e6, bandwidth_hz=32.0e6), 14)
    for spacing, delay in ((1.0, 0.5), (0.1, 0.5)):
        ideal = multipath_error_chips(spacing, 0.5, delay, 0.0)
        through = multipath_error_chips(spacing, 0.5, delay, 0.0, curve)
        assert through == pytest.approx(ideal, rel=0.05)


@pytest.mark.parametrize("spacing", [0.25, 0.5, 1.0])
def test_integral_of_code_noise_is_the_formula_where_the_front_end_is_wide(spacing: float) -> None:
    assert code_noise_ratio(FrontEnd(400.0e6), spacing) == pytest.approx(1.0, abs=0.01)
