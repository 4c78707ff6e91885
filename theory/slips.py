"""What a wrong attitude does to the slip test between two antennas, S(1.3).

The triple difference of satellites i and j over a baseline b holds, besides whole cycles and
noise, (uᵢ − uⱼ)·δb/λ, with δb = φ × b what the attitude's error changed by since the epoch before
(φ, rad). Lines of sight differ by 2 at most, so |value| ≤ 2·b·φ/λ cycles for a turn by φ. S asks
that four of its σ stay below a cycle and takes that bound for σ: φ < λ/(8·b). For b = 1 m and
λ = 0.1903 m this is 0.02379 rad, 1.363°; S prints 1.375°, which is 0.024 rad, the same rounded up
before the change to degrees. Rounding itself (a cycle found, none told where there is none) holds
to twice that, λ/(4·b).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import erf

from deepgnss.core.records import FloatArray

_SIGMAS: Final = 4.0  # of S's threshold


def attitude_limit_rad(baseline_m: float, wavelength_m: float, cycles: float = 1.0) -> float:
    """Turn, since the epoch before, within which slips of `cycles` exceed S's threshold."""
    return cycles * wavelength_m / (2.0 * _SIGMAS * baseline_m)


def rounding_limit_rad(baseline_m: float, wavelength_m: float) -> float:
    """Turn up to which rounding never fails, whatever the satellites; noise left aside."""
    return wavelength_m / (4.0 * baseline_m)


def value_sigma_cycles(
    turn_rad: float,
    baseline_m: FloatArray,
    sights: FloatArray,
    wavelength_m: float,
    phase_m: float = 0.0,
) -> FloatArray:
    """1σ of a slip-free triple difference, cycles.

    Parameters: turn_rad: 1σ by axis of what the attitude's error changes by; baseline_m (..., 3);
    sights (..., 3) uᵢ − uⱼ in the same axes; phase_m: 1σ of one phase, of which there are eight.

    (uᵢ − uⱼ)·(φ × b) = φ·(b × (uᵢ − uⱼ)).
    """
    arm_m = np.linalg.norm(np.cross(baseline_m, sights), axis=-1)
    return np.asarray(np.sqrt((turn_rad * arm_m) ** 2 + 8.0 * phase_m**2) / wavelength_m)


def share_right(sigma_cycles: FloatArray) -> FloatArray:
    """Share of values rounded to the right number of cycles: the error is below half a cycle."""
    with np.errstate(divide="ignore"):
        return np.asarray(erf(0.5 / (np.sqrt(2.0) * np.asarray(sigma_cycles))))
