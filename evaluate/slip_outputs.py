"""Files of the two-antenna method: tables for machines, S's figures 2 to 4 for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import State, sure
from deepgnss.evaluate.classical_slips import RESIDUAL_LIMIT_M
from deepgnss.evaluate.slips import Slips, phase_changes, slip_table
from deepgnss.io.output import part_path, reporting, write_whole
from deepgnss.io.rinex_obs_reader import ObsFile
from deepgnss.io.rinex_repair import write_changed
from deepgnss.io.summary import write_summary

mpl.use("Agg")

FILES: Final = (
    *("slips.csv", "summary.json", "*_repaired.rnx"),
    *("detection.png", "residual.png", "check.png"),
)
"""Names of all files a run may write."""

_OURS, _THEIRS, _SLIP, _FAINT = "#c2185b", "#1565c0", "#2e7d32", "#bbbbbb"


def write_slips(folder: Path, found: Slips, summary: dict[str, Any], figures: bool = True) -> None:
    """Write slips.csv, summary.json and the figures."""
    table = slip_table(found)
    text = table.to_csv(index=False, float_format="%.10g", lineterminator="\n")
    write_whole(folder / "slips.csv", text)
    write_summary(folder / "summary.json", summary)
    if figures:
        draw_detection(folder / "detection.png", found)
        if np.isfinite(found.between.check_m).any():
            draw_residual(folder / "residual.png", found)
            draw_check(folder / "check.png", found)


def write_repaired(
    folder: Path, found: Slips, files: tuple[tuple[Path, ObsFile], tuple[Path, ObsFile]]
) -> list[Path]:
    """Write either observation file with its phases repaired; returns their places."""
    paths: list[Path] = []
    for which, (source, read) in enumerate(files):
        stem = source.name.split(".")[0]
        name = f"{stem}_repaired.rnx"
        if paths and paths[0].name == name:
            name = f"{stem}_second_repaired.rnx"
        write_changed(folder / name, source, read, phase_changes(found, which, read))
        paths.append(folder / name)
    return paths


# --- figures -------------------------------------------------------------------------------------


def shown_signals(found: Slips) -> list[int]:
    """Signals of the satellite that slipped most (or is seen most): S's figures show one pair."""
    slipped = np.count_nonzero(found.between.cycles, axis=0)
    seen = sure(found.between).sum(axis=0)
    names = [signal.satellite for signal in found.pair.signals]
    references = set(found.classical.reference)
    best = max(
        sorted(set(names)),
        key=lambda name: (
            name not in references,
            sum(slipped[k] for k, other in enumerate(names) if other == name),
            sum(seen[k] for k, other in enumerate(names) if other == name),
        ),
    )
    return [k for k, name in enumerate(names) if name == best]


def draw_detection(path: Path, found: Slips) -> None:
    """S figure 2: test values by pseudorange and phase, and by INS and phase, for each signal."""
    signals = shown_signals(found)
    figure, axes = _figure(len(signals), 2)
    by_code, ours = found.classical, found.between
    for row, k in zip(np.atleast_2d(axes), signals, strict=True):
        name = found.pair.signals[k].name
        row[0].set_title(f"pseudorange and phase, {name}, against {by_code.reference[k]}")
        row[1].set_title(f"INS and phase, {name}")
        for axis, values, told in (
            (row[0], by_code.code_cycles[:, k], by_code.told_by_code[:, k]),
            (row[1], ours.value_cycles[:, k], ours.cycles[:, k]),
        ):
            axis.plot(found.pair.time_s, values, ".", markersize=3, color=_THEIRS, label="value")
            slip = told != 0.0
            axis.plot(
                found.pair.time_s[slip], told[slip], "o", markersize=6, mfc="none",
                color=_OURS, label=f"slips told: {int(slip.sum())}",
            )  # fmt: skip
            axis.set_ylabel("cycles")
            axis.legend(loc="upper right", fontsize=8)
        doubt = ours.state[:, k] == State.UNDECIDED
        row[1].plot(
            found.pair.time_s[doubt], ours.value_cycles[doubt, k], "x", color="k", label="undecided"
        )
        row[1].set_ylim(_reach(ours.value_cycles[:, k]))
    _save(figure, axes, path)


def draw_residual(path: Path, found: Slips) -> None:
    """S figure 3: ionospheric residual between the two signals of a satellite."""
    k = shown_signals(found)[0]
    figure, axis = _figure(1, 1)
    values = found.classical.residual_m[:, k]
    axis.plot(found.pair.time_s, values, ".", markersize=4, color=_THEIRS)
    for limit in (-RESIDUAL_LIMIT_M, RESIDUAL_LIMIT_M):
        axis.axhline(limit, color=_OURS, linewidth=0.8)
    _, both = np.unique([s.satellite for s in found.pair.signals], return_inverse=True)
    slipped = (found.between.cycles[:, both == both[k]] != 0.0).any(axis=1)
    axis.plot(
        found.pair.time_s[slipped], values[slipped], "o", mfc="none", color=_SLIP,
        label=f"slips by INS and phase: {int(slipped.sum())} epochs",
    )  # fmt: skip
    axis.legend(loc="upper right", fontsize=8)
    axis.set(ylabel="m")
    axis.set_title(
        f"ionospheric residual, {found.pair.signals[k].satellite},"
        f" against {found.classical.reference[k]}"
    )
    _save(figure, axis, path)


def draw_check(path: Path, found: Slips) -> None:
    """S figure 4: four-difference check of the repairs, of all satellites."""
    figure, axes = _figure(1, 2)
    for axis, values, title in (
        (axes[0], found.classical.check_m, "pseudorange and phase"),
        (
            axes[1],
            np.where(sure(found.between), found.between.check_m, np.nan),
            "INS and phase",
        ),
    ):
        axis.plot(found.pair.time_s, values, ".", markersize=2.5, color=_THEIRS)
        largest = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else np.nan
        axis.set(ylabel="m")
        axis.set_title(f"check value, {title}: at most {largest:.3g} m")
    _save(figure, axes, path)


def _reach(values: FloatArray) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    far = max(float(np.abs(known).max()) if known.size else 1.0, 1.0)
    return -1.15 * far, 1.15 * far


def _figure(rows: int, columns: int) -> tuple[Any, Any]:
    from matplotlib import pyplot as plt

    size = 11.0, 2.9 * rows + 0.3
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained")
    return figure, axes


def _save(figure: Any, axes: Any, path: Path) -> None:
    from matplotlib import pyplot as plt

    for axis in np.ravel(axes):
        axis.grid(color=_FAINT, alpha=0.4)
        axis.set_xlabel("time, s")
        axis.title.set_fontsize(10)
    with reporting(path):
        figure.savefig(part_path(path), format="png", dpi=110, metadata={"Software": None})
        part_path(path).replace(path)
    plt.close(figure)
