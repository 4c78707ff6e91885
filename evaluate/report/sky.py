"""Sky plot: the ways of the satellites, north up, and the names where each was last."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.overview import label_offsets
from deepgnss.evaluate.report.chart import CELLS, drawing, figure, label, legend
from deepgnss.evaluate.report.html import Html, Part, element

_RADIUS: Final = 0.47  # of the horizon, share of the width
_POINTS: Final = 1.3 * 90.0  # the same in `label_offsets`' points
_COLOURS: Final = {"G": "var(--gps)", "C": "var(--bds)"}
_NAMES: Final = {"G": "GPS", "C": "BeiDou"}


def sky(satellites: pd.DataFrame) -> Html:
    """Directions of all satellites above the horizon; filled: used in a position.

    satellites: as of satellites.csv.
    """
    seen = satellites.dropna(subset=["azimuth_deg", "elevation_deg"])
    seen = seen[seen["elevation_deg"] > 0.0]
    drawn: list[Part] = [*_dial()]
    places: dict[str, tuple[float, float]] = {}
    for name, way in seen.groupby("satellite", sort=True):
        colour = _COLOURS.get(str(name)[0], "var(--other)")
        x, y = _dial_places(way)
        cells = np.unique(np.round(np.column_stack((x, y)) * CELLS).astype(int), axis=0)
        step = max(1, len(x) // 200)
        line = "M" + "L".join(
            f"{CELLS * a:.0f} {CELLS * b:.0f}" for a, b in zip(x[::step], y[::step], strict=True)
        )
        if len(cells) > 1:
            drawn.append(element("path", d=line, stroke=colour, stroke_width=2.0))
        used = bool((way["used"] == 1).any())
        drawn.append(
            element(
                "circle", cx=f"{CELLS * x[-1]:.0f}", cy=f"{CELLS * y[-1]:.0f}", r="15",
                fill=colour if used else "var(--card)", stroke=colour, stroke_width=2.0,
            )
        )  # fmt: skip
        last = way.iloc[-1]
        places[str(name)] = (
            float(np.radians(last["azimuth_deg"])),
            float(90.0 - last["elevation_deg"]),
        )
    names = []
    for name, (right, up) in label_offsets(places).items():
        azimuth, zenith_deg = places[name]
        x0, y0 = _place(azimuth, zenith_deg)
        scale = _RADIUS / _POINTS * 1.15
        names.append(label(name, x0 + right * scale, y0 - up * scale))
    return figure(
        "Sky",
        element(
            "div",
            drawing(*drawn, keep_round=True),
            *(label(text, *_place(np.radians(deg), 90.0), class_="ring")
              for text, deg in (("N", 0), ("E", 90), ("S", 180), ("W", 270))),
            *names,
            class_="square",
            style="aspect-ratio:1",
        ),
        legend([(_COLOURS[s], _NAMES[s]) for s in _COLOURS if any(n[0] == s for n in places)]),
        note="Rings at 30° and 60° of elevation. Filled: used in a position at least once.",
    )  # fmt: skip


def _dial() -> list[Html]:
    rings = [
        element(
            "circle", cx=CELLS / 2, cy=CELLS / 2, r=f"{_RADIUS * CELLS * share:.0f}",
            fill="none", class_="grid",
        )
        for share in (1.0, 2.0 / 3.0, 1.0 / 3.0)
    ]  # fmt: skip
    low, high, middle = CELLS * (0.5 - _RADIUS), CELLS * (0.5 + _RADIUS), CELLS // 2
    cross = f"M{low:.0f} {middle}H{high:.0f}M{middle} {low:.0f}V{high:.0f}"
    return [*rings, element("path", d=cross, class_="grid")]


def _place(azimuth_rad: float, zenith_deg: float) -> tuple[float, float]:
    """From the top left, shares of the dial's square."""
    r = _RADIUS * zenith_deg / 90.0
    return 0.5 + r * float(np.sin(azimuth_rad)), 0.5 - r * float(np.cos(azimuth_rad))


def _dial_places(way: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    azimuth = np.radians(way["azimuth_deg"].to_numpy(np.float64))
    r = _RADIUS * (90.0 - way["elevation_deg"].to_numpy(np.float64)) / 90.0
    return 0.5 + r * np.sin(azimuth), 0.5 - r * np.cos(azimuth)
