"""A run cut into stretches, by name or of equal length, and its outages, each in figures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.outages import GOOD_M
from deepgnss.evaluate.positions import Section
from deepgnss.io.output import write_whole
from deepgnss.io.tables import number

_NOTHING: Final = "nothing observed"
_MOST: Final = 12
_LENGTHS_S: Final = (5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600)


class Stretch(NamedTuple):
    """What a stretch of time came to; NaN where there is nothing. Errors are horizontal."""

    name: str
    start_s: float
    end_s: float
    epochs: int
    fixed_share: float
    satellites: float  # mean, per position
    p50_m: float
    p95_m: float
    largest_m: float


class Outage(NamedTuple):
    """A time without a position, between two positions."""

    start_s: float  # first epoch without
    end_s: float  # first with a position again
    lasted_s: float
    reason: str  # that of most of its epochs
    used_before: int  # satellites of the last position before
    used_after: int  # of the first one after
    good_s: float  # from its end to the first position within GOOD_M; NaN: not before the next


class Span(NamedTuple):
    """A time of the run, s since the recording's start."""

    name: str
    start_s: float
    end_s: float


def named(sections: Sequence[Section], start_s: float) -> list[Span]:
    """Sections of the way as times of the run.

    Parameters: start_s, of the recording, GPST since its epoch.
    """
    half = SECONDS_PER_WEEK / 2.0
    return [
        Span(one.name, *((t - start_s + half) % SECONDS_PER_WEEK - half for t in one[1:]))
        for one in sections
    ]


def equal(end_s: float) -> list[Span]:
    """At most twelve stretches of one round length, which are their times."""
    length_s = next((x for x in _LENGTHS_S if end_s / x <= _MOST), _LENGTHS_S[-1])
    starts = np.arange(0.0, end_s + 1e-6, length_s).tolist()
    return [Span("", start_s, start_s + length_s) for start_s in starts]


def stretches(
    solution: pd.DataFrame, errors: pd.DataFrame | None, spans: Sequence[Span]
) -> list[Stretch]:
    """What the run came to in each of the times that hold an epoch.

    Parameters: solution, errors: with `s`, time since the start of the recording.
    """
    found = []
    for span in spans:
        own = _between(solution, span.start_s, span.end_s)
        if not len(own):
            continue
        valid = own["valid"] == 1
        sizes = np.zeros(0)
        if errors is not None:
            sizes = _between(errors, span.start_s, span.end_s)["horizontal_m"].dropna().to_numpy()
        found.append(
            Stretch(
                *span,
                len(own),
                float(valid.mean()),
                float(own["used"][valid].mean()) if valid.any() else math.nan,
                *(_percentile(sizes, share) for share in (50.0, 95.0, 100.0)),
            )
        )
    return found


def write_stretches(path: Path, found: Sequence[Stretch], start_s: float) -> None:
    """stretches.csv: what each named stretch came to; times are GPST of the week."""
    rows = ["name,from_tow_s,to_tow_s,epochs,fixed_share,satellites,p50_m,p95_m,largest_m"]
    for one in found:
        times = (f"{(start_s + t) % SECONDS_PER_WEEK:.3f}" for t in (one.start_s, one.end_s))
        values = (number(x, 4) for x in one[4:])
        name = '"' + one.name.replace('"', '""') + '"'
        rows.append(",".join((name, *times, str(one.epochs), *values)))
    write_whole(path, "\n".join(rows) + "\n")


def _between(frame: pd.DataFrame, start_s: float, end_s: float) -> pd.DataFrame:
    return frame[(frame["s"] >= start_s - 1e-6) & (frame["s"] < end_s - 1e-6)]


def _percentile(sizes: FloatArray, share: float) -> float:
    return float(np.percentile(sizes, share)) if sizes.size else math.nan


def with_missing_epochs(solution: pd.DataFrame) -> pd.DataFrame:
    """A solution with a row without position for every epoch at which nothing was observed.

    Parameters: solution: with `s`, time since the start of the recording.
    """
    times = solution["s"].to_numpy(np.float64)
    if len(times) < 3:
        return solution
    interval_s = float(np.median(np.diff(times)))
    place = np.round((times - times[0]) / interval_s).astype(np.int64)
    if np.any(np.diff(place) < 1):
        return solution
    every = np.arange(place[-1] + 1)
    whole = solution.set_index(place).reindex(every)
    whole["s"] = whole["s"].fillna(pd.Series(times[0] + every * interval_s, index=every))
    missing = pd.Series(~np.isin(every, place), index=every)
    counted = {name: whole[name].mask(missing, 0.0) for name in ("valid", "used")}
    return whole.assign(**counted, reason=whole["reason"].mask(missing, _NOTHING))


def outages(solution: pd.DataFrame, errors: pd.DataFrame | None) -> list[Outage]:
    """All times without a position between the first and the last one."""
    valid = solution["valid"].to_numpy() == 1
    times = solution["s"].to_numpy(np.float64)
    fixed = np.flatnonzero(valid)
    if fixed.size < 2:
        return []
    interval_s = float(np.median(np.diff(times)))
    ends = [
        (int(a), int(b))
        for a, b in itertools.pairwise(fixed)
        if times[b] - times[a] > 1.5 * interval_s
    ]
    untils = [*(float(times[a]) for a, _ in ends), math.inf][1:]  # the next one's start
    return [
        Outage(
            float(times[a] + interval_s),
            float(times[b]),
            round(float(times[b] - times[a] - interval_s), 3),
            _usual(solution["reason"].iloc[a + 1 : b]),
            int(solution["used"].iloc[a]),
            int(solution["used"].iloc[b]),
            _good(errors, float(times[b]), until),
        )
        for (a, b), until in zip(ends, untils, strict=True)
    ]


def _usual(reasons: Sequence[str] | pd.Series) -> str:
    known = pd.Series(reasons).dropna()
    return str(known.mode().iloc[0]) if len(known) else _NOTHING


def _good(errors: pd.DataFrame | None, end_s: float, until_s: float) -> float:
    if errors is None:
        return math.nan
    own = errors[(errors["s"] >= end_s - 1e-6) & (errors["s"] <= until_s + 1e-6)]
    good = own["s"][own["horizontal_m"] <= GOOD_M]
    return round(float(good.iloc[0]) - end_s, 3) if len(good) else math.nan
