"""The converter: float samples to levels, levels to the bytes of the file.

Up to 4 bits a converter has odd levels ±1, ±3 … (sign and magnitude), above it rounds to whole
numbers. Gain control is ideal: the level of the whole signal is known from its parts.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray
from deepgnss.io.formats import VALUE_BITS
from deepgnss.sim.scenario import FrontEnd

# Step over σ that loses least for a Gaussian input (J. Max, 1960), 1 to 4 bits.
_BEST_STEP: Final = {1: 1.5956, 2: 0.9957, 3: 0.5860, 4: 0.3352}
_ODD_LEVELS_TO: Final = 4
_HEADROOM: Final = 4.5  # σ at full scale of finer converters, up to 8 bits
_FINE_STEP: Final = 1.0 / 1024.0  # σ, of still finer ones


def step_over_sigma(bits: int) -> float:
    """Quantization step in units of the input's standard deviation."""
    if bits in _BEST_STEP:
        return _BEST_STEP[bits]
    return max(_HEADROOM / 2.0 ** (bits - 1), _FINE_STEP)


def levels(bits: int) -> tuple[FloatArray, FloatArray]:
    """Values a converter puts out, rising, and the thresholds between them in steps."""
    if bits <= _ODD_LEVELS_TO:
        half = 2 ** (bits - 1)
        return np.arange(1.0 - 2 * half, 2 * half, 2.0), np.arange(1.0 - half, half)
    top = 2 ** (bits - 1) - 1
    return np.arange(-top, top + 1.0), np.arange(-top, top) + 0.5


def convert(samples: NDArray[np.float32], sigma: float, front_end: FrontEnd) -> bytes:
    """Bytes of the file for float samples (rows, n) whose standard deviation is `sigma`.

    n fills whole bytes.
    """
    bits = front_end.converter_bits
    if bits == VALUE_BITS["float32"]:
        return (samples.T / np.float32(sigma)).astype("<f4").tobytes()
    gain = np.float32(1.0 / (sigma * step_over_sigma(bits)))
    steps = np.empty(samples.shape, dtype=np.int16)
    _quantize(samples, gain, bits, steps)
    stored = VALUE_BITS[front_end.format]
    if stored < VALUE_BITS["int8"]:
        packed = np.zeros(steps.size * stored // 8, dtype=np.uint8)
        _pack(steps, stored, packed)
        return packed.tobytes()
    values = 2 * steps + np.int16(1) if bits <= _ODD_LEVELS_TO else steps
    return values.T.astype("<i2" if front_end.format == "int16" else np.int8).tobytes()


@kernel
def _quantize(
    samples: NDArray[np.float32], gain: np.float32, bits: int, out: NDArray[np.int16]
) -> None:
    """Steps after `gain` (one step = 1), both (rows, n): step k stands for 2k + 1 up to 4 bits."""
    top = np.float32(2 ** (bits - 1) - 1)
    odd = bits <= _ODD_LEVELS_TO
    bottom = -top - np.float32(1.0) if odd else -top
    offset = np.float32(0.0) if odd else np.float32(0.5)
    for row in range(samples.shape[0]):
        source, target = samples[row], out[row]
        for n in range(source.size):
            step = np.floor(source[n] * gain + offset)
            target[n] = np.int16(min(max(step, bottom), top))


@kernel
def _pack(steps: NDArray[np.int16], bits: int, out: NDArray[np.uint8]) -> None:
    """Sign-magnitude codes of steps (rows, n), row by row within a sample, first value on top."""
    rows = steps.shape[0]
    samples = 8 // bits // rows  # per byte
    sign = 1 << (bits - 1)
    for sample in range(samples):
        for row in range(rows):
            shift = 8 - bits * (sample * rows + row + 1)
            source = steps[row, sample:]
            for n in range(out.size):
                step = source[n * samples]
                code = sign | ~step if step < 0 else step
                out[n] |= np.uint8(code << shift)
