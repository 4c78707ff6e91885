"""What a converter of few bits costs: loss of C/N0 behind it, for noise that dominates.

A quantizer q of Gaussian noise x passes a small signal with gain c₁ = E[q(x)·x] and turns the
noise's correlation ρ into Σ c_k²·ρ^k, c_k the coefficients of q over Hermite polynomials (R.
Price, 1958). White samples stay white: the loss is E[q²]/c₁² (J. Max, 1960). Noise that a filter
has coloured leaves part of its distortion outside the signal's band and loses less.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import scipy.signal
import scipy.special

from deepgnss.core.records import GPS_L1CA, FloatArray, SignalId
from deepgnss.sim.converter import levels, step_over_sigma
from deepgnss.sim.filters import low_pass
from deepgnss.sim.scenario import FrontEnd

_ORDER: Final = 41  # of the series; the rest of it is white
_SPECTRUM: Final = 8192


def quantization_loss_db(front_end: FrontEnd, signal: SignalId = GPS_L1CA) -> float:
    """C/N0 before the converter over that behind it, dB, by a correlator with the whole code."""
    bits = front_end.converter_bits
    if bits == 32:
        return 0.0
    power, series = _hermite_powers(bits)
    taps = low_pass(front_end)
    rho = np.zeros(_SPECTRUM)
    rho[0] = 1.0
    if taps is not None:
        h = taps.astype(np.float64) / np.linalg.norm(taps)
        lags = np.correlate(h, h, "full")
        rho[np.arange(1 - h.size, h.size)] = lags
    out = np.polynomial.polynomial.polyval(rho, series)
    out[0] = power
    density, before = (np.fft.fft(r).real for r in (out, rho))
    weight = _code_spectrum(front_end, signal)
    return 10.0 * math.log10(float(weight @ density) / float(series[1] * (weight @ before)))


def _hermite_powers(bits: int) -> tuple[float, FloatArray]:
    """E[q²], and c_k² for k from 0 on, of the converter at its best level.

    q rises by Δ at each threshold t: c_k = Σ Δ·φ(t)·He_{k−1}(t)/√k!, which vanishes for even k.
    """
    values, thresholds = levels(bits)
    thresholds = thresholds * step_over_sigma(bits)
    edges = np.concatenate([[-np.inf], thresholds, [np.inf]])
    power = float(np.sum(values**2 * np.diff(scipy.special.ndtr(edges))))
    phi = np.exp(-0.5 * thresholds**2) / math.sqrt(2.0 * math.pi) * np.diff(values)
    squares = np.zeros(_ORDER + 1)
    # Polynomials over √(k − 1)!, by their recurrence.
    older, polynomial = np.zeros_like(thresholds), np.ones_like(thresholds)
    for k in range(1, _ORDER + 1):
        squares[k] = np.sum(phi * polynomial) ** 2 / k if k % 2 else 0.0
        older, polynomial = (
            polynomial,
            (thresholds * polynomial - math.sqrt(k - 1.0) * older) / math.sqrt(k),
        )
    return power, squares


def _code_spectrum(front_end: FrontEnd, signal: SignalId) -> FloatArray:
    """Power of a random code at the frequencies of a transform, aliases folded."""
    rate_hz = front_end.sample_rate_hz
    residual_hz = signal.carrier_hz - front_end.centre_hz
    residual_hz = front_end.intermediate_hz + front_end.sense * residual_hz
    f_hz = np.fft.fftfreq(_SPECTRUM, 1.0 / rate_hz)
    weight = np.zeros(_SPECTRUM)
    for alias in range(-3, 4):
        weight += np.sinc((f_hz + alias * rate_hz - residual_hz) / signal.chip_rate_hz) ** 2
    return weight
