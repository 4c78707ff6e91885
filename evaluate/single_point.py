"""Positions of anybody's observations by our own single-point solution."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray, NavData, NavSolution
from deepgnss.evaluate.observations import epochs
from deepgnss.receiver import pvt

POSITIONS: Final = (
    *("week", "tow_s", "valid", "x_e_m", "y_e_m", "z_e_m", "v_n_mps", "v_e_mps", "v_d_mps"),
)
"""Columns of a table of positions; blank (NaN) where there is none."""


def single_point(
    observed: pd.DataFrame, nav: NavData, parameters: pvt.PvtParameters | None = None
) -> pd.DataFrame:
    """A position per epoch, as `deepgnss process` finds it (RAIM included).

    Parameters: observed: as of `read_observations`. Returns: columns POSITIONS.
    """
    parameters = parameters or pvt.PvtParameters()
    rows: list[tuple[float, ...]] = []
    solution: NavSolution | None = None
    for epoch in epochs(observed):
        found = pvt.solve(epoch, nav, parameters, solution)
        solution = found if found.valid else solution
        rows.append((epoch.time.week, epoch.time.tow_s, *_position(found)))
    return pd.DataFrame(rows, columns=list(POSITIONS))


def at_rest(positions: pd.DataFrame) -> FloatArray | None:
    """Median of the positions (3,), None where there is none."""
    valid = positions[positions["valid"] == 1]
    if valid.empty:
        return None
    return np.asarray(valid[["x_e_m", "y_e_m", "z_e_m"]].median(), np.float64)


def _position(found: NavSolution) -> tuple[float, ...]:
    if not found.valid:
        return (0, *[math.nan] * 6)
    lat_rad, lon_rad, _ = geodetic(found.r_e_m)
    v_n_mps = C_ne(lat_rad, lon_rad) @ found.v_e_mps
    return (1, *map(float, found.r_e_m), *map(float, v_n_mps))
