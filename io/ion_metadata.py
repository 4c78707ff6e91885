"""ION GNSS SDR Metadata Standard XML (`.xml`, `.sdrx`, `.smfx`) → descriptions of recordings.

The standard nests lane > block > chunk > lump > stream; `deepgnss.io.ion_layout` knows the bits.

`centerfreq` lies at `translatedfreq`. But some writers give the local oscillator as centerfreq and
the place of the band's carrier as translatedfreq (as acquisition shows in the standard's own
examples JRC and FITWDP): their sum is a GNSS carrier then, and centerfreq is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from deepgnss.core.errors import RecordingError
from deepgnss.io.formats import Block, RecordingDescription, StreamFormat
from deepgnss.io.ion_layout import IonChunk, IonStream, layout

_UNIT_HZ = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}

# Carriers of all systems, Hz: to tell a local oscillator from a band's centre.
_CARRIERS_HZ = (
    1575.42e6, 1227.60e6, 1176.45e6, 1561.098e6, 1207.14e6, 1268.52e6, 1191.795e6, 1278.75e6,
    1602.0e6, 1246.0e6, 1202.025e6,
)  # fmt: skip


class _Reader:
    """Elements of one document with errors that name the file and the element."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = path.read_text("utf-8-sig")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error
        except UnicodeDecodeError as error:
            raise RecordingError(f"{path}: is no UTF-8 text ({error.reason})") from None
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise RecordingError(f"{path}: document type declarations are not accepted")
        try:  # the XML declaration may stand behind white space in files of some writers
            self.root = ElementTree.fromstring(text.strip())
        except ElementTree.ParseError as error:
            raise RecordingError(f"{path}: is no XML text ({error})") from None
        for element in self.root.iter():
            element.tag = element.tag.rpartition("}")[2]

    def fail(self, reason: str) -> RecordingError:
        return RecordingError(f"{self.path}: {reason}")

    def child(self, parent: ElementTree.Element, tag: str) -> ElementTree.Element:
        found = parent.find(tag)
        if found is None:
            raise self.fail(f"<{tag}> is missing in <{parent.tag}>")
        return found

    def text(self, parent: ElementTree.Element, tag: str, default: str | None = None) -> str:
        found = parent.find(tag)
        if found is not None and found.text and found.text.strip():
            return found.text.strip()
        if default is None:
            raise self.fail(f"<{tag}> is missing in <{parent.tag}>")
        return default

    def whole(self, parent: ElementTree.Element, tag: str, default: str | None = None) -> int:
        text = self.text(parent, tag, default)
        if not text.isdecimal():
            raise self.fail(f"<{tag}> {text!r}: expected a whole number")
        return int(text)

    def frequency_hz(self, parent: ElementTree.Element, tag: str, default: str | None) -> float:
        text = self.text(parent, tag, default)
        element = parent.find(tag)
        unit = "Hz" if element is None else element.get("format", "Hz")
        try:
            return float(text) * _UNIT_HZ[unit]
        except (ValueError, KeyError):
            raise self.fail(f"<{tag}> {text!r} {unit}: expected a frequency") from None

    def named(self, tag: str, name: str) -> ElementTree.Element:
        """The defining element (one with children) of this tag and id."""
        for element in self.root.iter(tag):
            if element.get("id") == name and len(element):
                return element
        raise self.fail(f"<{tag} id={name!r}> is not defined")


def read_ion_metadata(path: Path, data_file: Path | None = None) -> RecordingDescription:
    """Description of the recording(s) of an ION metadata file.

    Parameters
    ----------
    data_file: only the streams of this file; default: all files named that exist.

    Raises
    ------
    RecordingError
        The file cannot be read, none of its data files exists, or the packing is not supported.
    """
    reader = _Reader(path)
    wanted, named = [], []
    for file in reader.root.iter("file"):
        url = reader.text(file, "url")
        named.append(url)
        target = path.parent / url
        if target.is_file() and (data_file is None or target.samefile(data_file)):
            wanted.append((file, target))
    if not wanted:
        what = data_file.name if data_file else "present"
        raise reader.fail(f"describes {', '.join(named) or 'no file'}; none is {what}")
    notes = [
        f"{path}: {url} is described but not there"
        for url in named
        if data_file is None and not (path.parent / url).is_file()
    ]
    streams: list[StreamFormat] = []
    for file, target in wanted:
        lane = reader.named("lane", reader.child(file, "lane").get("id", ""))
        for stream, remark in _lane_streams(reader, lane, target):
            streams.append(stream)
            notes += remark
    start, remark = _start(reader, wanted[0][0])
    return RecordingDescription(tuple(streams), start, (*notes, *remark))


