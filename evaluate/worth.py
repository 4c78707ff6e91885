"""What aiding was worth: the same recording with and without, figure beside figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from deepgnss.evaluate.comparison import Yardstick, compared
from deepgnss.evaluate.metrics import GROSS_M, metrics
from deepgnss.evaluate.report.chart import figure
from deepgnss.evaluate.report.comparison import write_comparison_report
from deepgnss.evaluate.report.tables import table
from deepgnss.evaluate.sources import read_source
from deepgnss.io.truth import Trajectory

_ROWS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("epochs with a fix", "fixed_share", lambda x: f"{100.0 * x:.2f} %"),
    ("ranges per epoch", "ranges_per_epoch", lambda x: f"{x:.2f}"),
    ("phases per epoch", "phases_per_epoch", lambda x: f"{x:.2f}"),
    ("possible slips per minute", "slips_per_minute", lambda x: f"{x:.1f}"),
    ("satellites lost per minute", "lost_per_minute", lambda x: f"{x:.1f}"),
    ("horizontal error, RMS", "horizontal_rms_m", lambda x: f"{x:.2f} m"),
    ("horizontal error, CEP50", "horizontal_p50_m", lambda x: f"{x:.2f} m"),
    ("horizontal error, CEP95", "horizontal_p95_m", lambda x: f"{x:.2f} m"),
    (
        f"horizontal errors above {GROSS_M:g} m",
        "gross_share",
        lambda x: f"{100.0 * x:.2f} %",
    ),
    ("vertical error, RMS", "vertical_rms_m", lambda x: f"{x:.2f} m"),
)


_NOTE = "Epochs are those at which something was observed; the shares below are of all instants."


def worth(folders: Sequence[Path]) -> list[tuple[str, ...]]:
    """Rows of a name and a figure per run; without truth nothing is said of errors."""
    runs = [metrics(Path(folder)) for folder in folders]
    return [
        (title, *("–" if math.isnan(run[name].value) else told(run[name].value) for run in runs))
        for title, name, told in _ROWS
        if not all(math.isnan(run[name].value) for run in runs)
    ]


def write_worth_report(
    folder: Path,
    runs: Mapping[str, Path],
    rows: Sequence[tuple[str, ...]],
    truth: Trajectory | None,
) -> Path:
    """Write report.html of the runs side by side, the table of `worth` first; returns its path."""
    path = folder / "report.html"
    found = compared([read_source(own, name) for name, own in runs.items()], Yardstick(truth))
    sheet = figure("What aiding was worth", table(["", *runs], rows), note=_NOTE)
    write_comparison_report(found, path, sheet)
    return path
