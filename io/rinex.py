"""What RINEX observation and navigation files share: bytes in, header lines, names, dates."""

from __future__ import annotations

import gzip
import importlib
import math
import re
import zlib
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple

from deepgnss.core.errors import InputFileError, OutputError
from deepgnss.core.records import UtcParameters
from deepgnss.core.time import GpsTime, leap_seconds_at
from deepgnss.io.input import reading

PROGRAM = "deepgnss"
STATION = "DGNS00XXX"  # marker, monument, receiver, country (unknown) of a long file name

_LABEL = 60  # column where a header label starts
_TICKS = 10_000_000  # of 0.1 µs, the resolution of RINEX epochs


class HeaderLine(NamedTuple):
    """One header line: what stands in front of the label, and the label."""

    content: str
    label: str


# --- reading -------------------------------------------------------------------------------------


def read_text(path: Path) -> str:
    """Return the text of a RINEX file: plain, .gz, .Z, and Hatanaka where its package is at hand.

    Raises
    ------
    InputFileError: missing, unreadable, damaged, or not text.
    """
    with reading(path):
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = _gunzip(data)
    if data[:2] == b"\x1f\x9d" or b"CRINEX VERS" in data[:100]:
        data = _decompress(path, data)
    if not data.strip():
        raise InputFileError(f"{path}: file is empty")
    if b"\0" in data[:4096]:
        raise InputFileError(f"{path}: not a RINEX file (binary data)")
    return data.decode("latin-1").replace("\r\n", "\n")


def _gunzip(data: bytes) -> bytes:
    try:
        return gzip.decompress(data)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"damaged gzip file: {error}") from error


def _decompress(path: Path, data: bytes) -> bytes:
    try:
        hatanaka = importlib.import_module("hatanaka")
    except ImportError as error:
        raise InputFileError(
            f"{path}: Hatanaka-compressed: `pip install hatanaka`, or unpack it with crx2rnx"
        ) from error
    try:
        return bytes(hatanaka.decompress(data))
    except (ValueError, hatanaka.HatanakaException) as error:
        cause = str(error).strip().splitlines()[0]
        raise InputFileError(f"{path}: Hatanaka decompression failed: {cause}") from error


def read_header(path: Path, lines: list[str], kind: str) -> tuple[float, list[HeaderLine]]:
    """Return RINEX version and header lines, the one with END OF HEADER being the last.

    kind: "O" or "N", the file type wanted.
    """
    first = lines[0]
    if first[_LABEL:].strip() != "RINEX VERSION / TYPE":
        raise InputFileError(f"{path}: not a RINEX file (line 1 has no RINEX VERSION / TYPE)")
    try:
        version = float(first[:9])
    except ValueError as error:
        raise InputFileError(f"{path}: line 1: RINEX version '{first[:9].strip()}'") from error
    if not 2.0 <= version < 4.0:
        raise InputFileError(f"{path}: RINEX {version:.2f}: versions 2 and 3 are understood")
    if first[20:21].upper() != kind:
        wanted = {"O": "observation", "N": "navigation"}[kind]
        raise InputFileError(f"{path}: RINEX type '{first[20:40].strip()}' is no {wanted} file")
    header = []
    for line in lines:
        header.append(HeaderLine(line[:_LABEL], line[_LABEL:].strip()))
        if header[-1].label == "END OF HEADER":
            return version, header
    raise InputFileError(f"{path}: no END OF HEADER")


# --- writing -------------------------------------------------------------------------------------


def header_line(content: str, label: str) -> str:
    """One header line: content in columns 1–60, label in 61–80."""
    return f"{content:<{_LABEL}.{_LABEL}}{label}\n"


def version_line(kind: str, systems: str) -> str:
    """First line of a RINEX 3.05 file: kind "O" or "N", systems as letters."""
    name = {"O": "OBSERVATION DATA", "N": "N: GNSS NAV DATA"}[kind]
    system = {"G": "G: GPS", "C": "C: BDS"}.get(systems, "M: MIXED")
    return header_line(f"{3.05:9.2f}{'':11}{name:<20}{system:<20}", "RINEX VERSION / TYPE")


def program_line(time: GpsTime, run_by: str = "") -> str:
    """PGM / RUN BY / DATE, dated by the data: the same input gives the same bytes."""
    date = f"{time.utc():%Y%m%d %H%M%S} UTC"
    return header_line(f"{PROGRAM:<20}{run_by:<20.20}{date:<20}", "PGM / RUN BY / DATE")


def leap_seconds_line(time: GpsTime, utc: UtcParameters | None) -> str:
    """LEAP SECONDS from the broadcast, or else from the table at `time`."""
    if utc is None:
        return header_line(f"{leap_seconds_at(time.utc(0)):6d}", "LEAP SECONDS")
    announced = (utc.leap_future_s, utc.leap_week, utc.leap_day)
    fields = (utc.leap_s, *announced) if utc.leap_week else (utc.leap_s,)
    return header_line("".join(f"{value:6d}" for value in fields), "LEAP SECONDS")


class Calendar(NamedTuple):
    """Date and time of day, seconds rounded to 0.1 µs and below 60."""

    year: int
    month: int
    day: int
    hour: int
    minute: int
    second: float


def calendar(time: GpsTime) -> Calendar:
    """Calendar fields of a GPST instant as RINEX epochs need them."""
    seconds, ticks = divmod(round(time.tow_s * _TICKS), _TICKS)
    at = GpsTime(time.week, 0.0).calendar() + timedelta(seconds=seconds)
    return Calendar(at.year, at.month, at.day, at.hour, at.minute, at.second + ticks / _TICKS)


def long_name(
    kind: str,
    systems: str,
    start: GpsTime,
    duration_s: float,
    interval_s: float | None = None,
    station: str = STATION,
) -> str:
    """Long file name of RINEX 3.05 table A1: `DGNS00XXX_R_20220011200_01M_10Z_GO.rnx`.

    kind: "O" or "N" (which has no interval). systems: letters, e.g. "GC".
    """
    if not re.fullmatch(r"[A-Z0-9]{9}", station):
        raise OutputError(f"station '{station}': a RINEX file name wants 9 capitals or digits")
    content = (systems if len(systems) == 1 else "M") + kind
    rate = [] if interval_s is None else [_rate(interval_s)]
    at = start.calendar()
    parts = [station, "R", f"{at:%Y%j%H%M}", _period(duration_s), *rate, content]
    return "_".join(parts) + ".rnx"


# Units of a file name with the count from which the next one is used.
_PERIODS = (("M", 60.0, 60), ("H", 3600.0, 24), ("D", 86_400.0, 100))
_INTERVALS = (("S", 1.0, 60), *_PERIODS)
_RATES = (("Z", 1.0, 100), ("C", 100.0, 100))  # Hz, hundreds of Hz


def _period(seconds: float) -> str:
    for unit, length_s, limit in _PERIODS:
        count = max(1, math.ceil(seconds / length_s))
        if count < limit:
            return f"{count:02d}{unit}"
    return "00U"


def _rate(interval_s: float) -> str:
    for quantity, units in ((interval_s, _INTERVALS), (1.0 / interval_s, _RATES)):
        for unit, size, limit in units:
            count = round(quantity / size)
            if 1 <= count < limit and math.isclose(count * size, quantity):
                return f"{count:02d}{unit}"
    return "00U"
