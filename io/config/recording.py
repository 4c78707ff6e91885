"""Section `recording`: what the samples are and how they lie in the file."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepgnss.core.errors import RecordingError
from deepgnss.io.config.quantity import ExistingFile, Quantity, Section, misfit
from deepgnss.io.formats import (
    BitCode,
    BitOrder,
    Block,
    Channels,
    IqOrder,
    Packing,
    SampleKind,
    Spectrum,
    StreamFormat,
    ValueFormat,
)

Count = Annotated[int, Quantity(0, 2**40, "bytes", whole=True)]
BitPlace = Annotated[int, Quantity(0, 64, "bits", whole=True)]
CodeValue = Annotated[int, Quantity(-32768, 32767, "", whole=True)]


def _date_and_time(value: object) -> object:
    # a bare date, read as midnight, would be a hint good to a day where the search trusts minutes
    if isinstance(value, datetime) or (
        isinstance(value, str) and re.match(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d", value)
    ):
        return value
    raise misfit("expected date and time, UTC, such as 2023-05-12T03:00:00Z")


def _as_utc(value: datetime) -> datetime:
    aware = value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)
    if not 1980 <= aware.year < 2100:
        raise misfit("expected a date between 1980 and 2099")
    return aware


UtcTime = Annotated[datetime, BeforeValidator(_date_and_time), AfterValidator(_as_utc)]


class PackingConfig(Section):
    """How values smaller than a byte, or a field of a wider word, are coded."""

    order: BitOrder = "msb_first"
    """Order of the values in a byte (or word): most or least significant bits first."""
    code: BitCode = "sign_magnitude"
    """Meaning of a value's bits; `levels`: looked up in the table below."""
    levels: Annotated[tuple[CodeValue, ...], Field(min_length=2, max_length=16)] | None = None
    """With `code: levels`: the value of each code, e.g. [1, 3, -3, -1]."""
    word_bytes: Literal[1, 2, 4, 8] = 1
    """Values sit in little-endian words of this many bytes."""
    field: tuple[BitPlace, BitPlace] | None = None
    """[shift, bits] of this stream inside the word; omitted: the whole word."""


class BlockConfig(Section):
    """Bytes that are no samples, before and after every block of samples."""

    header: Count = 0
    """Bytes to skip before every `payload` bytes."""
    payload: Count = 0
    """Bytes of samples in a block; 0: there are no blocks."""
    footer: Count = 0
    """Bytes to skip after every `payload` bytes."""


class ChannelsConfig(Section):
    """Streams interleaved sample by sample in one file."""

    count: Annotated[int, Quantity(1, 64, "streams", whole=True)] = 1
    """Streams in the file."""
    index: Annotated[int, Quantity(0, 63, "", whole=True)] = 0
    """Place of this one among them, from 0."""


class StreamConfig(Section):
    """One stream of samples: its file, number format and place in the spectrum."""

    name: Annotated[str, Field(min_length=1, max_length=32, pattern=r"^[\w.+-]+$")] = "L1"
    """Name in reports."""
    file: ExistingFile | None = None
    """Omitted: the RECORDING argument."""
    format: ValueFormat
    """Number format of a value; bits1, bits2, bits4 are packed (see `packing`)."""
    samples: SampleKind = "iq"
    """Complex (two values per sample) or real (one)."""
    iq_order: IqOrder = "iq"
    """Which of the two values of a complex sample comes first."""
    packing: PackingConfig = PackingConfig()
    block: BlockConfig = BlockConfig()
    channels: ChannelsConfig = ChannelsConfig()
    sample_rate: Annotated[float, Quantity(1e6, 2e9, "Hz")]
    """Samples (complex pairs count once) per second, Hz."""
    centre_frequency: Annotated[float, Quantity(1.0e9, 2.0e9, "Hz")] = 1575.42e6
    """RF frequency that lies at `intermediate_frequency`, Hz."""
    intermediate_frequency: Annotated[float, Quantity(-1e9, 1e9, "Hz")] = 0.0
    """Where the centre frequency lies in the samples, Hz."""
    spectrum: Spectrum = "upright"
    """Inverted: RF frequencies above the centre lie below the intermediate frequency."""
    offset: Count = 0
    """Bytes to skip at the start of the file."""

    def offset_of(self, carrier_hz: float) -> float:
        """Frequency, Hz, at which an RF frequency lies in the samples."""
        sign = -1.0 if self.spectrum == "inverted" else 1.0
        return self.intermediate_frequency + sign * (carrier_hz - self.centre_frequency)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        nyquist_hz = self.sample_rate / 2.0
        if abs(self.intermediate_frequency) > nyquist_hz:
            raise misfit(self._alias_hint(nyquist_hz), "intermediate_frequency")
        try:
            self.stream_format()
        except RecordingError as error:
            # "stream L1: packing.levels: …": the key stands first
            key, _, rest = str(error).partition(": ")[2].partition(": ")
            raise misfit(rest, key.split(" ")[0]) from error
        return self

    def stream_format(self) -> StreamFormat:
        """Return the description the readers work with."""
        return StreamFormat(
            name=self.name,
            format=self.format,
            samples=self.samples,
            sample_rate_hz=self.sample_rate,
            centre_hz=self.centre_frequency,
            intermediate_hz=self.intermediate_frequency,
            iq_order=self.iq_order,
            packing=Packing(**dict(self.packing)),
            block=Block(**dict(self.block)),
            channels=Channels(**dict(self.channels)),
            spectrum=self.spectrum,
            offset=self.offset,
            file=self.file,
        )

    def _alias_hint(self, nyquist_hz: float) -> str:
        expected = f"expected within ±{nyquist_hz:g} Hz, half the sample_rate"
        if self.samples != "real":
            return expected
        # band-pass sampling: say where the frequency folds to, and whether it comes out mirrored
        folded_hz = (self.intermediate_frequency + nyquist_hz) % self.sample_rate - nyquist_hz
        mirrored = (folded_hz < 0.0) != (self.spectrum == "inverted")
        return (
            f"{expected}; sampled band-pass it comes to lie at {abs(folded_hz):.10g} Hz, "
            f"spectrum {'inverted' if mirrored else 'upright'}"
        )


class RecordingConfig(Section):
    """The recording: when it was made, and its streams of samples."""

    start_time: UtcTime | None = None
    """Rough start, UTC (good to minutes); narrows the week and the search."""
    skip: Annotated[float, Quantity(0.0, 1e6, "s")] = 0.0
    """Seconds of recording to leave out at the start."""
    duration: Annotated[float, Quantity(0.0, 1e6, "s", above=True)] | None = None
    """Seconds of recording to process; omitted: to the end."""
    streams: tuple[StreamConfig, ...] = ()
    """Streams of samples; may be omitted for a recording that describes itself (SigMF, HDF5, ION
    metadata)."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [stream.name for stream in self.streams]
        for place, name in enumerate(names):
            if name in names[:place]:
                raise misfit(
                    "expected a name of its own for every stream", f"streams[{place}].name"
                )
        return self
