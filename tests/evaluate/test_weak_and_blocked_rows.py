"""Rows of weak signals, blockages and hard manoeuvres: their scenarios and what is measured."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Observation, SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.reproduce import blockage, high_dynamics, verdict, weak_ranges
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.high_dynamics import OFF_CHIPS, OFF_HZ, Outcome, manoeuvres
from deepgnss.evaluate.reproduce.sampled_truth import SampledTruth
from deepgnss.evaluate.reproduce.table import Measure
from deepgnss.evaluate.reproduce.whole_receiver import Recording
from deepgnss.sim.output import Written
from deepgnss.sim.schema import PUBLISHED, build, load_scenario

_SCENARIOS = {"weak_ranges": 21.5, "hundred_g": 20.0, "blockage_return": 47.0}


def _recording(name: str, folder: Path, *settings: str) -> Recording:
    simulation = build(load_scenario(PUBLISHED + name, settings))
    written = Written((), folder / "rec.bin", folder / "config.yaml")
    return Recording(simulation, written, (52.0, 10.0, 100.0))


@pytest.mark.slow
@pytest.mark.parametrize("measure", [weak_ranges.measure, blockage.measure, high_dynamics.measure])
def test_quick_rows_reach_their_targets(measure: Measure) -> None:
    figures = measure(True, [1])
    assert verdict(figures), figures


@pytest.mark.parametrize(("name", "dbhz"), _SCENARIOS.items())
def test_scenarios_end_at_the_stated_level(name: str, dbhz: float) -> None:
    scenario = build(load_scenario(PUBLISHED + name)).scenario
    loss = loss_db(scenario.streams[0].front_end)
    assert len(scenario.emitters) >= 6
    for emitter in scenario.emitters:
        assert emitter.cn0_dbhz[-1][1] - loss == pytest.approx(dbhz, abs=0.05)


def test_blockages_last_twenty_seconds_and_end_within_a_second_of_a_whole_one(
    tmp_path: Path,
) -> None:
    recording = _recording("blockage_return", tmp_path)
    steps = recording.scenario.emitters[0].cn0_dbhz
    ends = blockage.blockages_end_s(recording)
    assert len(ends) * len(recording.scenario.emitters) >= 20
    for end_s in ends:
        begin_s = max(second for second, dbhz in steps if second < end_s and not np.isfinite(dbhz))
        assert end_s - begin_s >= 20.0
        wait_s = -(recording.scenario.start.tow_s + end_s) % 1.0
        assert 0.9 < wait_s < 1.0
    short = _recording("blockage_return", tmp_path, "seconds=63")
    assert blockage.blockages_end_s(short) == ends[:1]


def test_manoeuvres_hold_100_g_for_a_second_and_end_with_the_jerk(tmp_path: Path) -> None:
    recording = _recording("hundred_g", tmp_path)
    vehicle = recording.scenario.vehicle
    found = manoeuvres(recording)
    assert len(found) == 4
    for begin_s, end_s in found:
        assert end_s - begin_s == pytest.approx(3.0)
        t_s = np.arange(begin_s - 0.5, end_s + 0.5, 0.01)
        felt = np.linalg.norm(vehicle.point(t_s).a_mps2, axis=1)
        assert (felt > 0.999 * 980.665).sum() == pytest.approx(100, abs=2)
        assert felt[t_s < begin_s - 0.02].max() < 1.0
        assert felt[t_s > end_s + 0.02].max() < 1.0


def test_pair_squares_are_those_of_all_pairs() -> None:
    errors = [1.5, -2.0, 0.25, 4.0]
    wanted = sum((a - b) ** 2 for a, b in itertools.combinations(errors, 2))
    assert weak_ranges._pair_squares(errors) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("outcome", "tracked"),
    [
        (Outcome(0.9 * OFF_HZ, -0.9 * OFF_CHIPS, lost=False), True),
        (Outcome(-1.1 * OFF_HZ, 0.0, lost=False), False),
        (Outcome(0.0, -1.1 * OFF_CHIPS, lost=False), False),
        (Outcome(0.0, 0.0, lost=True), False),
    ],
)
def test_tracked_is_neither_lost_nor_off(outcome: Outcome, *, tracked: bool) -> None:
    assert outcome.tracked is tracked


def _observation(satellite: str, transmit: GpsTime, doppler_hz: float) -> Observation:
    return Observation(
        satellite, "GPS_L1CA", 2.0e7, 0.0, doppler_hz, 40.0, 0.0, False, False, False, transmit
    )


def test_errors_need_neither_tag_nor_clock_model(tmp_path: Path) -> None:
    """A clock 3 µs fast read start + 1 s at the sample: GPST is 3 µs less, whatever a tag says."""
    recording = _recording("blockage_return", tmp_path)
    start = recording.scenario.start
    offset_s, rate_mps = 3.0e-6, -700.0
    seconds = np.arange(0.0, 3.0, 0.1)
    seconds = seconds[(seconds < 1.45) | (seconds > 1.95)]
    stamps = [start.plus(float(s)) for s in seconds]
    pd.DataFrame(
        {
            "gps_week": [at.week for at in stamps],
            "gps_tow_s": [at.tow_s for at in stamps],
            "offset_s": offset_s,
        }
    ).to_csv(tmp_path / "clock.csv")
    pd.DataFrame(
        {
            "week": [at.week for at in stamps],
            "tow": [at.tow_s for at in stamps],
            "satellite": "G03",
            "visible": 1,
            "pseudorange_m": 2.2e7 + rate_mps * seconds,
            "doppler_hz": 3000.0,
        }
    ).to_csv(tmp_path / "ranges.csv")
    truth = SampledTruth(recording)
    rate_hz = recording.scenario.streams[0].front_end.sample_rate_hz
    sample = round(rate_hz)
    instant = SampleInstant(sample, rate_hz - sample)
    now_s = 1.0 - offset_s
    assert truth.true_s(instant) == pytest.approx(now_s, abs=1e-12)
    flight_s = (2.2e7 + rate_mps * now_s) / SPEED_OF_LIGHT_MPS
    seen = _observation("G03", start.plus(now_s - flight_s - 1e-7), 3002.0)
    missed = truth.missed(seen, instant)
    assert missed is not None
    assert missed.range_m == pytest.approx(1e-7 * SPEED_OF_LIGHT_MPS, abs=0.04)  # left earlier
    assert missed.doppler_hz == pytest.approx(2.0)
    assert truth.missed(_observation("G04", start, 0.0), instant) is None
    assert truth.missed(seen, SampleInstant(round(1.7 * rate_hz), 0.0)) is None  # truth has a gap
