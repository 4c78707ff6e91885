"""report.html of a run: a function of what the run has left in its folder, and nothing else."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from deepgnss import __version__
from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import STAGES, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.errors import read_solution
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.evaluate.outages import GOOD_M
from deepgnss.evaluate.overview import Run
from deepgnss.evaluate.positions import Section, read_sections
from deepgnss.evaluate.report.axes import linear
from deepgnss.evaluate.report.chart import figure
from deepgnss.evaluate.report.error_charts import AXES, over_time, scatter, shares
from deepgnss.evaluate.report.html import Html, Part, document, element
from deepgnss.evaluate.report.signals import strengths, strips
from deepgnss.evaluate.report.sky import sky
from deepgnss.evaluate.report.stretches import (
    Outage,
    equal,
    named,
    outages,
    stretches,
    with_missing_epochs,
    write_stretches,
)
from deepgnss.evaluate.report.style import STYLE
from deepgnss.evaluate.report.tables import clock, metres, percent, seconds, table, tiles
from deepgnss.evaluate.report.track import Mapped, Way, track
from deepgnss.io.input import reading
from deepgnss.io.output import write_whole

NAME: Final = "report.html"
"""Of the file."""

STRETCHES: Final = "stretches.csv"
"""What each section of the way came to."""

_MOST_OUTAGES: Final = 30  # told; the longest ones


@dataclass(frozen=True, slots=True)
class RunFiles:
    """Tables of a run; times `s` count from the recording's start."""

    name: str
    solution: pd.DataFrame
    satellites: pd.DataFrame
    channels: pd.DataFrame
    errors: pd.DataFrame | None  # None without truth
    statistics: pd.DataFrame | None
    summary: Mapping[str, Any]
    start_s: float  # of the recording, GPST seconds since its epoch; 0: never known
    sections: tuple[Section, ...] = ()  # of the way

    @property
    def overview(self) -> Run:
        """What the picture of the run is drawn from."""
        return Run(self.name, self.solution, self.satellites, self.channels)


def read_run_files(folder: Path) -> RunFiles:
    """Read what a finished run has left.

    Raises InputFileError: a table or summary.json is missing.
    """
    with reading(folder / "summary.json"):
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    solution = read_solution(folder / "solution.csv")
    channels, satellites = (_table(folder / f"{n}.csv") for n in ("channels", "satellites"))
    errors, statistics = (
        _table(folder / f"{n}.csv") if (folder / f"{n}.csv").is_file() else None
        for n in ("errors", "statistics")
    )
    timed = channels.dropna(subset=["week", "tow_s"])[:1]
    start_s = float((_absolute(timed) - timed["recording_s"]).iloc[0]) if len(timed) else 0.0
    for frame in (solution, errors):
        if frame is not None:
            frame["s"] = _absolute(frame) - start_s
    channels["s"] = channels["recording_s"]
    name = str(summary.get("recording") or folder.resolve().name)
    told = folder / STRETCHES
    sections = read_sections(told) if told.is_file() else ()
    return RunFiles(
        name, solution, satellites, channels, errors, statistics, summary, start_s, sections
    )


def with_sections(run: RunFiles, folder: Path, sections: tuple[Section, ...]) -> RunFiles:
    """The run cut by sections of the way; what each came to is written to stretches.csv."""
    whole = with_missing_epochs(run.solution)
    found = stretches(whole, run.errors, named(sections, run.start_s))
    write_stretches(folder / STRETCHES, found, run.start_s)
    return replace(run, sections=sections)


def write_run_report(folder: Path, run: RunFiles | None = None) -> Path:
    """Write report.html into the folder of a finished run; returns its path.

    Parameters: run, as read from the folder; None: it is read.
    """
    path = folder / NAME
    write_whole(path, run_page(run or read_run_files(folder)))
    return path


def run_page(run: RunFiles) -> str:
    """The page of a run."""
    run = replace(run, solution=with_missing_epochs(run.solution))
    lost = outages(run.solution, run.errors)
    dark = [(one.start_s, one.end_s) for one in lost]
    parts: list[Part] = [
        _head(run),
        tiles(_facts(run, lost)),
        element("h2", "Where"),
        element("div", _map(run, dark), sky(run.satellites), class_="grid2"),
    ]
    if run.errors is not None and run.errors["horizontal_m"].notna().any():
        parts += [element("h2", "Errors against truth"), _errors(run, run.errors, dark)]
    parts += [
        element("h2", "Signals"),
        element("div", _signals(run, dark), _geometry(run, dark), class_="grid2"),
        element("h2", "Stretches and outages"),
        element("div", _stretches(run), _outages(lost, run.errors is not None), class_="stack"),
        element("h2", "Satellites"),
        _why_no_fix(run),
        element("h2", "Settings"),
        _settings(run),
    ]
    return document(f"{run.name} – deepgnss", STYLE, element("main", *parts))


