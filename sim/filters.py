"""The front end's filter: taps of a linear-phase FIR, and the kernel that applies it."""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.sim.scenario import FrontEnd

_STRETCH: Final = 2048  # samples that pass all taps while they are in the cache


def low_pass(front_end: FrontEnd) -> NDArray[np.float32] | None:
    """Taps of the front end's filter, unit gain in mid-band; None when there is none."""
    if front_end.bandwidth_hz is None:
        return None
    half_hz, middle_hz = front_end.bandwidth_hz / 2.0, abs(front_end.intermediate_hz)
    if front_end.is_complex:
        edges, through_zero = [half_hz], True
    else:
        edges, through_zero = [middle_hz - half_hz, middle_hz + half_hz], False
    taps = scipy.signal.firwin(
        front_end.filter_taps, edges, pass_zero=through_zero, fs=front_end.sample_rate_hz
    )
    return np.asarray(taps, dtype=np.float32)


@kernel
def filter_centred(
    samples: NDArray[np.float32], taps: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """out[:, n] = Σ taps[j]·samples[:, n + j]; samples longer by taps.size − 1.

    Taps are symmetric and odd in number: pairs at equal distance from the middle share a product.
    """
    half = taps.size // 2
    for row in range(out.shape[0]):
        for low in range(0, out.shape[1], _STRETCH):
            target = out[row, low : low + _STRETCH]
            source = samples[row, low : low + target.size + 2 * half]
            middle = source[half:]
            for n in range(target.size):
                target[n] = taps[half] * middle[n]
            for j in range(half):
                tap, left, right = taps[j], source[j:], source[2 * half - j :]
                for n in range(target.size):
                    target[n] += tap * (left[n] + right[n])
