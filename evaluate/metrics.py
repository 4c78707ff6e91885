"""What a run comes to in a few numbers, each with its own noise: for tables, limits, baselines."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.observables import week_seconds
from deepgnss.io.input import reading

GROSS_M: Final = 3.0
"""Horizontal error counted as gross, T table 6.10."""

_BLOCKS: Final = 8  # of the jackknife: errors of a run are correlated over seconds, not minutes


class Metric(NamedTuple):
    """A number and its 1σ; NaN where the run has nothing to tell it from."""

    value: float
    noise: float


@dataclass(frozen=True, slots=True)
class RunTables:
    """Tables of a run, each with the time `s` of its rows, s since the week of the first epoch."""

    solution: pd.DataFrame
    observed: pd.DataFrame
    events: pd.DataFrame  # times of these are those of the recording, from its start
    errors: pd.DataFrame | None  # None without truth

    @property
    def minutes(self) -> float:
        """Length of the solution."""
        interval_s = self.solution["s"].diff().median()
        return float(len(self.solution) * interval_s / 60.0)


class _Kind(NamedTuple):
    of: Callable[[RunTables], float]
    better: int  # +1: more is better, −1: less


def _share(tables: RunTables) -> float:
    return float((tables.solution["valid"] == 1).mean())


def _error(column: str, of: Callable[[FloatArray], float]) -> Callable[[RunTables], float]:
    def value(tables: RunTables) -> float:
        if tables.errors is None:
            return math.nan
        known = tables.errors[column].dropna().to_numpy(np.float64)
        return of(known) if known.size else math.nan

    return value


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _phases(tables: RunTables) -> pd.DataFrame:
    return tables.observed[tables.observed["carrier_valid"] == 1]


KINDS: Final[Mapping[str, _Kind]] = {
    "fixed_share": _Kind(_share, 1),
    "ranges_per_epoch": _Kind(lambda t: len(t.observed) / max(len(t.solution), 1), 1),
    "phases_per_epoch": _Kind(lambda t: len(_phases(t)) / max(len(t.solution), 1), 1),
    "slips_per_minute": _Kind(lambda t: float((_phases(t)["slip"] == 1).sum()) / t.minutes, -1),
    "lost_per_minute": _Kind(lambda t: float((t.events["what"] == "lost").sum()) / t.minutes, -1),
    "horizontal_rms_m": _Kind(_error("horizontal_m", _rms), -1),
    "horizontal_p50_m": _Kind(_error("horizontal_m", lambda x: float(np.percentile(x, 50.0))), -1),
    "horizontal_p95_m": _Kind(_error("horizontal_m", lambda x: float(np.percentile(x, 95.0))), -1),
    "vertical_rms_m": _Kind(_error("down_m", _rms), -1),
    "gross_share": _Kind(_error("horizontal_m", lambda x: float((x > GROSS_M).mean())), -1),
    "speed_rms_mps": _Kind(_error("v_horizontal_mps", _rms), -1),
}
"""Metrics by name; those of errors need a truth."""

FIRST_FIX: Final = "first_fix_s"
"""The one that stands for itself: when the first position came, s of recording."""

NAMES: Final = (FIRST_FIX, *KINDS)
"""All there are."""


def is_worse(name: str, change: float) -> bool:
    """Whether a change of a metric is one for the worse."""
    return change * (KINDS[name].better if name in KINDS else -1) < 0.0


def read_tables(folder: Path) -> RunTables:
    """Tables of a finished run.

    Raises InputFileError: one is missing (`output.csv` was off, or the run did not end).
    """
    solution = _timed(_table(folder / "solution.csv"))
    week = int(solution["week"].iloc[0]) if len(solution) else 0
    events = _table(folder / "events.csv")
    truth = folder / "errors.csv"
    errors = _timed(_table(truth), week) if truth.is_file() else None
    if errors is not None:
        errors["v_horizontal_mps"] = np.hypot(errors["v_north_mps"], errors["v_east_mps"])
    return RunTables(
        solution,
        _timed(_table(folder / "observations.csv"), week),
        events.rename(columns={"recording_s": "s"}),
        errors,
    )


def metrics(folder: Path) -> dict[str, Metric]:
    """All metrics of a finished run, with the jackknife's noise over blocks of time."""
    tables = read_tables(folder)
    found = {}
    with reading(folder / "summary.json"):
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    first_s = summary["first_fix_s"]
    found[FIRST_FIX] = Metric(math.nan if first_s is None else float(first_s), 0.0)
    parts = [_without(tables, block) for block in range(_BLOCKS)]
    for name, kind in KINDS.items():
        whole = kind.of(tables) if len(tables.solution) > _BLOCKS else math.nan
        noise = _jackknife([kind.of(part) for part in parts]) if math.isfinite(whole) else math.nan
        found[name] = Metric(whole, noise)
    return found


def _jackknife(values: list[float]) -> float:
    """1σ of a statistic from its values with one block left out each, Efron and Stein 1981."""
    left = np.array(values)
    return float(np.sqrt((left.size - 1) * np.mean((left - left.mean()) ** 2)))


def _without(tables: RunTables, block: int) -> RunTables:
    """A run without one of its blocks of time."""

    def rest(frame: pd.DataFrame, first_s: float, last_s: float) -> pd.DataFrame:
        place = (frame["s"] - first_s) / max(last_s - first_s, 1e-3) * _BLOCKS
        return frame[place.clip(0.0, _BLOCKS - 1e-9).astype(int) != block]

    first_s, last_s = tables.solution["s"].min(), tables.solution["s"].max()
    return RunTables(
        rest(tables.solution, first_s, last_s),
        rest(tables.observed, first_s, last_s),
        rest(tables.events, 0.0, tables.events["s"].max()),
        None if tables.errors is None else rest(tables.errors, first_s, last_s),
    )


def _timed(frame: pd.DataFrame, week: int | None = None) -> pd.DataFrame:
    if not len(frame):
        return frame.assign(s=np.zeros(0))
    first = int(frame["week"].iloc[0]) if week is None else week
    return frame.assign(s=week_seconds(frame, first))


def _table(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise InputFileError(f"{path}: not there: the run did not end, or output.csv was off")
    with reading(path):
        return pd.read_csv(path, low_memory=False)
