"""Truth trajectories: CSV with a named header, RTKLIB `.pos`, KF-GINS `.nav`, all to GPST.

A trajectory is that of one point: the antenna where the file gives it (CSV, `.pos`); a `.nav`
file gives the IMU, and becomes the antenna's with a lever arm and the attitude in the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pymap3d
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from deepgnss.core.attitude import matrix_from_euler
from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.input import reading
from deepgnss.io.rtklib_pos import read_pos

TruthFormat = Literal["csv", "rtklib_pos", "kfgins_nav"]

_LONGEST_GAP = 5.0  # times the usual interval: nothing is interpolated across more
_SAME_INSTANT_S = 1e-6


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Positions of one point over time, in order of time, without duplicates.

    week (n,), tow_s (n,): GPST. r_e_m (n, 3): ECEF. v_e_mps (n, 3): velocity of the same point
    in ECEF axes, None when the file has none (or only another point's). attitude_rad (n, 3):
    roll, pitch, yaw of the body (FRD against NED), None when unknown. attitude_sigma_rad (n, 3):
    1σ of its error about north, east, down, None when the file does not tell.
    """

    week: NDArray[np.int64]
    tow_s: FloatArray
    r_e_m: FloatArray
    v_e_mps: FloatArray | None = None
    attitude_rad: FloatArray | None = None
    attitude_sigma_rad: FloatArray | None = None

    @property
    def start(self) -> GpsTime:
        """First instant."""
        return GpsTime(int(self.week[0]), float(self.tow_s[0]))

    @property
    def end(self) -> GpsTime:
        """Last instant."""
        return GpsTime(int(self.week[-1]), float(self.tow_s[-1]))

    def seconds(self, week: NDArray[np.int64] | int, tow_s: FloatArray | float) -> FloatArray:
        """Seconds of GPST instants since `start` (exact to 0.1 ns over weeks)."""
        weeks = np.asarray(week, dtype=np.int64) - self.week[0]
        seconds: FloatArray = np.asarray(tow_s) - self.tow_s[0] + weeks * float(SECONDS_PER_WEEK)
        return seconds

    def of_point(self, arm_b_m: Sequence[float]) -> Trajectory:
        """The way of a point of the body at an arm from this one (FRD), without velocities.

        Two points of a body then are interpolated alike: between samples they keep their distance.

        Raises InputFileError: the trajectory has no attitude.
        """
        if self.attitude_rad is None:
            raise InputFileError("no attitude in the trajectory: a point of its body has no place")
        lat, lon, _ = pymap3d.ecef2geodetic(*self.r_e_m.T, deg=False)
        arm_n = matrix_from_euler(self.attitude_rad) @ np.asarray(arm_b_m, dtype=np.float64)
        arm_e = np.einsum("kji,kj->ki", C_ne(np.asarray(lat), np.asarray(lon)), arm_n)
        return replace(self, r_e_m=self.r_e_m + arm_e, v_e_mps=None)

    def at(
        self, week: NDArray[np.int64] | int, tow_s: FloatArray | float
    ) -> tuple[FloatArray, FloatArray]:
        """Position and velocity, each (k, 3) in ECEF, at k instants; NaN outside and in gaps.

        Cubic through the positions, with the file's velocities as slopes where it has them.
        """
        wanted = np.atleast_1d(self.seconds(week, tow_s))
        known = self.seconds(self.week, self.tow_s)
        origin = self.r_e_m[0]  # keeps the spline's digits for the metres that move
        if self.v_e_mps is None:
            spline: Any = CubicSpline(known, self.r_e_m - origin)
        else:
            spline = CubicHermiteSpline(known, self.r_e_m - origin, self.v_e_mps)
        r_e_m, v_e_mps = spline(wanted) + origin, spline(wanted, 1)
        after = np.clip(np.searchsorted(known, wanted, side="left"), 1, len(known) - 1)
        steps = np.diff(known)
        gap = steps[after - 1] > _LONGEST_GAP * np.median(steps)
        first, last = known[0] - _SAME_INSTANT_S, known[-1] + _SAME_INSTANT_S
        inside = (wanted >= first) & (wanted <= last)
        nearest_s = np.minimum(np.abs(wanted - known[after]), np.abs(wanted - known[after - 1]))
        unknown = ~inside | (gap & (nearest_s > _SAME_INSTANT_S))
        r_e_m[unknown], v_e_mps[unknown] = np.nan, np.nan
        return r_e_m, v_e_mps


