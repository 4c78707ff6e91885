"""One picture of a run: sky, signal strength, track, and errors (or DOP without truth)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.errors import Errors, errors, evaluate
from deepgnss.io.output import part_path, reporting
from deepgnss.io.truth import Trajectory

_SPARSE = 200  # fixes up to which each is drawn large
_MOST_POINTS = 4000  # per line; more do not show
_RINGS_RAD = np.radians(22.5)  # azimuth at which the elevation rings are labelled
_INK, _FAINT, _TRUTH, _OURS = "#222222", "#dddddd", "#999999", "#c2185b"
_AXIS_COLOURS = {"north_m": "#1565c0", "east_m": "#2e7d32", "down_m": "#ef6c00"}

# Twelve hues apart for the eye, then the same darkened: told apart also by the label at each line.
_HUES = (
    *("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b"),
    *("#e377c2", "#17becf", "#bcbd22", "#7f7f7f", "#1b3a8c", "#008080"),
)


@dataclass(frozen=True, slots=True)
class Run:
    """Tables of a run as pandas frames (columns as in `deepgnss.io.tables`)."""

    name: str
    solution: pd.DataFrame
    satellites: pd.DataFrame
    channels: pd.DataFrame


def draw_overview(path: Path, run: Run, truth: Trajectory | None = None) -> None:
    """Draw the figure as PNG; a run without any fix still gets its signals drawn.

    Raises
    ------
    OutputError: the file cannot be written.
    """
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1)
    figure = Figure(figsize=(13.5, 9.0), dpi=110, layout=layout)
    FigureCanvasAgg(figure)
    figure.suptitle(run.name, fontsize=14, color=_INK, x=0.02, ha="left", weight="bold")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.75), height_ratios=(1.0, 1.0))
    colours = _colours(sorted({*run.channels["satellite"], *run.satellites["satellite"]}))
    e = None if truth is None else errors(run.solution, truth)
    sky = figure.add_subplot(grid[0, 0], projection="polar")
    _draw_sky(sky, run.satellites, colours)  # type: ignore[arg-type]
    _draw_strength(figure.add_subplot(grid[0, 1]), run.channels, colours)
    _draw_track(figure.add_subplot(grid[1, 0]), run.solution, truth)
    below = figure.add_subplot(grid[1, 1])
    start = _start(run)
    if e is not None and e.fixed.any():
        _draw_errors(below, e, start)
    else:
        _draw_dop(below, run.solution, start)
    layout.execute(figure)
    figure.set_layout_engine("none")  # or saving would go through the whole drawing twice
    with reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(part_path(path), format="png", metadata={"Software": None})
        part_path(path).replace(path)


def _colours(satellites: Sequence[str]) -> dict[str, str]:
    hues = [*_HUES, *(_darker(hue) for hue in _HUES)]
    return {name: hues[k % len(hues)] for k, name in enumerate(satellites)}


def _darker(hue: str) -> str:
    rgb = [int(hue[k : k + 2], 16) / 255 * 0.6 for k in (1, 3, 5)]
    return to_hex((rgb[0], rgb[1], rgb[2]))


def _start(run: Run) -> float:
    """GPST second at sample 0, so that all time axes count from there."""
    known = run.channels.dropna(subset=["week", "tow_s"])
    if len(known):
        first = known.iloc[0]
        return float(_absolute(known.iloc[:1])[0] - first["recording_s"])
    return float(_absolute(run.solution.iloc[:1])[0]) if len(run.solution) else 0.0


def _absolute(frame: pd.DataFrame) -> FloatArray:
    weeks = frame["week"].to_numpy(dtype=np.float64)
    seconds: FloatArray = weeks * SECONDS_PER_WEEK + frame["tow_s"].to_numpy(dtype=np.float64)
    return seconds


def _thin(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.iloc[:: max(1, len(frame) // _MOST_POINTS)]


def _style(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=11, color=_INK)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=_FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


# --- sky -----------------------------------------------------------------------------------------


def _draw_sky(axes: PolarAxes, satellites: pd.DataFrame, colours: dict[str, str]) -> None:
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_ylim(0.0, 90.0)
    axes.set_yticks([0.0, 30.0, 60.0, 90.0], ["90°", "60°", "30°", ""], fontsize=8, color="#777777")
    axes.set_xticks(np.radians([0, 90, 180, 270]), ["N", "E", "S", "W"])
    axes.set_rlabel_position(float(np.degrees(_RINGS_RAD)))
    axes.grid(color=_FAINT, linewidth=0.6)
    axes.set_title("Sky (filled: used)", loc="left", fontsize=11, color=_INK)
    seen = satellites.dropna(subset=["azimuth_deg", "elevation_deg"])
    seen = seen[seen["elevation_deg"] > 0.0]
    places: dict[str, tuple[float, float]] = {}
    used: dict[str, bool] = {}
    for name, path in seen.groupby("satellite", sort=True):
        path = _thin(path)
        azimuth = np.radians(path["azimuth_deg"].to_numpy())
        zenith_deg = 90.0 - path["elevation_deg"].to_numpy()
        axes.plot(np.unwrap(azimuth), zenith_deg, color=colours[str(name)], linewidth=1.5)
        places[str(name)] = (float(azimuth[-1]), float(zenith_deg[-1]))
        used[str(name)] = bool(path["used"].any())
    for name, (azimuth_rad, zenith) in places.items():
        face = colours[name] if used[name] else "white"
        axes.plot(azimuth_rad, zenith, "o", ms=9, mfc=face, mec=colours[name], mew=1.5)
    for name, offset in label_offsets(places).items():
        axes.annotate(
            name,
            places[name],
            xytext=offset,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8,
            color=_INK,
        )


def label_offsets(places: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Where labels go around their markers, in points: away from whatever stands nearby."""
    points_per_degree = 1.3  # about, for a dial of the figure's size
    at = {
        name: np.array([np.sin(azimuth), np.cos(azimuth)]) * zenith * points_per_degree
        for name, (azimuth, zenith) in places.items()
    }
    ring_labels = [np.array([np.sin(_RINGS_RAD), np.cos(_RINGS_RAD)]) * r for r in (38.0, 68.0)]
    taken = [*at.values(), *(place * points_per_degree for place in ring_labels)]
    offsets = {}
    angles = np.radians(np.arange(0.0, 360.0, 30.0))
    for name, here in at.items():
        candidates = np.column_stack((17.0 * np.sin(angles), 13.0 * np.cos(angles)))
        apart = (here + candidates)[:, np.newaxis] - np.array(taken)
        distances = np.hypot(apart[..., 0] / 2.0, apart[..., 1]).min(axis=1)
        # Labels over the rim run into those of the other panels.
        outside = np.hypot(*(here + candidates).T) > 88.0 * points_per_degree
        best = candidates[int(np.argmax(np.where(outside, -1.0, distances)))]
        offsets[name] = (float(best[0]), float(best[1]))
        taken.append(here + best)
    return offsets


