"""Inertial logs written in every format that is read: CSV, KF-GINS, NovAtel RAWIMUSA, HDF5.

Digits are enough to read back the same numbers; NovAtel's counts carry what rounding leaves to the
next row, as a unit's own counter does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import ConfigError, OutputError
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.io.config.aids import NovatelModel
from deepgnss.io.config.axes import Matrix, axes_matrix
from deepgnss.io.container import ContainerWriter
from deepgnss.io.imu.novatel import COUNTS, log_line
from deepgnss.io.imu.tables import GROUP
from deepgnss.io.output import OutputFile, Writer

ImuFormat = Literal["csv", "kfgins", "novatel_rawimu", "hdf5"]
ImuKind = Literal["increments", "rates"]

ENDINGS: Final[dict[ImuFormat, str]] = {
    "csv": ".csv",
    "kfgins": ".txt",
    "novatel_rawimu": ".asc",
    "hdf5": ".h5",
}
_NS: Final = 10**9
_NAMES: Final[dict[ImuKind, tuple[str, ...]]] = {
    "increments": tuple(f"dtheta_{x}_rad" for x in "xyz") + tuple(f"dvel_{x}_mps" for x in "xyz"),
    "rates": tuple(f"gyro_{x}_radps" for x in "xyz") + tuple(f"accel_{x}_mps2" for x in "xyz"),
}
_UNITS: Final[dict[ImuKind, dict[str, str]]] = {
    "increments": {"gyro": "rad", "accel": "m/s"},
    "rates": {"gyro": "rad/s", "accel": "m/s^2"},
}


class ImuWriter(Writer):
    """Writes blocks of increments as a log.

    Parameters
    ----------
    path: the log; for HDF5 also a container that is open, which then gets its `/imu`.
    kind: what CSV and HDF5 hold; rates are means over the intervals.
    axes: of the log, as `imu.axes`.
    model: unit whose counts a NovAtel log holds.
    """

    def __init__(
        self,
        path: Path | ContainerWriter,
        file_format: ImuFormat = "csv",
        kind: ImuKind = "increments",
        axes: str | Matrix = "FRD",
        model: NovatelModel | None = None,
    ) -> None:
        if kind == "rates" and file_format in ("kfgins", "novatel_rawimu"):
            raise ConfigError(f"imu.kind: found rates; {file_format} holds increments only")
        if (model is not None) != (file_format == "novatel_rawimu"):
            raise ConfigError("imu.model: expected with format novatel_rawimu, and only then")
        self._kind = kind
        self._axes = axes
        self._format = file_format
        self._model = model
        self._to_log = axes_matrix(axes)  # rows: v_s = v_b @ C_bs
        self._left: FloatArray = np.zeros(6)  # counts owed to the next row
        self._own: ContainerWriter | None = None
        if file_format == "hdf5":
            if isinstance(path, ContainerWriter):
                self._container = path
            else:
                self._own = self._container = ContainerWriter(path)
        elif isinstance(path, ContainerWriter):
            raise ConfigError(f"imu.format: found {file_format}; a container holds hdf5")
        else:
            self._file = OutputFile(path)
            if file_format == "csv":
                self._file.write(",".join(("gps_week", "gps_tow_s", *_NAMES[kind])) + "\n")

    def write(self, block: ImuBlock) -> None:
        """Append a block."""
        readings = np.hstack([block.dtheta_b_rad @ self._to_log, block.dv_b_mps @ self._to_log])
        if self._kind == "rates":
            readings /= block.dt_s[:, np.newaxis]
        weeks, nanoseconds = _gpst(block)
        if self._format == "hdf5":
            columns = dict(zip(_NAMES[self._kind], readings.T, strict=True))
            times = {"gps_week": weeks, "gps_tow_s": nanoseconds / _NS}
            units = _UNITS[self._kind]
            self._container.append_table(GROUP, times | columns, kind=self._kind, **units)
        elif self._file is not None:
            lines: dict[str, Callable[..., Iterable[str]]] = {
                "csv": _csv_lines,
                "kfgins": _kfgins_lines,
                "novatel_rawimu": self._novatel_lines,
            }
            self._file.write("".join(lines[self._format](weeks, nanoseconds, readings)))

    def close(self) -> None:
        """Finish and give the file its final name."""
        super().close()
        if self._own:
            self._own.close()

    def abandon(self) -> None:
        """Stop here: what was written stays under its `.part` name."""
        super().abandon()
        if self._own:
            self._own.close(whole=False)

    def section(self, file: str | None) -> dict[str, Any]:
        """The section `imu` that reads the log back, without grade and lever arm."""
        return section(file, self._format, self._kind, self._axes, self._model)

    def _novatel_lines(
        self, weeks: list[int], nanoseconds: FloatArray, readings: FloatArray
    ) -> Iterable[str]:
        weights = COUNTS[self._model or "FSAS"]
        wanted = (
            np.cumsum(readings / np.repeat([weights.gyro_rad, weights.accel_mps], 3), axis=0)
            + self._left
        )
        whole = np.rint(wanted)
        self._left = wanted[-1] - whole[-1] if len(wanted) else self._left
        counts = np.diff(whole, axis=0, prepend=np.zeros((1, 6))).astype(np.int64)
        if np.abs(counts).max(initial=0) >= 2**31:
            raise OutputError(
                f"{self.path}: cannot write: counts of {self._model} overflow 32 bits"
            )
        for week, ns, row in zip(weeks, nanoseconds, counts.tolist(), strict=True):
            yield log_line(week, _tow(ns), row[3:], row[:3])


def section(
    file: str | None,
    file_format: ImuFormat,
    kind: ImuKind,
    axes: str | Matrix,
    model: NovatelModel | None,
) -> dict[str, Any]:
    """The section `imu` that reads such a log back, without grade and lever arm."""
    rows = axes if isinstance(axes, str) else [list(row) for row in axes]
    keys: dict[str, Any] = {"file": file} if file else {}
    keys |= {"format": file_format, "kind": kind, "units": dict(_UNITS[kind])}
    return keys | ({"model": model} if model else {}) | {"axes": rows}


def _gpst(block: ImuBlock) -> tuple[Any, Any]:
    """GPS weeks and whole ns of week of the ends of intervals."""
    start_s = int(block.origin.tow_s)
    rest_s = block.origin.tow_s - start_s
    total = start_s * _NS + np.rint((block.time_s + rest_s) * _NS).astype(np.int64)
    weeks, nanoseconds = np.divmod(total, SECONDS_PER_WEEK * _NS)
    return weeks + block.origin.week, nanoseconds


def _tow(nanoseconds: int) -> str:
    seconds, rest = divmod(int(nanoseconds), _NS)
    return f"{seconds}.{rest:09d}"


def _csv_lines(weeks: Any, nanoseconds: Any, readings: FloatArray) -> Iterable[str]:
    for week, ns, row in zip(weeks, nanoseconds, readings.tolist(), strict=True):
        yield f"{week},{_tow(ns)}," + ",".join(map(repr, row)) + "\n"


def _kfgins_lines(weeks: Any, nanoseconds: Any, readings: FloatArray) -> Iterable[str]:
    for _, ns, row in zip(weeks, nanoseconds, readings.tolist(), strict=True):
        yield f"{_tow(ns)} " + " ".join(map(repr, row)) + "\n"
