"""BCH(15, 11, 1) of the BeiDou messages: g(X) = X⁴ + X + 1 (BDS-SIS-ICD B1I 5.1.3).

The code is perfect: every 15 bits are a code word or one bit away from one. So it corrects any
single error, sees two only where nothing is corrected, and takes two for another one if it is.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.int8]

WORD_BITS: Final = 15
INFORMATION_BITS: Final = 11
_PARITY_BITS: Final = WORD_BITS - INFORMATION_BITS
_GENERATOR: Final = 0b10011


def _remainders() -> Bits:
    """Row k: X^(14 − k) mod g(X), first bit first, shape (15, 4): what bit k does to the check."""
    rows, value = [], 1
    for _ in range(WORD_BITS):
        rows.append([value >> shift & 1 for shift in range(_PARITY_BITS - 1, -1, -1)])
        value <<= 1
        if value >> _PARITY_BITS:
            value ^= _GENERATOR
    return np.array(rows[::-1], dtype=np.int8)


_CHECKS: Final = _remainders()
_BINARY: Final = 1 << np.arange(_PARITY_BITS - 1, -1, -1)
# Which bit a check value accuses; the check values of the 15 bits are all different.
_ACCUSED: Final = np.zeros(2**_PARITY_BITS, dtype=np.int64)
_ACCUSED[_CHECKS @ _BINARY] = np.arange(WORD_BITS)


def encode(information: Bits) -> Bits:
    """Code words, shape (…, 15), of information bits, shape (…, 11)."""
    parity = (information @ _CHECKS[:INFORMATION_BITS]) & 1
    return np.concatenate([information, parity.astype(np.int8)], axis=-1)


def correct(words: Bits) -> tuple[Bits, NDArray[np.bool_]]:
    """The code words nearest to received ones, shape (…, 15), and where a bit was turned (…)."""
    check = ((words @ _CHECKS) & 1) @ _BINARY
    wrong = check != 0
    turned = (np.arange(WORD_BITS) == _ACCUSED[check][..., np.newaxis]) & wrong[..., np.newaxis]
    return words ^ turned, wrong
