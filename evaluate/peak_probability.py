"""Correct-peak probability of the FFT discriminators against theory: T figure 3.4, FFT-PD."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray
from deepgnss.receiver.spectral import Tone, fft_tone, squared_tone
from deepgnss.theory.peak_probability import correct_peak_probability, sum_snr

SYMBOL_S = 0.02
SUMS = 16
FEW_BINS = 3

# Which line is the largest does not hang on what lies between the lines.
_Discriminator = Callable[[ComplexArray], Tone]
_NAMED: dict[str, tuple[_Discriminator, int, bool]] = {
    "FFT": (lambda sums: fft_tone(sums, SYMBOL_S, None, _no_offset), SUMS, True),
    "PFFT": (lambda sums: fft_tone(sums, SYMBOL_S, FEW_BINS, _no_offset), FEW_BINS, True),
    "SFFT": (lambda sums: squared_tone(sums, SYMBOL_S, None, _no_offset), SUMS, False),
    "PSFFT": (lambda sums: squared_tone(sums, SYMBOL_S, FEW_BINS, _no_offset), FEW_BINS, False),
}


class PeakShare(NamedTuple):
    """One point of the figure."""

    discriminator: str
    cn0_dbhz: float
    share: float  # of windows whose largest line was the tone's
    sigma: float  # of that share, from the number of windows
    theory: float | None  # the integral; None for squares, which have none


def _no_offset(_sums: ComplexArray) -> float:
    return 0.0


def peak_share(name: str, windows: ComplexArray) -> float:
    """Share of windows (trials, n) of a tone at zero frequency whose largest line is the middle.

    name: FFT, PFFT (symbols stripped), SFFT or PSFFT (symbols still on).
    """
    discriminate = _NAMED[name][0]
    return float(np.mean([discriminate(sums).peak == 0 for sums in windows]))


def prompt_sums(
    cn0_dbhz: float, trials: int, generator: np.random.Generator, *, symbols: bool
) -> ComplexArray:
    """Prompt sums (trials, 16) of a tone at zero frequency and random phase in unit noise."""
    shape = (trials, SUMS)
    noise = generator.standard_normal(shape) + 1j * generator.standard_normal(shape)
    tone = np.exp(2j * math.pi * generator.random((trials, 1)))
    signs = generator.choice((-1.0, 1.0), shape) if symbols else 1.0
    amplitude = math.sqrt(sum_snr(cn0_dbhz, SYMBOL_S))
    return np.asarray(amplitude * tone * signs + noise / math.sqrt(2.0))


def peak_shares(cn0s_dbhz: Sequence[float], trials: int, seed: int) -> list[PeakShare]:
    """All four discriminators over C/N0: our discriminators run, and the integral beside."""
    generator = np.random.default_rng(seed)
    points = []
    for name, (_, searched, stripped) in _NAMED.items():
        for cn0_dbhz in cn0s_dbhz:
            windows = prompt_sums(cn0_dbhz, trials, generator, symbols=not stripped)
            share = peak_share(name, windows)
            theory = (
                correct_peak_probability(sum_snr(cn0_dbhz, SYMBOL_S), SUMS, searched)
                if stripped
                else None
            )
            expected = share if theory is None else theory
            sigma = math.sqrt(max(expected * (1.0 - expected), 1.0 / trials) / trials)
            points.append(PeakShare(name, cn0_dbhz, share, sigma, theory))
    return points


def threshold_dbhz(points: Sequence[PeakShare], name: str, share: float = 0.9) -> float:
    """C/N0 where a discriminator reaches a share of right peaks, between the points."""
    curve = sorted((p.cn0_dbhz, p.share) for p in points if p.discriminator == name)
    cn0s, shares = zip(*curve, strict=True)
    return float(np.interp(share, np.maximum.accumulate(shares), cn0s))
