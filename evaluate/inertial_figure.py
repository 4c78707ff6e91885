"""One picture of an inertial navigation: track, errors with 3σ, attitude, biases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from deepgnss.core.attitude import euler_rad
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.deep.loose import Epochs, LooseRun
from deepgnss.evaluate.inertial import InertialErrors
from deepgnss.io.output import part_path, reporting

_INK, _FAINT, _REFERENCE = "#222222", "#dddddd", "#999999"
_HUES = ("#1565c0", "#2e7d32", "#ef6c00")
_MOST_POINTS = 4000


def draw_inertial(path: Path, run: LooseRun, errors: InertialErrors | None = None) -> None:
    """Draw the figure as PNG; without truth, σ alone stand where the errors would."""
    figure = Figure(figsize=(13.0, 12.0), layout=ConstrainedLayoutEngine())
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2)
    epochs = run.forward
    _draw_track(figure.add_subplot(grid[0, 0]), run)
    _draw_errors(figure.add_subplot(grid[0, 1]), epochs, errors, 0)
    _draw_attitude(figure.add_subplot(grid[1, 0]), epochs)
    _draw_errors(figure.add_subplot(grid[1, 1]), epochs, errors, 3)
    to_hour = 3600.0
    for place, first, unit, title in (
        (grid[2, 0], 0, np.degrees(1.0) * to_hour, "gyro bias, deg/h"),
        (grid[2, 1], 3, 1.0, "accelerometer bias, m/s²"),
    ):
        axes = figure.add_subplot(place)
        for axis, (name, hue) in enumerate(zip("xyz", _HUES, strict=True)):
            value = epochs.sensors[:, first + axis] * unit
            sigma = epochs.sensor_sigmas[:, first + axis] * unit
            _band(axes, epochs.time_s, value, sigma, hue, name)
        _style(axes, f"{title} (band: 1σ)", "s")
    part = part_path(path)
    with reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(part, format="png", dpi=110, metadata={"Software": None})
        part.replace(path)


def _draw_track(axes: Axes, run: LooseRun) -> None:
    origin = run.inputs.fixes[0].r_e_m
    to_n = C_ne(*geodetic(origin)[:2])
    held = {id(fix) for part in run.withheld for fix in part}
    used = [fix.r_e_m for fix in run.inputs.fixes if id(fix) not in held]
    hidden = [fix.r_e_m for part in run.withheld for fix in part]
    for places, hue, name in ((used, _REFERENCE, "fixes"), (hidden, "#c2185b", "withheld")):
        if places:
            north, east, _ = to_n @ (_thin(np.array(places)) - origin).T
            axes.plot(east, north, ".", color=hue, markersize=4, label=name, zorder=1)
    for epochs, hue, name in (
        (run.forward, _HUES[0], "forward"),
        (run.smooth, _HUES[1], "smoothed"),
    ):
        if epochs is not None:
            north, east, _ = to_n @ (_thin(epochs.antenna_r_e_m) - origin).T
            axes.plot(east, north, color=hue, linewidth=1.0, label=name, zorder=2)
    axes.set_aspect("equal", adjustable="datalim")
    _style(axes, "track, m north over m east", "")
    axes.legend(fontsize=8, frameon=False, loc="best")


def _draw_errors(axes: Axes, epochs: Epochs, errors: InertialErrors | None, first: int) -> None:
    """Position (first 0) or velocity (3): errors with 3σ, or 3σ alone."""
    what = "position, m" if first == 0 else "velocity, m/s"
    names, own = ("north", "east", "down"), slice(first, first + 3)
    if errors is None:
        sigma = 3.0 * np.sqrt(np.diagonal(epochs.antenna_covariance, axis1=1, axis2=2)[:, own])
        for axis, (name, hue) in enumerate(zip(names, _HUES, strict=True)):
            axes.plot(_thin(epochs.time_s), _thin(sigma[:, axis]), color=hue, label=name)
        axes.set_yscale("log")
        _style(axes, f"3σ of {what}", "s")
        return
    values = errors.position_m if first == 0 else errors.velocity_mps
    sigma = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2)[:, own])
    for axis, (name, hue) in enumerate(zip(names, _HUES, strict=True)):
        t, three = _thin(errors.time_s), 3.0 * _thin(sigma[:, axis])
        axes.plot(t, _thin(values[:, axis]), color=hue, linewidth=1.0, label=name)
        for side in (-three, three):
            axes.plot(t, side, color=hue, linewidth=0.6, linestyle=":")
    _style(axes, f"errors of {what} (dotted: 3σ)", "s")


def _draw_attitude(axes: Axes, epochs: Epochs) -> None:
    roll, pitch, yaw = np.degrees(euler_rad(epochs.q_nb)).T
    axes.plot(_thin(epochs.time_s), _thin(roll), color=_HUES[0], linewidth=1.0, label="roll")
    axes.plot(_thin(epochs.time_s), _thin(pitch), color=_HUES[1], linewidth=1.0, label="pitch")
    heading = yaw % 360.0
    turns = np.abs(np.diff(heading, prepend=heading[:1])) > 180.0
    other = axes.twinx()
    other.plot(
        _thin(epochs.time_s),
        _thin(np.where(turns, np.nan, heading)),
        color=_HUES[2],
        linewidth=0.8,
    )
    other.set_ylim(0.0, 360.0)
    other.set_yticks(np.arange(0, 361, 90))
    other.tick_params(colors=_HUES[2], labelsize=8)
    _style(axes, "roll and pitch, deg (right: heading)", "s")


def _band(
    axes: Axes, time_s: FloatArray, value: FloatArray, sigma: FloatArray, hue: str, name: str
) -> None:
    t, middle, half = _thin(time_s), _thin(value), _thin(sigma)
    axes.plot(t, middle, color=hue, linewidth=1.0, label=name)
    axes.fill_between(t, middle - half, middle + half, color=hue, alpha=0.15, linewidth=0)


def _thin(values: FloatArray) -> FloatArray:
    return values[:: max(1, len(values) // _MOST_POINTS)]


def _style(axes: Axes, title: str, x: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, color=_INK)
    axes.set_xlabel(x, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(color=_FAINT, linewidth=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)