def _lane_streams(
    reader: _Reader, lane: ElementTree.Element, file: Path
) -> Iterator[tuple[StreamFormat, list[str]]]:
    """Streams of a lane whose packing we can read; a remark for each."""
    block = reader.child(lane, "block")
    if len(lane.findall("block")) > 1 or len(block.findall("chunk")) > 1:
        raise reader.fail("lanes of several blocks or chunks are not supported")
    chunk = _chunk(reader, reader.child(block, "chunk"))
    payload = reader.whole(block, "cycles", "0") * chunk.sizeword * chunk.countwords
    edges = Block(
        header=reader.whole(block, "sizeheader", "0"),
        payload=payload,
        footer=reader.whole(block, "sizefooter", "0"),
    )
    if not payload:
        edges = Block()  # one block to the end of the file: its header is an offset
    offset = 0 if payload else reader.whole(block, "sizeheader", "0")
    system = reader.named("system", reader.child(lane, "system").get("id", ""))
    base_hz = reader.frequency_hz(system, "freqbase", None)
    for place, stream in enumerate(chunk.streams):
        band = reader.named("band", stream.band)
        centre_hz = reader.frequency_hz(band, "centerfreq", None)
        translated_hz = reader.frequency_hz(band, "translatedfreq", "0")
        remark = []
        if not _is_carrier(centre_hz) and _is_carrier(centre_hz + translated_hz):
            centre_hz += translated_hz
            remark = [
                f"{reader.path}: band {stream.band}: centerfreq is read as the local oscillator:"
                f" {centre_hz / 1e6:.10g} MHz lies at {translated_hz:.10g} Hz"
            ]
        try:
            where = layout(chunk, place)
        except RecordingError as error:
            raise reader.fail(str(error)) from None
        yield (
            StreamFormat(
                name=stream.name,
                format=where.format,
                samples="real" if stream.components == 1 else "iq",
                sample_rate_hz=base_hz * stream.ratefactor,
                centre_hz=centre_hz,
                intermediate_hz=translated_hz,
                iq_order=where.iq_order,
                packing=where.packing,
                block=edges,
                channels=where.channels,
                offset=offset,
                file=file,
            ),
            remark,
        )


def _chunk(reader: _Reader, parent: ElementTree.Element) -> IonChunk:
    lumps = parent.findall("lump")
    if len(lumps) != 1:
        raise reader.fail(f"a chunk of {len(lumps)} lumps is not supported (one is)")
    lump_shift = reader.text(lumps[0], "shift", "Undefined")
    streams = []
    for element in lumps[0].findall("stream"):
        shift = reader.text(element, "shift", "Undefined")
        stream = IonStream(
            name=element.get("id", "stream"),
            ratefactor=reader.whole(element, "ratefactor"),
            quantization=reader.whole(element, "quantization"),
            packedbits=reader.whole(element, "packedbits"),
            samples_reversed=(lump_shift if shift == "Undefined" else shift) == "Right",
            right_aligned=reader.text(element, "alignment", "Undefined") == "Right",
            format=reader.text(element, "format"),
            encoding=reader.text(element, "encoding"),
            band=reader.child(element, "band").get("id", ""),
        )
        if stream.ratefactor < 1 or not 0 < stream.used_bits <= stream.packedbits:
            raise reader.fail(f"stream {stream.name}: its samples do not fit in <packedbits>")
        streams.append(stream)
    chunk = IonChunk(
        sizeword=reader.whole(parent, "sizeword"),
        countwords=reader.whole(parent, "countwords"),
        little_endian=reader.text(parent, "endian", "Little") != "Big",
        words_reversed=reader.text(parent, "wordshift", "Undefined") == "Right",
        lumps_reversed=lump_shift == "Right",
        streams=tuple(streams),
    )
    if not streams or chunk.sizeword not in (1, 2, 4, 8) or chunk.countwords < 1:
        raise reader.fail("a chunk needs streams and words of 1, 2, 4 or 8 bytes")
    return chunk


def _is_carrier(frequency_hz: float) -> bool:
    return any(abs(frequency_hz - carrier_hz) < 1e3 for carrier_hz in _CARRIERS_HZ)


def _start(reader: _Reader, file: ElementTree.Element) -> tuple[datetime | None, list[str]]:
    """Time of the first sample (UTC) from the file's <timestamp>, else the session's <toa>."""
    session = next(reader.root.iter("session"), None)
    times = [
        _utc(text)
        for text in (
            reader.text(file, "timestamp", " "),
            reader.text(session, "toa", " ") if session is not None else " ",
        )
    ]
    stamp, toa = times
    remark = []
    if stamp and toa and abs((stamp - toa).total_seconds()) > 60.0:
        remark = [
            f"{reader.path}: the file's time stamp {stamp:%Y-%m-%d %H:%M:%S} is not the session's"
            f" {toa:%Y-%m-%d %H:%M:%S}: the stamp is used"
        ]
    return stamp or toa, remark


def _utc(text: str) -> datetime | None:
    """UTC of an XML dateTime; also of the shortened ones seen in the wild ("17:30:0.0Z")."""
    date, _, clock = text.strip().rstrip("Z").partition("T")
    try:
        day = datetime.strptime(date, "%Y-%m-%d").replace(tzinfo=UTC)
        parts = [float(part) for part in clock.split(":")] if clock else []
    except ValueError:
        return None
    hours, minutes, seconds = (*parts, 0.0, 0.0, 0.0)[:3]
    return datetime.fromtimestamp(day.timestamp() + 3600.0 * hours + 60.0 * minutes + seconds, UTC)
