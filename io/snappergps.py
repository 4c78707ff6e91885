"""SnapperGPS recordings: JSON of snapshots of 12 ms, base64, one bit per real sample.

Front end (SE4150L): 4.092 Msps, IF 4.092 MHz, which the sampling folds to zero frequency: RF
offsets of both signs lie on top of each other. Bits lsb first, 0 → +1.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deepgnss.core.errors import RecordingError
from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.io.formats import Packing, StreamFormat, as_utc
from deepgnss.io.samples import unpack_values

SAMPLE_RATE_HZ = 4.092e6
CENTRE_HZ = 1575.42e6


class Snapshot(NamedTuple):
    """Samples taken at once; time of the logger's own clock (UTC, off by up to seconds)."""

    time: datetime
    temperature_c: float
    block: SampleBlock


class _Entry(BaseModel):
    """One element of `snapshots`."""

    model_config = ConfigDict(extra="ignore")
    timestamp: datetime
    temperature: float = float("nan")
    data: str


class _File(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="ignore")
    snapshots: list[_Entry] = Field(min_length=1)


def read_snapshots(path: Path) -> Iterator[Snapshot]:
    """All snapshots of a SnapperGPS JSON file, in its order; each a stream of its own.

    Raises
    ------
    RecordingError
        The file cannot be read or is no such file; a snapshot is no base64 text.
    """
    try:
        content = _File.model_validate_json(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise RecordingError(f"{path}: no SnapperGPS recording: {key} {first['msg']}") from None
    packed = StreamFormat(
        "L1", "bits1", "real", SAMPLE_RATE_HZ, CENTRE_HZ, packing=Packing(order="lsb_first")
    )
    for place, entry in enumerate(content.snapshots):
        try:
            data = base64.b64decode(entry.data, validate=True)
        except binascii.Error as error:
            raise RecordingError(f"{path}: snapshots.{place}.data: {error}") from None
        samples = unpack_values(np.frombuffer(data, np.uint8), packed, 1.0)
        info = StreamInfo("L1", SAMPLE_RATE_HZ, CENTRE_HZ, 0.0, False, samples.size)
        yield Snapshot(as_utc(entry.timestamp), entry.temperature, SampleBlock(info, 0, samples))
