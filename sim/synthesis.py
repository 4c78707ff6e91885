"""Kernels that write signals: codes and carriers of all rows added to a stretch of samples.

A row is one path of one emitter. Within each millisecond of the sample axis its code and carrier
follow cubics. A run of 32 samples is anchored in float64 at its middle, with the carrier rotating
at the millisecond's mean frequency about it: at 100 g (5 kHz/s) and 4 Msps that departs from the
cubic by 1e-5 cycle. Rows go through a millisecond one after the other, while it is in the cache.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray

RUN: Final = 32
_MIDDLE: Final = (RUN - 1) / 2.0
_TWO_PI: Final = 2.0 * math.pi
_FRACTION_BITS: Final = 32  # of a chip, in the fixed-point phase within a run
_WINDOW: Final = 64  # chips in a word
MOST_CHIPS_PER_SAMPLE: Final = (_WINDOW - 2) / RUN


def code_windows(code: NDArray[np.int8]) -> NDArray[np.int64]:
    """The 64 chips from each chip of a periodic code on, (chips,): bit set where the chip is −1."""
    after = np.arange(code.size)[:, None] + np.arange(_WINDOW)
    bits = (code[after % code.size] < 0).astype(np.uint64)
    words = np.bitwise_or.reduce(bits << np.arange(_WINDOW, dtype=np.uint64), axis=1)
    return np.asarray(words).view(np.int64)


@kernel
def add_signals(
    samples: NDArray[np.float32],
    first: int,
    first_ms: int,
    samples_per_ms: float,
    amplitude: FloatArray,
    carrier_cycles: FloatArray,
    code_chips: FloatArray,
    chip: NDArray[np.int64],
    period: NDArray[np.int64],
    signs: NDArray[np.int8],
    windows: NDArray[np.int64],
    code_sizes: NDArray[np.int64],
) -> None:
    """Add rows of signals to samples [first, first + n) of the recording.

    samples: (2, n) as I and Q, or (1, n) real. The rest by row and by millisecond from `first_ms`
    on: amplitude (rows, ms), nothing is done where it is 0; carrier_cycles and code_chips
    (rows, ms, 4), cubics in u in [0, 1), the code's relative to the whole chip `chip` of code
    period number `period` (both (rows, ms)). signs: (rows, periods) ±1, symbol × secondary code.
    windows: (rows, chips) of `code_windows`, of which the first code_sizes (rows,) count.
    """
    cosine, sine = np.empty(RUN, dtype=np.float32), np.empty(RUN, dtype=np.float32)
    picked = np.empty(RUN, dtype=np.float32)
    cut_i, cut_q = np.empty(RUN, dtype=np.float32), np.empty(RUN, dtype=np.float32)
    in_phase, quadrature = samples[0], samples[samples.shape[0] - 1]
    is_complex = samples.shape[0] == 2
    end = first + samples.shape[1]
    step = 1.0 / samples_per_ms
    h = RUN * step
    for k in range(amplitude.shape[1]):
        start = math.ceil((first_ms + k) * samples_per_ms)
        stop = math.ceil((first_ms + k + 1) * samples_per_ms)
        if stop <= first or start >= end:
            continue
        u = (start + _MIDDLE) * step - (first_ms + k)
        for row in range(amplitude.shape[0]):
            if amplitude[row, k] == 0.0:
                continue
            c0, c1, c2, c3 = carrier_cycles[row, k]
            b0, b1, b2, b3 = code_chips[row, k]
            size = code_sizes[row]
            _turns(cosine, sine, (c1 + c2 + 0.75 * c3) * step * _TWO_PI)
            # Phasor at the middle of each run, by differences of the cubic over a run.
            cycles = c0 + u * (c1 + u * (c2 + u * c3))
            first_step = h * (c1 + 2.0 * c2 * u + 3.0 * c3 * u * u)
            first_step += h * h * (c2 + 3.0 * c3 * u) + h * h * h * c3
            second_step = 2.0 * h * h * (c2 + 3.0 * c3 * u) + 6.0 * h * h * h * c3
            angle = (cycles - math.floor(cycles)) * _TWO_PI
            zr, zi = amplitude[row, k] * math.cos(angle), amplitude[row, k] * math.sin(angle)
            angle = (first_step - math.floor(first_step)) * _TWO_PI
            wr, wi = math.cos(angle), math.sin(angle)
            qr, qi = math.cos(second_step * _TWO_PI), math.sin(second_step * _TWO_PI)
            angle = 6.0 * h * h * h * c3 * _TWO_PI
            pr, pi = math.cos(angle), math.sin(angle)
            for run in range(start, stop, RUN):
                if run >= end:
                    break
                a, b = np.float32(zr), np.float32(zi)
                zr, zi = zr * wr - zi * wi, zr * wi + zi * wr
                wr, wi = wr * qr - wi * qi, wr * qi + wi * qr
                qr, qi = qr * pr - qi * pi, qr * pi + qi * pr
                if run + RUN <= first:
                    continue
                v = (run + _MIDDLE) * step - (first_ms + k)
                rate = (b1 + v * (2.0 * b2 + 3.0 * v * b3)) * step
                phase = b0 + v * (b1 + v * (b2 + v * b3)) - rate * _MIDDLE
                whole = math.floor(phase)
                fixed = np.int64((phase - whole) * (1 << _FRACTION_BITS))
                fixed_rate = np.int64(rate * (1 << _FRACTION_BITS))
                at = chip[row, k] + np.int64(whole)
                number = period[row, k]
                while at >= size:
                    at, number = at - size, number + 1
                while at < 0:
                    at, number = at + size, number - 1
                word = windows[row, at]
                if signs[row, number] < 0:
                    word = ~word
                if size - at < _WINDOW and signs[row, number] != signs[row, number + 1]:
                    word = word ^ (np.int64(-1) << (size - at))
                for j in range(RUN):
                    shift = (fixed + fixed_rate * np.int64(j)) >> _FRACTION_BITS
                    picked[j] = np.float32(1 - 2 * np.int32((word >> (shift & 63)) & 1))
                low = run - first
                if low >= 0 and run + RUN <= stop and run + RUN <= end:
                    for j in range(RUN):
                        in_phase[low + j] += picked[j] * (a * cosine[j] - b * sine[j])
                    if is_complex:
                        for j in range(RUN):
                            quadrature[low + j] += picked[j] * (b * cosine[j] + a * sine[j])
                else:  # a run cut by the end of the millisecond or of the samples asked for
                    for j in range(RUN):
                        cut_i[j] = picked[j] * (a * cosine[j] - b * sine[j])
                        cut_q[j] = picked[j] * (b * cosine[j] + a * sine[j])
                    for n in range(max(first, run), min(stop, end, run + RUN)):
                        in_phase[n - first] += cut_i[n - run]
                        if is_complex:
                            quadrature[n - first] += cut_q[n - run]


@kernel
def _turns(cosine: NDArray[np.float32], sine: NDArray[np.float32], turn: float) -> None:
    """Fill cos and sin of turn·(j − middle of the run), by one rotation after the other."""
    real, imaginary = math.cos(turn * _MIDDLE), -math.sin(turn * _MIDDLE)
    cos, sin = math.cos(turn), math.sin(turn)
    for j in range(RUN):
        cosine[j], sine[j] = np.float32(real), np.float32(imaginary)
        real, imaginary = real * cos - imaginary * sin, real * sin + imaginary * cos
