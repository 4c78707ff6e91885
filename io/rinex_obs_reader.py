"""Bulk reader of RINEX observation files, versions 2.11 and 3: whole columns at a time.

A day of one station at 30 s (150,000 lines) takes seconds where georinex takes an hour;
georinex is the cross-check in the tests.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime, from_calendar
from deepgnss.io.rinex import HeaderLine, read_header, read_text

_WIDTH, _DECIMALS = 14, 3  # F14.3
_FIELD = 16  # with loss of lock and strength

# RINEX 2 names and what they are called in RINEX 3 (band and attribute; table 3 of RINEX 2.11).
_FROM_RINEX2 = {
    kind + old: kind + new for kind in "LDS" for old, new in (("1", "1C"), ("2", "2W"), ("5", "5X"))
} | {"C1": "C1C", "P1": "C1W", "C2": "C2X", "P2": "C2W", "C5": "C5X"}

_Bytes = NDArray[np.uint8]
_Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ObsFile:
    """Observations of one file.

    frame: one row per epoch and satellite, in file order: week, tow_s (in the file's time system
    as declared, BDT brought to GPST), satellite, one float column per observation code ("C1C";
    RINEX 2 codes translated; NaN where missing) and an int8 column `<code>_lli` per phase.
    position_e_m: approximate position of the header, (3,), or None.
    """

    frame: pd.DataFrame
    version: float
    position_e_m: FloatArray | None
    interval_s: float | None
    codes: dict[str, tuple[str, ...]] = field(default_factory=dict)  # by system letter
    lines: NDArray[np.int64] = field(  # first line of each row, from 0
        default_factory=lambda: np.zeros(0, np.int64)
    )

    def place(self, system: str, code: str) -> tuple[int, int]:
        """Where the field of an observation (F14.3, I1, I1) begins: lines after the first, column.

        code: as in `codes`.
        """
        if self.version < 3.0:
            number = self.codes[""].index(code)
            return number // 5, _FIELD * (number % 5)
        return 0, 3 + _FIELD * self.codes[system].index(code)


class _Epoch(NamedTuple):
    time: GpsTime
    satellites: list[str]
    lines: list[int]  # the first line of each satellite's observations


def read_obs(path: Path | str, systems: str | None = None) -> ObsFile:
    """Read an observation file (RINEX 2, 3; .gz, .Z; Hatanaka where its package is installed).

    Parameters
    ----------
    systems: letters of the systems wanted ("GC"); None: all.

    Raises
    ------
    InputFileError: missing, damaged, or no observation file; names file, line, cause.
    """
    path = Path(path)
    text = read_text(path)
    lines = text.split("\n")
    version, header = read_header(path, lines, "O")
    try:
        codes = _codes(header, version)
        shift_s = 14.0 if _time_system(header) == "BDT" else 0.0
        epochs_of = _epochs2 if version < 3.0 else _epochs3
        epochs = epochs_of(lines, len(header), codes)
    except _LineError as error:
        raise InputFileError(f"{path}: {error}") from error
    frame, lines_of_rows = _frame(path, text, epochs, codes, version, systems, shift_s)
    values = {h.label: h.content for h in header}
    return ObsFile(
        frame=frame,
        version=version,
        position_e_m=_position(values.get("APPROX POSITION XYZ", "")),
        interval_s=_first_float(values.get("INTERVAL", "")),
        codes={system: tuple(names) for system, names in codes.items()},
        lines=lines_of_rows,
    )


class _LineError(ValueError):
    def __init__(self, number: int, what: str) -> None:
        super().__init__(f"line {number + 1}: {what}")


# --- header --------------------------------------------------------------------------------------


def _codes(header: list[HeaderLine], version: float) -> dict[str, list[str]]:
    """Observation codes in file order by system letter; "" stands for every system (RINEX 2)."""
    codes: dict[str, list[str]] = {}
    system = ""
    for number, (content, label) in enumerate(header):
        if version < 3.0 and label == "# / TYPES OF OBSERV":
            names = content[6:].split()
            codes.setdefault("", []).extend(_FROM_RINEX2.get(name, name) for name in names)
        elif version >= 3.0 and label == "SYS / # / OBS TYPES":
            system = content[0].strip() or system
            # RINEX 3.02 alone calls B1I 1I.
            names = [
                name[0] + "2I" if system == "C" and name[1:] == "1I" else name
                for name in content[6:].split()
            ]
            codes.setdefault(system, []).extend(names)
        elif version >= 3.0 and label == "SYS / SCALE FACTOR":
            raise _LineError(number, "SYS / SCALE FACTOR is not understood")
    if not any(codes.values()):
        raise _LineError(len(header) - 1, "the header names no observation types")
    return codes


def _time_system(header: list[HeaderLine]) -> str:
    for content, label in header:
        if label == "TIME OF FIRST OBS":
            return content[48:51].strip() or "GPS"
    return "GPS"


def _position(content: str) -> FloatArray | None:
    try:
        position = np.array([float(x) for x in content.split()])
    except ValueError:
        return None
    return position if position.shape == (3,) and position.any() else None


def _first_float(content: str) -> float | None:
    try:
        return float(content.split()[0]) or None
    except (ValueError, IndexError):
        return None


# --- epochs --------------------------------------------------------------------------------------


def _time(number: int, fields: list[str]) -> GpsTime:
    try:
        year, month, day, hour, minute = (int(x) for x in fields[:5])
        if year < 100:
            year += 1900 if year >= 80 else 2000
        return from_calendar(datetime(year, month, day, hour, minute)).plus(float(fields[5]))
    except (ValueError, IndexError):
        raise _LineError(number, f"'{' '.join(fields)}' is not a date") from None


def _flag_and_count(number: int, line: str, flag: int) -> tuple[int, int]:
    try:
        return int(line[flag : flag + 1] or 0), int(line[flag + 1 : flag + 4] or 0)
    except ValueError:
        raise _LineError(number, f"'{line.strip()}' is not an epoch line") from None


def _is_header(line: str) -> bool:
    return line[60:].strip() == "RINEX VERSION / TYPE"


def _after_header(lines: list[str], number: int) -> int:
    """First line behind a further header: files glued together, with the same observations."""

    def types(first: int) -> tuple[list[str], int]:
        found: list[str] = []
        for end in range(first, len(lines)):
            label = lines[end][60:].strip()
            if label == "END OF HEADER":
                return found, end + 1
            if label == "SYS / # / OBS TYPES":
                found.append(lines[end].rstrip())
        return [], first

    names, end = types(number)
    if not names or names != types(0)[0]:
        raise _LineError(
            number, "a header other than the first: two files glued together, take them apart"
        )
    return end


def _later_counts(earlier: list[_Epoch], later: list[_Epoch]) -> list[_Epoch]:
    """Epochs of two parts: where both have one, that of the second, which was written last."""
    told = {epoch.time for epoch in later}
    return [epoch for epoch in earlier if epoch.time not in told] + later


def _epochs3(lines: list[str], first: int, codes: dict[str, list[str]]) -> list[_Epoch]:
    epochs: list[_Epoch] = []
    number = first
    while number < len(lines):
        line = lines[number]
        if not line.strip():
            number += 1
            continue
        if _is_header(line):
            return _later_counts(epochs, _epochs3(lines, _after_header(lines, number), codes))
        if line[0] != ">":
            raise _LineError(number, f"an epoch line ('>') is missing ({line[:40].strip()})")
        flag, count = _flag_and_count(number, line, 31)
        if flag <= 1:
            at = list(range(number + 1, number + 1 + count))
            if at and at[-1] >= len(lines):
                raise _LineError(number, f"file ends within the epoch of {count} satellites")
            satellites = [_satellite(k, lines[k][:3]) for k in at]
            for k, name in zip(at, satellites, strict=True):
                if name[0] not in codes:
                    raise _LineError(k, f"system '{name[0]}' is not in the header")
            epochs.append(_Epoch(_time(number, line[1:29].split()), satellites, at))
        number += 1 + count
    return epochs


def _epochs2(lines: list[str], first: int, codes: dict[str, list[str]]) -> list[_Epoch]:
    per_satellite = -(-len(codes[""]) // 5)
    epochs = []
    number = first
    while number < len(lines):
        line = lines[number]
        if not line.strip():
            number += 1
            continue
        flag, count = _flag_and_count(number, line, 28)
        if flag > 1:
            number += 1 + count
            continue
        head = max(1, -(-count // 12))
        names = "".join(
            f"{lines[k][32:68]:<36}" for k in range(number, min(number + head, len(lines)))
        )
        satellites = [_satellite(number, names[3 * k : 3 * k + 3]) for k in range(count)]
        at = [number + head + per_satellite * k for k in range(count)]
        if at and at[-1] + per_satellite > len(lines):
            raise _LineError(number, f"file ends within the epoch of {count} satellites")
        epochs.append(_Epoch(_time(number, line[:26].split()), satellites, at))
        number += head + per_satellite * count
    return epochs


def _satellite(number: int, name: str) -> str:
    try:
        return f"{name[0].strip() or 'G'}{int(name[1:3]):02d}"
    except (ValueError, IndexError):
        raise _LineError(number, f"'{name}' is not a satellite") from None


# --- observations --------------------------------------------------------------------------------


def _frame(
    path: Path,
    text: str,
    epochs: list[_Epoch],
    codes: dict[str, list[str]],
    version: float,
    systems: str | None,
    shift_s: float,
) -> tuple[pd.DataFrame, _Indices]:
    sizes = [len(epoch.satellites) for epoch in epochs]
    times = [epoch.time.plus(shift_s) for epoch in epochs]
    satellites = np.array([name for epoch in epochs for name in epoch.satellites], dtype="U3")
    first_lines = np.array([k for epoch in epochs for k in epoch.lines], dtype=np.int64)
    letters = satellites.astype("U1")
    data = np.frombuffer(text.encode("latin-1") + b"\n", dtype=np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    starts = np.concatenate(([0], ends[:-1] + 1))

    columns: dict[str, FloatArray] = {}
    losses: dict[str, NDArray[np.int8]] = {}
    for system, names in codes.items():
        rows = np.flatnonzero(letters == system) if system else np.arange(len(satellites))
        if (systems is not None and system and system not in systems) or not len(rows):
            continue
        for place, code in enumerate(names):
            if version < 3.0:
                line, offset = first_lines[rows] + place // 5, _FIELD * (place % 5)
            else:
                line, offset = first_lines[rows], 3 + _FIELD * place
            characters = _characters(data, starts[line] + offset, ends[line])
            values = _fixed_point(path, characters[:, :_WIDTH], line)
            if version < 3.0 or code[0] != "D":  # 0.000 may stand for missing
                values[values == 0.0] = np.nan
            columns.setdefault(code, np.full(len(satellites), np.nan))[rows] = values
            if code[0] == "L":
                lost = characters[:, _WIDTH].astype(np.int16) - ord("0")
                lost = np.where((lost >= 0) & (lost <= 7), lost, 0).astype(np.int8)
                losses.setdefault(code + "_lli", np.zeros(len(satellites), np.int8))[rows] = lost
    frame = pd.DataFrame(
        {
            "week": np.repeat(np.array([t.week for t in times], dtype=np.int64), sizes),
            "tow_s": np.repeat(np.array([t.tow_s for t in times], dtype=np.float64), sizes),
            "satellite": satellites.astype(object),
            **columns,
            **losses,
        }
    )
    if systems is None:
        return frame, first_lines
    wanted = np.isin(letters, list(systems))
    return frame[wanted].reset_index(drop=True), first_lines[wanted]


def _characters(data: _Bytes, start: _Indices, end: _Indices) -> _Bytes:
    """One field of many lines: (n, 16) characters, blanks beyond the end of a line."""
    places = start[:, None] + np.arange(_FIELD)
    inside = places < end[:, None]
    return np.where(inside, data[np.where(inside, places, 0)], np.uint8(ord(" ")))


def _fixed_point(path: Path, characters: _Bytes, lines: _Indices) -> FloatArray:
    """Values of F14.3 fields, NaN where blank."""
    blank = (characters == ord(" ")).all(axis=1)
    digits = characters.astype(np.int64) - ord("0")
    is_digit = (digits >= 0) & (digits <= 9)
    point = _WIDTH - 1 - _DECIMALS
    minus = characters == ord("-")
    # Right-aligned as the format says: blanks, sign, digits, point, three digits.
    lead = np.cumsum(is_digit[:, :point], axis=1) == 0
    regular = (
        (characters[:, point] == ord("."))
        & is_digit[:, point + 1 :].all(axis=1)
        & (is_digit[:, :point] | (lead & (minus | (characters == ord(" ")))[:, :point])).all(axis=1)
        & (minus.sum(axis=1) <= 1)
    )
    powers = 10 ** np.array([*range(12, 2, -1), 0, 2, 1, 0], dtype=np.int64)
    powers[point] = 0
    magnitude = np.where(is_digit, digits, 0) @ powers / 10**_DECIMALS
    values: FloatArray = np.where(minus.any(axis=1), -magnitude, magnitude)
    for k in np.flatnonzero(~regular & ~blank)[:1]:
        text = characters[k].tobytes().decode("latin-1")
        raise InputFileError(f"{path}: line {lines[k] + 1}: '{text}' is not a number in F14.3")
    values[blank] = np.nan
    return values
