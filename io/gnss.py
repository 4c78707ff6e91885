"""GNSS solutions other runs and programs left: ours, RTKLIB's, KF-GINS's, as one log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pymap3d
from numpy.typing import NDArray

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.imu.rows import Faults
from deepgnss.io.input import reading
from deepgnss.io.rtklib_pos import COVARIANCE, read_pos

_KFGINS: Final = ("tow_s", "lat_deg", "lon_deg", "height_m")
_VELOCITY: Final = ("vn_mps", "ve_mps", "vd_mps")
_POSITION_SIGMA: Final = ("sigma_n_m", "sigma_e_m", "sigma_d_m")
_VELOCITY_SIGMA: Final = ("sigma_vn_mps", "sigma_ve_mps", "sigma_vd_mps")
_OURS: Final = {"v_n_mps": "vn_mps", "v_e_mps": "ve_mps", "v_d_mps": "vd_mps"}
_AIDED: Final = "aided"


@dataclass(frozen=True, slots=True)
class GnssLog:
    """Antenna positions and velocities with covariances in NED, in order of time.

    Where a fix has no velocity, it and its covariance are NaN. `faults`: what was left out, a line
    each.
    """

    path: Path
    week: NDArray[np.int64]  # (n,)
    tow_s: FloatArray  # (n,)
    r_e_m: FloatArray  # (n, 3)
    covariance_n_m2: FloatArray  # (n, 3, 3)
    v_n_mps: FloatArray  # (n, 3)
    velocity_covariance_n_m2ps2: FloatArray  # (n, 3, 3)
    faults: tuple[str, ...]

    def time(self, k: int) -> GpsTime:
        """Instant of a fix."""
        return GpsTime(int(self.week[k]), float(self.tow_s[k]))


def is_weekless(path: Path) -> bool:
    """Whether a solution is KF-GINS text, whose seconds of week lack the week."""
    with reading(path), path.open(encoding="latin-1") as file:
        first = next((line for line in file if line.strip() and line.lstrip()[0] not in "#%"), "")
        commented = path.suffix.lower() == ".pos"
    return not commented and "," not in first and len(first.split()) in (7, 13)


def read_gnss(path: Path, near: GpsTime | None = None) -> GnssLog:
    """Read a solution.csv of ours, an RTKLIB `.pos`, or KF-GINS text, told apart by what they hold.

    KF-GINS: tow, latitude and longitude in deg, height, [velocity NED,] σ of position NED
    [, of velocity], 7 or 13 columns.

    Parameters
    ----------
    near: an instant within half a week of it, where it has no week; None: week 0.

    Raises
    ------
    InputFileError: it cannot be read, is none of these, or holds no fix with its σ.
    """
    path = Path(path)
    if is_weekless(path):
        frame = _read_kfgins(path, near)
    else:
        with reading(path), path.open(encoding="latin-1") as file:
            first = file.readline()
        if first.startswith("%") or path.suffix.lower() == ".pos":
            frame = read_pos(path)
        elif "tow_s" in first:
            frame = _read_ours(path)
        else:
            raise InputFileError(
                f"{path}: found {first[:40]!r}; expected a solution.csv, an RTKLIB .pos, or"
                " KF-GINS text of 7 or 13 columns"
            )
    return _log(path, frame)


def _read_ours(path: Path) -> pd.DataFrame:
    with reading(path):
        frame = pd.read_csv(path, low_memory=False).rename(columns=_OURS)
    for name in ("week", "lat_deg", "sigma_n_m"):
        if name not in frame:
            raise InputFileError(f"{path}: column '{name}' is missing: not a solution.csv")
    if "valid" in frame:
        frame = frame[frame["valid"] == 1]
    if "source" in frame:
        frame = frame.assign(**{_AIDED: frame["source"] != "gnss"})
    wanted = ["week", *_KFGINS, *_VELOCITY, *_POSITION_SIGMA, *_VELOCITY_SIGMA, _AIDED]
    with reading(path):
        return frame[[name for name in wanted if name in frame]].astype(np.float64)


def _read_kfgins(path: Path, near: GpsTime | None) -> pd.DataFrame:
    with reading(path):
        frame = pd.read_csv(path, sep=r"\s+", header=None, comment="#").astype(np.float64)
    more = (
        (*_VELOCITY, *_POSITION_SIGMA, *_VELOCITY_SIGMA)
        if frame.shape[1] == 13
        else _POSITION_SIGMA
    )
    if frame.shape[1] != len(_KFGINS) + len(more):
        raise InputFileError(f"{path}: {frame.shape[1]} columns; KF-GINS text has 7 or 13")
    frame.columns = pd.Index([*_KFGINS, *more])
    tow_s = frame["tow_s"].to_numpy()
    if tow_s.size and not 0.0 <= tow_s[0] < SECONDS_PER_WEEK:
        raise InputFileError(f"{path}: time {tow_s[0]:.10g} is no GPST second of week")
    week = 0
    if near is not None and tow_s.size:
        week = near.week + round((near.tow_s - tow_s[0]) / SECONDS_PER_WEEK)
    turns = np.cumsum(np.diff(tow_s, prepend=tow_s[:1]) < -0.5 * SECONDS_PER_WEEK)
    frame["week"] = week + turns.astype(np.float64)
    return frame


def _log(path: Path, frame: pd.DataFrame) -> GnssLog:
    faults = Faults(path)
    P, V = _covariances(frame, "position"), _covariances(frame, "velocity")
    place = frame[["week", "tow_s", "lat_deg", "lon_deg", "height_m"]].to_numpy()
    good = np.isfinite(place).all(axis=1) & _positive(P)
    _say(faults, ~good, "fixes without a position or its σ left out")
    if _AIDED in frame:
        aided = good & (frame[_AIDED].to_numpy() > 0.0)
        _say(faults, aided, "fixes that have an inertial navigation in them left out")
        good &= ~aided
    time_s = (frame["week"] - frame["week"].min()).to_numpy() * SECONDS_PER_WEEK + place[:, 1]
    back = np.flatnonzero(np.diff(time_s[good]) < 0.0)
    if back.size:
        row = int(np.flatnonzero(good)[back[0] + 1]) + 1
        raise InputFileError(f"{path}: fix {row}: time goes back")
    same = good & (np.diff(np.where(good, time_s, np.nan), prepend=np.nan) == 0.0)
    _say(faults, same, "fixes with the time of the fix before left out")
    good &= ~same
    if not good.any():
        raise InputFileError(f"{path}: holds no fix with a position and its σ")
    place, P, V = place[good], P[good], V[good]
    v_n = np.full((len(place), 3), np.nan)
    if all(name in frame for name in _VELOCITY):
        v_n = frame[list(_VELOCITY)].to_numpy()[good]
    unknown = ~(np.isfinite(v_n).all(axis=1) & _positive(V))
    v_n[unknown], V[unknown] = np.nan, np.nan
    return GnssLog(
        path,
        place[:, 0].astype(np.int64),
        place[:, 1],
        np.column_stack(pymap3d.geodetic2ecef(*place[:, 2:5].T)),
        P,
        v_n,
        V,
        tuple(faults),
    )


def _covariances(frame: pd.DataFrame, kind: str) -> FloatArray:
    """Covariances (n, 3, 3) of all that is known, NaN where nothing is."""
    names = [f"{kind}_{name}" for name in COVARIANCE]
    if all(name in frame for name in names):
        n, e, d, ne, nd, ed = frame[names].to_numpy().T
        return np.moveaxis(np.array([[n, ne, nd], [ne, e, ed], [nd, ed, d]]), -1, 0)
    sigmas = list(_POSITION_SIGMA if kind == "position" else _VELOCITY_SIGMA)
    if any(name not in frame for name in sigmas):
        return np.full((len(frame), 3, 3), np.nan)
    found: FloatArray = frame[sigmas].to_numpy()[:, :, np.newaxis] ** 2 * np.eye(3)
    return found


def _positive(covariances: FloatArray) -> NDArray[np.bool_]:
    finite = np.isfinite(covariances).all(axis=(1, 2))
    positive = np.zeros(len(covariances), dtype=np.bool_)
    positive[finite] = (np.linalg.eigvalsh(covariances[finite]) > 0.0).all(axis=1)
    return positive


def _say(faults: Faults, which: NDArray[np.bool_], what: str) -> None:
    if which.any():
        faults.add(what, int(np.flatnonzero(which)[0]) + 1, int(which.sum()))
