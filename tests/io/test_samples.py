"""Every sample format against a slow twin that reads bits as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.errors import RecordingError
from deepgnss.io import samples as kernels
from deepgnss.io.formats import VALUE_BITS, Block, Channels, Packing, StreamFormat
from deepgnss.io.recording import Recording

pytestmark = pytest.mark.kernel

RATE = 4.0e6
L1 = 1575.42e6

# What each two-bit code means, written out by hand.
TWO_BIT_LEVELS = {
    "sign_magnitude": [1, 3, -1, -3],
    "twos_complement": [1, 3, -3, -1],
    "offset_binary": [-3, -1, 1, 3],
}


def twin(data: bytes, stream: StreamFormat) -> list[tuple[int, ...]]:
    """All samples of integer formats, one tuple each, without any array."""
    payload = b""
    rest = data[stream.offset :]
    if stream.block.payload:
        while rest:
            rest = rest[stream.block.header :]
            payload += rest[: stream.block.payload]
            rest = rest[stream.block.payload + stream.block.footer :]
    else:
        payload = rest
    numbers = []
    bits, size = VALUE_BITS[stream.format], stream.word_bytes
    for start in range(0, len(payload) - size + 1, size):
        word = payload[start : start + size]
        if not stream.is_packed:
            numbers.append(int.from_bytes(word, "little", signed=True))
            continue
        text = f"{int.from_bytes(word, 'little'):0{8 * size}b}"
        if stream.packing.field:
            shift, width = stream.packing.field
            text = text[len(text) - shift - width : len(text) - shift]
        codes = [int(text[k : k + bits], 2) for k in range(0, len(text), bits)]
        numbers += codes if stream.packing.order == "msb_first" else codes[::-1]
    if stream.is_packed:
        levels = kernels.level_table(bits, stream.packing).tolist()
        numbers = [levels[code] for code in numbers]
    count, index = stream.channels.count, stream.channels.index
    if stream.samples == "real":
        return [(x,) for x in numbers[: len(numbers) // count * count][index::count]]
    pairs = list(zip(numbers[0::2], numbers[1::2], strict=False))
    chosen = pairs[: len(pairs) // count * count][index::count]
    if stream.iq_order == "qi":
        chosen = [(i, q) for q, i in chosen]
    if stream.spectrum == "inverted":
        highest = 32767 if stream.format == "int16" else 127
        chosen = [(i, min(-q, highest)) for i, q in chosen]
    return chosen


@st.composite
def packings(draw: st.DrawFn, bits: int) -> Packing:
    word_bytes = draw(st.sampled_from([1, 2, 4, 8]))
    code = draw(st.sampled_from(["sign_magnitude", "twos_complement", "offset_binary", "levels"]))
    levels = None
    if code == "levels":
        levels = tuple(
            draw(st.lists(st.integers(-128, 127), min_size=1 << bits, max_size=1 << bits))
        )
    field = None
    if draw(st.booleans()):
        values = draw(st.integers(1, 8 * word_bytes // bits))
        field = (draw(st.integers(0, 8 * word_bytes - values * bits)), values * bits)
    order = draw(st.sampled_from(["msb_first", "lsb_first"]))
    return Packing(order=order, code=code, levels=levels, word_bytes=word_bytes, field=field)


@st.composite
def formats(draw: st.DrawFn) -> StreamFormat:
    kind = draw(st.sampled_from(["int8", "int16", "bits1", "bits2", "bits4"]))
    bits = VALUE_BITS[kind]
    packing = draw(packings(bits)) if bits < 8 else Packing()
    word = packing.word_bytes if bits < 8 else bits // 8
    count = draw(st.integers(1, 3))
    block = Block()
    if draw(st.booleans()):
        block = Block(
            draw(st.integers(0, 5)), word * draw(st.integers(1, 9)), draw(st.integers(0, 3))
        )
    return StreamFormat(
        name="L1",
        format=kind,
        samples=draw(st.sampled_from(["real", "iq"])),
        sample_rate_hz=RATE,
        centre_hz=L1,
        intermediate_hz=1.0e6,
        iq_order=draw(st.sampled_from(["iq", "qi"])),
        packing=packing,
        block=block,
        channels=Channels(count, draw(st.integers(0, count - 1))),
        spectrum=draw(st.sampled_from(["upright", "inverted"])),
        offset=draw(st.integers(0, 7)),
    )


@settings(deadline=None, derandomize=True, max_examples=300)
@given(stream=formats(), data=st.binary(min_size=400, max_size=500), draw=st.data())
def test_any_format_any_place_equals_twin(
    tmp_path_factory: pytest.TempPathFactory,
    stream: StreamFormat,
    data: bytes,
    draw: st.DataObject,
) -> None:
    body = len(data) - stream.offset
    if not stream.block.payload:
        data = data[: stream.offset + body - body % stream.word_bytes]
    else:
        period = stream.block.header + stream.block.payload + stream.block.footer
        data = data[: stream.offset + body - body % period]
    path = tmp_path_factory.getbasetemp() / "any.bin"
    path.write_bytes(data)
    expected = np.array(twin(data, stream))
    with Recording([stream], path) as recording:
        total = recording.streams[0].sample_count
        assert total == len(expected)
        first = draw.draw(st.integers(0, total))
        count = draw.draw(st.integers(0, total - first))
        block = recording.read("L1", first, count)
    got = block.samples if stream.samples == "iq" else block.samples[:, np.newaxis]
    assert block.first == first
    assert got.shape == (count, stream.components)
    assert got.flags.c_contiguous
    assert got.dtype == (np.int16 if stream.format == "int16" else np.int8)
    np.testing.assert_array_equal(got, expected[first : first + count].reshape(got.shape))


@pytest.mark.parametrize("code", TWO_BIT_LEVELS)
def test_two_bit_codes(code: str) -> None:
    assert kernels.level_table(2, Packing(code=code)).tolist() == TWO_BIT_LEVELS[code]


def test_one_bit_zero_is_plus() -> None:
    assert kernels.level_table(1, Packing(code="sign_magnitude")).tolist() == [1, -1]
    assert kernels.level_table(1, Packing(code="twos_complement")).tolist() == [1, -1]
    assert kernels.level_table(1, Packing(code="offset_binary")).tolist() == [-1, 1]


@pytest.mark.parametrize("code", TWO_BIT_LEVELS)
@pytest.mark.parametrize("bits", [1, 2, 4])
def test_codes_are_odd_and_symmetric(bits: int, code: str) -> None:
    levels = kernels.level_table(bits, Packing(code=code))
    top = (1 << bits) - 1
    assert sorted(levels.tolist()) == list(range(-top, top + 1, 2))


def test_wide_levels_become_int16() -> None:
    levels = kernels.level_table(1, Packing(code="levels", levels=(300, -300)))
    assert levels.dtype == np.int16
    assert levels.tolist() == [300, -300]


def floats(**keys: object) -> StreamFormat:
    return StreamFormat("L1", "float32", "iq", RATE, L1, **keys)  # type: ignore[arg-type]


def test_float_samples_scale_by_one_factor(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    values = (rng.normal(size=(50_000, 2)) * 3e-4).astype("<f4")
    path = tmp_path / "f.bin"
    values.tofile(path)
    with Recording([floats()], path) as recording:
        whole = recording.read(0, 0, 50_000).samples
        parts = [recording.read(0, k, min(777, 50_000 - k)).samples for k in range(0, 50_000, 777)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert whole.dtype == np.int16
    rms = np.sqrt(np.mean(whole.astype(float) ** 2))
    assert rms == pytest.approx(kernels.FLOAT_RMS, rel=0.02)  # the factor comes from a sample
    factor = np.sum(whole * values.astype(float)) / np.sum(values.astype(float) ** 2)
    assert np.max(np.abs(whole - factor * values)) <= 0.51


@settings(deadline=None, derandomize=True)
@given(
    values=st.lists(st.floats(width=32, allow_nan=True, allow_infinity=True), max_size=30),
    factor=st.floats(1e-3, 1e3),
)
def test_scale_floats_saturates(values: list[float], factor: float) -> None:
    array = np.array(values, np.float32)
    scaled = np.empty(array.size, np.int16)
    kernels.scale_floats(array, factor, scaled)
    exact = array.astype(float) * factor
    expected = np.clip(np.rint(np.nan_to_num(exact, nan=0.0)), -32767, 32767)
    np.testing.assert_array_equal(scaled, expected)


def test_kernels_agree_without_compiler() -> None:
    rng = np.random.default_rng(3)
    words = rng.integers(0, 256, 60, dtype=np.uint8)
    levels = np.array([1, 3, -3, -1], np.int8)
    frames = rng.integers(-128, 128, (9, 6)).astype(np.int8)
    floats32 = np.array([0.5, 1.5, -2.5, np.nan, 1e9, -np.inf], np.float32)
    results = []
    for run in (lambda k: k, lambda k: getattr(k, "py_func", k)):
        fields = np.empty(75, np.int8)
        run(kernels.unpack_fields)(words, 4, 22, -2, 2, levels, fields)
        picked = np.empty((9, 2), np.int8)
        run(kernels.pick_channel)(frames, 2, 1, True, True, -128, picked)
        real = np.empty((9, 1), np.int8)
        run(kernels.pick_channel)(frames, 1, 4, False, False, -128, real)
        scaled = np.empty(6, np.int16)
        run(kernels.scale_floats)(floats32, 1.0, scaled)
        results.append(np.concatenate([fields, picked.ravel(), real.ravel(), scaled]))
    np.testing.assert_array_equal(results[0], results[1])
    assert results[0][-6:].tolist() == [0, 2, -2, 0, 32767, -32767]


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        ({"sample_rate_hz": 0.0}, "sample_rate"),
        ({"format": "int12"}, "int8, int16"),
        ({"iq_order": "xy"}, "iq_order"),
        ({"offset": -1}, "offset"),
        ({"channels": Channels(2, 2)}, "channels.index"),
        ({"block": Block(512, 0)}, "block.payload"),
        ({"block": Block(512, 3), "format": "int16"}, "2-byte words"),
        ({"format": "bits2", "packing": Packing(code="levels")}, "packing.levels"),
        ({"format": "bits2", "packing": Packing(levels=(1, 2, 3, 4))}, "packing.levels"),
        ({"format": "bits2", "packing": Packing(code="levels", levels=(1, -1))}, "4 values"),
        ({"format": "bits2", "packing": Packing(field=(0, 3))}, "packing.field"),
        ({"format": "bits2", "packing": Packing(field=(4, 6))}, "packing.field"),
        ({"format": "bits2", "packing": Packing(word_bytes=3)}, "word_bytes"),
        ({"packing": Packing(order="lsb_first")}, "only for bits1"),
    ],
)
def test_impossible_formats_name_the_key(keys: dict[str, object], word: str) -> None:
    base = {
        "name": "L1", "format": "int8", "samples": "iq", "sample_rate_hz": RATE, "centre_hz": L1
    }  # fmt: skip
    with pytest.raises(RecordingError, match=word) as caught:
        StreamFormat(**{**base, **keys})  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
