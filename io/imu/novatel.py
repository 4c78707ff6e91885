"""NovAtel RAWIMUA and RAWIMUSA: raw counts of a unit, in ASCII with a CRC (OEM7 reference manual).

A log gives week and seconds of the end of the interval, a status word, then Z, −Y, X of the
velocity increments and Z, −Y, X of the angle increments as counts. The axes are those of the
unit's SPAN frame, X right, Y forward, Z up, unless it is mounted otherwise.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.io.config.aids import NovatelModel
from deepgnss.io.imu.rows import CHUNK_ROWS, Faults, Rows
from deepgnss.io.input import reading

_FOOT: Final = 0.3048
_ARCSEC: Final = math.pi / 180.0 / 3600.0
_DEG: Final = math.pi / 180.0


class Counts(NamedTuple):
    """Weight of one count."""

    gyro_rad: float
    accel_mps: float


_HG1700: Final = Counts(2.0**-33, 2.0**-27 * _FOOT)
_HG1700_30G: Final = Counts(2.0**-33, 2.0**-26 * _FOOT)
_FSAS: Final = Counts(0.1 * 2.0**-8 * _ARCSEC, 0.05 * 2.0**-15)
_KVH: Final = Counts(0.1 / (3600.0 * 256.0), 0.05 * 2.0**-15)
COUNTS: Final[dict[NovatelModel, Counts]] = {
    "FSAS": _FSAS,
    "STIM300": Counts(2.0**-21 * _DEG, 2.0**-22),
    "HG1700-AG11": _HG1700,
    "HG1700-AG58": _HG1700,
    "HG1700-AG17": _HG1700_30G,
    "HG1700-AG62": _HG1700_30G,
    "HG1900": _HG1700,
    "HG1930": _HG1700,
    "HG4930": Counts(2.0**-33, 2.0**-29),
    "LN200": Counts(2.0**-19, 2.0**-14),
    "ADIS16488": Counts(720.0 / 2.0**31 * _DEG, 200.0 / 2.0**31),
    "uIMU": Counts(1e-9, 2e-8),
    "ISA100C": Counts(1e-9, 2e-8),
    "KVH1750": _KVH,
    "CPT": _KVH,
}
"""Weights of the counts by unit (log RAWIMUSX, table of raw IMU scale factors)."""


def crc32(text: bytes) -> int:
    """NovAtel's checksum of what stands between the sync character and the star."""
    return zlib.crc32(text, 0xFFFFFFFF) ^ 0xFFFFFFFF


def read_novatel(path: Path, model: NovatelModel, faults: Faults) -> Iterator[Rows]:
    """Rows of the RAWIMUA and RAWIMUSA logs in a file; other logs are passed over."""
    weights = COUNTS[model]
    scale = np.array([weights.accel_mps] * 3 + [weights.gyro_rad] * 3)
    lines: list[int] = []
    table: list[tuple[float, ...]] = []
    seen = False
    with reading(path), path.open("rb") as file:
        for number, line in enumerate(file, 1):
            row = _parse(line, number, faults)
            if row is None:
                continue
            lines.append(number)
            table.append(row)
            if len(lines) == CHUNK_ROWS:
                yield _rows(lines, table, scale)
                lines, table, seen = [], [], True
    if lines:
        yield _rows(lines, table, scale)
    elif not seen:
        raise InputFileError(f"{path}: holds no RAWIMUA or RAWIMUSA log with a right checksum")


def _parse(line: bytes, number: int, faults: Faults) -> tuple[float, ...] | None:
    """Week, seconds and six counts as the log orders them; None for what is no good log."""
    start = max(line.rfind(b"%RAWIMUSA,"), line.rfind(b"#RAWIMUA,"))
    if start < 0:
        return None
    body, star, check = line[start + 1 :].partition(b"*")
    try:
        right = crc32(body) == int(check[:8], 16)
        fields = body.split(b";", 1)[1].split(b",")
        values = (float(fields[0]), float(fields[1]), *(float(x) for x in fields[3:9]))
    except (ValueError, IndexError):
        right = False
    if not (star and right and len(values) == 8):
        faults.add("logs cut short or with a wrong checksum left out", number)
        return None
    return values


def _rows(lines: list[int], table: list[tuple[float, ...]], scale: FloatArray) -> Rows:
    numbers = np.array(table)
    zyx = numbers[:, 2:] * scale
    flip = np.array([1.0, -1.0, 1.0])
    accel, gyro = zyx[:, 2::-1] * flip, zyx[:, 5:2:-1] * flip
    return Rows(np.array(lines, dtype=np.int64), numbers[:, 0], numbers[:, 1], gyro, accel)


def log_line(week: int, tow: str, accel: list[int], gyro: list[int]) -> str:
    """One RAWIMUSA log: increments in counts along X, Y, Z."""
    (ax, ay, az), (gx, gy, gz) = accel, gyro
    body = f"RAWIMUSA,{week},{float(tow):.3f};{week},{tow},00000000,{az},{-ay},{ax},{gz},{-gy},{gx}"
    return f"%{body}*{crc32(body.encode()):08x}\n"
