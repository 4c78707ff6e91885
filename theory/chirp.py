"""Cramér–Rao bounds of phase, frequency and frequency rate in a stretch of correlation sums.

n sums of one interval each, power over noise `snr` in one of them; all in the middle of the
stretch, where phase and frequency, and frequency and rate, do not depend on each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scipy.integrate import quad

from deepgnss.theory.peak_probability import squared_sum_snr


class Bound(NamedTuple):
    """Least spread (1σ) of an unbiased estimate."""

    phase_cycles: float
    frequency_hz: float
    rate_hzps: float


def tone_bound(snr: float, sums: int, interval_s: float) -> Bound:
    """Of phase and frequency of a tone with no rate of its own, and of the rate of a chirp.

    A phase 2π(φ + f·t + ½a·t²) about the middle: σ_f² = 3/(2π²·snr·n·T²), which L(41) prints with
    N² for N³, and σ_a² = 90/(π²·snr·n·T⁴), L(40); T = n·interval (n² − 1 for n², and n² − 4
    beside it, for few sums). The chirp's phase has 9/4 of the tone's variance.
    """
    turn, n = 2.0 * math.pi, float(sums)
    information = 2.0 * snr * turn * turn
    t2 = interval_s**2 * n * (n * n - 1.0) / 12.0  # Σt²
    t4 = interval_s**4 * n * (n * n - 1.0) * (n * n - 4.0) / 720.0  # Σ(½t² − mean)²
    return Bound(
        math.sqrt(1.0 / (information * n)),
        math.sqrt(1.0 / (information * t2)),
        math.sqrt(1.0 / (information * t4)) if t4 > 0.0 else math.inf,
    )


def squared_bound(snr: float, sums: int, interval_s: float) -> Bound:
    """What squares of sums allow, L(7): a tone of twice the phase in white noise of that SNR."""
    return Bound(*(0.5 * x for x in tone_bound(squared_sum_snr(snr), sums, interval_s)))


def unknown_signs_bound(snr: float, sums: int, interval_s: float) -> Bound:
    """The bound of *any* estimate from sums whose signs ±1 are unknown, each by itself.

    The likelihood of a sum is Σ over both signs, so its score is that of a known sign times
    tanh(u), u = 2·Re(s*r)/σ² normal with mean and variance 2·snr: the information shrinks to
    E tanh²(u). It is 2·snr for weak sums, as of squares, and squares are never far from it.
    """
    mean, sigma = 2.0 * snr, math.sqrt(2.0 * snr)

    def density(x: float) -> float:
        return math.tanh(mean + sigma * x) ** 2 * math.exp(-0.5 * x * x)

    share = quad(density, -9.0, 9.0)[0] / math.sqrt(2.0 * math.pi)
    return tone_bound(snr * share, sums, interval_s)
