"""Odometer logs: CSV of GPST and speed."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.config.aids import OdometerConfig
from deepgnss.io.imu.rows import Faults
from deepgnss.io.input import reading
from deepgnss.io.output import OutputFile

_HEAD: Final = "gps_week,gps_tow_s,speed_mps"
_NAMES: Final = {
    **dict.fromkeys(("gps_week", "week"), "week"),
    **dict.fromkeys(("gps_tow_s", "tow_s", "tow", "sow", "time", "time_s"), "tow_s"),
    **dict.fromkeys(("speed_mps", "speed", "velocity", "v", "v_mps"), "speed"),
}
_TOO_FAST_MPS: Final = 150.0


class OdometerLog(NamedTuple):
    """Forward speeds of a vehicle, backwards negative; each the mean since the one before it."""

    origin: GpsTime
    time_s: FloatArray  # (n,) seconds of GPST since `origin`, rising
    speed_mps: FloatArray  # (n,)


def read_odometer(
    config: OdometerConfig, near: GpsTime | None = None
) -> tuple[OdometerLog, tuple[str, ...]]:
    """Read a log, in m/s after the config's scale; also what had to be left out, a line each.

    Parameters
    ----------
    near: an instant within half a week of the log, where it has no week; None: week 0.

    Raises
    ------
    InputFileError: it cannot be read, lacks a column, its time goes back, or its speeds are none.
    """
    path = config.file
    with reading(path):
        frame = pd.read_csv(path, comment="#", low_memory=False)
        frame = frame.rename(columns=lambda name: _NAMES.get(str(name).strip().lower(), name))
    for name in ("tow_s", "speed"):
        if name not in frame:
            raise InputFileError(f"{path}: no column {name}; expected the header {_HEAD}")
    wanted = [name for name in ("week", "tow_s", "speed") if name in frame]
    values = frame[wanted].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    faults, good = Faults(path), np.isfinite(values).all(axis=1)
    lines = np.arange(2, len(values) + 2)
    if not good.all():
        what = "rows that are no numbers left out"
        faults.add(what, int(lines[~good][0]), int((~good).sum()))
    values, lines = values[good], lines[good]
    if not len(values):
        raise InputFileError(f"{path}: holds no speeds")
    tow_s, speed_mps = values[:, -2], values[:, -1] * config.scale
    week = values[:, 0] if "week" in frame else np.full(tow_s.size, float(_week(tow_s[0], near)))
    origin = GpsTime(int(week[0]), float(np.floor(tow_s[0])))
    time_s = (week - week[0]) * SECONDS_PER_WEEK + (tow_s - origin.tow_s)
    back = np.flatnonzero(np.diff(time_s) < 0.0)
    if back.size:
        raise InputFileError(f"{path}:{lines[back[0] + 1]}: time goes back")
    same = np.append(False, np.diff(time_s) == 0.0)
    if same.any():
        what = "rows with the time of the row before left out"
        faults.add(what, int(lines[same][0]), int(same.sum()))
    fastest_mps = float(np.abs(speed_mps).max())
    if fastest_mps > _TOO_FAST_MPS:
        raise InputFileError(
            f"{path}: speeds of up to {fastest_mps:.0f} m/s; expected m/s after odometer.scale"
            " (km/h: 0.2777778)"
        )
    return OdometerLog(origin, time_s[~same], speed_mps[~same]), tuple(faults)


def write_odometer(path: Path, log: OdometerLog) -> None:
    """Write a log as CSV."""
    file = OutputFile(path)
    file.write(_HEAD + "\n")
    for time_s, speed_mps in zip(log.time_s.tolist(), log.speed_mps.tolist(), strict=True):
        time = log.origin.plus(time_s)
        file.write(f"{time.week},{time.tow_s:.9f},{speed_mps!r}\n")
    file.close()


def _week(tow_s: float, near: GpsTime | None) -> int:
    return near.week + round((near.tow_s - tow_s) / SECONDS_PER_WEEK) if near else 0
