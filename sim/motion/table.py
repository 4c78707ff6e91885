"""A track from a CSV file: quintic splines through its positions and angles.

Splines are four times continuously differentiable; before the first row and after the last the
vehicle goes straight on at a constant speed and attitude (acceleration and jerk are zero there).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.interpolate import PPoly, make_interp_spline

from deepgnss.core.attitude import euler_rad, matrix_from_euler, quaternion_from_matrix
from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray
from deepgnss.io.input import reading
from deepgnss.sim.motion.attitude import Angles
from deepgnss.sim.motion.jets import Jet
from deepgnss.sim.motion.paths import Motion
from deepgnss.sim.motion.profile import derivatives

_LONGEST_GAP: Final = 5.0  # times the usual interval
_LARGEST_TURN_RAD: Final = math.radians(90.0)  # from row to row
_STEEPEST_RAD: Final = math.radians(80.0)
_STANDING_MPS: Final = 0.5  # below, the course is not followed
_FOLLOWED_S: Final = 0.1

_SYNONYMS: Final = {
    "gps_week": "week",
    "gps_tow_s": "tow_s",
    "tow": "tow_s",
    "heading_deg": "yaw_deg",
    "x_m": "x_e_m",
    "y_m": "y_e_m",
    "z_m": "z_e_m",
}
_TIMES: Final = (("time_s",), ("week", "tow_s"), ("tow_s",))
_GEODETIC: Final = ("lat_deg", "lon_deg", "height_m")
_LOCAL: Final = ("north_m", "east_m", "height_m")
_OF_IMU: Final = ("imu_lat_deg", "imu_lon_deg", "imu_height_m")
_FORMS: Final = (_OF_IMU, _GEODETIC, _LOCAL, ("x_e_m", "y_e_m", "z_e_m"))
_ANGLES: Final = ("roll_deg", "pitch_deg", "yaw_deg")
_KNOWN: Final = {name for names in (*_TIMES, *_FORMS, _ANGLES) for name in names}


class Place(NamedTuple):
    """Origin of the local frame (WGS-84)."""

    latitude_rad: float
    longitude_rad: float
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class TrackPath:
    """Motion through the rows of a table."""

    position: PPoly  # (3,) in the local NED frame

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time of the table."""
        return float(self.position.x[1]), float(self.position.x[-2])

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative below the fifth jumps."""
        return self.span_s

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        return Motion(*derivatives(self.position, t_s, 3))


@dataclass(frozen=True, slots=True, eq=False)
class TrackAttitude:
    """Roll, pitch and yaw through the rows of a table."""

    angles: PPoly  # (3,) in rad against the local NED frame

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative below the fifth jumps."""
        return float(self.angles.x[1]), float(self.angles.x[-2])

    def __call__(self, t_s: FloatArray) -> Angles:
        """Angles at seconds since the start."""
        parts = [f.T for f in derivatives(self.angles, t_s, 3)]
        return Angles(*(Jet(*jet) for jet in zip(*parts, strict=True)))


def read_track(path: Path, place: Place) -> tuple[TrackPath, TrackAttitude]:
    """Path and attitude of a CSV file with a named header; its first row is at t = 0.

    Time: `time_s`, or `tow_s` (GPS seconds of week, with or without `week`). Position: `lat_deg,
    lon_deg, height_m` (WGS-84), `north_m, east_m, height_m` (from the place), or `x_e_m, y_e_m,
    z_e_m` (ECEF); positions of the IMU (`imu_lat_deg`, …) come first where a truth file has them
    beside the antenna's. Attitude: `roll_deg, pitch_deg, yaw_deg` against the NED frame of each
    row's position; without, forward follows the course (held while the vehicle stands).

    Raises
    ------
    InputFileError: a row is not what it should be; the line is named.
    """
    lines, columns = _columns(path)
    times = next((names for names in _TIMES if set(names) <= columns.keys()), None)
    if times is None:
        raise InputFileError(f"{path}: no column of time; expected time_s or tow_s")
    t_s = columns[times[-1]]
    if "week" in times:
        t_s = t_s + (columns["week"] - columns["week"][0]) * SECONDS_PER_WEEK
    t_s = t_s - t_s[0]
    _check_times(path, lines, t_s)
    r_n_m = _positions(path, columns, place)
    position = _spline(t_s, r_n_m)
    if set(_ANGLES) <= columns.keys():
        angles = _turned(np.radians([columns[name] for name in _ANGLES]).T, r_n_m, place)
        _check_angles(path, lines, angles)
        return TrackPath(position), TrackAttitude(_spline(t_s, angles))
    if any(name in columns for name in _ANGLES):
        raise InputFileError(f"{path}: expected all of {', '.join(_ANGLES)}, or none")
    return TrackPath(position), TrackAttitude(_followed(t_s, position))


def _columns(path: Path) -> tuple[list[int], dict[str, FloatArray]]:
    """Line number of each row, and the columns of numbers by name."""
    lines: list[int] = []
    rows: list[list[float]] = []
    names: list[str] = []
    with reading(path), path.open(encoding="utf-8", newline="") as file:
        table = csv.reader(file)
        for cells in table:
            if not any(cells) or cells[0].startswith("#"):
                continue
            if not names:
                names = [_SYNONYMS.get(name, name) for name in (c.strip().lower() for c in cells)]
                continue
            lines.append(table.line_num)
            rows.append(_numbers(f"{path}:{table.line_num}", names, cells))
    if len(rows) < 2:
        raise InputFileError(f"{path}: {len(rows)} rows; two at least make a track")
    return lines, dict(zip(names, np.array(rows).T, strict=True))


