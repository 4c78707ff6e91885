"""report.html of receivers side by side."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from deepgnss import __version__
from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.comparison import Comparison, Ways
from deepgnss.evaluate.comparison_tables import Sheet, sheets
from deepgnss.evaluate.observables import week_seconds
from deepgnss.evaluate.report.axes import Axis, linear, logarithmic
from deepgnss.evaluate.report.chart import figure
from deepgnss.evaluate.report.error_charts import WIDE, over_time, scatter, shares
from deepgnss.evaluate.report.html import Html, Part, document, element
from deepgnss.evaluate.report.signals import strengths, strips
from deepgnss.evaluate.report.style import STYLE
from deepgnss.evaluate.report.tables import bars, table
from deepgnss.evaluate.report.track import Mapped, Way, track
from deepgnss.io.output import write_whole

COLOURS: Final = ("var(--a)", "var(--b)", "var(--c)", "var(--d)", "var(--e)", "var(--f)")
_LEAST_M: Final = 0.01


def write_comparison_report(found: Comparison, path: Path, *before: Part) -> None:
    """Write the page; `before`: what is told first."""
    write_whole(path, comparison_page(found, *before))


def comparison_page(found: Comparison, *before: Part) -> str:
    """The page: pictures of positions, then every table, then signals."""
    names = list(dict.fromkeys([*found.positions, *found.heard, *found.strengths]))
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}
    parts: list[Part] = [
        element(
            "header",
            element("h1", " · ".join(names) or "Receivers"),
            element("p", f"{_when(found)}compared by deepgnss {__version__}", class_="soft"),
        ),
        *(element("p", note) for note in found.notes),
        *before,
    ]
    ways = found.ways
    if ways is not None and any(len(t) for t in found.errors.values()):
        parts += [element("h2", "Positions"), _positions(found, ways, colours)]
    told = [_sheet(sheet) for sheet in sheets(found)]
    parts += [element("h2", "Figures"), element("div", *told, class_="stack")] if told else []
    if found.strengths:
        parts += [element("h2", "Signals"), element("div", *_signals(found), class_="stack")]
    return document(f"{' · '.join(names)} – deepgnss", STYLE, element("main", *parts))


def _when(found: Comparison) -> str:
    if found.ways is None or not len(found.ways.asked):
        return ""
    ways = found.ways
    start, end = (_utc(float(k) * ways.interval_s) for k in (ways.asked[0], ways.asked[-1]))
    return f"{start:%Y-%m-%d %H:%M:%S} to {end:%H:%M:%S} UTC, {len(ways.asked)} instants; "


def _utc(seconds: float) -> datetime:
    week, tow_s = divmod(seconds, SECONDS_PER_WEEK)
    return GpsTime(int(week), tow_s).utc()


# --- positions -----------------------------------------------------------------------------------


def _positions(found: Comparison, ways: Ways, colours: Mapping[str, str]) -> Html:
    begin_s = float(ways.asked[0]) * ways.interval_s if len(ways.asked) else 0.0
    dark = [
        (gap.start * ways.interval_s - begin_s, gap.end * ways.interval_s - begin_s)
        for gap, _ in ways.gaps
    ]
    inside = {name: t[np.isin(t.index, ways.asked)] for name, t in found.errors.items()}
    lines = []
    for name, own in inside.items():
        whole = own["horizontal_m"].reindex(ways.asked)
        times = ways.asked * ways.interval_s - begin_s
        lines.append((name, colours[name], times.astype(float), whole.to_numpy(np.float64)))
    sizes = np.concatenate([size[np.isfinite(size)] for *_, size in lines])
    return element(
        "div",
        _map(ways, found.errors, colours, begin_s, dark),
        scatter({name: (colours[name], own) for name, own in inside.items()}),
        over_time(
            "Horizontal error over time",
            lines,
            dark,
            "horizontal error, m",
            _scale([size for *_, size in lines], sizes),
            dotted=True,
        ),
        shares(
            {n: (colours[n], own["horizontal_m"].to_numpy(float)) for n, own in inside.items()},
            ways.gross_m,
        ),
        figure(
            "Instants with a position",
            bars([(n, p.fixed_share, colours[n]) for n, p in found.positions.items()]),
            *_by_section(found, colours),
        ),
        class_="grid2",
    )


def _scale(each: list[FloatArray], together: FloatArray) -> Axis:
    """Logarithmic where receivers differ much."""
    medians = [float(np.nanmedian(size)) for size in each if np.isfinite(size).any()]
    if max(medians) > WIDE * max(min(medians), _LEAST_M):
        low = max(float(np.percentile(together, 1.0)), _LEAST_M)
        return logarithmic(low, float(together.max()))
    return linear(0.0, max(float(np.percentile(together, 99.0)) * 1.2, 0.1))


def _by_section(found: Comparison, colours: Mapping[str, str]) -> list[Html]:
    parts = []
    for section, told in found.sections.items():
        parts.append(element("h3", section, class_="inner"))
        parts.append(bars([(name, share, colours[name]) for name, share in told.items()]))
    return parts


def _map(
    ways: Ways,
    errors: Mapping[str, pd.DataFrame],
    colours: Mapping[str, str],
    begin_s: float,
    dark: list[tuple[float, float]],
) -> Html:
    truth = ways.truth
    true_s = truth.week * float(SECONDS_PER_WEEK) + truth.tow_s - begin_s
    end_s = float(ways.asked[-1]) * ways.interval_s - begin_s if len(ways.asked) else 0.0
    inside = (true_s >= -ways.interval_s) & (true_s <= end_s + ways.interval_s)
    step = max(1, int(inside.sum()) // 4000)
    mapped = []
    for name in errors:
        own = ways.positions[name]
        own = own[own["valid"] == 1]
        s = week_seconds(own, 0) - begin_s
        own, s = own[(s >= 0.0) & (s <= end_s)], s[(s >= 0.0) & (s <= end_s)]
        places = own[["x_e_m", "y_e_m", "z_e_m"]].to_numpy(np.float64)
        mapped.append(Mapped(name, Way(s, places), colours[name]))
    way = Way(true_s[inside][::step], truth.r_e_m[inside][::step])
    return track(mapped, way, dark, ways.gross_m)


# --- tables and signals --------------------------------------------------------------------------


def _sheet(sheet: Sheet) -> Html:
    return figure(
        sheet.title, table(sheet.head, sheet.rows, range(sheet.words)), note=sheet.note or None
    )


def _signals(found: Comparison) -> list[Html]:
    times = {name: week_seconds(own, 0) for name, own in found.strengths.items()}
    low = max(float(t.min()) for t in times.values())
    high = min(float(t.max()) for t in times.values())
    parts = []
    for name, own in found.strengths.items():
        t = times[name]
        inside = own.assign(s=t - low)[(t >= low) & (t <= high)]
        if len(inside):
            told = strengths(inside, 0.0, high - low)
            parts.append(strips(f"{name}: C/N0 of each satellite, dB-Hz", told, 0.0, high - low))
    return parts
