"""Frequency and frequency rate of a carrier in a stretch of correlations: a chirp, L 1.2.

Over some 100 ms a hard manoeuvre's rate is constant, so that short correlation sums are a linear
frequency-modulated tone, L(1). For every rate tried the likelihood over all frequencies is a
spectrum's highest line; rates are tried a quarter of that ridge's main lobe apart, L(13), and an
early-minus-late discriminator between them gives the rate, L(14–18).

In L(15), L(16) the discriminator's half spacing is d_a/2, not d_a as its second argument says;
L(17), L(18) follow from it then. (L 2.1.2 counts its searches with the whole lobe for d_a.) The
ridge is only roughly a triangle: the discriminator leaves a rate up to 0.05 Hz/s off over 400 ms,
and more spread than need be, so two more steps climb to the likelihood's own maximum, which L does
without.

Sums whose signs are not known are squared, L(7), and the chirp is half of what the squares show.
All values are received − local, in the *middle* of the stretch. Sums of 1 ms serve: at 1000 Hz/s
over 400 ms they lose 0.6 dB at the ends where L's of 0.25 ms lose nothing, but squared they are
6 dB better off where signals are weak.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.spectral import half_bins, turned
from deepgnss.receiver.trackers import Accumulated, Correction, Tracker

_TURN = 2.0 * math.pi
_LOBE = 9.6  # width of the ridge's main lobe times T², L(13)
CLIMBS = 2
_SURE = 9.0  # natural logarithm by which a peak must beat the highest one of noise


class Chirp(NamedTuple):
    """A chirp in the middle of its stretch."""

    phase_cycles: float  # within ±½, of squares ±¼
    frequency_hz: float
    rate_hzps: float
    surplus: float  # of the peak's power above what noise alone reaches, in its mean; > 0: seen


def rate_step_hzps(seconds: float) -> float:
    """Spacing of the rates tried, d_a of L(14): a quarter of the main lobe."""
    return _LOBE / 4.0 / seconds**2


def find_chirp(
    sums: ComplexArray, interval_s: float, largest_rate_hzps: float, climbs: int = CLIMBS
) -> Chirp:
    """The chirp in sums (n,) of known signs, rates up to ± the largest one.

    Frequencies up to ±1/(2·interval). climbs: steps to the likelihood's maximum, 0: as L has it.
    """
    seconds = sums.size * interval_s
    step = rate_step_hzps(seconds)
    each_side = math.ceil(largest_rate_hzps / step) + 1  # one beyond: it has neighbours
    rates = step * np.arange(-each_side, each_side + 1)
    spectra = np.abs(np.fft.fft(sums * _wiped(sums.size, interval_s, step, each_side), axis=1))
    best = 1 + int(spectra[1:-1].max(axis=1).argmax())
    late, prompt, early = (_highest(sums, interval_s, float(rates[best + k])) for k in (-1, 0, 1))
    rate = float(rates[best]) + step * _between(late.amplitude, prompt.amplitude, early.amplitude)
    frequency = _highest(sums, interval_s, rate).frequency_hz
    for _ in range(climbs):
        frequency, rate = climbed(sums, interval_s, frequency, rate)
    line = complex((sums * turns(sums.size, interval_s, frequency, rate)).sum())
    noise = float(np.vdot(sums, sums).real) or 1.0  # mean power of a line, were it all noise
    surplus = abs(line) ** 2 / noise - math.log(sums.size * rates.size) - _SURE
    return Chirp(cmath.phase(line) / _TURN, frequency, rate, surplus)


def find_squared_chirp(
    sums: ComplexArray, interval_s: float, largest_rate_hzps: float, climbs: int = CLIMBS
) -> Chirp:
    """The chirp in sums (n,) whose signs are not known: half of that in their squares.

    Frequencies up to ±1/(4·interval).
    """
    double = find_chirp(sums * sums, interval_s, 2.0 * largest_rate_hzps, climbs)
    phase, frequency, rate = (0.5 * value for value in double[:3])
    return Chirp(phase, frequency, rate, double.surplus)


def early_late_rate(late: float, early: float) -> float:
    """Discriminator of L(14) of the ridge's heights at a lower and a higher rate."""
    return (late - early) / (late + early) if late + early > 0.0 else 0.0


