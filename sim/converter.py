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
    """Bytes of the file for float samples (rows, n) whose standard deviation is `sigma`."""
    bits = front_end.converter_bits
    if bits == VALUE_BITS["float32"]:
        return (samples.T / np.float32(sigma)).astype("<f4").tobytes()
    out = np.empty(samples.shape[::-1], dtype=np.int16)
    _quantize(samples, np.float32(1.0 / (sigma * step_over_sigma(bits))), bits, out)
    if front_end.format == "int16":
        return out.astype("<i2").tobytes()
    if front_end.format == "int8":
        return out.astype(np.int8).tobytes()
    stored = VALUE_BITS[front_end.format]
    packed = np.zeros(-(-out.size * stored // 8), dtype=np.uint8)
    _pack(out.reshape(-1), stored, packed)
    return packed.tobytes()


@kernel
def _quantize(
    samples: NDArray[np.float32], gain: np.float32, bits: int, out: NDArray[np.int16]
) -> None:
    """Levels (n, rows) of samples (rows, n) after `gain` (one step = 1)."""
    top = np.float32(2 ** (bits - 1) - 1)
    for row in range(samples.shape[0]):
        source = samples[row]
        if bits <= _ODD_LEVELS_TO:
            for n in range(source.size):
                step = np.floor(source[n] * gain)
                step = min(max(step, -top - np.float32(1.0)), top)
                out[n, row] = 2 * np.int16(step) + 1
        else:
            for n in range(source.size):
                step = np.floor(source[n] * gain + np.float32(0.5))
                out[n, row] = np.int16(min(max(step, -top), top))


@kernel
def _pack(values: NDArray[np.int16], bits: int, out: NDArray[np.uint8]) -> None:
    """Sign-magnitude codes of odd levels, first value in the most significant bits."""
    per_byte = 8 // bits
    sign = 1 << (bits - 1)
    for n in range(values.size):
        value = values[n]
        code = (sign | ((-value - 1) >> 1)) if value < 0 else (value - 1) >> 1
        shift = (per_byte - 1 - n % per_byte) * bits
        out[n // per_byte] |= np.uint8(code << shift)
