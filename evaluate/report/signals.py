"""C/N0 over time, a strip per satellite, coloured by what its channel was doing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.report.axes import linear, time_axis
from deepgnss.evaluate.report.chart import Chart, drawing, figure, legend, ticks
from deepgnss.evaluate.report.html import Html, Part, element

Span = tuple[float, float]
"""From, to, s."""

_BINS: Final = 500
_LOW_DBHZ, _HIGH_DBHZ = 10.0, 55.0
_RULE_DBHZ: Final = 30.0
_MODES: Final = {
    "PLL": ("var(--pll)", "PLL: phase locked"),
    "FLL": ("var(--fll)", "FLL: frequency locked"),
    "FFT": ("var(--fft)", "FFT: weak, frequency by spectrum"),
    "pull-in": ("var(--pull)", "pull-in"),
    "hold": ("var(--hold)", "hold: no signal, coasting"),
    "lost": ("var(--other)", "lost"),
}
_PLAIN: Final = ("var(--other)", "as the log tells it")


class Strength(NamedTuple):
    """C/N0 of one satellite over stretches of equal length, NaN where it was not tracked."""

    cn0_dbhz: FloatArray
    mode: NDArray[np.str_]  # the one it ended each stretch in; empty where a log tells none


def strengths(channels: pd.DataFrame, low_s: float, high_s: float) -> dict[str, Strength]:
    """C/N0 and modes by satellite.

    channels: columns s, satellite, cn0_dbhz, and mode where there is one; times from low_s to
    high_s.
    """
    found = {}
    known = channels.dropna(subset=["cn0_dbhz"])
    count = int(np.clip(known["s"].nunique(), 1, _BINS))
    place = (known["s"].to_numpy() - low_s) / max(high_s - low_s, 1e-9) * count
    known = known.assign(bin=np.clip(np.ceil(place - 1e-6) - 1.0, 0, count - 1).astype(np.int64))
    for name, own in known.groupby("satellite", sort=True):
        bins = own.groupby("bin")
        cn0_dbhz = np.full(count, np.nan)
        means = bins["cn0_dbhz"].mean()
        cn0_dbhz[means.index.to_numpy()] = means.to_numpy()
        mode = np.full(count, "", dtype="U16")
        if "mode" in own:
            last = bins["mode"].last()
            mode[last.index.to_numpy()] = last.fillna("").astype(str).to_numpy()
        found[str(name)] = Strength(cn0_dbhz, mode)
    return found


def strips(
    title: str, found: dict[str, Strength], low_s: float, high_s: float, dark: Sequence[Span] = ()
) -> Html:
    """The strips of all satellites under each other; `dark`: stretches without a position."""
    axis, unit_s, unit = time_axis(low_s, high_s)
    chart = Chart(axis, linear(_LOW_DBHZ, _HIGH_DBHZ))
    shown = sorted(found)
    rows = []
    for name in shown:
        own = found[name]
        edges = np.linspace(low_s, high_s, len(own.cn0_dbhz) + 1) / unit_s
        drawn: list[Part] = [chart.band(a / unit_s, b / unit_s) for a, b in dark]
        for mode in dict.fromkeys(own.mode.tolist()):
            drawn.append(_steps(chart, edges, own, mode))
        drawn.append(chart.rule(_RULE_DBHZ, "var(--rule)"))
        median = float(np.nanmedian(own.cn0_dbhz))
        rows.append(
            element(
                "div",
                element("b", name),
                element(
                    "div",
                    drawing(*drawn),
                    *(ticks("x", axis) if name == shown[-1] else ()),
                    class_="area",
                ),
                element("em", f"{median:.0f}"),
                class_="strip last" if name == shown[-1] else "strip",
            )
        )
    seen = {mode for own in found.values() for mode in own.mode[np.isfinite(own.cn0_dbhz)].tolist()}
    keys = [told for mode, told in _MODES.items() if mode in seen]
    keys += [_PLAIN] if seen - set(_MODES) else []
    keys += [("var(--gap)", "no position")] if dark else []
    return figure(
        title,
        *rows,
        legend(keys),
        note=f"Time in {unit} since the start. A strip reaches from {_LOW_DBHZ:.0f} to "
        f"{_HIGH_DBHZ:.0f} dB-Hz, its line stands at {_RULE_DBHZ:.0f}; on the right the median.",
        class_="wide",
    )


def _steps(chart: Chart, edges: FloatArray, own: Strength, mode: str) -> Html:
    """The stretches of one mode as filled steps."""
    here = np.isfinite(own.cn0_dbhz) & (own.mode == mode)
    value = np.where(here, own.cn0_dbhz, np.nan)
    x = np.column_stack((edges[:-1], edges[1:], edges[1:])).ravel()
    y = np.column_stack((value, value, np.where(np.append(here[1:], False), value, np.nan))).ravel()
    return chart.area(x, y, _MODES.get(mode, _PLAIN)[0])
