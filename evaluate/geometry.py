"""Observation errors against broadcast orbits and a known antenna, and between two receivers.

What orbits, satellite clocks and atmosphere leave in the errors of one receiver goes when those of
another one near it are taken off, epoch by epoch: single differences over known geometry. A zero
baseline is the case of the same antenna.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, FloatArray, NavData
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
    seen = sights(observed, antenna, nav)
    return error_table(
        seen.frame, seen.range_m, seen.range_m, np.degrees(seen.elevation_rad), seen.clock_s
    )


_COLUMNS: Final = (
    *("week", "tow_s", "time_ms", "satellite", "elevation_deg", "cn0_dbhz", "code_m", "phase_m"),
    *("arc", "clock_s"),
)


class Sights(NamedTuple):
    """What every observation should be, row by row; NaN where orbit or place are not known."""

    frame: pd.DataFrame  # the observations by satellite and time, `week_seconds` as `_s`
    range_m: FloatArray  # (k,) pseudorange without atmosphere and receiver clock
    unit_e: FloatArray  # (k, 3) from antenna to satellite
    elevation_rad: FloatArray  # (k,)
    clock_s: FloatArray  # (k,) of the receiver, 0 where not known


def sights(observed: pd.DataFrame, antenna: Trajectory | FloatArray, nav: NavData) -> Sights:
    """Ranges at the instants the epochs were truly taken at, by each epoch's own clock error.

    Parameters: as of `modelled_errors`, of which week, tow_s, satellite, pseudorange_m are used.
    """
    week = int(observed["week"].iloc[0])
    frame = observed.assign(_s=week_seconds(observed, week)).sort_values(
        ["satellite", "_s"], kind="stable", ignore_index=True
    )
    size = len(frame)
    range_m, elevation_rad = np.full(size, np.nan), np.full(size, np.nan)
    unit_e, clock_s = np.full((size, 3), np.nan), np.zeros(size)
    groups = frame.groupby("_s", sort=True).indices.values()
    epochs = [_epoch_of(frame, np.asarray(rows), nav) for rows in groups]
    clocks_s = np.zeros(len(epochs))
    for _ in range(_ROUNDS):
        times = [epoch.time.plus(-late) for epoch, late in zip(epochs, clocks_s, strict=True)]
        for k, (epoch, time, r_e_m) in enumerate(
            zip(epochs, times, _places(antenna, times), strict=True)
        ):
            if not (epoch.rows.size and np.isfinite(r_e_m).all()):
                range_m[epoch.rows] = np.nan  # a clock's error may have led out of the way known
                continue
            seen = orbits.predict(epoch.ephemerides, time, r_e_m, np.zeros(3))
            late_m = epoch.pseudorange_m - seen.pseudorange_m
            if not np.isfinite(late_m).any():
                continue
            clocks_s[k] = float(np.nanmedian(late_m)) / SPEED_OF_LIGHT_MPS
            range_m[epoch.rows], elevation_rad[epoch.rows] = seen.pseudorange_m, seen.elevation_rad
            unit_e[epoch.rows], clock_s[epoch.rows] = seen.sight.unit_e, clocks_s[k]
    return Sights(frame, range_m, unit_e, elevation_rad, clock_s)


class _Epoch(NamedTuple):
    """Observations of an instant whose satellites have an orbit."""

    time: GpsTime
    rows: NDArray[np.int64]
    ephemerides: list[Ephemeris]
    pseudorange_m: FloatArray


def _epoch_of(frame: pd.DataFrame, rows: NDArray[np.int64], nav: NavData) -> _Epoch:
    first = frame.iloc[rows[0]]
    time = GpsTime(int(first["week"]), float(first["tow_s"]))
    chosen = [orbits.select(nav, str(name), time) for name in frame["satellite"].iloc[rows]]
    known = rows[[k for k, ephemeris in enumerate(chosen) if ephemeris is not None]]
    ephemerides = [ephemeris for ephemeris in chosen if ephemeris is not None]
    measured_m = frame["pseudorange_m"].iloc[known].to_numpy(np.float64)
    return _Epoch(time, known, ephemerides, measured_m)


def _places(antenna: Trajectory | FloatArray, times: Sequence[GpsTime]) -> FloatArray:
    """Antenna at instants, (n, 3)."""
    if isinstance(antenna, Trajectory):
        weeks, tows_s = zip(*times, strict=True)
        return antenna.at(np.array(weeks, np.int64), np.array(tows_s))[0]
    return np.tile(antenna, (len(times), 1))


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
