"""The way on a map of our own: positions, outages, scale bar, north arrow; no tiles, no network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.report.axes import Axis
from deepgnss.evaluate.report.chart import Chart, drawing, figure, legend
from deepgnss.evaluate.report.html import Html, Part, element

Span = tuple[float, float]
"""From, to, s."""

_NARROWEST, _WIDEST = 0.8, 1.5  # width over height
_LEAST_M: Final = 20.0
_MARGIN: Final = 0.07
_ROUND: Final = (1.0, 2.0, 5.0, 10.0)


class Way(NamedTuple):
    """Places over time, each (n, …); NaN where there is none."""

    s: FloatArray  # (n,) time
    r_e_m: FloatArray  # (n, 3)


class Mapped(NamedTuple):
    """Positions of one receiver."""

    name: str
    way: Way
    colour: str
    gross: NDArray[np.bool_] | None = None  # (n,) far from truth


def track(
    receivers: Sequence[Mapped], truth: Way | None, dark: Sequence[Span], gross_m: float
) -> Html:
    """The map.

    Parameters: truth, where it is known; dark, stretches without a position, drawn along truth,
    or straight from the last position to the next one.
    """
    known = [m.way.r_e_m[np.isfinite(m.way.r_e_m[:, 0])] for m in receivers]
    known += [truth.r_e_m[np.isfinite(truth.r_e_m[:, 0])]] if truth is not None else []
    together = np.concatenate(known) if known else np.zeros((0, 3))
    if not len(together):
        return figure("Track", element("p", "no position", class_="soft"))
    origin_e_m = np.median(together, axis=0)
    lat_rad, lon_rad, _ = geodetic(origin_e_m)
    to_n = C_ne(lat_rad, lon_rad)

    def local(r_e_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        ned = (r_e_m - origin_e_m) @ to_n.T
        return ned[:, 1], ned[:, 0]

    whole = known[-1] if truth is not None and len(known[-1]) else together
    chart, width_m, ratio = _frame(local(whole), local(together))
    drawn: list[Part] = []
    keys: list[tuple[str, str]] = []
    if truth is not None:
        drawn.append(chart.line(*local(truth.r_e_m), "var(--truth)", 7.0))
        keys.append(("var(--truth)", "truth"))
    lost = _lost(receivers, truth, dark) if dark else []
    for part in lost:
        drawn.append(chart.line(*local(part), "var(--lost)", 7.0 if truth is not None else 2.5))
    for one in receivers:
        east, north = local(one.way.r_e_m)
        if len(receivers) == 1:
            drawn.append(chart.line(east, north, one.colour, 1.5))
        drawn.append(chart.dots(east, north, one.colour, 4.5))
        keys.append((one.colour, one.name))
        if one.gross is not None and one.gross.any():
            drawn.append(chart.dots(east[one.gross], north[one.gross], "var(--fll)", 5.0))
            keys.append(("var(--fll)", f"position over {gross_m:g} m from truth"))
    keys += [("var(--lost)", "outage")] if lost else []
    return figure(
        "Track",
        element(
            "div",
            drawing(*drawn),
            element("span", "▲", element("br"), "N", class_="north"),
            class_="square map",
            style=f"aspect-ratio:{ratio:.4f}",
        ),
        _scale_bar(width_m),
        legend(keys),
        note=f"Around {_degrees(lat_rad, 'NS')}, {_degrees(lon_rad, 'EW')}."
        + ("" if truth is not None or not lost else " Outages are drawn straight across."),
    )


def _frame(
    whole: tuple[FloatArray, FloatArray], usual: tuple[FloatArray, FloatArray]
) -> tuple[Chart, float, float]:
    """A chart of equal scales, its width in m, width over height.

    Parameters: east and north of what it must hold, and of what it shall hold but for the 1 %
    furthest out on each side.
    """
    (west, right), (south, top) = (
        (
            min(float(all_of.min()), float(np.percentile(most, 1.0))),
            max(float(all_of.max()), float(np.percentile(most, 99.0))),
        )
        for all_of, most in zip(whole, usual, strict=True)
    )
    width = max(right - west, _LEAST_M) * (1.0 + 2.0 * _MARGIN)
    height = max(top - south, _LEAST_M) * (1.0 + 2.0 * _MARGIN)
    ratio = min(max(width / height, _NARROWEST), _WIDEST)
    width, height = max(width, height * ratio), max(height, width / ratio)
    x0, y0 = (west + right - width) / 2.0, (south + top - height) / 2.0
    return Chart(Axis(x0, x0 + width, ()), Axis(y0, y0 + height, ())), width, ratio


def _lost(receivers: Sequence[Mapped], truth: Way | None, dark: Sequence[Span]) -> list[FloatArray]:
    """The way through each outage, its ends included."""
    parts = []
    for start, end in dark:
        if truth is not None:
            first = max(int(np.searchsorted(truth.s, start)) - 1, 0)  # the last place before it
            part = truth.r_e_m[first : int(np.searchsorted(truth.s, end, "right"))]
        else:
            way = receivers[0].way
            have = np.isfinite(way.r_e_m[:, 0])
            before, after = way.r_e_m[have & (way.s < start)], way.r_e_m[have & (way.s >= end)]
            part = np.concatenate((before[-1:], after[:1]))
        if len(part):
            parts.append(part)
    return parts


def _scale_bar(width_m: float) -> Html:
    length_m = width_m / 3.0
    decade = 10.0 ** math.floor(math.log10(length_m))
    length_m = max(step * decade for step in _ROUND if step * decade <= length_m)
    text = f"{length_m:g} m" if length_m < 1000.0 else f"{length_m / 1000.0:g} km"
    width = f"width:{100.0 * length_m / width_m:.2f}%"
    return element("div", element("div", style=width), element("span", text), class_="scale")


def _degrees(angle_rad: float, letters: str) -> str:
    return f"{abs(math.degrees(angle_rad)):.4f}° {letters[angle_rad < 0.0]}"
