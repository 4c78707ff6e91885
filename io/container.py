"""Our HDF5 container: one file that can hold samples, IMU and truth.

/            attribute `start`: UTC of the first sample, ISO 8601 (optional)
/if/<name>   samples of stream <name>, chunked or not; attributes: the keys of `StreamFormat`,
             nested ones with a dot ("packing.order"). int8, int16 and float32 samples lie as
             numbers of that type, shape (n,) or (n, 2); packed ones as bytes, shape (n,).
/imu, /truth groups of one dataset per column, all of one length; attributes at will.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter, ValidationError

from deepgnss.core.errors import InputFileError, RecordingError
from deepgnss.io.formats import RecordingDescription, StreamFormat, as_utc
from deepgnss.io.output import part_path, reporting
from deepgnss.io.recording import open_hdf5

_TYPES = {"int8": "i1", "int16": "<i2", "float32": "<f4"}
_FORMAT = TypeAdapter(StreamFormat)
_CHUNK_BYTES = 1 << 20


class ContainerWriter:
    """Writes a container; the file has its final name only once it is whole.

    Raises
    ------
    OutputError: here and in every method: the file cannot be written.
    """

    def __init__(self, path: Path, start: datetime | None = None) -> None:
        """`start`: UTC of the first sample."""
        self.path = path
        with reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            self._file = h5py.File(part_path(path), "w")
        if start is not None:
            self._file.attrs["start"] = as_utc(start).isoformat()

    def add_stream(self, stream: StreamFormat, compression: str | None = None) -> None:
        """Add an empty stream; `compression` as in h5py (`"gzip"`)."""
        kind = np.dtype(_TYPES.get(stream.format, "u1"))
        row = () if stream.is_packed or stream.values_per_frame == 1 else (stream.values_per_frame,)
        rows = max(_CHUNK_BYTES // (kind.itemsize * stream.values_per_frame), 1)
        with reporting(self.path):
            dataset = self._file.create_dataset(
                f"if/{stream.name}",
                shape=(0, *row),
                maxshape=(None, *row),
                chunks=(rows, *row),
                dtype=kind,
                compression=compression,
            )
            for key, value in _flat(_FORMAT.dump_python(stream, exclude={"file", "dataset"})):
                dataset.attrs[key] = value

    def append(self, name: str, data: ArrayLike) -> None:
        """Append to stream `name`: rows of numbers as the file holds them, or packed bytes."""
        dataset = self._file[f"if/{name}"]
        rows = np.asarray(data, dataset.dtype).reshape(-1, *dataset.shape[1:])
        with reporting(self.path):
            first = dataset.shape[0]
            dataset.resize(first + rows.shape[0], axis=0)
            dataset[first:] = rows

    def add_table(
        self, name: str, columns: Mapping[str, ArrayLike], **attributes: str | float
    ) -> None:
        """Add a group of columns (`imu`, `truth`) with its attributes."""
        with reporting(self.path):
            group = self._file.create_group(name, track_order=True)
            for key, column in columns.items():
                group[key] = np.asarray(column)
            group.attrs.update(attributes)

    def append_table(
        self, name: str, columns: Mapping[str, ArrayLike], **attributes: str | float
    ) -> None:
        """Append rows to a group of columns; the first call makes it, with its attributes."""
        with reporting(self.path):
            if name not in self._file:
                group = self._file.create_group(name, track_order=True)
                for key, column in columns.items():
                    kind = np.asarray(column).dtype
                    group.create_dataset(key, (0,), kind, maxshape=(None,), chunks=(1 << 14,))
                group.attrs.update(attributes)
            for key, column in columns.items():
                dataset, rows = self._file[name][key], np.asarray(column)
                first = dataset.shape[0]
                dataset.resize(first + rows.size, axis=0)
                dataset[first:] = rows

    def close(self, whole: bool = True) -> None:
        """Close the file and, if it is whole, give it its name."""
        with reporting(self.path):
            self._file.close()
            if whole:
                part_path(self.path).replace(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(whole=kind is None)


def read_container(path: Path) -> RecordingDescription:
    """Streams of a container in alphabetical order, and its start.

    Raises
    ------
    RecordingError
        Not an HDF5 file, no stream in it, or one whose attributes do not describe it.
    """
    with open_hdf5(path) as file:
        streams = file.get("if")
        if not isinstance(streams, h5py.Group) or not len(streams):
            raise RecordingError(f"{path}: holds no stream /if/<name>")
        formats = tuple(_stream_format(path, name, streams[name]) for name in sorted(streams))
        start = file.attrs.get("start")
        try:
            when = as_utc(datetime.fromisoformat(start)) if start is not None else None
        except (TypeError, ValueError):
            raise RecordingError(f"{path}: attribute start {start!r} is no ISO 8601 time") from None
    return RecordingDescription(formats, when)


def read_table(
    path: Path, name: str
) -> tuple[dict[str, NDArray[np.generic]], dict[str, str | float]]:
    """Columns (shape (n,) each) and attributes of group `name` of a container.

    Raises
    ------
    InputFileError
        There is no such group, or its columns differ in length.
    """
    with open_hdf5(path) as file:
        group = file.get(name)
        if not isinstance(group, h5py.Group) or not len(group):
            raise InputFileError(f"{path}: holds no table /{name}")
        columns = {key: np.asarray(group[key]) for key in group}
        attributes = dict(group.attrs)
    if len({column.shape for column in columns.values()}) > 1:
        raise InputFileError(f"{path}: the columns of /{name} differ in length")
    return columns, attributes


def _stream_format(path: Path, name: str, dataset: h5py.Dataset) -> StreamFormat:
    if not isinstance(dataset, h5py.Dataset):
        raise RecordingError(f"{path}: /if/{name} is no dataset")
    description: dict[str, Any] = {"name": name, "file": path, "dataset": f"/if/{name}"}
    for key, value in dataset.attrs.items():
        outer, _, inner = key.partition(".")
        plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        if inner:
            description.setdefault(outer, {})[inner] = plain
        else:
            description[outer] = plain
    try:
        stream = _FORMAT.validate_python(description)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise RecordingError(f"{path}: /if/{name}: attribute {key}: {first['msg']}") from None
    expected = np.dtype(_TYPES.get(stream.format, "u1"))
    if dataset.dtype != expected:
        raise RecordingError(
            f"{path}: /if/{name} holds {dataset.dtype}, but its format {stream.format} needs"
            f" {expected}"
        )
    return stream


def _flat(nested: Mapping[str, Any], outer: str = "") -> list[tuple[str, Any]]:
    """Key, value pairs with dotted keys; None stands for itself by its absence."""
    pairs: list[tuple[str, Any]] = []
    for key, value in nested.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{outer}{key}.")
        elif value is not None:
            pairs.append((f"{outer}{key}", value))
    return pairs
