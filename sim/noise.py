"""White Gaussian noise as a function of seed, stream and sample number alone.

Sample n takes the 64 bits of SplitMix64 (Steele, Lea, Flood 2014) at counter n: 31 for the radius
of Box and Muller's pair, 33 for its angle. Logarithm, sine and cosine are polynomials in single
precision (after S. Moshier's Cephes), so that the same bits come out compiled or not, on any
machine. Tails reach 6.6 σ.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel

_STRETCH: Final = 512  # samples at a time, in scratch that stays in the innermost cache
_f = np.float32
_U: Final = np.uint64
_GOLDEN: Final = _U(0x9E3779B97F4A7C15)
_MIX1: Final = _U(0xBF58476D1CE4E5B9)
_MIX2: Final = _U(0x94D049BB133111EB)
_S30, _S27, _S31, _S33 = _U(30), _U(27), _U(31), _U(33)
_LOW31, _LOW2 = _U(0x7FFFFFFF), _U(3)
_MIDDLE: Final = np.int32(1 << 30)

_SPLIT: Final = np.int32(0x3F3504F3)  # bits of √½: mantissas are taken from √½ to √2
_EXPONENT: Final = np.int32(-(1 << 23))  # mask of sign and exponent
_HALF, _ONE = _f(0.5), _f(1.0)
_TWO: Final = _f(2.0)
_LN2: Final = _f(np.log(2.0))
_UNIT: Final = _f(31.0 * np.log(2.0))  # ln of the 2³¹ that the radius' integer counts
_QUARTER: Final = _f(np.pi / 2.0**32)  # (−2³⁰ … 2³⁰) → ∓π/4
_L = tuple(
    _f(x)
    for x in (
        7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1,
        -1.6668057665e-1, 2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1,
    )
)  # fmt: skip
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = _L
_S0, _S1, _S2 = _f(-1.9515295891e-4), _f(8.3321608736e-3), _f(-1.6666654611e-1)
_C0, _C1, _C2 = _f(2.443315711809948e-5), _f(-1.388731625493765e-3), _f(4.166664568298827e-2)


def normal_pairs(key: int, first: int, count: int) -> NDArray[np.float32]:
    """Independent standard normals of samples [first, first + count), (2, count) float32.

    key: 64 bits; first may be negative.
    """
    out = np.empty((2, count), dtype=np.float32)
    with np.errstate(over="ignore"):  # counters wrap
        start = np.array([first]).astype(np.uint64)[0] * _GOLDEN + _U(key)
        _fill(start, out)
    return out


@kernel
def _fill(start: np.uint64, out: NDArray[np.float32]) -> None:
    """Normals of the samples whose counters follow from `start`.

    Scratch is one array, by offsets, which the compiler knows not to overlap.
    """
    ints = np.empty(4 * _STRETCH, dtype=np.int32)
    floats = ints.view(np.float32)
    for low in range(0, out.shape[1], _STRETCH):
        in_phase, quadrature = out[0, low : low + _STRETCH], out[1, low : low + _STRETCH]
        n = in_phase.size
        for j in range(n):
            z = start + np.uint64(low + j) * _GOLDEN
            z = (z ^ (z >> _S30)) * _MIX1
            z = (z ^ (z >> _S27)) * _MIX2
            z = z ^ (z >> _S31)
            ints[j] = np.int32(z >> _S33)
            ints[_STRETCH + j] = np.int32(z & _LOW31) - _MIDDLE
            ints[2 * _STRETCH + j] = np.int32((z >> _S31) & _LOW2)
        for j in range(n):
            floats[3 * _STRETCH + j] = np.float32(ints[j]) + _HALF
        for j in range(n):  # = 2^exponent · mantissa
            above = np.int32(ints[3 * _STRETCH + j] - _SPLIT) & _EXPONENT
            ints[j] = above >> 23
            ints[3 * _STRETCH + j] -= above
        for j in range(n):
            f = floats[3 * _STRETCH + j] - _ONE
            square = f * f
            p = (((_L0 * f + _L1) * f + _L2) * f + _L3) * f + _L4
            p = (((p * f + _L5) * f + _L6) * f + _L7) * f + _L8
            logarithm = f + (square * f * p - _HALF * square)
            logarithm = (np.float32(ints[j]) * _LN2 - _UNIT) + logarithm
            radius = np.sqrt(np.abs(_TWO * logarithm))
            t = (np.float32(ints[_STRETCH + j]) + _HALF) * _QUARTER
            square = t * t
            sine = t + t * square * ((_S0 * square + _S1) * square + _S2)
            cosine = (_ONE - _HALF * square) + square * square * (
                (_C0 * square + _C1) * square + _C2
            )
            q = ints[2 * _STRETCH + j]
            a = sine if q & 1 else cosine
            b = cosine if q & 1 else sine
            in_phase[j] = -radius * a if (q + 1) & 2 else radius * a
            quadrature[j] = -radius * b if q & 2 else radius * b
