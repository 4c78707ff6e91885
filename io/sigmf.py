"""SigMF metadata (`.sigmf-meta`, SigMF 1.2) → description of a recording."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deepgnss.core.errors import RecordingError
from deepgnss.io.formats import Channels, RecordingDescription, StreamFormat, ValueFormat, as_utc

_NUMBERS: dict[str, ValueFormat] = {"i8": "int8", "i16_le": "int16", "f32_le": "float32"}


class _Capture(BaseModel):
    """A run of samples recorded without a change of setting."""

    model_config = ConfigDict(extra="ignore")
    sample_start: int = Field(0, alias="core:sample_start", ge=0)
    frequency: float | None = Field(None, alias="core:frequency")
    start: datetime | None = Field(None, alias="core:datetime")
    header_bytes: int = Field(0, alias="core:header_bytes", ge=0)


class _Global(BaseModel):
    """What holds for the whole recording."""

    model_config = ConfigDict(extra="ignore")
    datatype: str = Field(alias="core:datatype")
    sample_rate: float = Field(alias="core:sample_rate", gt=0)
    channels: int = Field(1, alias="core:num_channels", ge=1)
    dataset: str | None = Field(None, alias="core:dataset")
    intermediate_hz: float | None = Field(None, alias="deepgnss:intermediate_frequency")


class _Metadata(BaseModel):
    """A `.sigmf-meta` file, as far as it concerns us."""

    model_config = ConfigDict(extra="ignore")
    whole: _Global = Field(alias="global")
    captures: list[_Capture] = Field(min_length=1)


def read_sigmf(path: Path) -> RecordingDescription:
    """Description of the recording that a `.sigmf-meta` file belongs to.

    SigMF's `core:frequency` is the centre of the recorded band: it lies at 0 in complex samples,
    and is taken to lie at a quarter of the rate in real ones unless our extension
    `deepgnss:intermediate_frequency` (in `global`) says where.

    Raises
    ------
    RecordingError
        The file cannot be read, lacks a key, or describes something that is not supported.
    """
    try:
        metadata = _Metadata.model_validate(json.loads(path.read_text("utf-8")))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise RecordingError(f"{path}: {key}: {first['msg']}") from None
    except ValueError as error:
        raise RecordingError(f"{path}: is no JSON text ({error})") from None
    whole, capture = metadata.whole, metadata.captures[0]
    kind, number = whole.datatype[:1], whole.datatype[1:]
    if kind not in ("r", "c") or number not in _NUMBERS:
        known = ", ".join(f"{k}{n}" for k in "rc" for n in _NUMBERS)
        raise RecordingError(f"{path}: core:datatype {whole.datatype!r}: one of {known}")
    if capture.frequency is None:
        raise RecordingError(f"{path}: captures.0.core:frequency is missing")
    for later in metadata.captures[1:]:
        if later.header_bytes or later.frequency not in (None, capture.frequency):
            raise RecordingError(
                f"{path}: the capture at sample {later.sample_start} has another frequency or a"
                " header of its own; only one setting per recording is supported"
            )
    notes = []
    intermediate_hz = whole.intermediate_hz
    if intermediate_hz is None:
        intermediate_hz = whole.sample_rate / 4 if kind == "r" else 0.0
        if kind == "r":
            notes.append(
                f"{path}: real samples without deepgnss:intermediate_frequency: core:frequency is"
                f" taken to lie at {intermediate_hz:.10g} Hz, a quarter of the rate"
            )
    file = path.parent / whole.dataset if whole.dataset else path.with_suffix(".sigmf-data")
    streams = tuple(
        StreamFormat(
            name=f"ch{index}",
            format=_NUMBERS[number],
            samples="iq" if kind == "c" else "real",
            sample_rate_hz=whole.sample_rate,
            centre_hz=capture.frequency,
            intermediate_hz=intermediate_hz,
            channels=Channels(whole.channels, index),
            offset=capture.header_bytes,
            file=file,
        )
        for index in range(whole.channels)
    )
    start = as_utc(capture.start) if capture.start else None
    return RecordingDescription(streams, start, tuple(notes))
