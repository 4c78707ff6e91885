"""How often the largest line of a spectrum is the tone's, and the frequency error that gives.

T 3.3: n prompt sums of one interval T each with a signal-to-noise ratio C/N0·T, their spectrum of
n lines, m of them searched (all: FFT; the few about zero: PFFT). The tone lies on a line.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad
from scipy.special import i0e


def sum_snr(cn0_dbhz: float, interval_s: float) -> float:
    """Power of signal over noise in one prompt sum, T(3.28)."""
    return float(10.0 ** (cn0_dbhz / 10.0) * interval_s)


def squared_sum_snr(snr: float) -> float:
    """The same in the square of a sum: s² against 2sn + n², T 3.2.1's squaring loss."""
    return snr * snr / (4.0 * snr + 2.0)


def correct_peak_probability(snr: float, sums: int, searched: int | None = None) -> float:
    """Probability that the tone's line is the largest of those searched, T(3.26), T(3.27).

    The line's amplitude is Rice's, those of the other lines Rayleigh's; noise in each quadrature
    of a line is 1 here.

    Parameters: power ratio in one sum; sums transformed; lines searched, None for all of them.
    """
    others = (sums if searched is None else searched) - 1
    amplitude = math.sqrt(2.0 * sums * snr)

    def density(x: float) -> float:
        rice = x * math.exp(-0.5 * (x - amplitude) ** 2) * float(i0e(x * amplitude))
        return rice * float(-np.expm1(-0.5 * x * x)) ** others

    value, _ = quad(density, max(0.0, amplitude - 9.0), amplitude + 9.0, epsabs=1e-10, limit=200)
    return float(value)


def frequency_sigma_hz(
    snr: float, sums: int, interval_s: float, searched: int | None = None, *, squared: bool = False
) -> float:
    """Spread of the discriminator's error over right and wrong peaks, T(3.33–3.35).

    A right peak gives the Cramér–Rao bound of a tone (Rife and Boorstyn 1974): T(3.34) as printed
    lacks 3/2 and has a sampling rate too many. A wrong one lies anywhere in the range searched.
    Squares (approximately: their noise is not normal) see twice the frequency.
    """
    snr = squared_sum_snr(snr) if squared else snr
    right = correct_peak_probability(snr, sums, searched)
    bound = 6.0 / ((2.0 * math.pi * interval_s) ** 2 * sums * (sums**2 - 1) * snr)
    range_hz = (sums if searched is None else searched) / (sums * interval_s)
    variance = right * bound + (1.0 - right) * range_hz**2 / 12.0
    return math.sqrt(variance) / (2.0 if squared else 1.0)
