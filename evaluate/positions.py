"""Positions of several receivers against one truth: same instants for all, T tables 6.10–6.16."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.errors import errors
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.io.truth import Trajectory

Instants = NDArray[np.int64]
"""Whole intervals since the GPS epoch."""


class Section(NamedTuple):
    """A stretch of the way, in GPST seconds of week."""

    name: str
    from_tow_s: float
    to_tow_s: float


def read_sections(path: Path) -> tuple[Section, ...]:
    """Read sections of the way: CSV with name, from_tow_s, to_tow_s.

    Raises InputFileError: it cannot be read, or a column is missing.
    """
    try:
        frame = pd.read_csv(path)
        return tuple(
            Section(str(name), float(start), float(end))
            for name, start, end in zip(
                frame["name"], frame["from_tow_s"], frame["to_tow_s"], strict=True
            )
        )
    except (OSError, ValueError, KeyError) as error:
        raise InputFileError(
            f"{path}: not a CSV of name, from_tow_s, to_tow_s: {str(error).splitlines()[0]}"
        ) from error


class Figures(NamedTuple):
    """What the errors of a receiver come to; NaN where there is nothing."""

    epochs: int  # instants asked for
    fixed_share: float  # of them
    compared: int  # instants all receivers have
    north_std_m: float
    east_std_m: float
    down_std_m: float
    horizontal_rms_m: float
    cep50_m: float
    cep95_m: float
    gross_share: float  # of those compared
    longest_gap_s: float  # between positions


def position_errors(
    positions: Mapping[str, pd.DataFrame], truth: Trajectory, interval_s: float
) -> dict[str, pd.DataFrame]:
    """Errors of every receiver at the instants of a grid, north, east, down, estimate − truth.

    The position nearest to an instant stands for it; truth is taken at its own tag.

    Returns by name: index instant (whole intervals since the GPS epoch), tow_s, north_m, east_m,
    down_m, horizontal_m.
    """
    found = {}
    for name, frame in positions.items():
        own = frame[frame["valid"] == 1]
        seconds = own["week"].astype(np.float64) * SECONDS_PER_WEEK + own["tow_s"]
        instant = (seconds / interval_s).round().astype(np.int64)
        nearest = (seconds - instant * interval_s).abs().sort_values(kind="stable").index
        nearest = nearest[~instant[nearest].duplicated()].sort_values()
        own, instant = own.loc[nearest], instant[nearest]
        if own.empty:
            found[name] = pd.DataFrame(columns=list(_ERRORS), dtype=np.float64)
            continue
        e = errors(own, truth)
        covered = np.isin(_tags(own["week"], own["tow_s"]), _tags(e.week, e.tow_s))
        table = pd.DataFrame(
            {
                "tow_s": e.tow_s,
                "north_m": e.north_m,
                "east_m": e.east_m,
                "down_m": e.down_m,
                "horizontal_m": e.horizontal_m,
            },
            index=pd.Index(instant.to_numpy()[covered], name="instant"),
        )
        found[name] = table[~table.index.duplicated()].dropna()
    return found


_ERRORS: Final = ("tow_s", "north_m", "east_m", "down_m", "horizontal_m")


def _tags(week: pd.Series | Instants, tow_s: pd.Series | FloatArray) -> Instants:
    """Tags in µs: the same tag is the same number."""
    return np.asarray(week, np.int64) * SECONDS_PER_WEEK * 10**6 + np.round(
        np.asarray(tow_s) * 1e6
    ).astype(np.int64)


def grid(truth: Trajectory, interval_s: float) -> Instants:
    """Instants (whole intervals since the GPS epoch) that truth covers."""
    start, end = (
        (float(way.week) * SECONDS_PER_WEEK + way.tow_s) / interval_s
        for way in (truth.start, truth.end)
    )
    return np.arange(math.ceil(start - 1e-6), math.floor(end + 1e-6) + 1)


def figures(
    found: Mapping[str, pd.DataFrame],
    asked: Instants,
    interval_s: float,
    gross_m: float = GROSS_M,
) -> dict[str, Figures]:
    """Figures by receiver: errors over the instants all have, shares over those asked for."""
    shared = np.asarray(asked)
    for table in found.values():
        shared = np.intersect1d(shared, table.index.to_numpy())
    return {
        name: _figures(table, asked, shared, interval_s, gross_m) for name, table in found.items()
    }


def _figures(
    table: pd.DataFrame,
    asked: Instants,
    shared: Instants,
    interval_s: float,
    gross_m: float,
) -> Figures:
    own = np.intersect1d(asked, table.index.to_numpy())
    same = table.loc[shared]
    size = same["horizontal_m"].to_numpy(np.float64)
    gaps = np.diff(np.concatenate([asked[:1] - 1, own, asked[-1:] + 1])) - 1
    nothing = not len(size)
    return Figures(
        epochs=len(asked),
        fixed_share=len(own) / len(asked) if len(asked) else math.nan,
        compared=len(shared),
        north_std_m=math.nan if nothing else float(same["north_m"].std(ddof=0)),
        east_std_m=math.nan if nothing else float(same["east_m"].std(ddof=0)),
        down_std_m=math.nan if nothing else float(same["down_m"].std(ddof=0)),
        horizontal_rms_m=math.nan if nothing else float(np.sqrt(np.mean(size**2))),
        cep50_m=math.nan if nothing else float(np.percentile(size, 50.0)),
        cep95_m=math.nan if nothing else float(np.percentile(size, 95.0)),
        gross_share=math.nan if nothing else float((size > gross_m).mean()),
        longest_gap_s=float(np.max(gaps, initial=0)) * interval_s,
    )


def availability(
    found: Mapping[str, pd.DataFrame],
    asked: Instants,
    interval_s: float,
    sections: Sequence[Section],
) -> dict[str, dict[str, float]]:
    """Share of the instants of each section with a position: by section, then by receiver."""
    tow_s = (np.asarray(asked) * interval_s) % SECONDS_PER_WEEK
    table: dict[str, dict[str, float]] = {}
    for section in sections:
        inside = np.asarray(asked)[(tow_s >= section.from_tow_s) & (tow_s < section.to_tow_s)]
        if not len(inside):
            continue
        table[section.name] = {
            name: float(np.isin(inside, own.index.to_numpy()).mean()) for name, own in found.items()
        }
    return table
