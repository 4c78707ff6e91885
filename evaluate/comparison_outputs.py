"""Files of a comparison: tables for machines, figures for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.evaluate.comparison import Comparison, Ways
from deepgnss.evaluate.comparison_signals import draw_signals
from deepgnss.evaluate.errors import distribution
from deepgnss.evaluate.observations import wavelength_m
from deepgnss.evaluate.report.comparison import write_comparison_report
from deepgnss.io.output import write_whole
from deepgnss.io.summary import write_summary

mpl.use("Agg")

FILES: Final = (
    *("positions.csv", "errors.csv", "differences.csv", "satellites.csv", "rtk.csv"),
    *("recovery.csv", "summary.json", "report.html"),
    *("positions.png", "availability.png", "signals.png", "differences.png"),
)
"""Names of all files a comparison may write."""

_LEAST_M: Final = 1e-3  # errors below are drawn at the edge
_BAR: Final = 0.6  # height of an availability bar, axis units


def write_comparison(found: Comparison, folder: Path) -> None:
    """Write tables, summary.json and figures of what there is."""
    if found.positions:
        rows = pd.DataFrame([{"receiver": k, **v._asdict()} for k, v in found.positions.items()])
        _write(folder / "positions.csv", rows)
        parts = [table.assign(receiver=name) for name, table in found.errors.items()]
        _write(folder / "errors.csv", pd.concat(parts).reset_index())
    if found.ways is not None and any(one.compared for one in found.positions.values()):
        _draw_positions(found, found.ways, folder / "positions.png")
        _draw_availability(found, folder / "availability.png")
    if any(len(table) for table in found.doubled.values()):
        parts = [table.assign(receiver=name) for name, table in found.doubled.items()]
        _write(folder / "differences.csv", pd.concat(parts))
        parts = [
            table.rename_axis("satellite").reset_index().assign(receiver=name)
            for name, table in found.observations.items()
        ]
        _write(folder / "satellites.csv", pd.concat(parts))
        _draw_differences(found, folder / "differences.png")
    if found.rtk.errors:
        parts = [table.assign(receiver=name) for name, table in found.rtk.errors.items()]
        _write(folder / "rtk.csv", pd.concat(parts).reset_index())
    if found.ways is not None:
        _write(folder / "recovery.csv", _gap_rows(found.ways))
    if found.strengths:
        draw_signals(found.strengths, folder / "signals.png")
    write_comparison_report(found, folder / "report.html")
    summary: dict[str, Any] = {
        "positions": found.positions,
        "sections": found.sections,
        "gaps": found.ways.own_gaps if found.ways is not None else {},
        "observed": found.heard,
        "observations": {
            name: table.to_dict(orient="index") for name, table in found.observations.items()
        },
        "clocks": found.clocks,
        "rtk": found.rtk.shares,
        "notes": found.notes,
    }
    write_summary(folder / "summary.json", summary)


def _gap_rows(ways: Ways) -> pd.DataFrame:
    rows = [
        {
            "gap": gap.name,
            "from_tow_s": gap.start * ways.interval_s % SECONDS_PER_WEEK,
            "to_tow_s": gap.end * ways.interval_s % SECONDS_PER_WEEK,
            "receiver": name,
            "first_s": back.first_s,
            "good_s": back.good_s,
        }
        for gap, told in ways.gaps
        for name, back in told.items()
    ]
    columns = ["gap", "from_tow_s", "to_tow_s", "receiver", "first_s", "good_s"]
    return pd.DataFrame(rows, columns=columns)


def _write(path: Path, frame: pd.DataFrame) -> None:
    write_whole(path, frame.to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def _figure(rows: int, columns: int) -> tuple[Any, Any]:
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(rows, columns, figsize=(11.0, 3.2 * rows), layout="constrained")
    return figure, axes


def _save(figure: Any, path: Path) -> None:
    from matplotlib import pyplot as plt

    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_positions(found: Comparison, ways: Ways, path: Path) -> None:
    """Errors over time, scatter, distribution, and when there was a position."""
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(11.0, 8.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 1.5, 0.2 + 0.12 * len(found.errors)))
    over_time, bars = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[2, :])
    scatter, share = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    begin, interval_s = int(ways.asked[0]), ways.interval_s
    sizes = []
    for place, (name, whole) in enumerate(found.errors.items()):
        table = whole[np.isin(whole.index, ways.asked)]
        seconds = (table.index.to_numpy() - begin) * interval_s
        (line,) = over_time.plot(seconds, table["horizontal_m"], ".", markersize=3.0, label=name)
        color = line.get_color()
        scatter.plot(table["east_m"], table["north_m"], ".", markersize=3.0, color=color)
        size, below = distribution(table["horizontal_m"].to_numpy(np.float64))
        share.plot(size, 100.0 * below, color=color)
        spans = [(s - interval_s / 2.0, interval_s) for s in seconds.tolist()]
        bars.broken_barh(spans, (-place - _BAR / 2.0, _BAR), color=color, linewidth=0.0)
        sizes.append(size)
    reach_m = max(1.2 * float(np.percentile(np.concatenate(sizes), 98.0)), _LEAST_M)
    end_s = float(ways.asked[-1] - begin) * interval_s
    for axis in (over_time, bars):
        axis.set(xlabel="time, s", xlim=(-interval_s, end_s + interval_s))
    over_time.set(ylabel="horizontal error, m", yscale="log")
    over_time.legend(markerscale=3.0, fontsize=8, loc="best")
    scatter.set(xlabel="east error, m", ylabel="north error, m", aspect="equal")
    scatter.set(xlim=(-reach_m, reach_m), ylim=(-reach_m, reach_m))
    share.set(xlabel="horizontal error, m", ylabel="share of positions, %", xscale="log")
    bars.set(yticks=[-k for k in range(len(found.errors))], yticklabels=list(found.errors))
    bars.set_title("when there was a position", fontsize=9)
    for axis in (over_time, scatter, share):
        axis.grid(alpha=0.3)
    _save(figure, path)


def _draw_availability(found: Comparison, path: Path) -> None:
    """Share of the instants with a position, by section of the way, a bar per receiver."""
    from matplotlib import pyplot as plt

    rows = {"all": {k: v.fixed_share for k, v in found.positions.items()}, **found.sections}
    names = list(found.positions)
    figure, axis = plt.subplots(
        figsize=(11.0, 1.0 + 0.22 * (len(names) + 1) * len(rows)), layout="constrained"
    )
    height = 0.8 / len(names)
    for k, name in enumerate(names):
        places = np.arange(len(rows)) + (k - (len(names) - 1) / 2.0) * height
        widths = [100.0 * told[name] for told in rows.values()]
        drawn = axis.barh(places, widths, 0.92 * height, label=name)
        axis.bar_label(drawn, fmt="%.1f %%", padding=3, fontsize=8)
    axis.set(xlabel="instants with a position, %", xlim=(0.0, 108.0), yticks=range(len(rows)))
    axis.set_yticklabels(list(rows))
    axis.invert_yaxis()
    figure.legend(fontsize=8, loc="outside upper center", ncols=len(names), frameon=False)
    _save(figure, path)


def _draw_differences(found: Comparison, path: Path) -> None:
    """Code and carrier double differences over time, a row per receiver."""
    figure, axes = _figure(len(found.doubled), 2)
    for (code, phase), (name, table) in zip(
        np.atleast_2d(axes), found.doubled.items(), strict=True
    ):
        for axis in (code, phase):
            axis.set_prop_cycle(color=list(mpl.colormaps["tab20"](np.arange(20))))
        for satellite, own in table.groupby("satellite"):
            seconds = (own["time_ms"] - table["time_ms"].min()) * 1e-3
            code.plot(seconds, own["code_m"], ".", markersize=2.5, label=str(satellite))
            within = own["phase_m"].abs() < wavelength_m(str(satellite))  # the rest are slips
            phase.plot(seconds[within], 100.0 * own["phase_m"][within], ".", markersize=2.5)
        code.set(xlabel="time, s", ylabel="code, m", title=name)
        phase.set(xlabel="time, s", ylabel="carrier, cm", title=name)
        for axis in (code, phase):
            axis.grid(alpha=0.3)
    handles, names = np.atleast_2d(axes)[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, names, loc="outside lower center", ncols=10, markerscale=4.0, fontsize=8,
        frameon=False,
    )  # fmt: skip
    _save(figure, path)
