"""How much motion the FFT discriminator bears, alone and aided, T 4.6.2.

Within a window of length T_FFT the frequency may rise by a quarter of the range 1/T searched: the
rise of the window before, of which any line may have been found, and that of this one have to stay
within half of it, T(4.126). Aided, only the prediction's error rises, T(4.127).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from deepgnss.core.constants import STANDARD_GRAVITY_MPS2
from deepgnss.core.records import FloatArray, ImuGrade
from deepgnss.theory.inertial import error_sums

_NORTH = np.array([1.0, 0.0, 0.0])
_MOST_MPS2 = 1e6


def largest_rise_hz(interval_s: float, lines: int | None = None, window_s: float = 0.0) -> float:
    """By how much a frequency may change within a window: 1/(4T), T(4.127).

    Parameters: interval of one sum, s; lines searched out of a window's, None: all; window, s.
    """
    return 1.0 / (4.0 * interval_s) if lines is None else lines / (4.0 * window_s)


def largest_rate_hzps(interval_s: float, window_s: float, lines: int | None = None) -> float:
    """Frequency rate that an unaided discriminator bears: 1/(4·T·T_FFT), T(4.126)."""
    return largest_rise_hz(interval_s, lines, window_s) / window_s


def aided_rise_hz(
    grade: ImuGrade, east_mps2: float, window_s: FloatArray, wavelength_m: float
) -> FloatArray:
    """Error of the aiding frequency after windows (n,), rising, at an acceleration across.

    As T figure 4.11: north, while the vehicle accelerates east; errors drawn once add up with
    signs at their 1σ (they do all the harm), 1σ of the noise on top.
    """
    f_n = np.array([0.0, east_mps2, -STANDARD_GRAVITY_MPS2])
    velocity, _ = error_sums(grade, f_n, window_s, _NORTH)
    return np.asarray((np.abs(velocity.signed) + velocity.white) / wavelength_m)


def largest_acceleration_mps2(
    grade: ImuGrade, limit_hz: float, window_s: float, wavelength_m: float
) -> float:
    """Acceleration at which the aiding error reaches a limit within a window: T figure 4.12.

    0 where it does at rest already; infinite beyond 1000 km/s².
    """
    at = np.array([window_s])

    def excess_hz(east_mps2: float) -> float:
        return float(aided_rise_hz(grade, east_mps2, at, wavelength_m)[0]) - limit_hz

    if excess_hz(0.0) >= 0.0:
        return 0.0
    if excess_hz(_MOST_MPS2) <= 0.0:
        return float("inf")
    return float(brentq(excess_hz, 0.0, _MOST_MPS2, rtol=1e-6))
