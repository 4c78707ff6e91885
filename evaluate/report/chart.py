"""Charts as SVG stretched over their place, with labels of the page's own text beside it.

Lines keep their width and labels their size however wide the place is, so that one chart is read
on a phone and on a desk. Coordinates are whole numbers of a grid of CELLS; what falls on the same
cell is drawn once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.report.axes import Axis, tick_text
from deepgnss.evaluate.report.html import Html, Part, element

CELLS: Final = 1000
"""Width and height of the grid a chart is drawn on."""

_BINS: Final = 700  # along a line; more do not show


@dataclass(frozen=True, slots=True)
class Chart:
    """Two scales; its methods draw on them."""

    x: Axis
    y: Axis

    def line(self, x: FloatArray, y: FloatArray, colour: str, wide: float = 1.6) -> Html:
        """A line, broken where y is NaN."""
        across, up = thinned(x, y)
        return element("path", d=_lines(*self._cells(across, up)), stroke=colour, stroke_width=wide)

    def dots(self, x: FloatArray, y: FloatArray, colour: str, wide: float = 4.0) -> Html:
        """A round dot at every point."""
        keep = np.isfinite(x) & np.isfinite(y)
        cells = np.unique(np.column_stack(self._cells(x[keep], y[keep])), axis=0)
        d = "".join(f"M{a} {b}h0" for a, b in cells.tolist())
        return element("path", d=d, stroke=colour, stroke_width=wide)

    def area(self, x: FloatArray, y: FloatArray, colour: str) -> Html:
        """The area below a line, broken where y is NaN."""
        across, up = self._cells(x, y)
        parts = [
            f"M{across[part[0]]} {CELLS}"
            + "".join(f"L{across[k]} {up[k]}" for k in part)
            + f"V{CELLS}Z"
            for part in _whole_parts(y)
        ]
        return element("path", d="".join(parts), fill=colour, stroke="none")

    def band(self, start: float, end: float, colour: str = "var(--gap)") -> Html:
        """A stretch of the x scale, from top to bottom."""
        low, high = np.clip(self.x.share(np.array([start, end])), 0.0, 1.0) * CELLS
        return element(
            "rect", x=f"{low:.1f}", y="0", width=f"{max(high - low, 1.0):.1f}", height=str(CELLS),
            fill=colour,
        )  # fmt: skip

    def rule(self, y: float, colour: str = "var(--ink)") -> Html:
        """A thin line across."""
        height = float(self.y.share(y))
        return element(
            "path", d=f"M0 {CELLS * (1.0 - height):.0f}H{CELLS}", stroke=colour, stroke_width=1.0
        )

    def shown(self, *drawn: Part, unit: str = "", below: str = "", height: str = "14rem") -> Html:
        """The chart with grid and labels.

        Parameters: unit, of y, told above it; below, of x; height, CSS.
        """
        rules = "".join(
            f"M0 {CELLS * (1.0 - s):.0f}H{CELLS}" for s in self.y.share(np.array(self.y.ticks))
        ) + "".join(f"M{CELLS * s:.0f} 0V{CELLS}" for s in self.x.share(np.array(self.x.ticks)))
        area = element(
            "div",
            drawing(element("path", d=rules, class_="grid"), *drawn),
            *ticks("x", self.x),
            *ticks("y", self.y),
            class_="area",
            style=f"height:{height}",
        )
        return element(
            "div",
            element("div", unit, class_="unit") if unit else None,
            area,
            element("div", below, class_="below") if below else None,
            class_="chart",
        )

    def _cells(self, x: FloatArray, y: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Grid cells, far outside ones brought near; y counts from the top."""
        across = np.clip(np.nan_to_num(self.x.share(x)), -5.0, 5.0)
        up = np.clip(np.nan_to_num(1.0 - self.y.share(y)), -5.0, 5.0)
        up[~np.isfinite(y)] = _NOTHING
        return np.round(across * CELLS).astype(np.int64), np.round(up * CELLS).astype(np.int64)


_NOTHING: Final = 100.0  # share of the height that stands for NaN


def drawing(*drawn: Part, keep_round: bool = False) -> Html:
    """An SVG that fills its place: stretched, or as it is (`keep_round`, for square places)."""
    return element(
        "svg",
        *drawn,
        viewBox=f"0 0 {CELLS} {CELLS}",
        preserveAspectRatio="xMidYMid" if keep_round else "none",
        aria_hidden="true",
    )


def label(text: str, x: float, y: float, class_: str = "mark") -> Html:
    """Text centred at a place of a chart, shares of its width and height from the top left."""
    return element("span", text, class_=class_, style=f"left:{100.0 * x:.2f}%;top:{100.0 * y:.2f}%")


def legend(entries: Sequence[tuple[str, str]]) -> Html:
    """Colours and what they stand for: (colour, text)."""
    return element(
        "ul",
        *(
            element("li", element("i", style=f"background:{colour}"), text)
            for colour, text in entries
        ),
        class_="legend",
    )


def figure(title: str, *content: Part, note: Part = None, class_: str | None = None) -> Html:
    """A chart or table under its title, with a note below."""
    return element(
        "figure",
        element("h3", title),
        *content,
        element("figcaption", note) if note else None,
        class_=class_,
    )


def thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line by fewer points, highest and lowest of every stretch among them; NaN keep breaks."""
    count = len(x)
    size = count // _BINS
    if size < 4:
        return x, y
    keep: set[int] = set()
    for begin in range(0, count, size):
        part = y[begin : begin + size]
        known = np.flatnonzero(np.isfinite(part))
        blank = np.flatnonzero(~np.isfinite(part))
        keep.update((begin + blank[[0, -1]]).tolist() if blank.size else ())
        if known.size:
            ends = [
                known[0],
                known[-1],
                known[np.argmin(part[known])],
                known[np.argmax(part[known])],
            ]
            keep.update(begin + int(k) for k in ends)
    kept = np.array(sorted(keep))
    return x[kept], y[kept]


def ticks(side: Literal["x", "y"], axis: Axis) -> list[Html]:
    """Numbers of a scale, below its chart or left of it."""
    places = axis.share(np.array(axis.ticks))
    css = [
        f"left:{100.0 * s:.2f}%" if side == "x" else f"top:{100.0 - 100.0 * s:.2f}%" for s in places
    ]
    return [
        element("span", tick_text(tick, axis), class_=side, style=at)
        for tick, at in zip(axis.ticks, css, strict=True)
    ]


def _whole_parts(y: FloatArray) -> list[NDArray[np.int64]]:
    """Indices of the stretches without NaN."""
    known = np.flatnonzero(np.isfinite(y))
    return [p for p in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1) if p.size]


def _lines(across: NDArray[np.int64], up: NDArray[np.int64]) -> str:
    """A path through cells, each once in a row, lifted where there is nothing."""
    told: list[str] = []
    last: tuple[int, int] | None = None
    nothing = round(_NOTHING * CELLS)
    for a, b in zip(across.tolist(), up.tolist(), strict=True):
        if b == nothing:
            last = None
        elif last is None:
            told.append(f"M{a} {b}h0")
            last = (a, b)
        elif (a, b) != last:
            told.append(f"L{a} {b}")
            last = (a, b)
    return "".join(told)
