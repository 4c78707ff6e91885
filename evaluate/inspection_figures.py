"""Pictures of an inspection: histogram and spectrum as PNG and as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.inspection import Inspection, passband
from deepgnss.io.output import part_path, reporting

_BLOCKS = " ▁▂▃▄▅▆▇█"
_INK, _BAND, _MARK = "#1f4e79", "#dce8f2", "#c2185b"


def draw_inspection(path: Path, inspections: Sequence[Inspection]) -> None:
    """Draw histogram and spectrum of each stream as a row of a PNG figure.

    Raises
    ------
    OutputError: the file cannot be written.
    """
    rows = len(inspections)
    figure = Figure(figsize=(12.0, 3.6 * rows), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 2, squeeze=False, width_ratios=(1.0, 2.0))
    for row, seen in zip(axes, inspections, strict=True):
        _draw_histogram(row[0], seen)
        _draw_spectrum(row[1], seen)
    with reporting(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(part_path(path), format="png", metadata={"Software": None})
        part_path(path).replace(path)


def _draw_histogram(axes: Axes, seen: Inspection) -> None:
    value, share = folded_histogram(seen, 64)
    axes.bar(value, 100.0 * share, width=0.9 * (value[1] - value[0] if value.size > 1 else 1.0),
             color=_INK)  # fmt: skip
    axes.set_title(f"{seen.block.stream.name}: values", loc="left")
    axes.set_xlabel("value")
    axes.set_ylabel("share, %")


def _draw_spectrum(axes: Axes, seen: Inspection) -> None:
    frequency_hz, density_db = seen.spectrum
    stream = seen.block.stream
    band = passband(seen.spectrum)
    if band is not None:
        axes.axvspan(band[0] / 1e6, band[1] / 1e6, color=_BAND, label="passband")
    axes.plot(frequency_hz / 1e6, density_db, color=_INK, linewidth=0.8)
    axes.axvline(
        stream.intermediate_hz / 1e6, color=_MARK, linestyle="--", linewidth=0.9,
        label=f"{stream.centre_hz / 1e6:.10g} MHz",
    )  # fmt: skip
    axes.set_xlim(frequency_hz[0] / 1e6, frequency_hz[-1] / 1e6)
    axes.set_title(f"{stream.name}: spectrum", loc="left")
    axes.set_xlabel("frequency in the samples, MHz")
    axes.set_ylabel("density, dB/Hz")
    axes.legend(loc="upper right", frameon=False)


def folded_histogram(seen: Inspection, most: int) -> tuple[FloatArray, FloatArray]:
    """Values and their share, at most `most` of them: neighbours are taken together."""
    if seen.values.size <= most:
        return seen.values.astype(np.float64), seen.counts / seen.counts.sum()
    step = -(-int(seen.values[-1] - seen.values[0] + 1) // most)  # whole values in each class
    edges = np.arange(seen.values[0], seen.values[-1] + step + 1, step) - 0.5
    counts, _ = np.histogram(seen.values, edges, weights=seen.counts)
    return (edges[:-1] + edges[1:]) / 2.0, counts / counts.sum()


def histogram_text(seen: Inspection, most: int = 17, width: int = 40) -> list[str]:
    """One line per value (or class of values): value, share, bar."""
    value, share = folded_histogram(seen, most)
    top = float(share.max())
    return [
        f"{v:8.4g} {100.0 * s:6.2f} %  " + "█" * round(width * s / top)
        for v, s in zip(value.tolist(), share.tolist(), strict=True)
    ]


def spectrum_text(seen: Inspection, width: int = 72, height: int = 8) -> list[str]:
    """Spectrum in block characters, a scale in dB at the left and in MHz below."""
    frequency_hz, density_db = seen.spectrum
    columns = [part.max() for part in np.array_split(density_db, min(width, density_db.size))]
    low, high = float(np.percentile(columns, 2)), float(max(columns))
    low = min(low, high - 6.0)
    step_db = (high - low) / height
    eighths = [round(8 * max(c - low, 0.0) / step_db) for c in columns]
    lines = []
    for row in reversed(range(height)):
        bar = "".join(_BLOCKS[min(max(e - 8 * row, 0), 8)] for e in eighths)
        lines.append(f"{low + (row + 1) * step_db:7.1f} │{bar}")
    left, right = f"{frequency_hz[0] / 1e6:.3f}", f"{frequency_hz[-1] / 1e6:.3f} MHz"
    gap = max(len(columns) - len(left) - len(right), 1)
    return [*lines, f"  dB/Hz └{'─' * len(columns)}", f"         {left}{' ' * gap}{right}"]
