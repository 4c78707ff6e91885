"""When there was no position, and how soon afterwards there was one, and a good one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.evaluate.positions import Instants, Section, read_sections
from deepgnss.io.input import reading

GOOD_M: Final = 3.0
"""Horizontal error within which a position counts as good again."""


NEEDED: Final = 4
"""Satellites in sight below which no position is due."""


class Gap(NamedTuple):
    """A stretch of instants without a position."""

    start: int  # first instant without
    end: int  # first instant after it
    name: str = ""


class Recovery(NamedTuple):
    """How long after a gap, s; NaN: not before the next one."""

    first_s: float  # to the first position
    good_s: float  # to the first within GOOD_M of truth


def gaps(asked: Instants, have: Instants) -> list[Gap]:
    """Stretches of the instants asked for at which there is no position."""
    asked = np.asarray(asked)
    missing = asked[~np.isin(asked, have)]
    parts = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
    return [Gap(int(part[0]), int(part[-1]) + 1) for part in parts if part.size]


def common_gaps(asked: Instants, positions: Sequence[Instants]) -> list[Gap]:
    """Stretches at which no receiver has a position: they end when the first has one again.

    What comes before the first position of all, and after the last, is none.
    """
    if not positions:
        return []
    together = np.unique(np.concatenate([np.asarray(one) for one in positions]))
    asked = np.asarray(asked)
    if not together.size:
        return []
    return gaps(asked[(asked >= together[0]) & (asked <= together[-1])], together)


def read_gaps(path: Path, elevation_mask_deg: float) -> tuple[Section, ...]:
    """Stretches without sky: a CSV of sections, or the ranges.csv of a simulation.

    Of that, the times with fewer than NEEDED satellites in sight above the mask.

    Raises InputFileError: it cannot be read, or is neither.
    """
    with reading(path):
        frame = pd.read_csv(path, nrows=0)
    if not {"visible", "el_deg", "satellite", "tow"} <= set(frame.columns):
        return read_sections(path)
    with reading(path):
        frame = pd.read_csv(path, usecols=["visible", "el_deg", "satellite", "tow"])
    high = (frame["visible"] == 1) & (frame["el_deg"] >= elevation_mask_deg)
    seen = frame["satellite"].where(high).groupby(frame["tow"]).nunique()
    dark = np.flatnonzero(seen.to_numpy() < NEEDED)
    tow_s = np.append(seen.index.to_numpy(np.float64), np.inf)
    parts = np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1)
    return tuple(
        Section(f"below {NEEDED} satellites", float(tow_s[part[0]]), float(tow_s[part[-1] + 1]))
        for part in parts
        if part.size
    )


def named_gaps(sections: Sequence[Section], asked: Instants, interval_s: float) -> list[Gap]:
    """Gaps somebody names by their times of week, of those the instants asked for cover."""
    asked = np.asarray(asked)
    tow_s = (asked * interval_s) % SECONDS_PER_WEEK
    found = []
    for section in sections:
        inside = asked[(tow_s >= section.from_tow_s) & (tow_s < section.to_tow_s)]
        if inside.size:
            found.append(Gap(int(inside[0]), int(inside[-1]) + 1, section.name))
    return sorted(found)


def recovery(gap: Gap, errors: pd.DataFrame, until: int, interval_s: float) -> Recovery:
    """How soon after a gap a receiver was back.

    Parameters: errors, as of `position_errors`, index instant; until, instant at which patience
    ends (the next gap's start).
    """
    after = errors[(errors.index >= gap.end) & (errors.index < until)]
    good = after[after["horizontal_m"] <= GOOD_M]
    first_s, good_s = (
        float(rows.index.min() - gap.end) * interval_s if len(rows) else math.nan
        for rows in (after, good)
    )
    return Recovery(first_s, good_s)


def recoveries(
    over: Sequence[Gap], found: Mapping[str, pd.DataFrame], asked: Instants, interval_s: float
) -> list[tuple[Gap, dict[str, Recovery]]]:
    """Every gap, and by receiver how soon it was back."""
    end = int(asked[-1]) + 1 if len(asked) else 0
    untils = [*(gap.start for gap in over), end][1:]  # patience lasts until the next one
    return [
        (gap, {name: recovery(gap, table, until, interval_s) for name, table in found.items()})
        for gap, until in zip(over, untils, strict=True)
    ]


class OwnGaps(NamedTuple):
    """A receiver's own gaps, between its first and its last position."""

    gaps: int
    total_s: float
    longest_s: float
    good_median_s: float  # from the end of a gap to the first position within GOOD_M
    good_worst_s: float  # inf: in one of them never before the next gap


def own_gaps(errors: pd.DataFrame, asked: Instants, interval_s: float) -> OwnGaps:
    """What a receiver's own gaps come to."""
    over = common_gaps(asked, [errors.index.to_numpy(np.int64)])
    if not over:
        return OwnGaps(0, 0.0, 0.0, math.nan, math.nan)
    lasted_s = [interval_s * (gap.end - gap.start) for gap in over]
    back = [told[""].good_s for _, told in recoveries(over, {"": errors}, asked, interval_s)]
    known_s = np.where(np.isnan(back), math.inf, back)
    return OwnGaps(
        len(over),
        float(np.sum(lasted_s)),
        float(np.max(lasted_s)),
        float(np.median(known_s)),
        float(np.max(known_s)),
    )
