"""Recordings: files of raw samples as random-access streams of `SampleBlock`s.

Files are memory-mapped and never read whole; a block of samples is the same whatever was read
before it.
"""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol, Self

import h5py
import numpy as np

from deepgnss.core.errors import RecordingError
from deepgnss.core.records import PackedSamples, SampleBlock, Samples, StreamInfo
from deepgnss.io.formats import StreamFormat
from deepgnss.io.samples import FLOAT_RMS, Bytes, arrange, samples_by_byte, unpack_values


class ByteSource(Protocol):
    """Bytes that can be read anywhere; `size` is fixed when it is opened."""

    size: int

    def read(self, first: int, last: int) -> Bytes:
        """Bytes [first, last), shape (last − first,)."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


_RESIDENT_BYTES = 64_000_000  # of a mapped file, before its pages are given back


class FileBytes:
    """A memory-mapped file. Reads are views of the file, written to by nobody.

    The map is copy-on-write: arrays look writable, as kernels compiled for ordinary arrays want
    them, and still nothing can reach the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = open_readable(path)
        self.size = path.stat().st_size
        if self.size == 0:
            self._file.close()
            raise RecordingError(f"{path}: the recording is empty (0 bytes)")
        self._map = mmap.mmap(self._file.fileno(), self.size, access=mmap.ACCESS_COPY)
        self._bytes = np.frombuffer(self._map, np.uint8)
        self._resident = 0

    def read(self, first: int, last: int) -> Bytes:
        """Bytes [first, last), a view; a file that shrank meanwhile is an error."""
        size = os.fstat(self._file.fileno()).st_size
        if size < last:
            raise RecordingError(
                f"{self._path}: shrank from {self.size} to {size} bytes while it was read"
            )
        self._resident += last - first
        if self._resident > _RESIDENT_BYTES and hasattr(mmap, "MADV_DONTNEED"):
            # Pages read so far count as this program's memory until they are given back; blocks
            # handed out stay good: what is looked at again comes back from the file.
            self._map.madvise(mmap.MADV_DONTNEED)
            self._resident = last - first
        return self._bytes[first:last]

    def close(self) -> None:
        """Close the file; blocks already handed out keep the map alive until they are gone."""
        del self._bytes
        self._file.close()


