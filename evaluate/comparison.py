"""Several receivers side by side: positions against truth, code and carrier against a base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray, NavData
from deepgnss.evaluate.double_differences import (
    common,
    double_differences,
    references,
    satellite_table,
)
from deepgnss.evaluate.geometry import between, modelled_errors
from deepgnss.evaluate.heard import Heard, heard, strength
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.evaluate.outages import (
    Gap,
    OwnGaps,
    Recovery,
    common_gaps,
    named_gaps,
    own_gaps,
    recoveries,
)
from deepgnss.evaluate.positions import (
    Figures,
    Instants,
    Section,
    availability,
    figures,
    grid,
    position_errors,
)
from deepgnss.evaluate.rtk import NO_FIXES, RIGHT_M, Base, Fixes, rtk_fixes
from deepgnss.evaluate.single_point import at_rest, single_point
from deepgnss.evaluate.sources import Source
from deepgnss.io.truth import Trajectory


class Origin(NamedTuple):
    """What stands behind a receiver's figures, in words."""

    kind: str  # of file
    positions: str  # whose they are
    point: str  # antenna or IMU
    time: str  # the file's scale; all are compared on GPST


class Ways(NamedTuple):
    """Where all were over the instants compared, and how they came back after gaps."""

    truth: Trajectory
    positions: Mapping[str, pd.DataFrame]  # single_point.POSITIONS
    asked: Instants
    interval_s: float
    gaps: Sequence[tuple[Gap, Mapping[str, Recovery]]]  # those all had, or those named
    own_gaps: Mapping[str, OwnGaps]
    gross_m: float


class Clock(NamedTuple):
    """Difference of two receivers' clocks as the ranges show it (delays of cables with it)."""

    median_m: float
    sigma_m: float  # of one difference
    differences: int


@dataclass(frozen=True, slots=True)
class Comparison:
    """Tables by receiver; empty where nothing was given to compare with."""

    positions: Mapping[str, Figures]
    errors: Mapping[str, pd.DataFrame]  # as of `position_errors`
    sections: Mapping[str, Mapping[str, float]]  # share of instants with a position
    observations: Mapping[str, pd.DataFrame]  # as of `satellite_table`
    doubled: Mapping[str, pd.DataFrame]  # as of `double_differences`
    clocks: Mapping[str, Clock]  # against the base
    notes: tuple[str, ...] = ()
    rtk: Fixes = NO_FIXES
    ways: Ways | None = None  # None without truth
    strengths: Mapping[str, pd.DataFrame] = field(default_factory=dict)  # C/N0, as of `strength`
    heard: Mapping[str, Heard] = field(default_factory=dict)
    origins: Mapping[str, Origin] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Yardstick:
    """What the receivers are held against."""

    truth: Trajectory | None = None
    base: pd.DataFrame | None = None  # observations
    base_r_e_m: FloatArray | None = None  # (3,); None: that of the rovers (zero baseline)
    nav: NavData = field(default_factory=NavData)
    interval_s: float = 1.0
    elevation_mask_deg: float = 10.0
    gross_m: float = GROSS_M
    sections: tuple[Section, ...] = ()
    rtk_mode: str | None = None  # one of rtk.MODES; None: no RTK
    right_m: float = RIGHT_M  # horizontal error of a right fix
    gaps: tuple[Section, ...] = ()  # stretches without sky; none: those that all receivers had
    truth_path: Path | None = None  # a log that is the truth itself is not held against itself


def compare(sources: Sequence[Source], yardstick: Yardstick) -> Comparison:
    """Hold receivers against truth and base: same instants, same satellites for all.

    Receivers without positions of their own get those of our single-point solution.

    Raises InputFileError: there is nothing to compare with; RTK is asked for and cannot be.
    """
    if yardstick.truth is None and yardstick.base is None:
        raise InputFileError("--truth, --base: found neither; there is nothing to compare with")
    return compared(sources, yardstick)


def compared(sources: Sequence[Source], yardstick: Yardstick) -> Comparison:
    """As `compare`; with neither truth nor base, only what the receivers heard."""
    notes: list[str] = []
    place_e_m = _base_place(yardstick, notes)
    found: dict[str, pd.DataFrame] = {}
    asked, ways = np.zeros(0, np.int64), None
    sources = [_no_judge_of_itself(source, yardstick, notes) for source in sources]
    if yardstick.truth is not None:
        whole = [_with_positions(source, yardstick, notes) for source in sources]
        located = {s.name: s.positions for s in whole if len(s.positions)}
        found = position_errors(located, yardstick.truth, yardstick.interval_s)
        asked = _overlap(found, grid(yardstick.truth, yardstick.interval_s))
        ways = _ways(located, yardstick.truth, found, asked, yardstick)
    singles = _singles(sources, yardstick, place_e_m, notes)
    high = {
        name: table[table["elevation_deg"] >= yardstick.elevation_mask_deg]
        for name, table in singles.items()
    }
    shared = common(high) if high else {}
    first = next(iter(shared.values()), None)
    reference = references(first) if first is not None else {}
    doubled = {name: double_differences(table, reference) for name, table in shared.items()}
    return Comparison(
        figures(found, asked, yardstick.interval_s, yardstick.gross_m) if len(asked) else {},
        found,
        availability(found, asked, yardstick.interval_s, yardstick.sections),
        {name: satellite_table(table) for name, table in doubled.items()},
        doubled,
        {name: _clock(table) for name, table in singles.items()},
        tuple(notes),
        _rtk(sources, yardstick, place_e_m),
        ways,
        {source.name: table for source in sources if len(table := strength(source))},
        heard(sources),
        {source.name: _origin(source, yardstick) for source in sources},
    )


