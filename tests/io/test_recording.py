"""Opening recordings: what cannot be read is said in one line, what can be read is."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.errors import RecordingError
from deepgnss.io.formats import Block, Channels, Packing, StreamFormat
from deepgnss.io.recording import Recording

L1 = 1575.42e6


def stream(name: str = "L1", **keys: object) -> StreamFormat:
    values = {"format": "int8", "samples": "iq", "sample_rate_hz": 4e6, "centre_hz": L1, **keys}
    return StreamFormat(name=name, **values)  # type: ignore[arg-type]


def one_line(caught: pytest.ExceptionInfo[RecordingError], *words: str) -> None:
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        Recording([stream()], tmp_path / "none.bin")
    one_line(caught, "none.bin", "no such file")


def test_empty_file(tmp_path: Path) -> None:
    (tmp_path / "e.bin").touch()
    with pytest.raises(RecordingError) as caught:
        Recording([stream()], tmp_path / "e.bin")
    one_line(caught, "e.bin", "empty")


def test_directory(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        Recording([stream()], tmp_path)
    one_line(caught, str(tmp_path), "directory")


def test_fifo_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError) as caught:
        Recording([stream()], tmp_path / "pipe")
    one_line(caught, "pipe", "no ordinary file")


def test_no_streams_and_no_file() -> None:
    with pytest.raises(RecordingError, match="no stream"):
        Recording([], Path("x.bin"))
    with pytest.raises(RecordingError, match="no file"):
        Recording([stream()])


def test_too_small_for_one_sample(tmp_path: Path) -> None:
    path = tmp_path / "s.bin"
    path.write_bytes(b"\x01\x02\x03")
    with pytest.raises(RecordingError) as caught:
        Recording([stream(format="int16")], path)
    one_line(caught, "3 bytes are too few", "int16 iq")
    with pytest.raises(RecordingError) as caught:
        Recording([stream(offset=2)], path)
    one_line(caught, "offset 2")
    with pytest.raises(RecordingError) as caught:
        Recording([stream(offset=99)], path)
    one_line(caught, "offset 99")


def test_odd_size_splits_a_number(tmp_path: Path) -> None:
    path = tmp_path / "odd.bin"
    path.write_bytes(bytes(4001))
    with pytest.raises(RecordingError) as caught:
        Recording([stream(format="int16")], path)
    one_line(caught, "odd.bin", "1 byte(s) left over", "4001", "int16")


def test_trailing_half_sample_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "half.bin"
    path.write_bytes(bytes(4001))
    with Recording([stream()], path) as recording:
        assert recording.streams[0].sample_count == 2000
        assert len(recording.notes) == 1
        assert "1 value(s) left over" in recording.notes[0]


def test_partial_block_is_noted_and_used(tmp_path: Path) -> None:
    path = tmp_path / "blocks.bin"
    path.write_bytes(b"".join(b"HHH" + bytes([k] * 8) for k in range(5)) + b"HHH\x05\x05\x05")
    with Recording([stream(block=Block(3, 8))], path) as recording:
        assert recording.streams[0].sample_count == 21
        assert "ends within a block (6 of 11 bytes)" in recording.notes[0]
        assert recording.read(0, 0, 21).samples[:, 0].tolist() == [k // 4 for k in range(21)]


def test_last_word_of_wide_frames_needs_no_note(tmp_path: Path) -> None:
    # 7 bytes of 1-bit values hold 9 frames of 6 and two bits that cannot be a sample
    path = tmp_path / "bits.bin"
    path.write_bytes(bytes(7))
    with Recording([stream(format="bits1", channels=Channels(3, 1))], path) as recording:
        assert recording.streams[0].sample_count == 9
        assert recording.notes == ()


def test_read_outside_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.bin"
    path.write_bytes(bytes(20))
    with Recording([stream()], path) as recording:
        for first, count in ((-1, 2), (9, 2), (0, 11), (3, -1)):
            with pytest.raises(RecordingError, match=r"samples 0 … 9"):
                recording.read(0, first, count)
        with pytest.raises(RecordingError, match="no stream 'L5'"):
            recording.read("L5", 0, 1)
        assert recording.read(0, 10, 0).samples.shape == (0, 2)


def test_growing_file_keeps_its_first_length(tmp_path: Path) -> None:
    path = tmp_path / "grow.bin"
    path.write_bytes(bytes(range(20)))
    with Recording([stream()], path) as recording, path.open("ab") as more:
        more.write(bytes(100))
        more.flush()
        assert recording.streams[0].sample_count == 10
        assert recording.read(0, 0, 10).samples.ravel().tolist() == list(range(20))


def test_shrinking_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "shrink.bin"
    path.write_bytes(bytes(20))
    with Recording([stream()], path) as recording:
        os.truncate(path, 10)
        assert recording.read(0, 0, 5).samples.shape == (5, 2)
        with pytest.raises(RecordingError, match="shrank from 20 to 10 bytes"):
            recording.read(0, 0, 6)


def test_nothing_written_reaches_the_file(tmp_path: Path) -> None:
    path = tmp_path / "safe.bin"
    path.write_bytes(bytes(20))
    with Recording([stream()], path) as recording:
        recording.read(0, 0, 10).samples[:] = 5
    assert path.read_bytes() == bytes(20)


def test_block_outlives_its_recording(tmp_path: Path) -> None:
    path = tmp_path / "late.bin"
    path.write_bytes(bytes(range(20)))
    with Recording([stream()], path) as recording:
        block = recording.read(0, 2, 3)
        recording.close()
        with pytest.raises(RecordingError, match="is closed"):
            recording.read(0, 0, 1)
    assert block.samples.tolist() == [[4, 5], [6, 7], [8, 9]]


def test_two_streams_two_files_and_inverted_frequency(tmp_path: Path) -> None:
    a, b = tmp_path / "a.bin", tmp_path / "b.bin"
    a.write_bytes(bytes([1, 2, 3, 4]))
    b.write_bytes(np.array([-300, 300, -32768, -32768], "<i2").tobytes())
    both = [
        stream("L1"),
        stream(
            "B1", format="int16", file=b, spectrum="inverted", iq_order="qi",
            intermediate_hz=2e5, centre_hz=1561.098e6,
        ),
    ]  # fmt: skip
    with Recording(both, a) as recording:
        assert [s.name for s in recording.streams] == ["L1", "B1"]
        assert recording.streams[1].intermediate_hz == -2e5
        assert recording.streams[1].centre_hz == 1561.098e6
        assert recording.read("B1", 0, 2).samples.tolist() == [[300, 300], [-32768, 32767]]
        assert recording.read("L1", 1, 1).samples.tolist() == [[3, 4]]


def test_inversion_undone_puts_a_tone_where_it_belongs(tmp_path: Path) -> None:
    # RF centre + 0.3 MHz through an inverting mixer with IF +0.5 MHz: it lies at 0.2 MHz
    n = np.arange(4000)
    z = 100 * np.exp(2j * np.pi * 0.2e6 / 4e6 * n)
    path = tmp_path / "tone.bin"
    np.column_stack([z.real, z.imag]).round().astype(np.int8).tofile(path)
    inverted = stream(spectrum="inverted", intermediate_hz=0.5e6)
    with Recording([inverted], path) as recording:
        info, block = recording.streams[0], recording.read(0, 0, 4000).samples
    spectrum = np.abs(np.fft.fft(block[:, 0] + 1j * block[:, 1]))
    peak_hz = np.fft.fftfreq(4000, 1 / 4e6)[np.argmax(spectrum)]
    assert info.centre_hz + peak_hz - info.intermediate_hz == pytest.approx(L1 + 0.3e6, abs=1e3)


def test_unaligned_int16_is_copied_aligned(tmp_path: Path) -> None:
    path = tmp_path / "odd_offset.bin"
    path.write_bytes(b"\xff" + np.arange(10, dtype="<i2").tobytes())
    with Recording([stream(format="int16", samples="real", offset=1)], path) as recording:
        samples = recording.read(0, 0, 10).samples
    assert samples.flags.aligned
    assert samples.tolist() == list(range(10))


def test_packing_of_the_independent_recordings() -> None:
    # README: 1 bit per value, 0 → +, msb first, I then Q: the default packing says just that
    assert Packing() == Packing("msb_first", "sign_magnitude", None, 1, None)
