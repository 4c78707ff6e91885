"""Pictures of error budgets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deepgnss.evaluate.analysis.budgets import Budget
from deepgnss.io.output import part_path, reporting

_HUES: Final = ("#1565c0", "#2e7d32", "#ef6c00", "#c2185b", "#6a1b9a", "#00838f", "#5d4037")
_INK, _FAINT, _REFERENCE = "#222222", "#dddddd", "#999999"


def draw(path: Path, budget: Budget) -> None:
    """Draw a budget as PNG.

    Raises
    ------
    OutputError: the file cannot be written.
    """
    count, painter = _PAINTERS[budget.name]
    figure = Figure(figsize=(5.4 * count, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, count, squeeze=False)[0]
    painter(list(axes), budget)
    figure.suptitle(budget.title, fontsize=11, color=_INK, x=0.01, ha="left")
    with reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(part_path(path), format="png", metadata={"Software": None})
        part_path(path).replace(path)


def _style(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=9, loc="left", color=_INK)
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(color=_FAINT, linewidth=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(fontsize=7.5, frameon=False)


def _lines(axes: Axes, curves: pd.DataFrame, x: str, named: Mapping[str, str]) -> None:
    """Curves over the column x, in |value|; the first thick."""
    for k, (column, label) in enumerate(named.items()):
        axes.plot(
            curves[x],
            curves[column].abs(),
            color=_INK if k == 0 else _HUES[(k - 1) % len(_HUES)],
            linewidth=1.8 if k == 0 else 1.1,
            label=label,
        )


_DRAWN: Final = ("initial velocity", "initial attitude", "accelerometer bias",
                 "accelerometer scale", "gyro bias")  # fmt: skip
_NOISE: Final = ("accelerometer noise", "accelerometer drift", "gyro noise", "gyro drift")


def _closed_loop(axes: list[Axes], budget: Budget) -> None:
    def column(name: str) -> str:
        return f"{name.replace(' ', '_')}_deg"

    drawn = {"sum_deg": "sum, every error at +1σ"} | {column(name): name for name in _DRAWN}
    noise = {"noise_1sigma_deg": "all noise, 1σ"} | {column(name): name for name in _NOISE}
    for place, title, named in (
        (axes[0], "drawn once", drawn),
        (axes[1], "noise on the way, 1σ", noise),
    ):
        _lines(place, budget.curves, "time_s", named)
        place.set_ylim(bottom=0.0)
        _style(place, title, "s", "phase error, deg")


def _open_loop(axes: list[Axes], budget: Budget) -> None:
    for place, title, quantity, unit, limit in (
        (axes[0], "phase", "phase_deg", "deg", 180.0),
        (axes[1], "frequency", "frequency_hz", "Hz", None),
        (axes[2], "code", "code_m", "m", None),
    ):
        named = {
            f"sum_and_1sigma_{quantity}": "sum + 1σ of noise and clock",
            f"sum_{quantity}": "sum, every error at +1σ",
            f"noise_1sigma_{quantity}": "noise of the unit, 1σ",
            f"total_1sigma_{quantity}": "all by chance, 1σ",
        }
        if quantity != "code_m":
            named[f"clock_1sigma_{quantity}"] = "clock, 1σ"
        _lines(place, budget.curves, "time_s", named)
        if limit is not None:
            place.axhline(limit, color=_REFERENCE, linestyle="--", linewidth=0.9)
        place.set_yscale("log")
        top = float(budget.curves[f"sum_and_1sigma_{quantity}"].max())
        place.set_ylim(top * 1e-3, top * 1.5)
        _style(place, title, "s", unit)
        place.legend(fontsize=7.5, frameon=False, loc="lower right")


def _discriminator(axes: list[Axes], budget: Budget) -> None:
    curves = budget.curves
    for place, title, kind in ((axes[0], "aided", "aided"), (axes[1], "alone", "alone")):
        names = [name for name in curves if str(name).startswith(kind)]
        for k, name in enumerate(names):
            label = str(name).split("_")[1].replace("ms", " ms")
            place.plot(curves["window_s"], curves[name], color=_HUES[k % len(_HUES)], label=label)
        place.set_yscale("log")
        _style(place, f"{title}: tracked below the curve", "window, s", "acceleration, m/s²")
    axes[0].axhline(1000.0, color=_REFERENCE, linestyle="--", linewidth=0.9)


def _jitter(axes: list[Axes], budget: Budget) -> None:
    names = {
        "total_deg": "1σ + lag/3, K(1)",
        "thermal_deg": "thermal",
        "oscillator_deg": "oscillator",
        "vibration_deg": "vibration",
        "lag_deg": "lag",
    }
    some = {column: name for column, name in names.items() if budget.curves[column].max() > 0.0}
    _lines(axes[0], budget.curves, "bandwidth_hz", some)
    axes[0].axhline(15.0, color=_REFERENCE, linestyle="--", linewidth=0.9)
    axes[0].set(xscale="log", yscale="log", ylim=(1e-2, 100.0))
    _style(axes[0], "over bandwidth", "Hz", "phase, deg")
    table = budget.table
    for k, name in enumerate(("K(1) of 15, deg", "thermal, deg", "oscillator, deg")):
        hue = _INK if k == 0 else _HUES[k - 1]
        axes[1].plot(table["C/N0, dB-Hz"], table[name], color=hue, label=name.split(",")[0])
    axes[1].axhline(15.0, color=_REFERENCE, linestyle="--", linewidth=0.9)
    axes[1].set(yscale="log")
    _style(axes[1], "over C/N0", "dB-Hz", "phase, deg")
    axes[2].plot(table["C/N0, dB-Hz"], table["code, m"], color=_INK, label="thermal")
    axes[2].set(yscale="log")
    _style(axes[2], "code over C/N0", "dB-Hz", "m")


def _peaks(axes: list[Axes], budget: Budget) -> None:
    curves = budget.curves
    for k, name in enumerate(("fft", "pfft", "sfft", "psfft")):
        hue = _HUES[k]
        axes[0].errorbar(
            curves["cn0_dbhz"],
            100.0 * curves[f"{name}_share"],
            200.0 * curves[f"{name}_1sigma"],
            fmt="o" if f"{name}_integral" in curves else "o-",
            linewidth=0.8,
            markersize=3.0,
            color=hue,
            label=f"{name.upper()}, simulated",
        )
        if f"{name}_integral" in curves:
            axes[0].plot(
                curves["cn0_dbhz"],
                100.0 * curves[f"{name}_integral"],
                color=hue,
                label=f"{name.upper()}, integral",
            )
    _style(axes[0], "bars: 2σ of the share", "C/N0, dB-Hz", "right peaks, %")


_Painter = Callable[[list[Axes], Budget], None]
_PAINTERS: Final[Mapping[str, tuple[int, _Painter]]] = {
    "closed_loop": (2, _closed_loop),
    "open_loop": (3, _open_loop),
    "discriminator": (2, _discriminator),
    "jitter": (3, _jitter),
    "peaks": (1, _peaks),
}
