"""Kernels of the simulator against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.io.formats import VALUE_BITS, ValueFormat
from deepgnss.sim.converter import convert, levels, step_over_sigma
from deepgnss.sim.filters import filter_centred
from deepgnss.sim.scenario import FrontEnd
from deepgnss.sim.synthesis import add_signals, code_windows

pytestmark = pytest.mark.kernel

CODES = [np.where(np.random.default_rng(k).random(n) < 0.5, 1, -1) for k, n in enumerate((89, 178))]


def _twin(
    samples: NDArray[np.float32],
    first: int,
    first_ms: int,
    per_ms: float,
    amplitude: FloatArray,
    carrier: FloatArray,
    code: FloatArray,
    chip: NDArray[np.int64],
    period: NDArray[np.int64],
    signs: NDArray[np.int8],
) -> FloatArray:
    """Every sample by its own cubics, in double precision."""
    n = np.arange(first, first + samples.shape[1])
    # a sample that lies on the edge of a millisecond belongs to the one that begins there
    k = (
        np.searchsorted(np.ceil((first_ms + np.arange(amplitude.shape[1])) * per_ms), n, "right")
        - 1
    )
    u = n / per_ms - first_ms - k
    powers = u[:, None] ** np.arange(4)
    out = np.zeros(n.size, dtype=np.complex128)
    for row in range(amplitude.shape[0]):
        chips = np.floor(np.sum(code[row, k] * powers, axis=1)).astype(int) + chip[row, k]
        size = CODES[row].size
        value = CODES[row][chips % size] * signs[row, period[row, k] + chips // size]
        cycles = np.sum(carrier[row, k] * powers, axis=1)
        out += amplitude[row, k] * value * np.exp(2j * np.pi * cycles)
    return samples + (np.array([out.real, out.imag]) if samples.shape[0] == 2 else out.real)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(
    per_ms=st.sampled_from([128.0, 131.7, 200.25, 517.3]),
    first=st.integers(0, 900),
    count=st.integers(1, 700),
    rows=st.sampled_from([1, 2]),
    seed=st.integers(0, 1000),
)
def test_signals_are_what_their_cubics_say(
    per_ms: float, first: int, count: int, rows: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    first_ms = int(first / per_ms)
    ms = int(count / per_ms) + 3
    amplitude = random.uniform(0.5, 1.5, (2, ms)) * (random.random((2, ms)) < 0.8)
    carrier = random.normal(size=(2, ms, 4)) * [1e3, 9.0, 2e-4, 1e-5]
    code = random.uniform(0.0, 1.0, (2, ms, 4)) * [1.0, 0.0, 1e-3, 1e-4]
    code[..., 1] = np.array([[90.31], [113.07]])
    chip = random.integers(0, 89, (2, ms))
    period = random.integers(0, 5, (2, ms))
    signs = random.choice(np.array([-1, 1], dtype=np.int8), (2, 9))
    windows = np.zeros((2, 178), dtype=np.int64)
    for row, primary in enumerate(CODES):
        windows[row, : primary.size] = code_windows(primary.astype(np.int8))
    sizes = np.array([primary.size for primary in CODES])
    start = random.normal(size=(rows, count)).astype(np.float32)
    expected = _twin(start, first, first_ms, per_ms, amplitude, carrier, code, chip, period, signs)
    samples = start.copy()
    add_signals(
        samples, first, first_ms, per_ms, amplitude, carrier, code, chip, period, signs, windows,
        sizes,
    )  # fmt: skip
    off = np.abs(samples - expected).max(axis=0) > 2e-3
    # a chip's edge that falls on a sample to the last digits may fall to either side
    assert np.sum(off) <= 1 + count // 500
    assert off.mean() < 0.5 or count < 4


def test_silence_costs_no_signal() -> None:
    samples = np.zeros((2, 300), dtype=np.float32)
    nothing = np.zeros((1, 3, 4))
    add_signals(
        samples, 0, 0, 128.0, np.zeros((1, 3)), nothing, nothing, np.zeros((1, 3), np.int64),
        np.zeros((1, 3), np.int64), np.ones((1, 3), np.int8),
        code_windows(CODES[0].astype(np.int8))[None], np.array([89]),
    )  # fmt: skip
    assert not samples.any()


def test_windows_hold_the_next_64_chips() -> None:
    windows = code_windows(CODES[0].astype(np.int8))
    for at in (0, 40, 88):
        bits = [(int(windows[at]) >> k) & 1 for k in range(64)]
        assert bits == [int(CODES[0][(at + k) % 89] < 0) for k in range(64)]


@pytest.mark.parametrize("count", [1, 100, 2049])
def test_filter_is_a_convolution(count: int) -> None:
    random = np.random.default_rng(1)
    taps = random.normal(size=31).astype(np.float32)
    taps = taps + taps[::-1]
    samples = random.normal(size=(2, count + 30)).astype(np.float32)
    out = np.empty((2, count), dtype=np.float32)
    filter_centred(samples, taps, out)
    expected = [np.convolve(row.astype(float), taps.astype(float), "valid") for row in samples]
    np.testing.assert_allclose(out, expected, atol=3e-5)


@pytest.mark.parametrize("is_complex", [True, False], ids=["iq", "real"])
@pytest.mark.parametrize("form", ["bits1", "bits2", "bits4", "int8", "int16", "float32"])
def test_bytes_of_a_converter(form: ValueFormat, is_complex: bool) -> None:
    """Levels by their thresholds; codes by numpy's bit packing."""
    rows = 1 + is_complex
    random = np.random.default_rng(3)
    samples = (4.0 * random.normal(size=(rows, 264))).astype(np.float32)
    middle_hz = 0.0 if is_complex else 1.0e6
    front_end = FrontEnd(4.0e6, form, is_complex=is_complex, intermediate_hz=middle_hz)
    data = convert(samples, 4.0, front_end)
    flat = samples.T.reshape(-1)
    if form == "float32":
        np.testing.assert_array_equal(np.frombuffer(data, "<f4"), flat / np.float32(4.0))
        return
    bits = front_end.converter_bits
    values, thresholds = levels(bits)
    step = np.float32(1.0 / (4.0 * step_over_sigma(bits)))
    expected = values[np.searchsorted(thresholds, flat * step, side="right")].astype(int)
    if VALUE_BITS[form] >= 8:
        read = np.frombuffer(data, "<i2" if form == "int16" else np.int8)
    else:
        codes = np.unpackbits(np.frombuffer(data, np.uint8)).reshape(-1, bits)
        magnitude = codes[:, 1:].astype(int) @ (1 << np.arange(bits - 2, -1, -1)) if bits > 1 else 0
        read = (1 - 2 * codes[:, 0].astype(int)) * (2 * magnitude + 1)
    np.testing.assert_array_equal(read, expected)
