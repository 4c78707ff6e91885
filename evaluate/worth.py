"""What aiding was worth: the same recording with and without, figure beside figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

GROSS_M = 3.0
"""Horizontal error counted as gross, T table 6.10."""


def worth(folders: Sequence[Path], with_truth: bool) -> list[tuple[str, ...]]:
    """Rows of a name and a figure per run."""
    runs = [_figures(Path(folder), with_truth) for folder in folders]
    return [(name, *(run[name] for run in runs)) for name in runs[0]]


def _figures(folder: Path, with_truth: bool) -> dict[str, str]:
    solution = pd.read_csv(folder / "solution.csv")
    observed = pd.read_csv(folder / "observations.csv", low_memory=False)
    events = pd.read_csv(folder / "events.csv")
    epochs = max(len(solution), 1)
    phase = observed["carrier_valid"] == 1
    figures = {
        "epochs with a fix": f"{100.0 * (solution['valid'] == 1).sum() / epochs:.2f} %",
        "ranges per epoch": f"{len(observed) / epochs:.2f}",
        "phases per epoch": f"{phase.sum() / epochs:.2f}",
        "possible slips": f"{int((phase & (observed['slip'] == 1)).sum())}",
        "satellites lost": f"{int((events['what'] == 'lost').sum())}",
    }
    if with_truth:
        errors_m = pd.read_csv(folder / "errors.csv")["horizontal_m"].dropna()
        if len(errors_m):
            statistics = pd.read_csv(folder / "statistics.csv", index_col="quantity")
            known = statistics.loc["horizontal_m"]
            gross = 100.0 * float((errors_m > GROSS_M).mean())
            figures |= {
                "horizontal error, RMS": f"{known['rms']:.2f} m",
                "horizontal error, CEP50 / 95": f"{known['p50']:.2f} / {known['p95']:.2f} m",
                f"horizontal errors above {GROSS_M:g} m": f"{gross:.2f} %",
            }
    return figures