class DatasetBytes:
    """The raw bytes of a dataset (any integer or float type, chunked or not) in an HDF5 file."""

    def __init__(self, path: Path, name: str) -> None:
        self._file = open_hdf5(path)
        dataset = self._file.get(name)
        if not isinstance(dataset, h5py.Dataset) or dataset.ndim == 0:
            self._file.close()
            raise RecordingError(f"{path}: holds no dataset {name}")
        self._dataset = dataset
        self._row_bytes = dataset.dtype.itemsize * math.prod(dataset.shape[1:])
        self.size = self._row_bytes * dataset.shape[0]
        if self.size == 0:
            self._file.close()
            raise RecordingError(f"{path}: dataset {name} is empty")

    def read(self, first: int, last: int) -> Bytes:
        """Bytes [first, last), a copy."""
        row = first // self._row_bytes
        rows = np.ascontiguousarray(self._dataset[row : -(-last // self._row_bytes)])
        start = first - row * self._row_bytes
        return rows.reshape(-1).view(np.uint8)[start : start + last - first]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class _Stream:
    info: StreamInfo
    format: StreamFormat
    source: ByteSource
    origin: str  # file (and dataset) for messages
    float_factor: float
    by_byte: Samples | None  # `samples_by_byte`


class Recording:
    """An open recording; use it in a `with` statement, or call `close`.

    Attributes
    ----------
    streams: one `StreamInfo` per stream, in the order of the description.
    notes: remarks for the user, one line each (e.g. bytes left over at the end of a file).
    """

    def __init__(self, formats: Sequence[StreamFormat], path: Path | None = None) -> None:
        """Open the files of all streams.

        Parameters
        ----------
        formats: description of the streams. path: file of those streams that name none.

        Raises
        ------
        RecordingError
            A file that is missing, empty, a directory, not readable, too small for one sample, or
            that ends in the middle of a number.
        """
        if not formats:
            raise RecordingError(f"{path}: no stream of samples is described")
        self._sources: dict[tuple[Path, str | None], ByteSource] = {}
        self._streams: list[_Stream] = []
        notes: list[str] = []
        try:
            for stream in formats:
                opened, remark = self._open_stream(stream, path)
                self._streams.append(opened)
                notes += remark
        except BaseException:
            self.close()
            raise
        self.streams: tuple[StreamInfo, ...] = tuple(s.info for s in self._streams)
        self.notes: tuple[str, ...] = tuple(dict.fromkeys(notes))

    def read(self, stream: int | str, first: int, count: int) -> SampleBlock:
        """Samples [first, first + count) of a stream given by place or name.

        Raises
        ------
        RecordingError
            No such stream, or samples outside the recording.
        """
        s = self._find(stream)
        if first < 0 or count < 0 or first + count > s.info.sample_count:
            raise RecordingError(
                f"{s.origin}: stream {s.info.name} has samples 0 … {s.info.sample_count - 1},"
                f" not {first} … {first + count - 1}"
            )
        return SampleBlock(s.info, first, _read_samples(s, first, count))

    def close(self) -> None:
        """Close all files."""
        for source in self._sources.values():
            source.close()
        self._sources.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _find(self, stream: int | str) -> _Stream:
        if not self._sources:
            raise RecordingError(f"{self._streams[0].origin}: the recording is closed")
        for place, s in enumerate(self._streams):
            if stream in (place, s.info.name):
                return s
        names = ", ".join(s.info.name for s in self._streams)
        raise RecordingError(f"no stream {stream!r} in the recording (it has {names})")

    def _open_stream(
        self, stream: StreamFormat, path: Path | None
    ) -> tuple[_Stream, tuple[str, ...]]:
        file = stream.file or path
        if file is None:
            raise RecordingError(f"stream {stream.name}: no file given")
        origin = f"{file}:{stream.dataset}" if stream.dataset else str(file)
        key = (file, stream.dataset)
        if key not in self._sources:
            self._sources[key] = (
                DatasetBytes(file, stream.dataset) if stream.dataset else FileBytes(file)
            )
        source = self._sources[key]
        count, notes = _count_samples(stream, source.size, origin)
        inverted = stream.spectrum == "inverted"
        info = StreamInfo(
            name=stream.name,
            sample_rate_hz=stream.sample_rate_hz,
            centre_hz=stream.centre_hz,
            intermediate_hz=-stream.intermediate_hz if inverted else stream.intermediate_hz,
            is_complex=stream.samples == "iq",
            sample_count=count,
        )
        opened = _Stream(info, stream, source, origin, 1.0, samples_by_byte(stream))
        if stream.format == "float32":
            opened = replace(opened, float_factor=_float_factor(opened))
        return opened, notes


def open_readable(path: Path) -> BinaryIO:
    """Open a file for reading, or say in one line why not."""
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory, not a recording")
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: is no ordinary file; samples are read at random places")
        return path.open("rb")
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading, or say in one line why not."""
    open_readable(path).close()
    try:
        return h5py.File(path, "r")
    except OSError as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(f"{path}: is no readable HDF5 file ({reason})") from error


def _count_samples(stream: StreamFormat, size: int, origin: str) -> tuple[int, tuple[str, ...]]:
    """Whole samples in a file of `size` bytes, and a remark when bytes are left over."""
    block, available = stream.block, size - stream.offset
    payload, cut_block = available, 0
    if block.payload:
        period = block.header + block.payload + block.footer
        whole, cut_block = divmod(available, period)
        payload = whole * block.payload + min(max(cut_block - block.header, 0), block.payload)
    words, cut_word = divmod(payload, stream.word_bytes)
    frames, spare = divmod(words * stream.values_per_word, stream.values_per_frame)
    if frames < 1:
        raise RecordingError(
            f"{origin}: {size} bytes are too few for one sample of stream {stream.name}"
            f" ({stream.format} {stream.samples}, offset {stream.offset})"
        )
    if cut_block:
        return frames, (
            f"{origin}: ends within a block ({cut_block} of {period} bytes): truncated?"
            " the part that is there is used",
        )
    if cut_word:
        raise RecordingError(
            f"{origin}: {cut_word} byte(s) left over: {payload} bytes of samples do not hold whole"
            f" {stream.word_bytes}-byte {stream.format} words: wrong format or offset, or truncated"
        )
    if spare >= stream.values_per_word:  # fewer only fill up the last word
        return frames, (
            f"{origin}: {spare} value(s) left over at the end, less than a sample of"
            f" {stream.values_per_frame}: truncated?",
        )
    return frames, ()


def _read_samples(s: _Stream, first: int, count: int) -> Samples | PackedSamples:
    """Samples [first, first + count): shape (count,) real or (count, 2), or as they are packed."""
    if s.by_byte is not None:
        first_byte, skip = divmod(first, s.by_byte.shape[1])
        data = _read_payload(s, first_byte, -(-(first + count) // s.by_byte.shape[1]))
        return PackedSamples(data, s.by_byte, skip, count)
    stream = s.format
    first_value = first * stream.values_per_frame
    last_value = first_value + count * stream.values_per_frame
    first_word = first_value // stream.values_per_word
    last_word = -(-last_value // stream.values_per_word)
    data = _read_payload(s, first_word * stream.word_bytes, last_word * stream.word_bytes)
    values = unpack_values(data, stream, s.float_factor)
    skip = first_value - first_word * stream.values_per_word
    return arrange(values[skip : skip + last_value - first_value], stream)


def _read_payload(s: _Stream, first: int, last: int) -> Bytes:
    """Bytes [first, last) of the samples alone, counted without headers and footers."""
    block, offset = s.format.block, s.format.offset
    if not block.payload or first == last:
        return s.source.read(offset + first, offset + last)
    period = block.header + block.payload + block.footer
    pieces = []
    for b in range(first // block.payload, (last - 1) // block.payload + 1):
        start, begin = b * block.payload, offset + b * period + block.header
        pieces.append(
            s.source.read(begin + max(first - start, 0), begin + min(last - start, block.payload))
        )
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _float_factor(s: _Stream) -> float:
    """What float32 samples are multiplied by: from 64 short pieces spread over the recording."""
    stream = s.format
    frame_bytes = 4 * stream.values_per_frame
    length = min(4096, s.info.sample_count)
    power, finite = 0.0, 0
    for first in np.linspace(0, s.info.sample_count - length, 64).astype(np.int64).tolist():
        data = _read_payload(s, first * frame_bytes, (first + length) * frame_bytes)
        with np.errstate(invalid="ignore"):  # NaNs of any kind are data here
            values = np.require(data.view("<f4"), requirements="A").astype(np.float64)
        values = values[np.isfinite(values)]
        power += float(np.sum(values**2))
        finite += values.size
    return FLOAT_RMS / math.sqrt(power / finite) if power > 0.0 else 1.0