def _between(late: float, prompt: float, early: float) -> float:
    """Place of the ridge's top among three rates, in their spacing, L(15–18)."""
    below, above = early_late_rate(late, prompt), early_late_rate(prompt, early)
    return -0.5 * (above + below) / (above - below) if above > below else 0.0


class _Line(NamedTuple):
    frequency_hz: float
    amplitude: float


def _highest(sums: ComplexArray, interval_s: float, rate_hzps: float) -> _Line:
    """Highest point of the spectrum at a rate, between the lines too."""
    wiped = sums * turns(sums.size, interval_s, 0.0, rate_hzps)
    peak = int(np.argmax(np.abs(np.fft.fft(wiped))))
    peak -= sums.size if 2 * peak >= sums.size else 0
    about = turned(wiped, peak)
    rest = min(max(half_bins(about), -1.0), 1.0)
    amplitude = abs(complex(turned(about, rest).sum()))
    return _Line((peak + rest) / (sums.size * interval_s), amplitude)


def climbed(
    sums: ComplexArray, interval_s: float, frequency_hz: float, rate_hzps: float
) -> tuple[float, float]:
    """Gauss–Newton's step of the likelihood L(9): phases about their mean, by least squares."""
    t, t2 = _moments(sums.size, interval_s)
    wiped = sums * turns(sums.size, interval_s, frequency_hz, rate_hzps)
    line = complex(wiped.sum())
    if line == 0.0:
        return frequency_hz, rate_hzps
    angle = (wiped * (line.conjugate() / abs(line) ** 2)).imag * sums.size / _TURN
    return (
        frequency_hz + float(t @ angle) / float(t @ t),
        rate_hzps + float(t2 @ angle) / float(t2 @ t2),
    )


@lru_cache(maxsize=16)
def _moments(count: int, interval_s: float) -> tuple[FloatArray, FloatArray]:
    """Seconds from the middle, and half their squares less their mean: what f and a turn."""
    t = interval_s * (np.arange(count, dtype=np.float64) - 0.5 * (count - 1))
    half = 0.5 * t * t
    return t, np.asarray(half - half.mean())


def turns(count: int, interval_s: float, frequency_hz: float, rate_hzps: float) -> ComplexArray:
    """Replica (count,) that takes a chirp off."""
    t = interval_s * (np.arange(count) - 0.5 * (count - 1))
    return np.asarray(np.exp(-1j * _TURN * t * (frequency_hz + 0.5 * rate_hzps * t)))


@lru_cache(maxsize=4)
def _wiped(count: int, interval_s: float, step_hzps: float, each_side: int) -> ComplexArray:
    """Replicas (rates, count) of the rates tried, at zero frequency."""
    t = interval_s * (np.arange(count) - 0.5 * (count - 1))
    rates = step_hzps * np.arange(-each_side, each_side + 1)[:, np.newaxis]
    return np.asarray(np.exp(-1j * math.pi * rates * t * t))


@dataclass(frozen=True, slots=True)
class ChirpLock:
    """Frequency lock that finds the rate as well, from nothing: before phase lock, L 1.2.

    Code periods' signs are not known, so their squares are searched. What they do not show, below
    some 33 dB-Hz over 200 ms, is left to a loop for faint signals.
    """

    faint: Tracker
    interval_s: float = 0.2
    largest_rate_hzps: float = 1000.0

    def correct(self, seen: Accumulated) -> Correction:
        """Frequency and rate of an interval; a shorter one tells no rate."""
        if seen.seconds > 0.5 * self.interval_s:
            prompts = seen.periods[:, 1]
            found = find_squared_chirp(prompts, seen.period_s, self.largest_rate_hzps)
            if found.surplus > 0.0:
                return Correction(0.0, found.frequency_hz, found.rate_hzps)
        return self.faint.correct(seen)
