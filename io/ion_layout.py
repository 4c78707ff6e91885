"""Where the samples of one stream lie in a chunk of the ION GNSS SDR Metadata Standard.

A chunk is `countwords` words of `sizeword` bytes, read as one row of bits, most significant first;
lumps fill it again and again, each the samples of all streams during one period of the base rate.
Right shifts reverse that row (words), the lumps in it, or the samples in a stream.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from deepgnss.core.errors import RecordingError
from deepgnss.io.formats import BitCode, Channels, IqOrder, Packing, ValueFormat

REAL_FORMATS = ("IF", "IFn")

# A sample a, b of format IQn is a − jb = −j(b + ja), and so on: up to a constant quarter turn of
# the carrier's phase every complex format is a + jb ("iq") or b + ja ("qi").
COMPLEX_FORMATS: dict[str, IqOrder] = {
    "IQ": "iq", "InQn": "iq", "QIn": "iq", "QnI": "iq",
    "IQn": "qi", "InQ": "qi", "QI": "qi", "QnIn": "qi",
}  # fmt: skip

_PLAIN: dict[tuple[int, str], ValueFormat] = {
    (8, "INT8"): "int8", (8, "TC"): "int8", (16, "TC"): "int16", (32, "FP"): "float32"
}  # fmt: skip
_PACKED: dict[int, ValueFormat] = {1: "bits1", 2: "bits2", 4: "bits4"}
_SAME_CODE: dict[str, BitCode] = {
    "SMA": "sign_magnitude", "TCA": "twos_complement", "OBA": "offset_binary"
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class IonStream:
    """One <stream> element: `ratefactor` samples in `packedbits` bits of each lump."""

    name: str
    ratefactor: int
    quantization: int
    packedbits: int
    samples_reversed: bool
    right_aligned: bool
    format: str
    encoding: str
    band: str

    @property
    def components(self) -> int:
        """Real numbers per sample."""
        return 1 if self.format in REAL_FORMATS else 2

    @property
    def used_bits(self) -> int:
        """Bits of `packedbits` that hold samples."""
        return self.ratefactor * self.quantization * self.components


@dataclass(frozen=True, slots=True)
class IonChunk:
    """A <chunk> with one kind of <lump>, streams from the most significant bits down."""

    sizeword: int
    countwords: int
    little_endian: bool
    words_reversed: bool
    lumps_reversed: bool
    streams: tuple[IonStream, ...]

    @property
    def bits(self) -> int:
        """Bits of a chunk."""
        return 8 * self.sizeword * self.countwords

    @property
    def lump_bits(self) -> int:
        """Bits of a lump."""
        return sum(stream.packedbits for stream in self.streams)


class Layout(NamedTuple):
    """What `StreamFormat` wants to know."""

    format: ValueFormat
    packing: Packing
    channels: Channels
    iq_order: IqOrder


def layout(chunk: IonChunk, place: int) -> Layout:
    """Layout of the stream at `place` of a chunk's streams.

    Raises
    ------
    RecordingError
        An arrangement that `StreamFormat` cannot express, named.
    """
    stream = chunk.streams[place]
    if chunk.bits % chunk.lump_bits:
        raise _unsupported(stream, f"{chunk.lump_bits}-bit lumps in {chunk.bits}-bit chunks")
    if chunk.lumps_reversed and chunk.lump_bits < chunk.bits:
        raise _unsupported(stream, "several lumps in reversed order")
    if stream.format not in (*COMPLEX_FORMATS, *REAL_FORMATS):
        raise _unsupported(stream, f"format {stream.format}")
    if stream.quantization in _PACKED:
        return _packed_layout(chunk, place)
    return _plain_layout(chunk, place)


def _plain_layout(chunk: IonChunk, place: int) -> Layout:
    """Whole bytes: numbers as the machine writes them."""
    stream = chunk.streams[place]
    bits = stream.quantization
    if (bits, stream.encoding) not in _PLAIN:
        raise _unsupported(stream, f"{bits}-bit samples in encoding {stream.encoding}")
    if not (_alone(chunk) or _alike(chunk)) or chunk.words_reversed or _backwards(stream):
        raise _unsupported(stream, f"{bits}-bit samples in other than plain order")
    if bits > 8 and not (chunk.little_endian and 8 * chunk.sizeword == bits):
        raise _unsupported(stream, f"{bits}-bit samples in other than little-endian words")
    return Layout(_PLAIN[bits, stream.encoding], Packing(), _channels(chunk, place), _order(stream))


def _packed_layout(chunk: IonChunk, place: int) -> Layout:
    """Parts of bytes: all streams alike and interleaved, or each in a field of its own."""
    stream = chunk.streams[place]
    backwards, word_bytes, field = _backwards(stream), chunk.sizeword, None
    if _alone(chunk) or _alike(chunk):
        if chunk.countwords > 1 and chunk.words_reversed != backwards:
            raise _unsupported(stream, "words and samples in opposite orders")
        if backwards and chunk.lump_bits < chunk.bits:
            raise _unsupported(stream, "right-shifted samples in several lumps")
        if not chunk.little_endian:
            if backwards and chunk.sizeword > 1:
                raise _unsupported(stream, "right-shifted samples in big-endian words")
            word_bytes = 1  # most significant first all through: the bytes as they come
    else:
        if chunk.countwords != 1 or chunk.lump_bits != chunk.bits:
            raise _unsupported(stream, "streams of different kinds in more or less than one word")
        if not chunk.little_endian and chunk.sizeword > 1:
            raise _unsupported(stream, "streams of different kinds in big-endian words")
        shift = sum(s.packedbits for s in chunk.streams[place + 1 :])
        if not stream.right_aligned:
            shift += stream.packedbits - stream.used_bits
        field = (shift, stream.used_bits)
    code, levels = _code(stream)
    order = _order(stream)
    if backwards and stream.components == 2:  # only samples are reversed, not I and Q in each
        order = "qi" if order == "iq" else "iq"
    packing = Packing("lsb_first" if backwards else "msb_first", code, levels, word_bytes, field)
    return Layout(_PACKED[stream.quantization], packing, _channels(chunk, place), order)


def _alone(chunk: IonChunk) -> bool:
    return len(chunk.streams) == 1 and chunk.streams[0].used_bits == chunk.streams[0].packedbits


def _alike(chunk: IonChunk) -> bool:
    """Streams that take turns sample by sample."""
    kinds = {(s.ratefactor, s.quantization, s.components) for s in chunk.streams}
    return (
        len(kinds) == 1
        and chunk.streams[0].ratefactor == 1
        and all(s.used_bits == s.packedbits for s in chunk.streams)
    )


def _channels(chunk: IonChunk, place: int) -> Channels:
    return Channels(len(chunk.streams), place) if _alike(chunk) else Channels()


def _backwards(stream: IonStream) -> bool:
    return stream.samples_reversed and stream.ratefactor > 1


def _order(stream: IonStream) -> IqOrder:
    return COMPLEX_FORMATS.get(stream.format, "iq")


def _code(stream: IonStream) -> tuple[BitCode, tuple[int, ...] | None]:
    """Meaning of a stream's codes: ours where it is the same, else a table of levels."""
    bits, encoding = stream.quantization, stream.encoding
    if encoding == "SIGN" and bits == 1:
        return "sign_magnitude", None
    if encoding in _SAME_CODE:
        return _SAME_CODE[encoding], None
    half = 1 << (bits - 1)
    codes = range(2 * half)
    sign_last = [(-1 if c & 1 else 1, c >> 1) for c in codes]
    ungrayed = [c ^ (c >> 1) ^ (c >> 2) ^ (c >> 3) for c in codes]
    tables = {
        "TC": [c - 2 * half if c >= half else c for c in codes],
        "OB": [c - half for c in codes],
        "SM": [-(c % half) if c >= half else c for c in codes],
        "MS": [sign * m for sign, m in sign_last],
        "MSA": [sign * (2 * m + 1) for sign, m in sign_last],
        "OG": [g - half for g in ungrayed],
        "OGA": [2 * g - (2 * half - 1) for g in ungrayed],
    }
    if encoding not in tables:
        raise _unsupported(stream, f"{bits}-bit samples in encoding {encoding}")
    return "levels", tuple(tables[encoding])


def _unsupported(stream: IonStream, what: str) -> RecordingError:
    return RecordingError(f"stream {stream.name}: {what}: not supported")
