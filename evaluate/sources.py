"""Whoever is compared: a run of ours, or the log of another receiver, as tables of one shape."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pymap3d
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.errors import read_solution
from deepgnss.evaluate.observations import OBSERVATION_COLUMNS, read_channels, read_observations
from deepgnss.evaluate.single_point import POSITIONS
from deepgnss.io.nmea import read_nmea
from deepgnss.io.truth import Trajectory, TruthFormat, read_truth
from deepgnss.io.ubx import read_ubx


class Source(NamedTuple):
    """Positions and observations of one receiver, on GPST; either table may be empty."""

    name: str
    kind: str  # of file
    positions: pd.DataFrame  # single_point.POSITIONS; of the antenna unless `point` says otherwise
    observations: pd.DataFrame  # observations.OBSERVATION_COLUMNS
    point: str = "antenna"
    channels: pd.DataFrame | None = None  # channels.csv of a run of ours
    path: Path | None = None


def read_source(path: Path, name: str = "", lever_arm_m: Sequence[float] | None = None) -> Source:
    """Read a run's folder, UBX, NMEA, RINEX observations, RTKLIB `.pos`, KF-GINS `.nav`.

    Parameters: lever_arm_m, IMU → antenna in the body (FRD), which takes a `.nav` to the antenna.
    Raises InputFileError: it cannot be read, or is none of these.
    """
    return _read(path, name, lever_arm_m)._replace(path=path)


def read_reference(
    path: Path, form: TruthFormat | None, lever_arm_m: Sequence[float] | None = None
) -> Trajectory:
    """The way the antenna went: a truth file, or the positions in a UBX or NMEA log.

    Parameters: form, of the file; None: by its ending, CSV unless it says otherwise.
    Raises InputFileError: it cannot be read, or holds no positions.
    """
    endings: dict[str, TruthFormat] = {".pos": "rtklib_pos", ".nav": "kfgins_nav"}
    if form is not None or path.suffix.lower() not in _LOGS:
        form = form or endings.get(path.suffix.lower(), "csv")
        return read_truth(path, form, lever_arm_m=lever_arm_m)
    known = read_source(path).positions
    known = known[known["valid"] == 1].drop_duplicates(["week", "tow_s"])
    if known.empty:
        raise InputFileError(f"{path}: no positions in it")
    known = known.sort_values(["week", "tow_s"], kind="stable")
    return Trajectory(
        known["week"].to_numpy(np.int64),
        known["tow_s"].to_numpy(np.float64),
        known[["x_e_m", "y_e_m", "z_e_m"]].to_numpy(np.float64),
    )


_LOGS = (".ubx", ".nmea", ".nme")


def _read(path: Path, name: str, lever_arm_m: Sequence[float] | None) -> Source:
    name = name or (path.name if path.is_dir() else path.stem)
    if path.is_dir():
        return _run(path, name)
    ending = path.suffix.lower()
    if ending == ".ubx":
        log = read_ubx(path)
        return Source(name, "UBX", _tidy(log.positions), log.observations)
    if ending == ".pos":
        return Source(name, "RTKLIB", _of(read_truth(path, "rtklib_pos")), _no_observations())
    head = _head(path)
    if b"RINEX VERSION / TYPE" in head:
        return Source(name, "RINEX", _no_positions(), read_observations(path))
    if head.lstrip().startswith(b"$") or ending in (".nmea", ".nme"):
        return Source(name, "NMEA", _nmea(path), _no_observations())
    if ending == ".nav":
        way = _of(read_truth(path, "kfgins_nav", lever_arm_m=lever_arm_m))
        point = "IMU" if lever_arm_m is None else "antenna"
        return Source(name, "KF-GINS", way, _no_observations(), point)
    raise InputFileError(
        f"{path}: expected a run's folder, .ubx, NMEA, RINEX observations, .pos or .nav"
    )


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(200)
    except OSError as error:
        raise InputFileError(f"{path}: cannot read: {error.strerror}") from error


def _run(folder: Path, name: str) -> Source:
    solution = folder / "solution.csv"
    if not solution.is_file():
        raise InputFileError(f"{folder}: no solution.csv in it: not the folder of a finished run")
    observed = folder / "observations.csv"
    observations = read_observations(observed) if observed.is_file() else _no_observations()
    told = folder / "channels.csv"
    channels = read_channels(told) if told.is_file() else None
    positions = _tidy(read_solution(solution))
    return Source(name, "deepgnss", positions, observations, channels=channels)


def _tidy(frame: pd.DataFrame) -> pd.DataFrame:
    return frame[list(POSITIONS)].reset_index(drop=True)


def _no_positions() -> pd.DataFrame:
    return pd.DataFrame(columns=list(POSITIONS), dtype=np.float64)


def _no_observations() -> pd.DataFrame:
    return pd.DataFrame(columns=list(OBSERVATION_COLUMNS))


def _of(way: Trajectory) -> pd.DataFrame:
    """Positions of a trajectory, its velocity in north, east, down where it has one."""
    v_n_mps = np.full_like(way.r_e_m, np.nan)
    if way.v_e_mps is not None:
        lat_deg, lon_deg, _ = pymap3d.ecef2geodetic(*way.r_e_m.T)
        for k, (lat, lon) in enumerate(zip(np.radians(lat_deg), np.radians(lon_deg), strict=True)):
            v_n_mps[k] = C_ne(float(lat), float(lon)) @ way.v_e_mps[k]
    return _positions(way.week, way.tow_s, np.ones(len(way.week)), way.r_e_m, v_n_mps)


def _nmea(path: Path) -> pd.DataFrame:
    log = read_nmea(path)
    r_e_m = np.column_stack(
        pymap3d.geodetic2ecef(log.lat_rad, log.lon_rad, log.height_m, deg=False)
    )
    velocity = np.column_stack(
        [
            log.speed_mps * np.cos(log.course_rad),
            log.speed_mps * np.sin(log.course_rad),
            np.full(len(log.week), np.nan),
        ]
    )
    valid = (log.quality > 0) & np.isfinite(r_e_m).all(axis=1)
    return _positions(log.week, log.tow_s, valid, r_e_m, velocity)


def _positions(
    week: FloatArray | NDArray[Any],
    tow_s: FloatArray,
    valid: FloatArray | NDArray[Any],
    r_e_m: FloatArray,
    v_n_mps: FloatArray,
) -> pd.DataFrame:
    columns = [week, tow_s, np.asarray(valid, np.int64), *r_e_m.T, *v_n_mps.T]
    return pd.DataFrame(dict(zip(POSITIONS, columns, strict=True)))
