"""Solutions of RTKLIB (`.pos`; solution.c, outsolhead) as tables, on GPST and the ellipsoid."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pymap3d

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime, leap_seconds_at
from deepgnss.io.input import reading

COVARIANCE: Final = ("var_n", "var_e", "var_d", "cov_ne", "cov_nd", "cov_ed")
"""Columns, behind `position_` (m²) and `velocity_` (m²/s²), of an NED covariance."""

_AXES: Final = {  # RTKLIB's names of axes → directions in its order
    "neu": ("n", "e", "u", "ne", "eu", "un"),
    "xyz": ("x", "y", "z", "xy", "yz", "zx"),
}


def read_pos(path: Path) -> pd.DataFrame:
    """Read week, tow_s (GPST), lat_deg, lon_deg, height_m, quality; what it has of the rest.

    The rest: vn_mps, ve_mps, vd_mps, and the columns of `COVARIANCE` of positions and velocities.

    Raises
    ------
    InputFileError: it cannot be read, or is not RTKLIB's.
    """
    with reading(path):
        lines = path.read_text(encoding="latin-1").splitlines()
    header = next((line for line in lines if line.startswith("%") and "(m)" in line), "")
    if not header:
        raise InputFileError(f"{path}: not an RTKLIB .pos file (no column header)")
    if "latitude(d'" in header:
        raise InputFileError(f"{path}: positions in degrees, minutes, seconds: use -s ' ' degrees")
    names = header[1:].split()
    rows = [line.replace(",", " ").split() for line in lines if line[:1] not in ("%", "")]
    if any(len(row) < 5 for row in rows):
        raise InputFileError(f"{path}: a row is not a solution: fewer than 5 columns")
    with reading(path):
        table = [[*_time(row[0], row[1], names[0] == "UTC"), *map(float, row[2:])] for row in rows]
    if not table or len({len(row) for row in table}) != 1:
        raise InputFileError(f"{path}: no solutions, or rows of unequal length")
    values = np.array(table)
    columns = {name: values[:, 2 + k] for k, name in enumerate(names[1:]) if k + 2 < len(table[0])}
    is_ecef = "x-ecef(m)" in columns
    frame = pd.DataFrame({"week": values[:, 0], "tow_s": values[:, 1]})
    place = values[:, 2:5]
    if is_ecef:
        place = np.column_stack(pymap3d.ecef2geodetic(*place.T))
    frame[["lat_deg", "lon_deg", "height_m"]] = place
    frame["quality"] = columns.get("Q", np.full(len(frame), np.nan))
    up_is_minus_down: FloatArray = np.diag([1.0, 1.0, -1.0])
    to_n = C_ne(*np.radians(place[:, :2]).T) if is_ecef else up_is_minus_down
    axes = "xyz" if is_ecef else "neu"
    velocity = [f"v{axis}(m/s)" for axis in axes]
    if all(name in columns for name in velocity):
        v = np.column_stack([columns[name] for name in velocity])
        frame[["vn_mps", "ve_mps", "vd_mps"]] = (to_n @ v[:, :, np.newaxis])[:, :, 0]
    for kind, prefix, unit in (("position", "sd", "(m)"), ("velocity", "sdv", "")):
        roots = [f"{prefix}{pair}{unit}" for pair in _AXES[axes]]
        if all(name in columns for name in roots):
            in_file = _covariance(np.column_stack([columns[name] for name in roots]))
            covariance = to_n @ in_file @ np.swapaxes(to_n, -1, -2)
            (i, j) = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
            frame[[f"{kind}_{name}" for name in COVARIANCE]] = covariance[:, i, j]
    return frame


def _covariance(roots: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3) of RTKLIB's signed roots (n, 6): 11, 22, 33, 12, 23, 31."""
    a, b, c, ab, bc, ca = (np.sign(roots) * roots**2).T
    rows = [[a, ab, ca], [ab, b, bc], [ca, bc, c]]
    return np.moveaxis(np.array(rows), -1, 0)


def _time(first: str, second: str, is_utc: bool) -> tuple[float, float]:
    if "/" not in first:
        return float(first), float(second)
    stamp = pd.Timestamp(f"{first.replace('/', '-')}T{second}")
    elapsed = stamp - pd.Timestamp("1980-01-06")
    leap_s = leap_seconds_at(stamp.tz_localize("UTC").to_pydatetime()) if is_utc else 0
    weeks, rest = divmod(elapsed.value, SECONDS_PER_WEEK * 10**9)
    time = GpsTime(weeks, rest * 1e-9).plus(leap_s)
    return float(time.week), time.tow_s
