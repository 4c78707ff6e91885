"""LFM-CRB: spread of a chirp's frequency and rate against the Cramér–Rao bound, L figures 5 to 8.

Correlation sums of 0.25 ms over 400 ms by L(1), their noise white; frequency, rate and phase new
with every trial. Squared: every sum has a sign of its own, and is judged against what squares
allow, L(7) put into the bound, as L does; no estimate whatever from such sums can beat the bound of
unknown signs, which is shown beside it. Above threshold: no trial of this level or a higher one
has left the likelihood's main peak.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.receiver.chirp import CLIMBS, Chirp, find_chirp, find_squared_chirp
from deepgnss.theory.chirp import Bound, squared_bound, tone_bound, unknown_signs_bound

INTERVAL_S: Final = 0.25e-3
SUMS: Final = 1600
LIMIT: Final = 1.1
LARGEST_HZPS: Final = 200.0
_LEVELS_DBHZ: Final[Mapping[bool, tuple[float, ...]]] = {
    False: (18.0, 20.0, 22.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0),
    True: (30.0, 31.0, 32.0, 33.0, 35.0, 40.0, 45.0, 50.0),
}
_TRIALS, _QUICK_TRIALS = 200, 40  # of a level and seed
_LOST = 8.0  # bounds away: another peak of the likelihood
_WIDE_HZ: Final = 150.0  # frequencies drawn
_PLAIN_DBHZ: Final = 50.0  # where L's own discriminator is shown


class Spread(NamedTuple):
    """Errors of frequency (Hz) and rate (Hz/s), in the bounds of their level."""

    cn0_dbhz: float
    frequency: FloatArray
    rate: FloatArray

    @property
    def ratios(self) -> tuple[float, float]:
        """Root mean squares."""
        return _rms(self.frequency), _rms(self.rate)

    @property
    def lost(self) -> int:
        """Trials that ended on another peak."""
        off = np.maximum(np.abs(self.frequency), np.abs(self.rate))
        return int(np.sum(off > _LOST))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _bound(cn0_dbhz: float, *, squared: bool) -> Bound:
    bound = squared_bound if squared else tone_bound
    return bound(10.0 ** (0.1 * cn0_dbhz) * INTERVAL_S, SUMS, INTERVAL_S)


def spread(
    cn0_dbhz: float,
    trials: int,
    generator: np.random.Generator,
    *,
    squared: bool,
    climbs: int = CLIMBS,
) -> Spread:
    """Errors of estimates at a level."""
    t = INTERVAL_S * (np.arange(SUMS) - 0.5 * (SUMS - 1))
    amplitude = math.sqrt(10.0 ** (0.1 * cn0_dbhz) * INTERVAL_S)
    errors = np.empty((trials, 2))
    for k in range(trials):
        phase, frequency = generator.uniform(0.0, 1.0), generator.uniform(-_WIDE_HZ, _WIDE_HZ)
        rate = generator.uniform(-LARGEST_HZPS, LARGEST_HZPS)
        tone = amplitude * np.exp(2j * np.pi * (phase + t * (frequency + 0.5 * rate * t)))
        signs = generator.choice((-1.0, 1.0), SUMS) if squared else 1.0
        found = _found(signs * tone + _noise(generator), squared=squared, climbs=climbs)
        errors[k] = found.frequency_hz - frequency, found.rate_hzps - rate
    bound = _bound(cn0_dbhz, squared=squared)
    return Spread(cn0_dbhz, errors[:, 0] / bound.frequency_hz, errors[:, 1] / bound.rate_hzps)


def _found(sums: ComplexArray, *, squared: bool, climbs: int) -> Chirp:
    find = find_squared_chirp if squared else find_chirp
    return find(sums, INTERVAL_S, LARGEST_HZPS, climbs)


def _noise(generator: np.random.Generator) -> ComplexArray:
    parts = generator.standard_normal((SUMS, 2)) / math.sqrt(2.0)
    return np.asarray(parts @ [1.0, 1.0j])


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Each level above threshold is judged; L's own discriminator is shown; quick: one seed."""
    trials = _QUICK_TRIALS if quick else _TRIALS
    generators = [np.random.default_rng(seed) for seed in (seeds[:1] if quick else seeds)]
    figures = []
    for squared in (False, True):
        levels = _LEVELS_DBHZ[squared]
        levels = levels[-5:] if quick else levels
        spreads = [_pooled(level, trials, generators, squared=squared) for level in levels]
        name = "squared" if squared else "signs known"
        above = [s for k, s in enumerate(spreads) if not any(o.lost for o in spreads[k:])]
        lowest = above[0].cn0_dbhz if above else math.inf
        lost = ", ".join(f"{s.lost} at {s.cn0_dbhz:g}" for s in spreads if s.lost)
        total = trials * len(generators)
        text = f"{lowest:g} dB-Hz" + (f" (lost of {total}: {lost})" if lost else "")
        figures.append(Figure(f"{name}: above threshold from", text, None if above else False))
        figures += [_judged(name, one, total, quick, squared=squared) for one in above]
    plain = _pooled(_PLAIN_DBHZ, trials, generators, squared=False, climbs=0)
    figures.append(_figure(f"L(15–18) alone, {_PLAIN_DBHZ:g} dB-Hz", plain.ratios, "", None))
    return figures


def _pooled(
    cn0_dbhz: float,
    trials: int,
    generators: Sequence[np.random.Generator],
    *,
    squared: bool,
    climbs: int = CLIMBS,
) -> Spread:
    all_of = [spread(cn0_dbhz, trials, g, squared=squared, climbs=climbs) for g in generators]
    frequency, rate = (np.concatenate([s[k] for s in all_of]) for k in (1, 2))
    return Spread(cn0_dbhz, np.asarray(frequency), np.asarray(rate))


def _judged(name: str, one: Spread, trials: int, quick: bool, *, squared: bool) -> Figure:
    ratios = one.ratios
    more = f" ({trials} trials)"
    if squared:
        snr = 10.0 ** (0.1 * one.cn0_dbhz) * INTERVAL_S
        least = unknown_signs_bound(snr, SUMS, INTERVAL_S).frequency_hz
        share = _bound(one.cn0_dbhz, squared=True).frequency_hz / least
        more += f"; that bound is {share:.3f} · that of unknown signs"
    met = None if quick else max(ratios) <= LIMIT
    return _figure(f"{name}, {one.cn0_dbhz:g} dB-Hz", ratios, more, met)


def _figure(what: str, ratios: tuple[float, float], more: str, met: bool | None) -> Figure:
    text = f"frequency {ratios[0]:.3f}, rate {ratios[1]:.3f} · bound{more}"
    return Figure(what, text, met)