def read_truth(
    path: Path | str,
    file_format: TruthFormat = "csv",
    *,
    lever_arm_m: Sequence[float] | None = None,
    week: int | None = None,
) -> Trajectory:
    """Read the trajectory of the antenna.

    Parameters
    ----------
    lever_arm_m: IMU → antenna in the body (FRD), for files that give the IMU; None: the
        trajectory is left to be the IMU's.
    week: GPS week of a `.nav` file that has 0 in its week column.

    Raises
    ------
    InputFileError: the file cannot be read, or is not what the format says.
    """
    path = Path(path)
    readers = {"csv": _read_csv, "rtklib_pos": read_pos, "kfgins_nav": _read_nav}
    columns = readers[file_format](path)
    frame = columns.astype(np.float64)
    needed = ["week", "tow_s", "lat_deg", "lon_deg", "height_m"]
    bad = ~np.isfinite(frame[needed].to_numpy()).all(axis=1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0]) + 1
        raise InputFileError(f"{path}: data row {row}: time or position is not a number")
    if (frame["week"] <= 0).any():
        if week is None:
            raise InputFileError(f"{path}: GPS week 0 in the file: state the week in the config")
        frame["week"] = float(week)
    frame = frame.sort_values(["week", "tow_s"], kind="stable").drop_duplicates(["week", "tow_s"])
    if len(frame) < 2:
        raise InputFileError(f"{path}: {len(frame)} epochs: two at least make a trajectory")
    return _trajectory(frame, file_format == "kfgins_nav", lever_arm_m)


def _trajectory(
    frame: pd.DataFrame, is_imu: bool, lever_arm_m: Sequence[float] | None
) -> Trajectory:
    lat, lon = np.radians(frame["lat_deg"].to_numpy()), np.radians(frame["lon_deg"].to_numpy())
    position = pymap3d.geodetic2ecef(lat, lon, frame["height_m"].to_numpy(), deg=False)
    attitude = _columns(frame, "roll_deg", "pitch_deg", "heading_deg")
    attitude_rad = None if attitude is None else np.radians(attitude)
    velocity = _columns(frame, "vn_mps", "ve_mps", "vd_mps")
    # Where positions of the IMU stand beside the antenna's, the velocity is the IMU's.
    v_e_mps = None
    if velocity is not None and "imu_lat_deg" not in frame:
        v_e_mps = np.einsum("kji,kj->ki", C_ne(lat, lon), velocity)
    sigma_deg = _columns(frame, *_SIGMAS)
    found = Trajectory(
        week=frame["week"].to_numpy().astype(np.int64),
        tow_s=frame["tow_s"].to_numpy(),
        r_e_m=np.column_stack(position),
        v_e_mps=v_e_mps,
        attitude_rad=attitude_rad,
        attitude_sigma_rad=None if sigma_deg is None else np.radians(sigma_deg),
    )
    return found.of_point(lever_arm_m) if is_imu and lever_arm_m is not None else found


def _columns(frame: pd.DataFrame, *names: str) -> FloatArray | None:
    if any(name not in frame for name in names):
        return None
    values = frame[list(names)].to_numpy(dtype=np.float64)
    return values if np.isfinite(values).all() else None


# --- formats -------------------------------------------------------------------------------------

_CSV_NAMES = {
    "gps_week": "week",
    "gps_tow_s": "tow_s",
    "tow": "tow_s",
    "v_n_mps": "vn_mps",
    "v_e_mps": "ve_mps",
    "v_d_mps": "vd_mps",
    "yaw_deg": "heading_deg",
}
_SIGMAS = ("sigma_phi_n_deg", "sigma_phi_e_deg", "sigma_phi_d_deg")
_CSV_NEEDED = ("week", "tow_s", "lat_deg", "lon_deg", "height_m")


def _read_csv(path: Path) -> pd.DataFrame:
    with reading(path):
        frame = pd.read_csv(path).rename(columns=_CSV_NAMES)
    missing = [name for name in _CSV_NEEDED if name not in frame]
    if missing:
        raise InputFileError(f"{path}: column '{missing[0]}' is missing in the header")
    if "valid" in frame:  # a solution of our own, taken as truth
        frame = frame[frame["valid"] == 1]
    known = [*_CSV_NEEDED, *_OPTIONAL]
    frame = frame[[name for name in known if name in frame]]
    with reading(path):
        return frame.astype(np.float64)


_OPTIONAL = (
    *("vn_mps", "ve_mps", "vd_mps", "roll_deg", "pitch_deg", "heading_deg"),
    *("imu_lat_deg", "imu_lon_deg", "imu_height_m"),
    *_SIGMAS,
)


_NAV_NAMES = (
    *("week", "tow_s", "lat_deg", "lon_deg", "height_m", "vn_mps", "ve_mps", "vd_mps"),
    *("roll_deg", "pitch_deg", "heading_deg"),
)


def _read_nav(path: Path) -> pd.DataFrame:
    with reading(path):
        frame = pd.read_csv(path, sep=r"\s+", header=None, comment="%")
    if frame.shape[1] < len(_NAV_NAMES):
        raise InputFileError(
            f"{path}: {frame.shape[1]} columns; a KF-GINS .nav file has {len(_NAV_NAMES)}"
        )
    frame = frame.iloc[:, : len(_NAV_NAMES)]
    frame.columns = pd.Index(_NAV_NAMES)
    with reading(path):
        return frame.astype(np.float64)
