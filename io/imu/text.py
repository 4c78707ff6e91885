"""Inertial logs as text: CSV with or without a header, KF-GINS increments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.errors import InputFileError
from deepgnss.io.config.aids import ImuUnitsConfig
from deepgnss.io.imu.rows import CHUNK_ROWS, NEEDED, Rows, find_columns, rows_of
from deepgnss.io.input import reading

_COMMENTS: Final = ("#", "%", "//")


def read_csv(path: Path, columns: Sequence[str] | None, units: ImuUnitsConfig) -> Iterator[Rows]:
    """Rows of a CSV, by the names in its header or by `columns`, names in file order.

    Commas, semicolons, tabs or blanks may part the fields; comments may stand on top.
    """
    (first, text), (_, second) = _first_lines(path)
    separator = next((mark for mark in (",", ";", "\t") if mark in text), r"\s+")
    fields = _fields(text, separator)
    has_header = not any(_is_number(field) for field in fields)
    if not has_header and columns is None:
        raise InputFileError(
            f"{path}:{first}: found {text[:40]!r}; expected a header with names of columns"
            " (state them as imu.columns)"
        )
    names = list(columns) if columns is not None else fields
    where = "imu.columns" if columns is not None else "the header"
    count = len(_fields(second, separator))
    if count > len(names):
        raise InputFileError(
            f"{path}: rows of {count} fields, {where} names {len(names)} (a - passes one over)"
        )
    places = find_columns(path, names, units, where)
    yield from _rows(path, separator, first - 1 + has_header, names, places)


def read_kfgins(path: Path) -> Iterator[Rows]:
    """Rows of KF-GINS text: seconds of week, three Δθ in rad, three Δv in m/s."""
    (first, _), _ = _first_lines(path)
    places = {key: place for place, key in enumerate(NEEDED)}
    yield from _rows(path, r"\s+", first - 1, list(NEEDED), places)


def _rows(
    path: Path, separator: str, skipped: int, names: list[str], places: dict[str, int]
) -> Iterator[Rows]:
    with reading(path):
        chunks = pd.read_csv(
            path,
            sep=separator,
            header=None,
            names=range(len(names)),
            index_col=False,
            usecols=sorted(places.values()),
            skiprows=skipped,
            skip_blank_lines=False,
            chunksize=CHUNK_ROWS,
            low_memory=False,
            encoding="latin-1",
        )
    kept = {column: place for place, column in enumerate(sorted(places.values()))}
    order = {key: kept[place] for key, place in places.items()}
    line = skipped + 1
    with chunks:
        while True:
            with reading(path):
                frame = next(chunks, None)
            if frame is None:
                return
            numbers = frame.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
            lines = np.arange(line, line + len(numbers))
            line += len(numbers)
            yield rows_of(lines, numbers, order)


def _first_lines(path: Path) -> tuple[tuple[int, str], tuple[int, str]]:
    """Numbers and texts of the first two lines that are neither empty nor comments."""
    found: list[tuple[int, str]] = []
    with reading(path), path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, 1):
            text = line.strip()
            if text and not text.startswith(_COMMENTS):
                found.append((number, text))
            if len(found) == 2:
                return found[0], found[1]
    raise InputFileError(f"{path}: holds no data")


def _fields(text: str, separator: str) -> list[str]:
    parts = text.split() if separator == r"\s+" else text.split(separator)
    return [part.strip() for part in parts]


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True