def _table(path: Path) -> pd.DataFrame:
    with reading(path):
        return pd.read_csv(path, low_memory=False)


def _absolute(frame: pd.DataFrame) -> pd.Series:
    return frame["week"].astype(np.float64) * SECONDS_PER_WEEK + frame["tow_s"]


# --- head ----------------------------------------------------------------------------------------


def _head(run: RunFiles) -> Html:
    signals = ", ".join(str(name) for name in run.summary.get("signals", ()))
    told = [f"{float(run.summary.get('recording_s') or 0.0):.1f} s of recording"]
    if run.start_s > 0.0:
        week, tow_s = divmod(run.start_s, SECONDS_PER_WEEK)
        told.append(f"from {GpsTime(int(week), tow_s).utc():%Y-%m-%d %H:%M:%S} UTC")
    aided = "inertial" in run.summary
    told.append("aided by an inertial unit" if aided else "without aiding")
    return element(
        "header",
        element("h1", run.name),
        element("p", f"{' · '.join(told)}.", class_="soft"),
        element("p", f"{signals} · deepgnss {__version__}", class_="soft"),
    )


def _facts(run: RunFiles, lost: list[Outage]) -> list[tuple[str, str]]:
    valid = run.solution["valid"] == 1
    fixed = float(valid.mean()) if len(valid) else math.nan
    facts = [(percent(fixed), "of the instants with a position")]
    first_s = run.summary.get("first_fix_s")
    facts.append(("none" if first_s is None else f"{first_s:.1f} s", "to the first position"))
    if run.errors is not None and run.errors["horizontal_m"].notna().any():
        size = run.errors["horizontal_m"].dropna()
        facts.append((metres(float(np.percentile(size, 50.0))), "horizontal error, half within"))
        facts.append((metres(float(np.percentile(size, 95.0))), "horizontal error, 95 % within"))
        facts.append((percent(float((size > GROSS_M).mean())), f"positions over {GROSS_M:g} m off"))
    if valid.any():
        facts.append((f"{run.solution['used'][valid].mean():.1f}", "satellites per position"))
    longest_s = max((one.lasted_s for one in lost), default=0.0)
    facts.append((f"{longest_s:g} s" if lost else "none", "longest outage"))
    return facts


# --- charts --------------------------------------------------------------------------------------


def _map(run: RunFiles, dark: list[tuple[float, float]]) -> Html:
    places = run.solution[["x_e_m", "y_e_m", "z_e_m"]].to_numpy(np.float64)
    places[run.solution["valid"].to_numpy() != 1] = np.nan
    truth, gross = None, None
    if run.errors is not None and "true_x_e_m" in run.errors:
        true_r_e_m = run.errors[["true_x_e_m", "true_y_e_m", "true_z_e_m"]].to_numpy(np.float64)
        truth = Way(run.errors["s"].to_numpy(np.float64), true_r_e_m)
        far = run.errors["s"][run.errors["horizontal_m"] > GROSS_M]
        gross = np.isin(run.solution["s"], far)
    own = Mapped(
        "positions", Way(run.solution["s"].to_numpy(np.float64), places), "var(--track)", gross
    )
    return track([own], truth, dark, GROSS_M)


def _errors(run: RunFiles, found: pd.DataFrame, dark: list[tuple[float, float]]) -> Html:
    times = found["s"].to_numpy(np.float64)
    lines = [
        (name, colour, times, found[key].to_numpy(np.float64))
        for key, (colour, name) in AXES.items()
    ]
    size: FloatArray = found["horizontal_m"].to_numpy(np.float64)
    return element(
        "div",
        over_time("Position error over time", lines, dark, "estimate − truth, m"),
        scatter({"positions": ("var(--track)", found)}),
        shares({"positions": ("var(--track)", size)}, GROSS_M),
        _statistics(run.statistics) if run.statistics is not None else None,
        class_="grid2",
    )


_QUANTITIES: Final = {
    "north_m": ("north", "m"),
    "east_m": ("east", "m"),
    "down_m": ("down", "m"),
    "horizontal_m": ("horizontal", "m"),
    "v_north_mps": ("speed north", "m/s"),
    "v_east_mps": ("speed east", "m/s"),
    "v_down_mps": ("speed down", "m/s"),
}


def _statistics(found: pd.DataFrame) -> Html:
    columns = ("mean", "std", "rms", "p50", "p95", "max")
    rows = []
    for _, row in found.iterrows():
        told = _QUANTITIES.get(str(row["quantity"]))
        if told is not None:
            rows.append([", ".join(told), *(_number(row[name]) for name in columns)])
    head = ["error", "mean", "σ", "RMS", "50 %", "95 %", "largest"]
    return figure("Statistics", table(head, rows), class_="wide")


def _number(value: float) -> str:
    return "–" if not math.isfinite(value) else f"{value:.3f}".replace("-", "−")


