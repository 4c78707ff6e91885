"""Errors of a solution against truth (estimate − truth) and what they come to."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.io.input import reading
from deepgnss.io.output import write_whole
from deepgnss.io.tables import number
from deepgnss.io.truth import Trajectory

GROSS_M = 30.0
"""A fix further than this from truth, horizontally, counts as gross (unless asked otherwise)."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors at every epoch that truth covers, NaN where there was no fix; arrays of one length."""

    week: NDArray[np.int64]
    tow_s: FloatArray
    north_m: FloatArray
    east_m: FloatArray
    down_m: FloatArray
    horizontal_m: FloatArray
    v_north_mps: FloatArray
    v_east_mps: FloatArray
    v_down_mps: FloatArray
    true_x_e_m: FloatArray  # truth's place
    true_y_e_m: FloatArray
    true_z_e_m: FloatArray

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """True where there was a fix."""
        return np.isfinite(self.horizontal_m)


class Statistics(NamedTuple):
    """Of one error, over all epochs with a fix."""

    quantity: str  # name and unit, as in `Errors`
    mean: float
    std: float
    rms: float
    median: float  # of the magnitude; of horizontal_m: CEP50
    percentile95: float  # of the magnitude; of horizontal_m: CEP95
    largest: float  # magnitude


class Evaluation(NamedTuple):
    """What the errors of a run come to."""

    epochs: int  # that truth covers
    fixed_share: float
    gross_share: float  # of the fixes
    gross_m: float
    statistics: tuple[Statistics, ...]

    def of(self, quantity: str) -> Statistics:
        """Statistics of one quantity by its name."""
        return next(s for s in self.statistics if s.quantity == quantity)


_QUANTITIES = (
    *("north_m", "east_m", "down_m", "horizontal_m"),
    *("v_north_mps", "v_east_mps", "v_down_mps"),
)


def read_solution(path: Path | str) -> pd.DataFrame:
    """Read a solution.csv of ours; blank cells are NaN."""
    path = Path(path)
    with reading(path):
        frame = pd.read_csv(path, dtype={"satellites": str, "rejected": str, "reason": str})
    for name in ("week", "tow_s", "valid", "x_e_m", "v_n_mps"):
        if name not in frame:
            raise InputFileError(f"{path}: column '{name}' is missing: not a solution.csv")
    return frame


def errors(solution: pd.DataFrame, truth: Trajectory) -> Errors:
    """Errors in north, east, down of truth's place.

    solution: as of `read_solution` (week, tow_s, valid, x_e_m … v_d_mps).
    """
    week = solution["week"].to_numpy(dtype=np.int64)
    tow_s = solution["tow_s"].to_numpy(dtype=np.float64)
    true_r_e_m, true_v_e_mps = truth.at(week, tow_s)
    covered = np.isfinite(true_r_e_m).all(axis=1)
    table = solution[covered]
    valid = table["valid"].to_numpy() == 1
    r_e_m = table[["x_e_m", "y_e_m", "z_e_m"]].to_numpy(dtype=np.float64)
    v_n_mps = table[["v_n_mps", "v_e_mps", "v_d_mps"]].to_numpy(dtype=np.float64)
    d_n_m, dv_n_mps = np.full((len(table), 3), np.nan), np.full((len(table), 3), np.nan)
    for k, (at, v_e_mps) in enumerate(zip(true_r_e_m[covered], true_v_e_mps[covered], strict=True)):
        if valid[k]:
            to_n = C_ne(*geodetic(at)[:2])
            d_n_m[k] = to_n @ (r_e_m[k] - at)
            dv_n_mps[k] = v_n_mps[k] - to_n @ v_e_mps
    (north_m, east_m, down_m), (v_north_mps, v_east_mps, v_down_mps) = d_n_m.T, dv_n_mps.T
    return Errors(
        week=week[covered],
        tow_s=tow_s[covered],
        north_m=north_m,
        east_m=east_m,
        down_m=down_m,
        horizontal_m=np.hypot(north_m, east_m),
        v_north_mps=v_north_mps,
        v_east_mps=v_east_mps,
        v_down_mps=v_down_mps,
        true_x_e_m=true_r_e_m[covered, 0],
        true_y_e_m=true_r_e_m[covered, 1],
        true_z_e_m=true_r_e_m[covered, 2],
    )


def evaluate(e: Errors, gross_m: float = GROSS_M) -> Evaluation:
    """Statistics over the epochs with a fix; shares are NaN where there is nothing to share."""
    fixed = e.fixed
    fixes = int(fixed.sum())
    gross = int((e.horizontal_m[fixed] > gross_m).sum())
    return Evaluation(
        epochs=len(fixed),
        fixed_share=fixes / len(fixed) if len(fixed) else math.nan,
        gross_share=gross / fixes if fixes else math.nan,
        gross_m=gross_m,
        statistics=tuple(_statistics(name, getattr(e, name)[fixed]) for name in _QUANTITIES),
    )


def _statistics(name: str, values: FloatArray) -> Statistics:
    values = values[np.isfinite(values)]
    if not len(values):
        return Statistics(name, *[math.nan] * 6)
    size = np.abs(values)
    median, percentile95 = np.percentile(size, (50.0, 95.0))
    return Statistics(
        name,
        float(values.mean()),
        float(values.std()),
        float(np.sqrt(np.mean(values**2))),
        float(median),
        float(percentile95),
        float(size.max()),
    )


def distribution(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Empirical distribution: sorted magnitudes and the share of values not above each."""
    size = np.sort(np.abs(values[np.isfinite(values)]))
    return size, np.arange(1, len(size) + 1) / max(len(size), 1)


def write_errors(path: Path, e: Errors) -> None:
    """errors.csv: one row per epoch that truth covers, errors blank where there was no fix."""
    names = [field.name for field in fields(e)]
    rows = [",".join(names)]
    for week, tow_s, *values in zip(*(getattr(e, name) for name in names), strict=True):
        rows.append(",".join((str(week), f"{tow_s:.6f}", *(number(float(x), 4) for x in values))))
    write_whole(path, "\n".join(rows) + "\n")


def write_statistics(path: Path, evaluation: Evaluation) -> None:
    """statistics.csv: one row per quantity, then counts and shares."""
    rows = ["quantity,mean,std,rms,p50,p95,max"]
    for s in evaluation.statistics:
        rows.append(",".join((s.quantity, *(number(x, 4) for x in s[1:]))))
    rows.append(f"epochs,{evaluation.epochs},,,,,")
    rows.append(f"fixed_share,{number(evaluation.fixed_share, 6)},,,,,")
    limit = f"{evaluation.gross_m:g}m"
    rows.append(f"gross_share_over_{limit},{number(evaluation.gross_share, 6)},,,,,")
    write_whole(path, "\n".join(rows) + "\n")