def _numbers(where: str, names: Sequence[str], cells: Sequence[str]) -> list[float]:
    if len(cells) != len(names):
        raise InputFileError(f"{where}: {len(cells)} cells, the header has {len(names)}")
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            value = float(cell)
        except ValueError as error:
            if name in _KNOWN:
                raise InputFileError(f"{where}: {name}: {cell!r} is not a number") from error
            value = math.nan  # a column that is not ours
        if name in _KNOWN and not math.isfinite(value):
            raise InputFileError(f"{where}: {name}: {cell!r} is not a finite number")
        values.append(value)
    return values


def _check_times(path: Path, lines: Sequence[int], t_s: FloatArray) -> None:
    steps = np.diff(t_s)
    usual_s = float(np.median(steps))

    def refuse(wrong: NDArray[np.bool_], what: Callable[[float], str]) -> None:
        if wrong.any():
            row = int(np.argmax(wrong)) + 1
            raise InputFileError(f"{path}:{lines[row]}: {what(float(steps[row - 1]))}")

    refuse(steps == 0.0, lambda _: "the time of the row before it again")
    refuse(steps < 0.0, lambda step: f"time goes back by {-step:g} s")
    refuse(
        steps > _LONGEST_GAP * usual_s,
        lambda step: f"a gap of {step:g} s in rows every {usual_s:g} s",
    )


def _positions(path: Path, columns: dict[str, FloatArray], place: Place) -> FloatArray:
    """Positions (n, 3) in the local NED frame."""
    form = next((names for names in _FORMS if set(names) <= columns.keys()), None)
    if form is None:
        forms = "; or ".join(", ".join(names) for names in _FORMS[1:])
        raise InputFileError(f"{path}: no columns of position; expected {forms}")
    a, b, c = (columns[name] for name in form)
    if form == _LOCAL:
        return np.column_stack([a, b, -c])
    if form in (_OF_IMU, _GEODETIC):
        a, b, c = pymap3d.geodetic2ecef(a, b, c)
    r_n_m: FloatArray = (np.column_stack([a, b, c]) - ecef(*place)) @ C_ne(*place[:2]).T
    return r_n_m


def _turned(euler: FloatArray, r_n_m: FloatArray, place: Place) -> FloatArray:
    """Angles against the frame of the place, of angles against the frame of each position."""
    C_n0e = C_ne(*place[:2])
    r_e_m = ecef(*place) + r_n_m @ C_n0e
    lat, lon, _ = pymap3d.ecef2geodetic(*r_e_m.T, deg=False)
    C_n0b = C_n0e @ np.swapaxes(C_ne(lat, lon), -1, -2) @ matrix_from_euler(euler)
    return np.unwrap(euler_rad(quaternion_from_matrix(C_n0b)), axis=0)


def _check_angles(path: Path, lines: Sequence[int], angles: FloatArray) -> None:
    steep = np.abs(angles[:, 1]) > _STEEPEST_RAD
    if steep.any():
        raise InputFileError(
            f"{path}:{lines[int(np.argmax(steep))]}: pitch_deg: expected up to"
            f" {math.degrees(_STEEPEST_RAD):.0f}° either way"
        )
    wild = (np.abs(np.diff(angles, axis=0)) > _LARGEST_TURN_RAD).any(axis=1)
    if wild.any():
        raise InputFileError(
            f"{path}:{lines[int(np.argmax(wild)) + 1]}: turned by more than"
            f" {math.degrees(_LARGEST_TURN_RAD):.0f}° since the row before it"
        )


def _followed(t_s: FloatArray, position: PPoly) -> PPoly:
    """Angles without roll that follow the course, held while the vehicle stands."""
    finer = max(1, math.ceil(float(np.median(np.diff(t_s))) / _FOLLOWED_S))
    rows = np.arange(t_s.size)
    t_s = np.interp(np.arange((t_s.size - 1) * finer + 1) / finer, rows, t_s)
    north, east, down = position(t_s, 1).T
    level = np.hypot(north, east)
    moving = level > _STANDING_MPS
    if not moving.any():
        return _spline(t_s[[0, -1]], np.zeros((2, 3)))
    course = np.unwrap(np.arctan2(east[moving], north[moving]))
    slope = np.arctan2(-down[moving], level[moving])
    held = [np.interp(t_s, t_s[moving], angle) for angle in (course, slope)]
    return _spline(t_s, np.column_stack([np.zeros(t_s.size), held[1], held[0]]))


def _spline(t_s: FloatArray, values: FloatArray) -> PPoly:
    """Quintic through values (n, k), straight at both ends and beyond."""
    still = np.zeros(values.shape[1])
    ends: Any = [(2, still), (3, still)]
    spline = make_interp_spline(t_s, values, k=5, bc_type=(ends, ends))
    c = np.array([spline(t_s, order) / math.factorial(order) for order in range(5, -1, -1)])
    # The last row starts the piece beyond the end; one second before the first ends there.
    c[:4, -1] = 0.0
    before = c[:, :1].copy()
    before[:4] = 0.0
    before[5] -= before[4]
    x = np.concatenate([[t_s[0] - 1.0], t_s, [t_s[-1] + 1.0]])
    return PPoly(np.concatenate([before, c], axis=1), x)
