"""How the samples of a recording lie in its file: the description every reader agrees on.

A `StreamFormat` is one entry of `recording.streams` in the YAML, whoever wrote it: a human, SigMF,
ION metadata or our HDF5 container.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, get_args

from deepgnss.core.errors import RecordingError

ValueFormat = Literal["int8", "int16", "float32", "bits1", "bits2", "bits4"]
SampleKind = Literal["real", "iq"]
IqOrder = Literal["iq", "qi"]
BitOrder = Literal["msb_first", "lsb_first"]
BitCode = Literal["sign_magnitude", "twos_complement", "offset_binary", "levels"]
Spectrum = Literal["upright", "inverted"]

VALUE_BITS: dict[str, int] = {
    "int8": 8, "int16": 16, "float32": 32, "bits1": 1, "bits2": 2, "bits4": 4
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Packing:
    """Where packed values sit in their bytes, and what their codes mean (`packing:`).

    order: of the values in a word. code: see `deepgnss.io.samples.level_table`. levels: value of
    each code, for code "levels". word_bytes: values sit in little-endian words of this size.
    field: (shift, bits) of this stream inside the word, shift counted from its lowest bit.
    """

    order: BitOrder = "msb_first"
    code: BitCode = "sign_magnitude"
    levels: tuple[int, ...] | None = None
    word_bytes: int = 1
    field: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Block:
    """Bytes that are no samples: a header before (and footer after) every `payload` bytes."""

    header: int = 0
    payload: int = 0  # 0: the file has no blocks
    footer: int = 0


@dataclass(frozen=True, slots=True)
class Channels:
    """Streams interleaved sample by sample in one file: this one is `index` of `count`."""

    count: int = 1
    index: int = 0


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """One stream of a recording as it lies in its file: `recording.streams[]` of the YAML.

    Frequencies are those of the file: with an inverted spectrum, RF `centre_hz` lies at
    `intermediate_hz` before the inversion is undone.

    Raises
    ------
    RecordingError
        A value that cannot be, or values that contradict each other.
    """

    name: str
    format: ValueFormat
    samples: SampleKind
    sample_rate_hz: float
    centre_hz: float
    intermediate_hz: float = 0.0
    iq_order: IqOrder = "iq"
    packing: Packing = field(default_factory=Packing)
    block: Block = field(default_factory=Block)
    channels: Channels = field(default_factory=Channels)
    spectrum: Spectrum = "upright"
    offset: int = 0  # bytes to skip at the start
    file: Path | None = None  # None: the recording's main file
    dataset: str | None = None  # inside an HDF5 file: the dataset with this stream's bytes

    def __post_init__(self) -> None:
        for reason in _contradictions(self):
            raise RecordingError(f"stream {self.name}: {reason}")

    @property
    def is_packed(self) -> bool:
        """True when several values share a byte, or a word has to be taken apart."""
        return self.format.startswith("bits")

    @property
    def value_bits(self) -> int:
        """Bits of one real number in the file."""
        return VALUE_BITS[self.format]

    @property
    def components(self) -> int:
        """Real numbers per sample: 1 real, 2 complex."""
        return 2 if self.samples == "iq" else 1

    @property
    def values_per_frame(self) -> int:
        """Real numbers per instant, all interleaved channels together."""
        return self.components * self.channels.count

    @property
    def word_field(self) -> tuple[int, int]:
        """(shift, bits) of the bits used in each word of a packed format."""
        return self.packing.field or (0, 8 * self.packing.word_bytes)

    @property
    def word_bytes(self) -> int:
        """Smallest piece of the file that can be unpacked alone."""
        return self.packing.word_bytes if self.is_packed else self.value_bits // 8

    @property
    def values_per_word(self) -> int:
        """Real numbers in `word_bytes` bytes."""
        return self.word_field[1] // self.value_bits if self.is_packed else 1


@dataclass(frozen=True, slots=True)
class RecordingDescription:
    """What a metadata file says: the streams, when they began (UTC), and remarks for the user."""

    streams: tuple[StreamFormat, ...]
    start: datetime | None = None
    notes: tuple[str, ...] = ()


def as_utc(time: datetime) -> datetime:
    """A time as UTC; one without a zone is taken to be UTC."""
    return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)


def _contradictions(stream: StreamFormat) -> list[str]:
    """Everything that cannot be true of a stream, each with what would fit."""
    s, packing = stream, stream.packing
    rules = [
        (s.format in VALUE_BITS, f"format {s.format!r}: one of {', '.join(VALUE_BITS)}"),
        *(
            (value in get_args(kind), f"{key} {value!r}: one of {', '.join(get_args(kind))}")
            for key, value, kind in (
                ("samples", s.samples, SampleKind),
                ("iq_order", s.iq_order, IqOrder),
                ("spectrum", s.spectrum, Spectrum),
                ("packing.order", packing.order, BitOrder),
                ("packing.code", packing.code, BitCode),
            )
        ),
        (
            math.isfinite(s.sample_rate_hz) and s.sample_rate_hz > 0,
            f"sample_rate {s.sample_rate_hz}: a positive number of Hz",
        ),
        (math.isfinite(s.centre_hz), f"centre_frequency {s.centre_hz}: a number of Hz"),
        (math.isfinite(s.intermediate_hz), f"intermediate_frequency {s.intermediate_hz}: in Hz"),
        (s.offset >= 0, f"offset {s.offset}: 0 or more bytes"),
        (
            s.block.header >= 0 and s.block.payload >= 0 and s.block.footer >= 0,
            f"block {s.block}: 0 or more bytes each",
        ),
        (
            s.block.payload > 0 or s.block.header == s.block.footer == 0,
            "block.payload 0: a header or footer needs the bytes of samples it belongs to",
        ),
        (
            0 <= s.channels.index < s.channels.count,
            f"channels.index {s.channels.index}: 0 … count − 1 ({s.channels.count - 1})",
        ),
        (packing.word_bytes in (1, 2, 4, 8), f"word_bytes {packing.word_bytes}: 1, 2, 4 or 8"),
    ]
    failed = [text for holds, text in rules if not holds]
    return failed or _packing_contradictions(stream)


def _packing_contradictions(stream: StreamFormat) -> list[str]:
    bits, packing = stream.value_bits, stream.packing
    levels, (shift, width) = packing.levels, stream.word_field
    rules = [
        (
            stream.is_packed or packing == Packing(),
            f"packing: only for bits1, bits2, bits4 (format is {stream.format})",
        ),
        (
            (levels is not None) == (packing.code == "levels"),
            "packing.levels: goes with packing.code: levels, and only with it",
        ),
        (
            levels is None or len(levels) == 1 << bits,
            f"packing.levels: {1 << bits} values for {stream.format}, one per code",
        ),
        (
            levels is None or all(-32768 <= level <= 32767 for level in levels),
            "packing.levels: integers that fit in 16 bits",
        ),
        (
            shift >= 0 and width > 0 and shift + width <= 8 * packing.word_bytes,
            f"packing.field [{shift}, {width}]: [shift, bits] inside {8 * packing.word_bytes} bits",
        ),
        (
            not stream.is_packed or width % bits == 0,
            f"packing.field: {width} bits do not hold whole {bits}-bit values",
        ),
        (
            stream.block.payload % stream.word_bytes == 0,
            f"block.payload {stream.block.payload}: whole {stream.word_bytes}-byte words",
        ),
    ]
    return [text for holds, text in rules if not holds]
