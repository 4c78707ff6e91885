"""Positions of several receivers: the same instants for all, tags off the grid, sections, files."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pymap3d
import pytest
from click.testing import CliRunner
from report_pages import HOSTILE, faults, words

from deepgnss.cli.main import cli
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.comparison import Yardstick, compare
from deepgnss.evaluate.comparison_signals import MODE_COLOURS, OTHER, draw_signals
from deepgnss.evaluate.observations import OBSERVATION_COLUMNS
from deepgnss.evaluate.outages import (
    Gap,
    Recovery,
    common_gaps,
    named_gaps,
    own_gaps,
    read_gaps,
    recoveries,
)
from deepgnss.evaluate.positions import Section, availability, figures, grid, position_errors
from deepgnss.evaluate.report.comparison import comparison_page
from deepgnss.evaluate.single_point import POSITIONS
from deepgnss.evaluate.sources import Source
from deepgnss.io.truth import Trajectory

_WEEK, _START_S = 2290, 1000.0
_AT = (np.radians(48.0), np.radians(11.0), 500.0)


def _place(tow_s: FloatArray, off_ned_m: FloatArray) -> FloatArray:
    """A car that goes north at 10 m/s, and an error from it."""
    enu = np.column_stack(
        [off_ned_m[:, 1], 10.0 * (tow_s - _START_S) + off_ned_m[:, 0], -off_ned_m[:, 2]]
    )
    return np.column_stack(pymap3d.enu2ecef(*enu.T, *_AT, deg=False))


def _positions(tow_s: FloatArray, off_ned_m: FloatArray) -> pd.DataFrame:
    columns = [np.full(len(tow_s), _WEEK), tow_s, np.ones(len(tow_s), int)]
    place = _place(tow_s, off_ned_m)
    return pd.DataFrame(
        dict(zip(POSITIONS, [*columns, *place.T, *np.zeros((3, len(tow_s)))], strict=True))
    )


@pytest.fixture
def truth() -> Trajectory:
    tow_s = _START_S + np.arange(0.0, 100.05, 0.1)
    return Trajectory(np.full(len(tow_s), _WEEK), tow_s, _place(tow_s, np.zeros((len(tow_s), 3))))


def test_errors_have_their_sign_and_belong_to_their_own_tag(truth: Trajectory) -> None:
    late = _START_S + np.arange(1.0, 99.0) + 0.3  # 3 m of way behind the whole second
    found = position_errors({"a": _positions(late, np.tile([1.0, -2.0, 3.0], (98, 1)))}, truth, 1.0)
    table = found["a"]
    assert len(table) == 98
    assert table[["north_m", "east_m", "down_m"]].mean().to_numpy() == pytest.approx(
        [1.0, -2.0, 3.0], abs=0.01
    )
    assert table["horizontal_m"].to_numpy() == pytest.approx(np.sqrt(5.0), abs=0.01)


def test_errors_are_counted_where_all_have_positions_and_shares_where_one_was_asked_for(
    truth: Trajectory,
) -> None:
    every = _START_S + np.arange(0.0, 101.0)
    tenth = _START_S + np.arange(0.0, 100.05, 0.1)
    bad = np.zeros((len(every), 3))
    bad[30:50, 1] = 8.0  # where the other has nothing
    gap = (tenth < _START_S + 29.5) | (tenth > _START_S + 50.5)
    found = position_errors(
        {
            "whole": _positions(every, bad),
            "gap": _positions(tenth[gap], np.tile([0.0, 4.0, 0.0], (int(gap.sum()), 1))),
        },
        truth,
        1.0,
    )
    asked = grid(truth, 1.0)
    told = figures(found, asked, 1.0, gross_m=3.0)
    assert (told["whole"].epochs, told["whole"].compared) == (101, 80)
    assert told["whole"].fixed_share == 1.0 and told["gap"].fixed_share == pytest.approx(80 / 101)
    assert told["gap"].longest_gap_s == 21.0
    assert told["whole"].horizontal_rms_m == pytest.approx(0.0, abs=1e-3)
    assert (told["whole"].gross_share, told["gap"].gross_share) == (0.0, 1.0)
    assert told["gap"].east_std_m == pytest.approx(0.0, abs=0.01)
    sections = (Section("tunnel", _START_S + 30.0, _START_S + 40.0), Section("none", 5.0, 6.0))
    shares = availability(found, asked, 1.0, sections)
    assert shares == {"tunnel": {"whole": 1.0, "gap": 0.0}}


def _errors(instants: list[int], horizontal_m: list[float]) -> pd.DataFrame:
    return pd.DataFrame({"horizontal_m": horizontal_m}, index=pd.Index(instants, name="instant"))


def test_a_gap_all_had_ends_when_the_first_is_back() -> None:
    asked = np.arange(100, 140)
    early = _errors([*range(100, 110), *range(120, 140)], [1.0] * 10 + [5.0] * 2 + [1.0] * 18)
    late = _errors([*range(100, 108), *range(124, 130)], [1.0] * 14)
    over = common_gaps(asked, [t.index.to_numpy() for t in (early, late)])
    assert over == [Gap(110, 120)]
    ((_, told),) = recoveries(over, {"early": early, "late": late}, asked, 0.5)
    assert told["early"] == Recovery(0.0, 1.0) and told["late"] == Recovery(2.0, 2.0)
    own = own_gaps(late, asked, 0.5)
    assert (own.gaps, own.total_s, own.longest_s, own.good_worst_s) == (1, 8.0, 8.0, 0.0)


def test_a_receiver_that_is_not_back_before_the_next_gap_says_so() -> None:
    asked = np.arange(0, 30)
    other = _errors([*range(0, 5), *range(10, 15), *range(20, 30)], [1.0] * 20)
    poor = _errors([*range(0, 5), *range(20, 30)], [1.0] * 5 + [9.0] * 10)
    over = common_gaps(asked, [t.index.to_numpy() for t in (other, poor)])
    first, second = recoveries(over, {"poor": poor}, asked, 1.0)
    assert np.isnan(first[1]["poor"].first_s) and second[1]["poor"].first_s == 0.0
    assert np.isnan(second[1]["poor"].good_s)
    assert own_gaps(poor, asked, 1.0).good_worst_s == np.inf
    assert own_gaps(_errors([], []), asked, 1.0).gaps == 0 and not common_gaps(asked, [])
    assert recoveries([], {}, asked, 1.0) == []


def test_gaps_may_be_named_by_their_times() -> None:
    tunnel = Section("tunnel", 10.0, 20.0)
    (gap,) = named_gaps((tunnel, Section("elsewhere", 900.0, 910.0)), np.arange(0, 60), 0.5)
    assert gap == Gap(20, 40, "tunnel")


def test_the_sky_of_a_simulation_names_its_gaps(tmp_path: Path) -> None:
    rows = ["tow,satellite,visible,el_deg"]
    for tow in range(20):
        seen = 3 if 5 <= tow < 9 or tow >= 18 else 6
        rows += [f"{tow},G{k:02d},{int(k < seen)},{40 if k else 5}" for k in range(8)]
    (tmp_path / "ranges.csv").write_text("\n".join(rows) + "\n")
    spans = [one[1:] for one in read_gaps(tmp_path / "ranges.csv", 0.0)]
    assert spans == [(5.0, 9.0), (18.0, np.inf)]
    assert [one[1:] for one in read_gaps(tmp_path / "ranges.csv", 10.0)] == spans  # 5 are enough
    (tmp_path / "own.csv").write_text("name,from_tow_s,to_tow_s\ntunnel,5,9\n")
    assert read_gaps(tmp_path / "own.csv", 10.0) == (Section("tunnel", 5.0, 9.0),)


def test_the_command_writes_tables_and_figures(truth: Trajectory, tmp_path: Path) -> None:
    every = _START_S + np.arange(0.0, 101.0)
    runs = []
    for name, size_m in (("one", 1.0), ("two", 2.0)):
        folder = tmp_path / name
        folder.mkdir()
        noise = np.random.default_rng(1).normal(0.0, size_m, (101, 3))
        frame = _positions(every, noise).assign(satellites="", rejected="", reason="")
        frame.to_csv(folder / "solution.csv", index=False)
        runs.append(str(folder))
    lat, lon, height = pymap3d.ecef2geodetic(*truth.r_e_m.T)
    pd.DataFrame(
        {
            "week": truth.week,
            "tow_s": truth.tow_s,
            "lat_deg": lat,
            "lon_deg": lon,
            "height_m": height,
        }
    ).to_csv(tmp_path / "truth.csv", index=False)
    out = tmp_path / "out"
    run = CliRunner().invoke(
        cli, ["compare", *runs, "--truth", str(tmp_path / "truth.csv"), "--output", str(out)]
    )
    assert run.exit_code == 0, run.output
    summary = json.loads((out / "summary.json").read_text())
    ratio = summary["positions"]["two"]["cep50_m"] / summary["positions"]["one"]["cep50_m"]
    assert ratio == pytest.approx(2.0, rel=1e-3)
    assert len(pd.read_csv(out / "errors.csv")) == 202
    assert (out / "positions.png").stat().st_size > 10_000
    page = (out / "report.html").read_text()
    assert faults(page) == [] and "two" in words(page) and "Positions against truth" in words(page)
    again = tmp_path / "again"
    CliRunner().invoke(
        cli, ["compare", *runs, "--truth", str(tmp_path / "truth.csv"), "--output", str(again)]
    )
    assert (again / "report.html").read_text() == page


def test_a_log_that_is_the_truth_is_not_held_against_itself(truth: Trajectory) -> None:
    every = _START_S + np.arange(0.0, 101.0)
    own, path = _positions(every, np.ones((101, 3))), Path("log.ubx")
    nothing = pd.DataFrame(columns=list(OBSERVATION_COLUMNS))
    log = Source("log", "UBX", own, nothing, path=path)
    run = Source("run", "deepgnss", own, nothing, path=Path("out"))
    found = compare([run, log], Yardstick(truth, truth_path=path))
    assert set(found.positions) == {"run"} and found.origins["log"].positions == "none"
    assert any("it is the truth" in note for note in found.notes)


def test_strengths_are_drawn_with_and_without_modes(tmp_path: Path) -> None:
    tow_s = _START_S + np.repeat(np.arange(0.0, 50.0), 2)
    log = pd.DataFrame({"week": _WEEK, "tow_s": tow_s, "satellite": ["G01", "C02"] * 50})
    log = log.assign(cn0_dbhz=np.where(tow_s < _START_S + 25.0, 45.0, 20.0))
    run = log.assign(mode=np.where(tow_s < _START_S + 25.0, "PLL", "FFT"))
    for name in ("a.png", "b.png"):
        draw_signals({"run": run, "log": log}, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    shown = (matplotlib.image.imread(tmp_path / "a.png")[:, :, :3] * 255.0).round()
    strong, weak, plain = (
        (shown == [int(colour[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=2).sum()
        for colour in (MODE_COLOURS["PLL"], MODE_COLOURS["FFT"], OTHER)
    )
    assert weak / strong == pytest.approx(5.0 / 30.0, rel=0.1)  # dB above 15, as long each
    assert plain == pytest.approx(strong + weak, rel=0.05)


def test_names_of_receivers_stay_text_on_the_page(truth: Trajectory) -> None:
    every = _START_S + np.arange(0.0, 101.0)
    nothing = pd.DataFrame(columns=list(OBSERVATION_COLUMNS))
    sections = (Section(HOSTILE, _START_S, _START_S + 50.0),)
    sources = [Source(HOSTILE, HOSTILE, _positions(every, np.ones((101, 3))), nothing)]
    page = comparison_page(compare(sources, Yardstick(truth, sections=sections, gaps=sections)))
    assert faults(page) == [] and "<script" not in page


def test_nothing_to_hold_them_against_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    run = CliRunner().invoke(cli, ["compare", str(tmp_path / "run")])
    assert run.exit_code == 2 and "no solution.csv in it" in run.output
    run = CliRunner().invoke(cli, ["compare"])
    assert run.exit_code == 2 and "nothing to compare" in run.output
    (tmp_path / "log.txt").write_text("hello\n")
    run = CliRunner().invoke(cli, ["compare", "--log", str(tmp_path / "log.txt")])
    assert run.exit_code == 2 and "expected a run's folder, .ubx, NMEA" in run.output