def _signals(run: RunFiles, dark: list[tuple[float, float]]) -> Html:
    if not len(run.channels):
        return figure("C/N0", element("p", "no signal tracked", class_="soft"))
    end_s = float(run.channels["s"].max())
    found = strengths(run.channels, 0.0, end_s)
    return strips("C/N0 of each satellite, dB-Hz", found, 0.0, end_s, dark)


def _geometry(run: RunFiles, dark: list[tuple[float, float]]) -> Part:
    if not len(run.solution):
        return None
    times = run.solution["s"].to_numpy(np.float64)
    used = run.solution["used"].to_numpy(np.float64)
    lines = [("satellites used", "var(--track)", times, used)]
    scale = linear(0.0, max(float(np.nanmax(used)) * 1.1, 5.0), (1.0, 2.0, 5.0, 10.0))
    return over_time("Satellites used", lines, dark, "satellites", scale)


# --- tables --------------------------------------------------------------------------------------


def _stretches(run: RunFiles) -> Part:
    if not len(run.solution):
        return None
    spans = equal(float(run.solution["s"].max()))
    if run.sections:
        spans = named(run.sections, run.start_s)
    found = stretches(run.solution, run.errors, spans)
    if not found:
        return None
    head = ["stretch", "epochs", "with a position", "satellites"]
    head += ["half within", "95 % within", "largest"] if run.errors is not None else []
    rows = []
    for one in found:
        row = [
            f"{one.name} {clock(one.start_s)} – {clock(one.end_s)}".strip(),
            str(one.epochs),
            percent(one.fixed_share),
            f"{one.satellites:.1f}" if math.isfinite(one.satellites) else "–",
        ]
        if run.errors is not None:
            row += [metres(x) for x in (one.p50_m, one.p95_m, one.largest_m)]
        rows.append(row)
    return figure("Stretch by stretch", table(head, rows), note="Errors are horizontal.")


def _outages(lost: list[Outage], against_truth: bool) -> Html:
    if not lost:
        text = "There was a position at every epoch from the first to the last."
        return figure("Outages", element("p", text))
    told = sorted(sorted(lost, key=lambda one: -one.lasted_s)[:_MOST_OUTAGES])
    head = ["from", "because", "lasted", "satellites before", "after"]
    head += [f"then within {GOOD_M:g} m"] if against_truth else []
    rows: list[list[Part]] = []
    for one in told:
        row: list[Part] = [clock(one.start_s), one.reason, f"{one.lasted_s:g} s"]
        row += [str(one.used_before), str(one.used_after)]
        row += ["not" if math.isnan(one.good_s) else seconds(one.good_s)] if against_truth else []
        rows.append(row)
    left = len(lost) - len(told)
    note = "Satellites: those used in the last position before and the first after."
    if against_truth:
        note += f" Within {GOOD_M:g} m: how long after the first position."
    note += f" {left} shorter outages are left out." if left else ""
    return figure("Outages", table(head, rows, (0, 1)), note=note)


def _why_no_fix(run: RunFiles) -> Html:
    ranked = sorted(
        run.summary.get("satellites", ()),
        key=lambda o: (-STAGES.index(o["stage"]), -o["used_epochs"], o["satellite"], o["signal"]),
    )
    rows: list[list[Part]] = [
        [
            o["satellite"],
            o["signal"],
            o["stage"],
            _tenth(o["acquisition_peak"]),
            _tenth(o["cn0_dbhz"]),
            str(o["used_epochs"]) if o["used_epochs"] else "",
            o["reason"],
        ]
        for o in ranked
    ]
    head = ["satellite", "signal", "reached", "peak", "C/N0", "epochs used", "because"]
    body = table(head, rows, (0, 1, 2, 6)) if rows else element("p", "no satellite searched")
    return figure(
        "How far each satellite came, and why no further",
        body,
        note="Peak: of its best search, over the noise. C/N0: the highest, dB-Hz.",
    )


def _tenth(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


def _settings(run: RunFiles) -> Html:
    rows = _flat("", run.summary.get("config", {}))
    facts = {k: v for k, v in run.summary.items() if k not in ("config", "satellites")}
    return element(
        "div",
        _fold("Configuration of this run, defaults filled in", rows),
        _fold("summary.json in short", _flat("", facts)),
        class_="stack",
    )


def _fold(title: str, rows: list[tuple[str, str]]) -> Html:
    text = "\n".join(f"{key}: {value}" for key, value in rows)
    return element("details", element("summary", title), element("pre", text))


def _flat(prefix: str, value: Any) -> list[tuple[str, str]]:
    """Keys of nested settings by dots, and their values as text."""
    if isinstance(value, Mapping):
        pairs = ((f"{prefix}.{key}" if prefix else str(key), one) for key, one in value.items())
        return [row for key, one in pairs for row in _flat(key, one)]
    return [(prefix, json.dumps(value, ensure_ascii=False))]
