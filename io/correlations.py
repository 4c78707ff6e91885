"""HDF5 file with correlator outputs: `/<satellite>/<signal>/{taps, first_sample, row, seconds}`.

HDF5 has no state on disk that survives a kill between two of its own writes. The file is therefore
opened only to append what has been gathered, and closed again: at any other moment it is whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import OutputError
from deepgnss.core.records import Correlations
from deepgnss.io.output import Closing, part_path, reporting

_CHUNK_ROWS = 4096
_FLUSH_ROWS = 1 << 16


class CorrelationWriter(Closing):
    """Appends correlations of all channels; bounded memory.

    Per channel group: `taps` complex64 (rows, taps), one row per code period; and per record
    `first_sample` int64 (of its first period), `row` int64 (where it starts in taps) and
    `seconds` float64 (length of one period).

    Parameters
    ----------
    tap_chips: signal name → offsets of its taps from prompt, in chips, early positive; kept as
        the attribute `tap_chips` of each group.
    """

    def __init__(self, path: Path, tap_chips: Mapping[str, tuple[float, ...]]) -> None:
        self.path = path
        self._tap_chips = tap_chips
        self._pending: dict[str, list[Correlations]] = {}
        self._pending_rows = 0
        self._rows: dict[str, int] = {}
        self._open = True
        with reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            h5py.File(part_path(path), "w").close()

    def write(self, satellite: str, signal: str, correlations: Correlations) -> None:
        """Append the code periods of one record of one channel."""
        width = len(self._tap_chips[signal])
        if correlations.taps.shape[1] != width:
            raise OutputError(
                f"{self.path}: {satellite} {signal}: {correlations.taps.shape[1]} taps, "
                f"{width} were announced"
            )
        self._pending.setdefault(f"{satellite}/{signal}", []).append(correlations)
        self._pending_rows += len(correlations.taps)
        if self._pending_rows >= _FLUSH_ROWS:
            self.flush()

    def flush(self) -> None:
        """Bring everything to disk."""
        if not self._pending:
            return
        pending, self._pending, self._pending_rows = self._pending, {}, 0
        with reporting(self.path), h5py.File(part_path(self.path), "a") as file:
            for name in sorted(pending):
                self._append(file, name, pending[name])

    def _append(self, file: h5py.File, name: str, records: list[Correlations]) -> None:
        group = file.require_group(name)
        tap_chips = self._tap_chips[name.split("/")[1]]
        if "taps" not in group:
            group.attrs["tap_chips"] = tap_chips
            _create(group, "taps", np.complex64, len(tap_chips))
            for column, kind in (("first_sample", np.int64), ("row", np.int64)):
                _create(group, column, kind)
            _create(group, "seconds", np.float64)
        lengths = np.array([len(record.taps) for record in records])
        before = self._rows.get(name, 0)
        self._rows[name] = before + int(lengths.sum())
        _extend(group["taps"], np.concatenate([record.taps for record in records]))
        _extend(group["first_sample"], np.array([record.first for record in records]))
        _extend(group["row"], before + np.cumsum(lengths) - lengths)
        _extend(group["seconds"], np.array([record.seconds for record in records]))

    def close(self) -> None:
        """Finish and give the file its final name."""
        if self._open:
            self.flush()
            self._open = False
            with reporting(self.path):
                part_path(self.path).replace(self.path)

    def abandon(self) -> None:
        """Stop here: what was written stays readable under its `.part` name."""
        if self._open:
            self._open = False
            self.flush()


def _create(group: h5py.Group, name: str, kind: type, *width: int) -> None:
    group.create_dataset(
        name,
        shape=(0, *width),
        maxshape=(None, *width),
        chunks=(_CHUNK_ROWS, *width),
        dtype=kind,
        track_times=False,  # the same input gives the same bytes
    )


def _extend(dataset: h5py.Dataset, values: NDArray[Any]) -> None:
    start = len(dataset)
    dataset.resize(start + len(values), axis=0)
    dataset[start:] = values
