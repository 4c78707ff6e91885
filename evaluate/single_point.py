"""Positions of anybody's observations by our own single-point solution."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import (
    Epoch,
    FloatArray,
    NavData,
    NavSolution,
    Observation,
    SampleInstant,
)
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.observations import SIGNAL_OF_SYSTEM
from deepgnss.receiver import pvt

POSITIONS: Final = (
    *("week", "tow_s", "valid", "x_e_m", "y_e_m", "z_e_m", "v_n_mps", "v_e_mps", "v_d_mps"),
)
"""Columns of a table of positions; blank (NaN) where there is none."""

_USUAL_DBHZ: Final = 40.0  # of receivers that do not tell it


def single_point(
    observed: pd.DataFrame, nav: NavData, parameters: pvt.PvtParameters | None = None
) -> pd.DataFrame:
    """A position per epoch, as `deepgnss process` finds it (RAIM included).

    Parameters: observed: as of `read_observations`. Returns: columns POSITIONS.
    """
    parameters = parameters or pvt.PvtParameters()
    rows: list[tuple[float, ...]] = []
    solution: NavSolution | None = None
    for _, epoch in observed.groupby(["week", "tow_s"], sort=True):
        time = GpsTime(int(epoch["week"].iloc[0]), float(epoch["tow_s"].iloc[0]))
        found = pvt.solve(_epoch(time, epoch), nav, parameters, solution)
        solution = found if found.valid else solution
        rows.append((time.week, time.tow_s, *_position(found)))
    return pd.DataFrame(rows, columns=list(POSITIONS))


def at_rest(positions: pd.DataFrame) -> FloatArray | None:
    """Median of the positions (3,), None where there is none."""
    valid = positions[positions["valid"] == 1]
    if valid.empty:
        return None
    return np.asarray(valid[["x_e_m", "y_e_m", "z_e_m"]].median(), np.float64)


def _epoch(time: GpsTime, rows: pd.DataFrame) -> Epoch:
    known = rows[np.isfinite(rows["pseudorange_m"])]
    ranges_m, cycles, dopplers_hz, cn0_dbhz = (
        known[name].to_numpy(np.float64)
        for name in ("pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz")
    )
    observations = tuple(
        Observation(
            satellite=satellite,
            signal=SIGNAL_OF_SYSTEM[satellite[0]].name,
            pseudorange_m=float(ranges_m[k]),
            carrier_cycles=float(cycles[k]),
            doppler_hz=float(dopplers_hz[k]),
            cn0_dbhz=float(cn0_dbhz[k]) if cn0_dbhz[k] > 0.0 else _USUAL_DBHZ,
            lock_time_s=0.0,
            slip=False,
            half_cycle=False,
            carrier_valid=math.isfinite(cycles[k]),
            transmit=time.plus(-float(ranges_m[k]) / SPEED_OF_LIGHT_MPS),
        )
        for k, satellite in enumerate(known["satellite"].astype(str))
    )
    return Epoch(time, SampleInstant(0, 0.0), observations)


def _position(found: NavSolution) -> tuple[float, ...]:
    if not found.valid:
        return (0, *[math.nan] * 6)
    lat_rad, lon_rad, _ = geodetic(found.r_e_m)
    v_n_mps = C_ne(lat_rad, lon_rad) @ found.v_e_mps
    return (1, *map(float, found.r_e_m), *map(float, v_n_mps))
