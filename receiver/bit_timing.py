"""Time of a snapshot from the symbol edges of all its satellites.

The codes give time modulo a code period as soon as a fix stands; the fix alone knows it to some
10 ms, and a coarse time costs position (satellites move 0.8 m in a millisecond). Symbols change at
instants of satellite time known to all, so that one number of milliseconds must suit every
satellite: a few changes of sign in a dozen milliseconds decide it modulo a symbol.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.core.time import GpsTime

_DOPPLER_HZ = 8.0  # what the velocity of a fix leaves open
_CLOCK_REACH_S = 0.2  # offsets considered either side of a fix
_WILD = 1e-2  # likelihood of a fix whose time is far off, against one in the middle
_STAMP_S = 1e-3  # what time stamps err from one to the next
_STAMP_RATE = 2e-5  # and per second
_FORGOTTEN = 1e-12  # weight of offsets thought impossible


class PeriodSums(NamedTuple):
    """Prompt correlations of one satellite over a snapshot, carrier wiped off as predicted."""

    sums: ComplexArray  # (periods,)
    times_s: FloatArray  # (periods,) middles of the periods
    noise: float  # mean power of noise in the sum over everything
    number: int  # count of code periods in satellite time at the first, for candidate 0


def edge_log_likelihoods(one: PeriodSums, symbol_periods: int, span_hz: float) -> FloatArray:
    """Log-likelihood of every place of the symbol edges, shape (symbol_periods,).

    Entry e: a symbol starts in the period whose count from the first is e, modulo a symbol.
    Phase and signs are unknown, Doppler to ± span_hz.
    """
    seconds = float(one.times_s[-1] - one.times_s[0]) or 1e-3
    reach = math.ceil(span_hz * 8.0 * seconds)
    dopplers_hz = np.linspace(-span_hz, span_hz, 2 * reach + 1)
    turned = one.sums * np.exp(-2j * np.pi * dopplers_hz[:, np.newaxis] * one.times_s)
    out = np.empty(symbol_periods)
    for edge in range(symbol_periods):
        starts = np.arange(edge, one.sums.size, symbol_periods)
        if edge:
            starts = np.concatenate([[0], starts])
        symbols = np.add.reduceat(turned, starts, axis=1)
        pairs = (symbols[:, 1:] * symbols[:, :-1].conj()).real
        signs = np.cumprod(np.where(pairs < 0.0, -1.0, 1.0), axis=1)
        total = symbols[:, 0] + (signs * symbols[:, 1:]).sum(axis=1)
        # The better sign of each change and the other one, equally likely before.
        odds = np.log(0.5 * (1.0 + np.exp(-4.0 * np.abs(pairs) / one.noise))).sum(axis=1)
        out[edge] = float((np.abs(total) ** 2 / one.noise + odds).max())
    return out


def edge_evidence(satellites: Sequence[PeriodSums], symbol_periods: int) -> FloatArray:
    """Log-likelihood of candidate 0, 1, 2 … periods later, shape (symbol_periods,)."""
    evidence = np.zeros(symbol_periods)
    candidates = np.arange(symbol_periods)
    for one in satellites:
        likelihoods = edge_log_likelihoods(one, symbol_periods, _DOPPLER_HZ)
        evidence += likelihoods[np.mod(-(one.number + candidates), symbol_periods)]
    return evidence


def nearest_allowed_s(time_s: float, clock_s: float, period_s: float) -> float:
    """From a time to the nearest instant the codes allow, s.

    Parameters: clock_s, the common bias of a coarse-time fix, which is minus the time of reception
    modulo a code period.
    """
    return math.remainder(-clock_s - time_s, period_s)


class TimeEstimate(NamedTuple):
    """Correction of the time of a fix and its standard deviation."""

    correction_s: float
    sigma_s: float


@dataclass(frozen=True, slots=True)
class TimeEvidence:
    """What one snapshot says of its time, counted from the time of its fix.

    Instants nearest_s + n·period_s are possible; n has the log-likelihood edges[n mod symbol] by
    the symbol edges, and that of a normal distribution with sigma_s around the fix.
    """

    nearest_s: float
    sigma_s: float
    period_s: float
    edges: FloatArray

    def candidates(self, reach_s: float) -> tuple[FloatArray, FloatArray]:
        """Possible corrections of time within ± reach, and their evidence by the edges."""
        reach = math.ceil(reach_s / self.period_s)
        n = np.arange(-reach, reach + 1)
        times_s = self.nearest_s + n.astype(np.float64) * self.period_s
        return times_s, self.edges[np.mod(n, self.edges.size)]

    def estimate(self) -> TimeEstimate:
        """Time by this snapshot alone."""
        corrections_s, score = self.candidates(5.0 * self.sigma_s)
        return _moments(corrections_s, score - 0.5 * (corrections_s / self.sigma_s) ** 2)


def _moments(corrections_s: FloatArray, score: FloatArray) -> TimeEstimate:
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    mean_s = float(weight @ corrections_s)
    return TimeEstimate(mean_s, math.sqrt(float(weight @ (corrections_s - mean_s) ** 2)))


@dataclass(frozen=True, slots=True)
class StampClock:
    """How far the time stamps of a series are off: possible offsets and their log-weights.

    Each fix counts by a quarter only (its errors last longer than a snapshot), and a wild one not
    at all, so that a wrong offset is left again when many later fixes speak against it.
    """

    stamp: GpsTime | None = None
    offsets_s: FloatArray = field(default_factory=lambda: np.zeros(1))
    score: FloatArray = field(default_factory=lambda: np.zeros(1))

    @property
    def offset_s(self) -> float:
        """Time minus time stamp, the likeliest."""
        return float(self.offsets_s[self.score.argmax()])

    def after(
        self, stamp: GpsTime, time: GpsTime, evidence: TimeEvidence
    ) -> tuple[StampClock, TimeEstimate]:
        """The clock after a fix at `time`, and the time of this fix by all evidence."""
        fixed_s = time.since(stamp)
        corrections_s, score = evidence.candidates(_CLOCK_REACH_S)
        offsets_s = fixed_s + corrections_s
        misfit = corrections_s / (2.0 * evidence.sigma_s)
        score = score + np.log(np.exp(-0.5 * misfit**2) + _WILD)
        if self.stamp is not None:
            apart_s = offsets_s[:, np.newaxis] - self.offsets_s
            moved_s = _STAMP_S + _STAMP_RATE * abs(stamp.since(self.stamp))
            likely = np.exp(self.score - self.score.max() - 0.5 * (apart_s / moved_s) ** 2)
            score += np.log(likely.sum(axis=1) + _FORGOTTEN)
        score -= score.max()
        return StampClock(stamp, offsets_s, score), _moments(corrections_s, score)
