"""Errors against truth: over time, across the plane, and how many are below each size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.errors import distribution
from deepgnss.evaluate.report.axes import Axis, around, linear, logarithmic, time_axis
from deepgnss.evaluate.report.chart import Chart, figure, legend
from deepgnss.evaluate.report.html import Html, Part, element

Span = tuple[float, float]
"""From, to, s."""

AXES: Final = {
    "north_m": ("var(--north)", "north"),
    "east_m": ("var(--east)", "east"),
    "down_m": ("var(--down)", "down"),
}
_LEAST_M: Final = 1e-3
WIDE: Final = 4.0  # medians this many times apart want a logarithmic scale


def over_time(
    title: str,
    lines: Sequence[tuple[str, str, FloatArray, FloatArray]],
    dark: Sequence[Span],
    unit: str,
    scale: Axis | None = None,
    dotted: bool = False,
) -> Html:
    """Values over time.

    Parameters: lines, (name, colour, times s, values), NaN where there is none; dark, stretches
    to shade; scale, of the values: default about zero, by percentiles.
    """
    times = np.concatenate([t for _, _, t, _ in lines])
    axis, unit_s, word = time_axis(float(times.min()), float(times.max()))
    chart = Chart(axis, scale or around(np.concatenate([v for *_, v in lines])))
    drawn: list[Part] = [chart.band(a / unit_s, b / unit_s) for a, b in dark]
    if scale is None:
        drawn.append(chart.rule(0.0, "var(--soft)"))
    for _, colour, t, v in lines:
        drawn.append(
            chart.dots(t / unit_s, v, colour, 3.0) if dotted else chart.line(t / unit_s, v, colour)
        )
    keys = [(colour, name) for name, colour, _, _ in lines]
    keys += [("var(--gap)", "no position")] if dark else []
    return figure(
        title,
        chart.shown(*drawn, unit=unit, below=f"time since the start, {word}"),
        legend(keys),
        class_="wide",
    )


def scatter(found: Mapping[str, tuple[str, pd.DataFrame]]) -> Html:
    """Horizontal errors, by receiver (colour, table of north_m, east_m).

    The circle of one receiver holds 95 % of its errors.
    """
    tables = {
        name: table.dropna(subset=["east_m", "north_m"]) for name, (_, table) in found.items()
    }
    size = np.concatenate(
        [
            np.hypot(*(t[k].to_numpy(np.float64) for k in ("east_m", "north_m")))
            for t in tables.values()
        ]
    )
    if not size.size:
        return figure("Horizontal scatter", element("p", "no position", class_="soft"))
    reach = float(np.percentile(size, 98.0)) * 1.25
    reach = max(min(reach, float(size.max()) * 1.08), 0.05)
    axis = linear(-reach, reach)
    chart = Chart(axis, axis)
    upright = chart.line(np.zeros(2), np.array([-reach, reach]), "var(--soft)", 1.0)
    drawn: list[Part] = [chart.rule(0.0, "var(--soft)"), upright]
    for name, table in tables.items():
        east, north = (table[key].to_numpy(np.float64) for key in ("east_m", "north_m"))
        inside = np.hypot(east, north) <= reach * np.sqrt(2.0)
        drawn.append(chart.dots(east[inside], north[inside], found[name][0]))
    if len(tables) == 1:
        turn = np.linspace(0.0, 2.0 * np.pi, 91)
        for share in (50.0, 95.0):
            r = float(np.percentile(size, share))
            drawn.append(chart.line(r * np.sin(turn), r * np.cos(turn), "var(--ink)", 1.2))
    outside = int((size > reach * np.sqrt(2.0)).sum())
    notes = ["Circles hold 50 and 95 % of the errors."] if len(tables) == 1 else []
    notes += [f"{outside} further out."] if outside else []
    return figure(
        "Horizontal scatter",
        element(
            "div",
            chart.shown(*drawn, unit="north, m", below="east, m", height="auto;aspect-ratio:1"),
        ),
        legend([(colour, name) for name, (colour, _) in found.items()]) if len(found) > 1 else None,
        note=" ".join(notes) or None,
    )


def shares(found: Mapping[str, tuple[str, FloatArray]], limit_m: float) -> Html:
    """How many positions are better than each size: by receiver, (colour, horizontal errors m)."""
    known = {name: values[np.isfinite(values)] for name, (_, values) in found.items()}
    known = {name: values for name, values in known.items() if values.size}
    if not known:
        return figure("Share of positions within", element("p", "no position", class_="soft"))
    medians = [float(np.median(values)) for values in known.values()]
    together = np.concatenate(list(known.values()))
    if max(medians) > WIDE * max(min(medians), _LEAST_M):
        axis = logarithmic(
            max(float(np.percentile(together, 1.0)), _LEAST_M), max(float(together.max()), 0.1)
        )
    else:
        axis = linear(0.0, max(float(np.percentile(together, 99.0)) * 1.05, 0.1))
    chart = Chart(axis, linear(0.0, 100.0))
    drawn: list[Part] = []
    if axis.low < limit_m < axis.high:
        drawn.append(chart.line(np.full(2, limit_m), np.array([0.0, 100.0]), "var(--soft)", 1.0))
    for name, values in known.items():
        size, below = distribution(values)
        line = chart.line(
            np.append(np.maximum(size, axis.low), axis.high),
            np.append(100.0 * below, 100.0),
            found[name][0],
            2.0,
        )
        drawn.append(line)
    return figure(
        "Share of positions within",
        chart.shown(*drawn, unit="%", below="horizontal error, m", height="auto;aspect-ratio:1"),
        legend([(found[name][0], name) for name in known]) if len(known) > 1 else None,
        note=f"Upright line: {limit_m:g} m." if axis.low < limit_m < axis.high else None,
    )
