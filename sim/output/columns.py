"""CSV tables written by columns, chunk after chunk: memory does not grow with the length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.output import OutputFile, Writer

CHUNK: Final = 20_000
"""Rows computed at a time."""

TIME_COLUMNS: Final[Mapping[str, int | None]] = {"gps_week": None, "gps_tow_s": 6}


class ColumnTable(Writer):
    """A CSV file of named columns, each with its decimals (None: as it is)."""

    def __init__(self, path: Path, columns: Mapping[str, int | None]) -> None:
        self._digits = tuple(columns.values())
        self._row = ",".join("%s" if d is None else f"%.{d}f" for d in self._digits) + "\n"
        self._file = OutputFile(path)
        self._file.write(",".join(columns) + "\n")

    def write(self, *columns: ArrayLike) -> None:
        """Append rows, given as one array (n,) per column."""
        cells = [
            np.asarray(column).tolist()
            # + 0.0: no -0.000
            if digits is None
            else (np.round(np.asarray(column, dtype=np.float64), digits) + 0.0).tolist()
            for column, digits in zip(columns, self._digits, strict=True)
        ]
        if self._file is not None and cells[0]:
            self._file.write("".join(self._row % row for row in zip(*cells, strict=True)))


def time_columns(start: GpsTime, t_s: FloatArray) -> tuple[list[int], FloatArray]:
    """GPS weeks and seconds of week of true times (n,), s from the start."""
    times = [start.plus(float(t)) for t in t_s]
    return [time.week for time in times], np.array([time.tow_s for time in times])


def instants(
    start: GpsTime, seconds: float, step_s: float, chunk: int = CHUNK
) -> Iterator[FloatArray]:
    """Chunks of true times, s from the start, that are multiples of `step_s` of GPST."""
    first = int(np.ceil(round(start.tow_s / step_s, 6)))
    last = int(np.floor(round((start.tow_s + seconds) / step_s, 6)))
    for low in range(first, last + 1, chunk):
        numbers = np.arange(low, min(low + chunk, last + 1))
        yield np.asarray(numbers * step_s - start.tow_s, dtype=np.float64)