# --- signal strength -----------------------------------------------------------------------------


def _draw_strength(axes: Axes, channels: pd.DataFrame, colours: dict[str, str]) -> None:
    _style(axes, "Signal strength", "time since start of recording (s)", "C/N0 (dB-Hz)")
    drawn = channels.dropna(subset=["cn0_dbhz"])
    ends: dict[str, tuple[float, float]] = {}
    for name, track in drawn.groupby("satellite", sort=True):
        track = _thin(track)
        time_s, cn0 = track["recording_s"].to_numpy(), track["cn0_dbhz"].to_numpy()
        time_s, cn0 = _with_gaps(time_s, cn0)
        axes.plot(time_s, cn0, color=colours[str(name)], linewidth=1.1)
        ends[str(name)] = (float(time_s[-1]), float(cn0[-1]))
    if not ends:
        _say(axes, "no signal tracked")
        return
    last = float(drawn["recording_s"].max())
    axes.set_xlim(0.0, last * 1.001)
    low, high = np.nanpercentile(drawn["cn0_dbhz"], (0.5, 99.9))
    axes.set_ylim(max(low - 3.0, 0.0), high + 3.0)
    _label_ends(axes, ends, colours)


def _with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Break a line where its satellite was not tracked."""
    steps = np.diff(time_s)
    if not len(steps):
        return time_s, values
    breaks = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(values, breaks, np.nan)


def _label_ends(axes: Axes, ends: dict[str, tuple[float, float]], colours: dict[str, str]) -> None:
    """Name every line in the right margin at its last value, spread so that none overlap."""
    low, high = axes.get_ylim()
    names = sorted(ends, key=lambda name: ends[name][1])
    per_column = 26
    columns = -(-len(names) // per_column)
    for column in range(columns):
        part = names[column::columns]
        wanted = np.array([(ends[name][1] - low) / (high - low) for name in part])
        for name, y in zip(part, _spread(wanted, 1.0 / per_column), strict=True):
            axes.annotate(
                name,
                (1.0, y),
                xytext=(6 + 30 * column, 0),
                xycoords="axes fraction",
                textcoords="offset points",
                fontsize=8,
                va="center",
                color=colours[name],
                weight="bold",
                annotation_clip=False,
            )


def _spread(wanted: FloatArray, spacing: float) -> FloatArray:
    """Heights near those wanted (ascending), at least `spacing` apart and within [0, 1]."""
    heights = np.clip(wanted, 0.0, 1.0)
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + spacing)
    top = 1.0
    for k in range(len(heights) - 1, -1, -1):
        heights[k] = min(heights[k], top)
        top = heights[k] - spacing
    return heights


# --- track and errors ----------------------------------------------------------------------------


def _draw_track(axes: Axes, solution: pd.DataFrame, truth: Trajectory | None) -> None:
    _style(axes, "Track", "east (m)", "north (m)")
    axes.set_aspect("equal", adjustable="datalim")
    fixes = solution[solution["valid"] == 1]
    if not len(fixes):
        _say(axes, "no fix")
        return
    r_e_m = _thin(fixes)[["x_e_m", "y_e_m", "z_e_m"]].to_numpy(dtype=np.float64)
    origin = np.median(r_e_m, axis=0)
    if truth is not None:
        whole = solution.iloc[:: max(1, len(solution) // _MOST_POINTS)]
        true_r_e_m, _ = truth.at(
            whole["week"].to_numpy(dtype=np.int64), whole["tow_s"].to_numpy(dtype=np.float64)
        )
        east, north = _local(true_r_e_m, origin)
        axes.plot(east, north, color=_TRUTH, linewidth=4.0, label="truth", solid_capstyle="round")
    east, north = _local(r_e_m, origin)
    size = 3.5 if len(east) > _SPARSE else 7.0
    axes.plot(east, north, ".", color=_OURS, ms=size, label="fixes", markeredgewidth=0.0)
    axes.plot(east[0], north[0], "o", mfc="white", mec=_OURS, ms=7, label="first fix")
    axes.legend(fontsize=8, frameon=True, edgecolor="none", framealpha=0.8, loc="best")
    axes.margins(0.12)
    axes.locator_params(nbins=6)


def _local(r_e_m: FloatArray, origin_e_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    lat, lon, _ = geodetic(origin_e_m)
    north, east, _ = ((r_e_m - origin_e_m) @ C_ne(lat, lon).T).T
    return east, north


def _draw_errors(axes: Axes, e: Errors, start_s: float) -> None:
    result = evaluate(e)
    h = result.of("horizontal_m")
    title = (
        f"Position error: horizontal RMS {h.rms:.2f} m, 95 % {h.percentile95:.2f} m, "
        f"{result.fixed_share:.1%} of epochs fixed"
    )
    _style(axes, title, "time since start of recording (s)", "estimate − truth (m)")
    time_s = e.week * float(SECONDS_PER_WEEK) + e.tow_s - start_s
    step = max(1, len(time_s) // _MOST_POINTS)
    for name, colour in _AXIS_COLOURS.items():
        label = name.removesuffix("_m")
        axes.plot(
            time_s[::step], getattr(e, name)[::step], color=colour, linewidth=1.0, label=label
        )
    _fit_height(axes, [getattr(e, name)[e.fixed] for name in _AXIS_COLOURS])
    axes.axhline(0.0, color=_INK, linewidth=0.7)
    axes.set_xlim(min(0.0, float(time_s[0])), float(time_s[-1]))
    axes.legend(fontsize=8, ncols=3, frameon=False, loc="upper right")


def _fit_height(axes: Axes, values: Iterable[FloatArray]) -> None:
    """Limits by percentiles: one gross error must not flatten the rest; room for the legend."""
    together = np.concatenate(list(values))
    low, middle, high = np.percentile(together, (2.0, 50.0, 98.0))
    low = max(middle - 1.8 * (middle - low), float(together.min()))
    high = min(middle + 1.8 * (high - middle), float(together.max()))
    room = 0.1 * max(high - low, 0.1)
    axes.set_ylim(min(low, 0.0) - room, max(high, 0.0) + 3.0 * room)


def _draw_dop(axes: Axes, solution: pd.DataFrame, start_s: float) -> None:
    title = "Satellites used and dilution of precision"
    _style(axes, title, "time since start of recording (s)", "satellites used")
    fixes = _thin(solution)
    if not (fixes["valid"] == 1).any():
        _say(axes, "no fix")
        return
    time_s = _absolute(fixes) - start_s
    axes.step(time_s, fixes["used"], where="post", color="#1565c0", linewidth=1.3)
    axes.set_ylim(0.0, max(8.0, float(fixes["used"].max()) * 1.25))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.label.set_color("#1565c0")
    axes.set_xlim(min(0.0, float(time_s[0])), max(float(time_s[-1]), float(time_s[0]) + 1e-3))
    right = axes.twinx()
    right.spines[["top", "left"]].set_visible(False)
    right.plot(time_s, fixes["hdop"], color="#ef6c00", linewidth=1.3, label="HDOP")
    right.plot(time_s, fixes["pdop"], color="#6a1b9a", linewidth=1.3, label="PDOP")
    right.set_ylabel("DOP")
    highest = fixes["pdop"].dropna()
    right.set_ylim(0.0, 4.0 if highest.empty else float(np.percentile(highest, 99.0)) * 1.6)
    if not highest.empty:
        right.legend(fontsize=8, ncols=2, frameon=False, loc="upper right")


def _say(axes: Axes, text: str) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="#777777", fontsize=12)
