"""Kernels that write signals: code and carrier of one emitter added to a stretch of samples.

Within each millisecond of the sample axis code and carrier follow cubics; a run of 32 samples is
anchored in float64 at its middle, with the carrier rotating at the millisecond's mean frequency
about it. At 100 g (5 kHz/s) and 4 Msps that departs from the cubic by 1e-5 cycle.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray

_RUN: Final = 32
_MIDDLE: Final = (_RUN - 1) / 2.0
_TWO_PI: Final = 2.0 * math.pi


@kernel
def add_signal(
    samples: NDArray[np.float32],
    first: int,
    first_ms: int,
    samples_per_ms: float,
    carrier_cycles: FloatArray,
    code_chips: FloatArray,
    chip_base: NDArray[np.int64],
    amplitude: FloatArray,
    code: NDArray[np.int8],
    symbols: NDArray[np.int8],
    first_symbol: int,
    chips_per_symbol: int,
) -> None:
    """Add one emitter to samples [first, first + n) of the recording.

    samples: (2, n) as I and Q, or (1, n) real. carrier_cycles, code_chips: (milliseconds, 4) cubics
    in u in [0, 1) from millisecond `first_ms` on, the code's relative to the whole chip number
    chip_base (milliseconds,) since the signal's time zero. amplitude: (milliseconds,). symbols:
    ±1, the first of number `first_symbol` since the signal's time zero.
    """
    chips = np.empty(0, dtype=np.float32)
    cosine, sine = np.empty(_RUN, dtype=np.float32), np.empty(_RUN, dtype=np.float32)
    picked, scratch = np.empty(_RUN, dtype=np.float32), np.empty(_RUN, dtype=np.float32)
    end = first + samples.shape[1]
    step = 1.0 / samples_per_ms
    for k in range(carrier_cycles.shape[0]):
        start = math.ceil((first_ms + k) * samples_per_ms)
        stop = math.ceil((first_ms + k + 1) * samples_per_ms)
        if stop <= first or start >= end:
            continue
        c0, c1, c2, c3 = carrier_cycles[k]
        b0, b1, b2, b3 = code_chips[k]
        needed = int(b0 + b1 + b2 + b3 + _RUN * b1 * step) + 4
        if chips.size < needed:
            chips = np.empty(needed, dtype=np.float32)
        _unroll(chips, chip_base[k] - 1, code, symbols, first_symbol, chips_per_symbol)
        turn = (c1 + c2 + 0.75 * c3) * step * _TWO_PI  # per sample, mid-millisecond
        for j in range(_RUN):
            angle = turn * (j - _MIDDLE)
            cosine[j], sine[j] = math.cos(angle), math.sin(angle)
        for run in range(start, stop, _RUN):
            if run + _RUN <= first or run >= end:
                continue
            u = (run + _MIDDLE) * step - (first_ms + k)
            cycles = c0 + u * (c1 + u * (c2 + u * c3))
            angle = (cycles - math.floor(cycles)) * _TWO_PI
            real = np.float32(amplitude[k] * math.cos(angle))
            imaginary = np.float32(amplitude[k] * math.sin(angle))
            rate = (b1 + u * (2.0 * b2 + 3.0 * u * b3)) * step
            chip = 1.0 + b0 + u * (b1 + u * (b2 + u * b3)) - rate * _MIDDLE
            low, high = max(first, run), min(stop, end, run + _RUN)
            for j in range(_RUN):
                picked[j] = chips[np.int32(chip + rate * j)]
            for row in range(samples.shape[0]):
                a, b = (real, imaginary) if row == 0 else (imaginary, -real)
                if high - low == _RUN:
                    _add_run(samples[row, low - first : high - first], picked, a, b, cosine, sine)
                else:  # a run cut by the end of the millisecond or of the samples asked for
                    scratch[:] = 0.0
                    _add_run(scratch, picked, a, b, cosine, sine)
                    samples[row, low - first : high - first] += scratch[low - run : high - run]


@kernel
def _add_run(
    out: NDArray[np.float32],
    picked: NDArray[np.float32],
    a: np.float32,
    b: np.float32,
    cosine: NDArray[np.float32],
    sine: NDArray[np.float32],
) -> None:
    """Add a run of chips on a carrier: out += picked·(a·cosine − b·sine)."""
    for j in range(_RUN):
        out[j] += picked[j] * (a * cosine[j] - b * sine[j])


@kernel
def _unroll(
    chips: NDArray[np.float32],
    first_chip: int,
    code: NDArray[np.int8],
    symbols: NDArray[np.int8],
    first_symbol: int,
    chips_per_symbol: int,
) -> None:
    """Fill chips with code × symbol from chip number `first_chip` on."""
    at = first_chip % code.size
    symbol = first_chip // chips_per_symbol
    left = (symbol + 1) * chips_per_symbol - first_chip
    sign = symbols[symbol - first_symbol]
    for i in range(chips.size):
        chips[i] = code[at] * sign
        at += 1
        left -= 1
        if at == code.size:
            at = 0
        if left == 0:
            symbol += 1
            left = chips_per_symbol
            sign = symbols[symbol - first_symbol]


@kernel
def filter_centred(
    samples: NDArray[np.float32], taps: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """out[:, n] = Σ taps[j]·samples[:, n + j]; samples longer by taps.size − 1."""
    for row in range(out.shape[0]):
        source, target = samples[row], out[row]
        target[:] = 0.0
        for j in range(taps.size):
            tap = taps[j]
            for n in range(target.size):
                target[n] += tap * source[n + j]
