"""Observation errors against broadcast orbits and a known antenna, and between two receivers.

What orbits, satellite clocks and atmosphere leave in the errors of one receiver goes when those of
another one near it are taken off, epoch by epoch: single differences over known geometry. A zero
baseline is the case of the same antenna.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.observables import error_table, week_seconds
from deepgnss.io.truth import Trajectory
from deepgnss.receiver import orbits

APART_MS: Final = 20
"""Epochs of two receivers are of one instant when their tags differ by less: clocks of receivers
that steer by whole milliseconds."""

_ROUNDS: Final = 3  # of clock error: each is 1e-5 (range rate over c) of the one before


def modelled_errors(
    observed: pd.DataFrame, antenna: Trajectory | FloatArray, nav: NavData
) -> pd.DataFrame:
    """Errors of every observation whose satellite has an orbit, the epoch's clock (a median) off.

    Atmosphere stays in them. Satellites that are broadcast unhealthy count: they send all the same.

    Parameters: observed: as of `read_observations`; antenna: the way it went, or where it is (3,).

    Returns: columns of `observables.range_errors`; time_ms since the week of the first observation.
    """
    if observed.empty:
        return pd.DataFrame(columns=list(_COLUMNS))
    week = int(observed["week"].iloc[0])
    frame = observed.assign(_s=week_seconds(observed, week)).sort_values(
        ["satellite", "_s"], kind="stable", ignore_index=True
    )
    size = len(frame)
    range_m, elevation_rad, clock_s = (np.full(size, np.nan) for _ in range(3))
    for _, rows in frame.groupby("_s", sort=True):
        place = rows.index.to_numpy()
        time = GpsTime(int(rows["week"].iloc[0]), float(rows["tow_s"].iloc[0]))
        found = _epoch(rows, time, antenna, nav)
        if found is not None:
            range_m[place], elevation_rad[place], clock_s[place] = found
    return error_table(frame, range_m, range_m, np.degrees(elevation_rad), clock_s)


_COLUMNS: Final = (
    *("week", "tow_s", "time_ms", "satellite", "elevation_deg", "cn0_dbhz", "code_m", "phase_m"),
    *("arc", "clock_s"),
)


def _epoch(
    rows: pd.DataFrame, time: GpsTime, antenna: Trajectory | FloatArray, nav: NavData
) -> tuple[FloatArray, FloatArray, float] | None:
    """Pseudoranges, elevations and the clock error of an epoch; None where nothing is known."""
    chosen = [orbits.select(nav, str(name), time) for name in rows["satellite"]]
    known = [k for k, ephemeris in enumerate(chosen) if ephemeris is not None]
    ephemerides = [ephemeris for ephemeris in chosen if ephemeris is not None]
    measured_m = rows["pseudorange_m"].to_numpy(np.float64)
    if not np.isfinite(measured_m[known]).any():
        return None
    range_m, elevation_rad = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    clock_s = 0.0
    for _ in range(_ROUNDS):
        there = time.plus(-clock_s)
        r_e_m = _place(antenna, there)
        if not np.isfinite(r_e_m).all():
            return None
        seen = orbits.predict(ephemerides, there, r_e_m, np.zeros(3))
        range_m[known], elevation_rad[known] = seen.pseudorange_m, seen.elevation_rad
        clock_s = float(np.nanmedian(measured_m - range_m)) / SPEED_OF_LIGHT_MPS
    return range_m, elevation_rad, clock_s


def _place(antenna: Trajectory | FloatArray, time: GpsTime) -> FloatArray:
    if isinstance(antenna, Trajectory):
        return np.asarray(antenna.at(time.week, time.tow_s)[0][0])
    return antenna


def between(rover: pd.DataFrame, base: pd.DataFrame) -> pd.DataFrame:
    """Errors of a rover less those of a base at the same instants, for satellites both have.

    Parameters, returns: tables as of `modelled_errors`; an arc is one of both receivers, clock_s
    the difference of their clocks, cn0_dbhz and elevation the rover's.
    """
    later = base[["time_ms", "satellite", "code_m", "phase_m", "arc", "clock_s"]]
    both = pd.merge_asof(
        rover.sort_values("time_ms", kind="stable"),
        later.sort_values("time_ms", kind="stable"),
        on="time_ms",
        by="satellite",
        direction="nearest",
        tolerance=APART_MS,
        suffixes=("", "_base"),
    ).dropna(subset=["code_m_base"])
    pairs = both.groupby(["satellite", "arc", "arc_base"], sort=True).ngroup()
    differences = both.assign(
        code_m=both["code_m"] - both["code_m_base"],
        phase_m=both["phase_m"] - both["phase_m_base"],
        clock_s=both["clock_s"] - both["clock_s_base"],
        arc=pairs,
    )
    return differences[list(rover.columns)].sort_values(
        ["time_ms", "satellite"], kind="stable", ignore_index=True
    )
