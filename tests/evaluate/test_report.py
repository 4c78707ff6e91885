"""report.html: one file that loads nothing, escapes everything, and is the same every time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from report_pages import HOSTILE, faults, made_up, words

from deepgnss.cli.main import cli
from deepgnss.evaluate.positions import Section, read_sections
from deepgnss.evaluate.report.axes import around, linear, logarithmic, time_axis
from deepgnss.evaluate.report.chart import thinned
from deepgnss.evaluate.report.html import Html, document, element
from deepgnss.evaluate.report.run import (
    read_run_files,
    run_page,
    with_sections,
    write_run_report,
)
from deepgnss.evaluate.report.signals import strengths
from deepgnss.evaluate.report.stretches import (
    equal,
    named,
    outages,
    stretches,
    with_missing_epochs,
    write_stretches,
)


def test_a_page_loads_nothing_and_shows_all_parts() -> None:
    page = run_page(made_up())
    assert faults(page) == []
    told = words(page)
    for part in ("Track", "Sky", "Position error over time", "Horizontal scatter", "Outages"):
        assert part in told
    assert "PLL: phase locked" in told and "hold: no signal, coasting" in told
    assert "2 of 4 satellites needed" in told and 'name="viewport"' in page


def test_what_would_load_something_is_found() -> None:
    good = document("a", "p { color: red; }", element("p", "b"))
    assert faults(good) == []
    for bad in (
        "<img src='https://a.example/b.png'/>",
        "<script>1</script>",
        "<p onclick='x'></p>",
    ):
        assert faults(good.replace("</body>", f"{bad}</body>"))
    assert faults(good.replace("color: red", "background: url(x)"))


def test_names_out_of_files_stay_text() -> None:
    run = made_up(name=HOSTILE)
    first = str(run.channels["satellite"].iloc[0])
    hostile = {first: HOSTILE}
    solution = run.solution.assign(reason=np.where(run.solution["valid"] == 1, "", HOSTILE))
    told = [{**s, "satellite": HOSTILE, "reason": HOSTILE} for s in run.summary["satellites"]]
    summary = {"signals": [HOSTILE], "config": {HOSTILE: {"x": HOSTILE}}, "satellites": told}
    page = run_page(
        replace(
            run,
            solution=solution,
            satellites=run.satellites.replace({"satellite": hostile}),
            channels=run.channels.replace({"satellite": hostile, "mode": {"hold": HOSTILE}}),
            summary={**run.summary, **summary},
        )
    )
    assert faults(page) == []
    assert "<script" not in page and "<img" not in page and "\x00" not in page
    assert "<script>fetch" in words(page)  # shown as it is, not hidden


def test_only_markup_of_ours_passes_unescaped() -> None:
    assert (
        element("p", "<b>", Html("<b>x</b>"), title='"')
        == '<p title="&quot;">&lt;b&gt;<b>x</b></p>'
    )
    assert element("p", None, class_="a", data_label=None) == '<p class="a"></p>'


@pytest.mark.parametrize("satellites", [0, 1])
@pytest.mark.parametrize("with_truth", [False, True])
def test_runs_that_came_to_little(satellites: int, with_truth: bool) -> None:
    run = made_up(4, satellites, gap=(0, 4), with_truth=with_truth)
    assert faults(run_page(run)) == []
    nothing = replace(
        run, solution=run.solution[:0], satellites=run.satellites[:0], channels=run.channels[:0],
        errors=None if run.errors is None else run.errors[:0], start_s=0.0,
        summary={**run.summary, "satellites": [], "first_fix_s": None},
    )  # fmt: skip
    assert faults(run_page(nothing)) == []
    one = replace(run, solution=made_up(1, gap=(9, 9)).solution, errors=None)
    assert faults(run_page(one)) == []


def test_an_hour_of_a_drive_is_a_file_of_sane_size() -> None:
    page = run_page(made_up(3600, 24, per_epoch=2))
    assert faults(page) == []
    assert len(page.encode()) < 2_000_000


def test_a_folder_gives_the_same_bytes_every_time(tmp_path: Path) -> None:
    run = made_up()
    tables = {"solution": run.solution, "satellites": run.satellites, "errors": run.errors}
    times = run.solution[["week", "tow_s", "s"]]
    tables["channels"] = run.channels.merge(times, on="s").rename(columns={"s": "recording_s"})
    for name, table in tables.items():
        assert table is not None
        kept = table.drop(columns="s") if "s" in table else table
        kept.assign(**_more(name)).to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "summary.json").write_text(json.dumps({**run.summary, "recording": "my.bin"}))
    pages = []
    for _ in range(2):
        done = CliRunner().invoke(cli, ["report", str(tmp_path)])
        assert done.exit_code == 0, done.output
        pages.append((tmp_path / "report.html").read_bytes())
    assert pages[0] == pages[1]
    told = words(pages[0].decode())
    assert "my.bin" in told and "2023-11-26 00:16:22 UTC" in told  # 18 leap seconds off GPST
    cut = with_sections(read_run_files(tmp_path), tmp_path, (Section("yard", 1005.0, 1015.0),))
    page = write_run_report(tmp_path, cut).read_bytes()
    assert "yard 0:05 – 0:15" in words(page.decode())
    assert write_run_report(tmp_path).read_bytes() == page  # the folder knows its sections


def _more(name: str) -> dict[str, object]:
    if name == "satellites":
        return {"week": 2290, "tow_s": 1000.0}
    return {"v_n_mps": 0.0, "satellites": "", "rejected": ""} if name == "solution" else {}


def test_a_folder_without_a_run_is_one_line(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["report", str(tmp_path)])
    assert done.exit_code == 2 and done.stderr.count("\n") == 1 and "summary.json" in done.stderr


# --- what the pictures are made of ---------------------------------------------------------------


def test_outages_and_what_follows_them() -> None:
    run = made_up(gap=(20, 26))
    (one,) = outages(run.solution, run.errors)
    assert (one.start_s, one.end_s, one.lasted_s) == (20.0, 26.0, 6.0)
    assert (one.reason, one.used_before, one.used_after) == ("2 of 4 satellites needed", 8, 8)
    assert one.good_s == 2.0  # two positions 9 m off come first
    dropped = run.solution[run.solution["valid"] == 1]  # rows that are missing altogether
    (again,) = outages(dropped, run.errors)
    assert (again.lasted_s, again.reason) == (6.0, "nothing observed")
    whole = with_missing_epochs(dropped)
    assert len(whole) == 60 and whole["valid"].sum() == 54
    assert whole["s"].to_numpy() == pytest.approx(np.arange(60.0))
    assert words(run_page(replace(run, solution=dropped))).count("90.0 %") == 1
    whole = made_up(gap=(70, 75))
    assert outages(whole.solution, whole.errors) == []
    assert "at every epoch from the first to the last" in words(run_page(whole))


def test_stretches_count_what_lies_in_them() -> None:
    run = made_up(60, gap=(20, 26))
    found = stretches(run.solution, run.errors, equal(59.0))
    assert [one.start_s for one in found] == [5.0 * k for k in range(12)]
    assert [one.fixed_share for one in found][3:6] == [1.0, 0.0, 0.8]
    assert found[5].largest_m == pytest.approx(9.0, abs=1.5) and np.isnan(found[4].largest_m)
    assert not stretches(run.solution[:0], None, equal(59.0))


def test_sections_are_told_by_name_and_read_back(tmp_path: Path) -> None:
    run = made_up(60, gap=(20, 26))
    sections = (Section('a "tunnel", long', 1018.0, 1030.0), Section("elsewhere", 5000.0, 5010.0))
    found = stretches(run.solution, run.errors, named(sections, run.start_s))
    assert [(one.name, one.start_s, one.epochs, one.fixed_share) for one in found] == [
        ('a "tunnel", long', 18.0, 12, 0.5)
    ]
    write_stretches(tmp_path / "stretches.csv", found, run.start_s)
    assert read_sections(tmp_path / "stretches.csv") == sections[:1]
    assert 'a "tunnel", long 0:18 – 0:30' in words(run_page(replace(run, sections=sections)))
    sunday = named((Section("x", 1.0, 2.0),), 2290 * 604800.0 + 604799.0)  # over the week's end
    assert (sunday[0].start_s, sunday[0].end_s) == (2.0, 3.0)


def test_scales_have_few_round_ticks() -> None:
    for low, high in ((0.0, 1.0), (-3.7, 12.1), (1e-4, 3e-4), (0.0, 86400.0), (5.0, 5.0)):
        axis = linear(low, high)
        assert 1 <= len(axis.ticks) <= 6
        assert all(axis.low - 1e-9 <= t <= axis.high + 1e-9 for t in axis.ticks)
    assert logarithmic(0.02, 30.0).ticks == (0.01, 0.1, 1.0, 10.0, 100.0)
    assert float(logarithmic(0.1, 10.0).share(1.0)) == pytest.approx(0.5)
    assert time_axis(0.0, 90.0)[2] == "s" and time_axis(0.0, 3600.0)[2] == "min"
    values = np.append(np.random.default_rng(2).normal(size=400), 1e4)
    assert around(values).high < 10.0


def test_a_thinned_line_keeps_its_extremes_and_breaks() -> None:
    x = np.arange(20_000.0)
    y = np.sin(x / 500.0)
    y[7_777], y[9_000:9_100] = 50.0, np.nan
    few_x, few_y = thinned(x, y)
    assert len(few_x) < 5_000 and np.nanmax(few_y) == 50.0
    assert np.isnan(few_y[(few_x >= 9_000) & (few_x < 9_100)]).all()
    assert np.all(np.diff(few_x) > 0.0)


def test_strengths_fall_into_the_stretch_they_belong_to() -> None:
    rows = [(1.0, "G01", 40.0, "PLL"), (2.0, "G01", 30.0, "hold"), (4.0, "G01", 20.0, "FFT")]
    rows += [(3.0, "G02", 45.0, "PLL")]
    found = strengths(pd.DataFrame(rows, columns=["s", "satellite", "cn0_dbhz", "mode"]), 0.0, 4.0)
    own = found["G01"]
    assert own.mode.tolist() == ["PLL", "hold", "", "FFT"]
    assert own.cn0_dbhz[[0, 1, 3]].tolist() == [40.0, 30.0, 20.0] and np.isnan(own.cn0_dbhz[2])
