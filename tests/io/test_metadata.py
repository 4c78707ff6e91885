"""SigMF, ION metadata and our container: what they say of a recording, and what they refuse."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest

from deepgnss.core.errors import InputFileError, RecordingError
from deepgnss.io.container import ContainerWriter, read_container, read_table
from deepgnss.io.formats import Block, Channels, Packing, StreamFormat
from deepgnss.io.ion_layout import IonChunk, IonStream, layout
from deepgnss.io.metadata import describe
from deepgnss.io.recording import Recording
from deepgnss.io.samples import FLOAT_RMS
from deepgnss.io.snappergps import read_snapshots

L1 = 1575.42e6


# --- SigMF ---------------------------------------------------------------------------------------


def sigmf(folder: Path, captures: list[dict[str, object]], **whole: object) -> Path:
    meta = {"global": {f"core:{k}": v for k, v in whole.items()}, "captures": captures}
    path = folder / "r.sigmf-meta"
    path.write_text(json.dumps(meta))
    return path


CAPTURE = {"core:sample_start": 0, "core:frequency": L1, "core:datetime": "2022-01-01T12:00:10Z"}


@pytest.mark.parametrize(
    ("datatype", "kind", "width"),
    [("ci8", "i1", 2), ("ci16_le", "<i2", 2), ("ri8", "i1", 1), ("ri16_le", "<i2", 1)],
)
def test_sigmf_integers(tmp_path: Path, datatype: str, kind: str, width: int) -> None:
    values = np.arange(-12, 12, dtype=kind).reshape(-1, width)
    (tmp_path / "r.sigmf-data").write_bytes(b"head" + values.tobytes())
    capture = {**CAPTURE, "core:header_bytes": 4}
    meta = sigmf(tmp_path, [capture], datatype=datatype, sample_rate=4e6)
    for path in (meta, tmp_path / "r.sigmf-data"):
        description = describe(path)
        assert description is not None
        assert description.start == datetime(2022, 1, 1, 12, 0, 10, tzinfo=UTC)
        with Recording(description.streams) as recording:
            info = recording.streams[0]
            assert (info.sample_rate_hz, info.centre_hz) == (4e6, L1)
            assert info.intermediate_hz == (0.0 if width == 2 else 1e6)
            assert info.sample_count == 24 // width
            got = recording.read(0, 0, 24 // width).samples.reshape(-1, width)
        np.testing.assert_array_equal(got, values)
    assert len(description.notes) == (width == 1)


def test_sigmf_channels_and_dataset_name(tmp_path: Path) -> None:
    np.arange(12, dtype="<f4").tofile(tmp_path / "other.iq")
    meta = sigmf(
        tmp_path, [CAPTURE], datatype="cf32_le", sample_rate=4e6, num_channels=2, dataset="other.iq"
    )
    description = describe(meta)
    assert description is not None
    assert [s.channels for s in description.streams] == [Channels(2, 0), Channels(2, 1)]
    with Recording(description.streams) as recording:
        second = recording.read(1, 0, 3).samples.astype(float)
    expected = np.array([[2, 3], [6, 7], [10, 11]])
    factor = FLOAT_RMS / np.sqrt(np.mean(np.arange(12.0) ** 2))  # one for the whole file
    np.testing.assert_array_equal(second, np.rint(factor * expected))


@pytest.mark.parametrize(
    ("whole", "captures", "word"),
    [
        ({"datatype": "cu8", "sample_rate": 1e6}, [CAPTURE], "core:datatype 'cu8'"),
        ({"datatype": "ci16_be", "sample_rate": 1e6}, [CAPTURE], "ci16_le"),
        ({"datatype": "ci8"}, [CAPTURE], "core:sample_rate"),
        ({"datatype": "ci8", "sample_rate": -1}, [CAPTURE], "core:sample_rate"),
        ({"datatype": "ci8", "sample_rate": 1e6}, [], "captures"),
        ({"datatype": "ci8", "sample_rate": 1e6}, [{}], "core:frequency is missing"),
        (
            {"datatype": "ci8", "sample_rate": 1e6},
            [CAPTURE, {"core:sample_start": 5, "core:frequency": 1.0}],
            "sample 5 has another frequency",
        ),
    ],
)
def test_sigmf_refusals(
    tmp_path: Path, whole: dict[str, object], captures: list[dict[str, object]], word: str
) -> None:
    with pytest.raises(RecordingError, match=word) as caught:
        describe(sigmf(tmp_path, captures, **whole))
    assert "r.sigmf-meta" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sigmf_not_json_or_missing(tmp_path: Path) -> None:
    path = tmp_path / "x.sigmf-meta"
    with pytest.raises(RecordingError, match="cannot be read"):
        describe(path)
    path.write_text("{")
    with pytest.raises(RecordingError, match="no JSON"):
        describe(path)


def test_bare_samples_have_no_description(tmp_path: Path) -> None:
    assert describe(tmp_path / "rec.bin") is None


# --- ION metadata --------------------------------------------------------------------------------


def ion_stream(name: str = "L1", **keys: object) -> IonStream:
    values: dict[str, object] = {
        "ratefactor": 1, "quantization": 2, "packedbits": 2, "samples_reversed": False,
        "right_aligned": False, "format": "IF", "encoding": "TCA", "band": "L1", **keys,
    }  # fmt: skip
    return IonStream(name=name, **values)  # type: ignore[arg-type]


def ion_chunk(*streams: IonStream, **keys: object) -> IonChunk:
    values: dict[str, object] = {
        "sizeword": 1, "countwords": 1, "little_endian": True, "words_reversed": False,
        "lumps_reversed": False, **keys,
    }  # fmt: skip
    return IonChunk(streams=streams, **values)  # type: ignore[arg-type]


def test_ion_right_shift_all_through_is_lsb_first() -> None:
    stream = ion_stream(ratefactor=20, packedbits=40, samples_reversed=True)
    found = layout(ion_chunk(stream, countwords=5, words_reversed=True), 0)
    assert found.packing == Packing("lsb_first", "twos_complement")


def test_ion_reversed_complex_samples_keep_i_and_q() -> None:
    # word 0b_I1Q1_I0Q0, first sample at the right end: lsb first meets Q before I
    stream = ion_stream(
        ratefactor=2, quantization=1, packedbits=4, format="IQ", encoding="SIGN",
        samples_reversed=True,
    )  # fmt: skip
    wide = ion_stream("pad", ratefactor=1, quantization=4, packedbits=4)
    found = layout(ion_chunk(stream, wide), 0)
    assert found.packing.order == "lsb_first"
    assert found.packing.field == (4, 4)
    assert found.iq_order == "qi"


@pytest.mark.parametrize(("right", "shift"), [(False, 6), (True, 4)])
def test_ion_alignment_inside_packed_bits(right: bool, shift: int) -> None:
    stream = ion_stream(packedbits=4, right_aligned=right)
    other = ion_stream("B", quantization=4, packedbits=4)
    assert layout(ion_chunk(stream, other), 0).packing.field == (shift, 2)
    assert layout(ion_chunk(stream, other), 1).packing.field == (0, 4)


@pytest.mark.parametrize(
    ("encoding", "levels"),
    [
        ("TC", (0, 1, -2, -1)),
        ("OB", (-2, -1, 0, 1)),
        ("SM", (0, 1, 0, -1)),
        ("MS", (0, 0, 1, -1)),
        ("MSA", (1, -1, 3, -3)),
        ("OG", (-2, -1, 1, 0)),
        ("OGA", (-3, -1, 3, 1)),
    ],
)
def test_ion_encodings(encoding: str, levels: tuple[int, ...]) -> None:
    stream = ion_stream(ratefactor=4, packedbits=8, encoding=encoding)
    assert layout(ion_chunk(stream), 0).packing.levels == levels


@pytest.mark.parametrize(
    ("chunk", "word"),
    [
        (ion_chunk(ion_stream(quantization=3, packedbits=8)), "3-bit"),
        (ion_chunk(ion_stream(encoding="XX")), "XX"),
        (ion_chunk(ion_stream(packedbits=3)), "3-bit lumps"),
        (ion_chunk(ion_stream(), lumps_reversed=True), "reversed order"),
        (ion_chunk(ion_stream(format="ZZ")), "format ZZ"),
        (
            ion_chunk(
                ion_stream(quantization=16, packedbits=16, encoding="TC"),
                sizeword=2, little_endian=False,
            ),
            "little-endian",
        ),
        (ion_chunk(ion_stream(ratefactor=8, packedbits=16, samples_reversed=True), countwords=2),
         "opposite orders"),
    ],
)  # fmt: skip
def test_ion_refusals(chunk: IonChunk, word: str) -> None:
    with pytest.raises(RecordingError, match=word):
        layout(chunk, 0)


def test_ion_documents_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    for text, word in (
        ("<metadata>", "no XML"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><metadata/>", "document type"),
        ("<metadata/>", "describes no file"),
        ("<metadata><file><url>gone.dat</url></file></metadata>", "describes gone.dat"),
    ):
        path.write_text(text)
        with pytest.raises(RecordingError, match=word) as caught:
            describe(path)
        assert "m.xml" in str(caught.value)
    (tmp_path / "here.dat").write_bytes(bytes(8))
    path.write_text("<metadata><file><url>here.dat</url><lane id='A'/></file></metadata>")
    with pytest.raises(RecordingError, match="lane id='A'"):
        describe(path)


# --- HDF5 container ------------------------------------------------------------------------------


def container_streams() -> list[StreamFormat]:
    return [
        StreamFormat("a", "int8", "iq", 4e6, L1, block=Block(), iq_order="qi"),
        StreamFormat("b", "int16", "real", 5e6, L1, intermediate_hz=1.25e6),
        StreamFormat("c", "float32", "iq", 4e6, L1),
        StreamFormat(
            "d", "bits2", "iq", 8e6, 1561.098e6, spectrum="inverted",
            packing=Packing("lsb_first", "levels", (1, 3, -3, -1), 2, (4, 8)),
        ),
    ]  # fmt: skip


@pytest.mark.parametrize("compression", [None, "gzip"])
def test_container_round_trip(tmp_path: Path, compression: str | None) -> None:
    rng = np.random.default_rng(11)
    data = {
        "a": rng.integers(-128, 128, (3000, 2)).astype(np.int8),
        "b": rng.integers(-999, 999, 3000).astype("<i2"),
        "c": rng.normal(size=(3000, 2)).astype("<f4"),
        "d": rng.integers(0, 256, 3000).astype(np.uint8),
    }
    start = datetime(2020, 6, 25, 12, tzinfo=UTC)
    path = tmp_path / "new" / "all.h5"
    streams = container_streams()
    with ContainerWriter(path, start) as writer:
        for stream in streams:
            writer.add_stream(stream, compression)
            for piece in np.array_split(data[stream.name], 7):
                writer.append(stream.name, piece)
        assert not path.exists()
        writer.add_table("imu", {"t": np.arange(5.0), "wx": np.ones(5)}, kind="rates", rate=200.0)
    assert not path.with_name("all.h5.part").exists()
    description = describe(path)
    assert description is not None
    assert description.start == start
    bare = []
    for stream in streams:
        raw = tmp_path / f"{stream.name}.bin"
        data[stream.name].tofile(raw)
        bare.append(
            StreamFormat(**{**{k: getattr(stream, k) for k in stream.__slots__}, "file": raw})
        )
    with Recording(description.streams, path) as packed, Recording(bare) as flat:
        assert packed.streams == flat.streams
        for place, info in enumerate(flat.streams):
            for first, count in ((0, info.sample_count), (1, 17), (info.sample_count - 1, 1)):
                np.testing.assert_array_equal(
                    packed.read(place, first, count).samples, flat.read(place, first, count).samples
                )
    columns, attributes = read_table(path, "imu")
    assert columns["t"].tolist() == [0, 1, 2, 3, 4]
    assert attributes == {"kind": "rates", "rate": 200.0}


def test_container_same_input_same_bytes(tmp_path: Path) -> None:
    for name in ("x.h5", "y.h5"):
        with ContainerWriter(tmp_path / name) as writer:
            writer.add_stream(container_streams()[0])
            writer.append("a", np.ones((100, 2), np.int8))
    assert (tmp_path / "x.h5").read_bytes() == (tmp_path / "y.h5").read_bytes()


def test_container_broken_off_keeps_its_part_name(tmp_path: Path) -> None:
    path = tmp_path / "broken.h5"
    with pytest.raises(ValueError, match="stop"), ContainerWriter(path):
        raise ValueError("stop")
    assert not path.exists()


def test_container_refusals(tmp_path: Path) -> None:
    path = tmp_path / "c.h5"
    path.write_text("no HDF5 at all")
    with pytest.raises(RecordingError, match="no readable HDF5"):
        read_container(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(RecordingError, match="no stream /if/"):
        read_container(path)
    with pytest.raises(InputFileError, match="no table /imu"):
        read_table(path, "imu")
    with h5py.File(path, "w") as file:
        file["if/L1"] = np.ones(10, np.int8)
    with pytest.raises(RecordingError, match=r"attribute (format|samples|sample_rate_hz)"):
        read_container(path)
    with h5py.File(path, "a") as file:
        file["if/L1"].attrs.update(
            {"format": "int16", "samples": "iq", "sample_rate_hz": 4e6, "centre_hz": L1}
        )
    with pytest.raises(RecordingError, match="holds int8, but its format int16"):
        read_container(path)


# --- SnapperGPS ----------------------------------------------------------------------------------


def test_snapshots_bits(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    entry = {"timestamp": "2021-11-22T12:40:00.5Z", "data": "BYA="}  # 0x05 0x80
    path.write_text(json.dumps({"snapshots": [entry]}))
    (snapshot,) = read_snapshots(path)
    assert snapshot.time == datetime(2021, 11, 22, 12, 40, 0, 500_000, tzinfo=UTC)
    assert snapshot.block.samples.tolist() == [-1, 1, -1, *[1] * 5, *[1] * 7, -1]
    assert snapshot.block.stream.sample_rate_hz == 4.092e6


def test_snapshots_refusals(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    for text, word in (
        ("[]", "no SnapperGPS recording"),
        ('{"snapshots": []}', "snapshots"),
        ('{"snapshots": [{"timestamp": "2021-11-22T12:40:00Z", "data": "%"}]}', r"snapshots\.0"),
    ):
        path.write_text(text)
        with pytest.raises(RecordingError, match=word):
            list(read_snapshots(path))
    with pytest.raises(RecordingError, match="cannot be read"):
        list(read_snapshots(tmp_path / "none.json"))
