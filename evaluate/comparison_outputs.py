"""Files of a comparison: tables for machines, figures for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.evaluate.comparison import Comparison
from deepgnss.evaluate.errors import distribution
from deepgnss.evaluate.observations import wavelength_m
from deepgnss.io.output import write_whole
from deepgnss.io.summary import write_summary

mpl.use("Agg")

FILES: Final = (
    *("positions.csv", "errors.csv", "differences.csv", "satellites.csv", "rtk.csv"),
    "summary.json",
    *("positions.png", "differences.png"),
)
"""Names of all files a comparison may write."""

_LEAST_M: Final = 1e-3  # errors below are drawn at the edge
_BARS: Final = 0.35  # room around the availability bars, axis units


def write_comparison(found: Comparison, folder: Path) -> None:
    """Write tables, summary.json and figures of what there is."""
    if found.positions:
        rows = pd.DataFrame([{"receiver": k, **v._asdict()} for k, v in found.positions.items()])
        _write(folder / "positions.csv", rows)
        parts = [table.assign(receiver=name) for name, table in found.errors.items()]
        _write(folder / "errors.csv", pd.concat(parts).reset_index())
        _draw_positions(found, folder / "positions.png")
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
    summary: dict[str, Any] = {
        "positions": found.positions,
        "sections": found.sections,
        "observations": {
            name: table.to_dict(orient="index") for name, table in found.observations.items()
        },
        "clocks": found.clocks,
        "rtk": found.rtk.shares,
        "notes": found.notes,
    }
    write_summary(folder / "summary.json", summary)


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


def _draw_positions(found: Comparison, path: Path) -> None:
    """Errors over time, scatter, distribution, and when there was a position."""
    figure, axes = _figure(2, 2)
    (over_time, scatter), (share, bars) = axes
    starts = [table["tow_s"].iloc[0] for table in found.errors.values() if len(table)]
    begin_s = min(starts, default=0.0)
    for place, (name, table) in enumerate(found.errors.items()):
        seconds = (table["tow_s"] - begin_s) % SECONDS_PER_WEEK
        (line,) = over_time.plot(seconds, table["horizontal_m"], ".", markersize=2.5, label=name)
        color = line.get_color()
        scatter.plot(table["east_m"], table["north_m"], ".", markersize=2.5, color=color)
        size, below = distribution(table["horizontal_m"].to_numpy(np.float64))
        share.plot(size, 100.0 * below, color=color)
        bars.plot(seconds, np.full(len(table), place), "|", markersize=10.0, color=color)
    over_time.set(xlabel="time, s", ylabel="horizontal error, m", yscale="log")
    over_time.set_ylim(bottom=_LEAST_M)
    over_time.legend(markerscale=4.0, fontsize=8)
    scatter.set(xlabel="east error, m", ylabel="north error, m", aspect="equal")
    share.set(xlabel="horizontal error, m", ylabel="share of positions, %", xscale="log")
    share.set_xlim(left=_LEAST_M)
    bars.set(xlabel="time, s", yticks=range(len(found.errors)), yticklabels=list(found.errors))
    bars.set_ylim(-0.5 - _BARS, len(found.errors) - 0.5 + _BARS)
    bars.set_title("when there was a position", fontsize=9)
    for axis in (over_time, scatter, share):
        axis.grid(alpha=0.3)
    _save(figure, path)


def _draw_differences(found: Comparison, path: Path) -> None:
    """Code and carrier double differences over time, a row per receiver."""
    figure, axes = _figure(len(found.doubled), 2)
    for (code, phase), (name, table) in zip(
        np.atleast_2d(axes), found.doubled.items(), strict=True
    ):
        for satellite, own in table.groupby("satellite"):
            seconds = (own["time_ms"] - table["time_ms"].min()) * 1e-3
            code.plot(seconds, own["code_m"], ".", markersize=2.5, label=str(satellite))
            within = own["phase_m"].abs() < wavelength_m(str(satellite))  # the rest are slips
            phase.plot(seconds[within], 100.0 * own["phase_m"][within], ".", markersize=2.5)
        code.set(xlabel="time, s", ylabel="code, m", title=name)
        phase.set(xlabel="time, s", ylabel="carrier, cm", title=name)
        code.legend(markerscale=4.0, fontsize=7, ncols=4)
        for axis in (code, phase):
            axis.grid(alpha=0.3)
    _save(figure, path)