def _no_judge_of_itself(source: Source, yardstick: Yardstick, notes: list[str]) -> Source:
    """A log that is the truth keeps its observations only."""
    if source.path is None or yardstick.truth_path is None:
        return source
    if source.path.resolve() != yardstick.truth_path.resolve():
        return source
    notes.append(f"{source.name}: it is the truth; its own positions are not held against it")
    return source._replace(positions=source.positions[:0])


def _ways(
    located: Mapping[str, pd.DataFrame],
    truth: Trajectory,
    found: Mapping[str, pd.DataFrame],
    asked: Instants,
    yardstick: Yardstick,
) -> Ways:
    interval_s = yardstick.interval_s
    over = (
        named_gaps(yardstick.gaps, asked, interval_s)
        if yardstick.gaps
        else common_gaps(asked, [table.index.to_numpy(np.int64) for table in found.values()])
    )
    return Ways(
        truth,
        located,
        asked,
        interval_s,
        recoveries(over, found, asked, interval_s),
        {name: own_gaps(table, asked, interval_s) for name, table in found.items()},
        yardstick.gross_m,
    )


def _origin(source: Source, yardstick: Yardstick) -> Origin:
    located = yardstick.truth is not None and len(source.observations) and yardstick.nav.ephemerides
    whose = "its own" if len(source.positions) else "ours, single point" if located else "none"
    time = {"NMEA": "UTC", "RINEX": "as its header says"}.get(source.kind, "GPST")
    return Origin(source.kind, whose, source.point, time)


def _with_positions(source: Source, yardstick: Yardstick, notes: list[str]) -> Source:
    if len(source.positions) or source.observations.empty:
        if source.point != "antenna":
            notes.append(f"{source.name}: positions are those of the {source.point}")
        return source
    if not yardstick.nav.ephemerides:
        notes.append(f"{source.name}: no positions: the log has none, and there is no NAV file")
        return source
    notes.append(f"{source.name}: positions by our single-point solution of its observations")
    return source._replace(positions=single_point(source.observations, yardstick.nav))


def _overlap(found: Mapping[str, pd.DataFrame], asked: Instants) -> Instants:
    """Instants between the first and the last that every receiver has been running at."""
    for table in found.values():
        if len(table):
            asked = asked[(asked >= table.index.min()) & (asked <= table.index.max())]
    return asked


def _base_place(yardstick: Yardstick, notes: list[str]) -> FloatArray | None:
    """Where the base stands, (3,); None without one."""
    if yardstick.base is None or yardstick.base_r_e_m is not None:
        return yardstick.base_r_e_m
    place_e_m = at_rest(single_point(yardstick.base, yardstick.nav))
    notes.append("base: its file has no position: the median of its own single-point solutions")
    if place_e_m is None:
        raise InputFileError("--base: no position in its header, and none found with this NAV file")
    return place_e_m


def _singles(
    sources: Sequence[Source],
    yardstick: Yardstick,
    base_r_e_m: FloatArray | None,
    notes: list[str],
) -> dict[str, pd.DataFrame]:
    """Single differences of every receiver with observations against the base."""
    base, nav = yardstick.base, yardstick.nav
    if base is None or base_r_e_m is None:
        return {}
    of_base = modelled_errors(base, base_r_e_m, nav)
    singles = {}
    for source in sources:
        if source.observations.empty:
            continue
        antenna = yardstick.truth if yardstick.truth is not None else base_r_e_m
        singles[source.name] = between(modelled_errors(source.observations, antenna, nav), of_base)
    if yardstick.truth is None and singles:
        notes.append("no truth: rovers are taken to be at the base's antenna (zero baseline)")
    return singles


def _rtk(sources: Sequence[Source], yardstick: Yardstick, base_r_e_m: FloatArray | None) -> Fixes:
    """RTK of every receiver with observations."""
    truth, base, mode = yardstick.truth, yardstick.base, yardstick.rtk_mode
    if mode is None:
        return NO_FIXES
    if truth is None or base is None or base_r_e_m is None or not yardstick.nav.ephemerides:
        raise InputFileError("--rtk: it needs --truth, --base and broadcast orbits (--nav)")
    observed = {s.name: s.observations for s in sources if len(s.observations)}
    given = Base(base, base_r_e_m, yardstick.nav)
    return rtk_fixes(observed, given, truth, yardstick.interval_s, mode, yardstick.right_m)


def _clock(single: pd.DataFrame) -> Clock:
    total_m = single["code_m"] + SPEED_OF_LIGHT_MPS * single["clock_s"]
    median_m = float(total_m.median())
    spread_m = 1.4826 * float(
        (total_m - median_m).abs().median()
    )  # jumps of a channel are no noise
    return Clock(median_m, spread_m, len(total_m))
