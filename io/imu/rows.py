"""What the formats of inertial logs have in common: numbered rows of time and six readings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.io.config.aids import ImuUnitsConfig

CHUNK_ROWS: Final = 16_384


class Rows(NamedTuple):
    """Consecutive rows of a log in its own units and axes; what is no number is NaN."""

    line: NDArray[np.int64]  # (n,) from 1: line of a text, row of a table
    week: FloatArray | None  # (n,) GPS week; None: the log has none
    time: FloatArray  # (n,) seconds of week, samples or ticks
    gyro: FloatArray  # (n, 3)
    accel: FloatArray  # (n, 3)


@dataclass
class Fault:
    """One kind of fault in a log: how often, where first, and how much time it touched."""

    what: str  # after the count, "rows that are not numbers left out"
    count: int = 0
    line: int = 0
    seconds: float = 0.0


class Faults:
    """Faults of a log that could be handled, to be said once each."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._faults: dict[str, Fault] = {}

    def add(self, what: str, line: int, count: int = 1, seconds: float = 0.0) -> None:
        """Note one more of a kind."""
        fault = self._faults.setdefault(what, Fault(what, line=line))
        fault.count += count
        fault.seconds += seconds

    def __iter__(self) -> Iterator[str]:
        """One line for each kind: file, first line of it, number, seconds."""
        for fault in sorted(self._faults.values(), key=lambda fault: fault.line):
            duration = f", {fault.seconds:.3f} s in all" if fault.seconds else ""
            yield f"{self.path}:{fault.line}: {fault.what}: {fault.count}{duration}"


# --- columns by name -----------------------------------------------------------------------------

_TIMES: Final = {
    **dict.fromkeys(("gps_week", "gpsweek", "week"), "week"),
    **dict.fromkeys(("gps_tow_s", "tow_s", "tow", "gps_sow_s", "sow_s", "sow"), "time"),
    **dict.fromkeys(("time", "time_s", "timestamp", "t", "t_s", "gpst", "gps_time"), "time"),
    **dict.fromkeys(("tick", "ticks", "tick_ms", "time_ms", "sample", "samples"), "time"),
}
_SENSORS: Final = {
    **dict.fromkeys(
        ("dtheta", "dang", "gyro", "gyr", "omega", "angular_velocity", "w", "g"), "gyro"
    ),
    **dict.fromkeys(("dvel", "dv", "accel", "acc", "linear_acceleration", "f", "a"), "accel"),
}
_READING: Final = re.compile(
    rf"({'|'.join(sorted(_SENSORS, key=len, reverse=True))})[ _]?([xyz])(?:[ _(\[]+(.+?)[)\]]?)?"
)
_UNITS: Final = {
    **dict.fromkeys(("rad",), "rad"),
    **dict.fromkeys(("deg",), "deg"),
    **dict.fromkeys(("radps", "rad/s", "rads", "rps"), "rad/s"),
    **dict.fromkeys(("degps", "deg/s", "dps", "degs"), "deg/s"),
    **dict.fromkeys(("mps", "m/s", "ms"), "m/s"),
    **dict.fromkeys(("mps2", "m/s2", "m/s^2", "mss", "ms2", "m/s/s"), "m/s^2"),
    **dict.fromkeys(("g",), "g"),
}
NEEDED: Final = ("time", *(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"))


def find_columns(
    path: Path, names: Iterable[str], units: ImuUnitsConfig, where: str
) -> dict[str, int]:
    """Places of `week` (if any), `time`, `gyro_x` … `accel_z` among the names of a log's columns.

    Raises
    ------
    InputFileError: one is missing or there twice, or its name tells another unit than the config.
    """
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        plain = name.strip().strip('"').lower()
        reading = _READING.fullmatch(plain)
        if plain in _TIMES:
            key = _TIMES[plain]
        elif reading:
            key = f"{_SENSORS[reading[1]]}_{reading[2]}"
            unit, stated = _UNITS.get(reading[3] or ""), getattr(units, key[:-2])
            if unit and unit != stated:
                raise InputFileError(
                    f"{path}: column '{name}' is in {unit}, the config has"
                    f" imu.units.{key[:-2]}: {stated}"
                )
        else:
            continue
        if key in places:
            raise InputFileError(f"{path}: two columns of {where} give {key}")
        places[key] = place
    for key in NEEDED:
        if key not in places:
            raise InputFileError(
                f"{path}: {where} gives no {key}; expected columns such as gps_week, gps_tow_s,"
                " gyro_x … accel_z (state them as imu.columns)"
            )
    return places


def rows_of(lines: NDArray[np.int64], table: FloatArray, places: dict[str, int]) -> Rows:
    """Rows of a table (n, columns) by the places of its columns."""
    pick = [places[key] for key in NEEDED]
    week = table[:, places["week"]] if "week" in places else None
    return Rows(lines, week, table[:, pick[0]], table[:, pick[1:4]], table[:, pick[4:7]])
