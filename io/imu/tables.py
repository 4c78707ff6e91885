"""The `/imu` group of our HDF5 container: columns named as in a CSV, read piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from deepgnss.core.errors import InputFileError
from deepgnss.io.config.aids import ImuUnitsConfig
from deepgnss.io.imu.rows import CHUNK_ROWS, Rows, find_columns, rows_of
from deepgnss.io.input import reading
from deepgnss.io.recording import open_hdf5

GROUP = "imu"


def read_hdf5(path: Path, kind: str, units: ImuUnitsConfig) -> Iterator[Rows]:
    """Rows of `/imu`; attributes `kind`, `gyro`, `accel` there must agree with the config."""
    with open_hdf5(path) as file:
        group = file.get(GROUP)
        if not isinstance(group, h5py.Group) or not len(group):
            raise InputFileError(f"{path}: holds no table /{GROUP}")
        for key, stated in (("kind", kind), ("gyro", units.gyro), ("accel", units.accel)):
            found = group.attrs.get(key, stated)
            if found != stated:
                name = key if key == "kind" else f"units.{key}"
                raise InputFileError(
                    f"{path}: /{GROUP} says {key}: {found}, the config has imu.{name}: {stated}"
                )
        names = list(group)
        columns: list[Any] = [group[name] for name in names]
        places = find_columns(path, names, units, f"/{GROUP}")
        if len({column.shape for column in columns}) > 1:
            raise InputFileError(f"{path}: the columns of /{GROUP} differ in length")
        count = columns[0].shape[0]
        for first in range(0, count, CHUNK_ROWS):
            last = min(first + CHUNK_ROWS, count)
            with reading(path):
                table = np.column_stack([np.asarray(c[first:last], np.float64) for c in columns])
            yield rows_of(np.arange(first + 1, last + 1), table, places)
