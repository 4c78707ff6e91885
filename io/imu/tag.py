"""RTKLIB time tags beside a log: when its bytes came in, and what that says of its own clock.

A tag file holds 60 characters of title, the tick count and the GPST at which the log was opened
(u4; u4 seconds since 1970, f8 fraction), then pairs of u4: ms since then and bytes written so far.
"""

from __future__ import annotations

import struct
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime, from_calendar
from deepgnss.io.input import reading

_HEAD: Final = 60
_START: Final = struct.Struct("<IId")
_BIN_S: Final = 1.0


class TagLine(NamedTuple):
    """The log's clock on GPST: seconds since `opened` = first_s + slope·(tick − first_tick)."""

    opened: GpsTime
    first_tick: float
    first_s: float
    slope: float  # seconds per tick

    def seconds(self, ticks: FloatArray) -> FloatArray:
        """Seconds since `opened` of ticks (n,)."""
        return self.first_s + self.slope * (ticks - self.first_tick)


def read_tags(path: Path) -> tuple[GpsTime, FloatArray, FloatArray]:
    """GPST of the log's opening, and arrival times in s since then and bytes by then, (n,) each."""
    with reading(path):
        data = path.read_bytes()
    if not data.startswith(b"TIMETAG RTKLIB") or len(data) < _HEAD + _START.size + 8:
        raise InputFileError(f"{path}: not an RTKLIB time tag file")
    _, seconds, fraction = _START.unpack_from(data, _HEAD)
    opened = from_calendar(datetime(1970, 1, 1) + timedelta(seconds=seconds)).plus(fraction)
    body = data[_HEAD + _START.size :]
    pairs = np.frombuffer(body[: len(body) // 8 * 8], "<u4").reshape(-1, 2)
    return opened, pairs[:, 0] * 1e-3, pairs[:, 1].astype(np.float64)


def fit_tags(
    tag_file: Path, log: Path, lines: NDArray[np.int64], ticks: FloatArray, tick_s: float
) -> TagLine:
    """Lay the ticks of a log's rows on GPST by its time tags.

    A row cannot come in before it was measured, and some come in at once: the line of the ticks
    runs along the lower edge of the arrival times, where it touches them on both sides of the
    middle. What every row is late by stays in it; the config's `time_offset` takes that off.
    """
    opened, arrival_s, written = read_tags(tag_file)
    with reading(log):
        data = log.read_bytes()
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n")) + 1.0
    lost = written[-1] - len(data)
    if ends.size and abs(lost - ends.size) <= 1.0:  # logged with CR LF, kept with LF
        ends += np.arange(1, ends.size + 1)
    elif not 0.0 <= lost < 4096.0:
        raise InputFileError(
            f"{tag_file}: counts {written[-1]:.0f} bytes, {log} has {len(data)}: not its time tags"
        )
    known = lines <= ends.size
    ends, ticks = ends[lines[known] - 1], ticks[known]
    came = np.searchsorted(written, ends)
    known = came < arrival_s.size
    return _lower_edge(opened, ticks[known], arrival_s[came[known]], tick_s)


def _lower_edge(opened: GpsTime, ticks: FloatArray, came_s: FloatArray, tick_s: float) -> TagLine:
    x = (ticks - ticks[0]) * tick_s
    bins = np.floor(x / _BIN_S).astype(np.int64)
    order = np.lexsort((came_s - x, bins))
    lowest = order[np.unique(bins[order], return_index=True)[1]]
    edge: list[tuple[float, float]] = []
    for px, py in zip(x[lowest].tolist(), (came_s - x)[lowest].tolist(), strict=True):
        while len(edge) > 1 and _turns_down(edge[-2], edge[-1], (px, py)):
            edge.pop()
        edge.append((px, py))
    middle = 0.5 * (x[0] + x[-1])
    k = next((i for i in range(1, len(edge)) if edge[i][0] >= middle), len(edge) - 1)
    (x0, y0), (x1, y1) = edge[max(k - 1, 0)], edge[k]
    drift = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
    return TagLine(opened, float(ticks[0]), y0 - drift * x0, tick_s * (1.0 + drift))


def _turns_down(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
