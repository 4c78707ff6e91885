"""Slips put into a pair of receivers, and how each method fares against them, S 2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import BoolArray, IntArray, State, sure
from deepgnss.evaluate.antenna_pair import AntennaPair, Side
from deepgnss.evaluate.classical_slips import couples
from deepgnss.evaluate.slips import Slips


class Inserted(NamedTuple):
    """Slips put into a pair: cycles at each epoch and signal, (n, m), of both antennas."""

    first: FloatArray
    second: FloatArray

    @property
    def between(self) -> FloatArray:
        """What the difference second − first slips by."""
        return np.asarray(self.second - self.first)


def with_slips(pair: AntennaPair, slips: Inserted) -> AntennaPair:
    """The pair with slips: each adds to all later phases of its signal at its antenna."""

    def slipped(side: Side, cycles: FloatArray) -> Side:
        return replace(side, phase_m=side.phase_m + np.cumsum(cycles, axis=0) * pair.wavelength_m)

    return replace(
        pair, first=slipped(pair.first, slips.first), second=slipped(pair.second, slips.second)
    )


SMALL_PAIRS: Final = ((1, 1), (3, 2), (4, 3), (5, 4), (9, 7))
"""Cycles on two frequencies that hardly change the ionospheric residual (GPS: 0.3 to 8 cm)."""

_FEW: Final = 4  # signals of an epoch slip together at most, where nothing else is said


def random_slips(
    pair: AntennaPair, count: int, rng: np.random.Generator, hard: bool = False
) -> Inserted:
    """As many slips of 1 to 3 cycles at random epochs, signals and antennas (S 2).

    hard: several at once, up to nearly half of the satellites; unlike ones on both antennas; the
    satellite highest up; pairs of `SMALL_PAIRS` on both frequencies. A slip counts where a
    difference slips.
    """
    known = _testable(pair)
    slips = Inserted(*np.zeros((2, *known.shape)))
    epochs = rng.permutation(np.flatnonzero(known.any(axis=1)))
    for epoch in epochs:
        left = count - int(np.count_nonzero(slips.between))
        if left <= 0:
            break
        free = np.flatnonzero(known[epoch])
        kind = rng.random() if hard else 1.0
        both = _both_signals(pair, free, rng)
        if kind < 0.2 and both.size == 2 and left >= 2:
            small = np.array(SMALL_PAIRS[rng.integers(len(SMALL_PAIRS))])
            slips[rng.integers(2)][epoch, both] = rng.choice([-1, 1]) * small
            continue
        for m in _chosen(pair, epoch, free, kind, rng)[:left]:
            one, two = rng.choice([-3, -2, -1, 1, 2, 3], 2, replace=False)
            if kind > 0.7 or rng.random() < 0.5:
                slips[rng.integers(2)][epoch, m] = one
            else:  # both antennas, by unlike numbers
                slips.first[epoch, m], slips.second[epoch, m] = one, two
    return slips


def _both_signals(pair: AntennaPair, free: IntArray, rng: np.random.Generator) -> IntArray:
    """The signals of one satellite."""
    names = np.array([pair.signals[m].satellite for m in free])
    return np.asarray(free[names == rng.choice(names)])


def _chosen(
    pair: AntennaPair, epoch: int, free: IntArray, kind: float, rng: np.random.Generator
) -> IntArray:
    """Signals that slip at an epoch: one; by `kind` the highest, nearly half of all, or several."""
    if kind == 1.0:
        return rng.permutation(free)[:1]
    if kind < 0.35:
        return free[[np.argmax(pair.first.height[epoch, free])]]
    if kind < 0.4:
        names = np.array([pair.signals[m].satellite for m in free])
        satellites = rng.permutation(np.unique(names))
        return free[np.isin(names, satellites[: max((satellites.size - 1) // 2, 1)])]
    return rng.permutation(free)[: int(rng.integers(1, _FEW + 1))]


def _testable(pair: AntennaPair) -> BoolArray:
    """Where a phase and the one an epoch before are there at both antennas, (n, m)."""
    here = np.isfinite(pair.first.phase_m + pair.second.phase_m)
    before = np.vstack([np.zeros((1, here.shape[1]), np.bool_), here[:-1]])
    return np.asarray(here & before)


class Score(NamedTuple):
    """How a method fared against the slips put in."""

    inserted: int
    found: int  # told with the right number of cycles
    wrong: int  # told with another number, or undecided
    missed: int
    false: int  # told where there is none, undecided among them
    phases: int  # held against their past


def score(slipped: FloatArray, told: FloatArray, doubted: BoolArray, tested: BoolArray) -> Score:
    """Compare cycles told with those put in, (n, m) each, where phases were tested."""
    true = tested & (slipped != 0.0)
    right = true & (told == slipped) & ~doubted
    missed = true & (told == 0.0) & ~doubted
    return Score(
        inserted=int(true.sum()),
        found=int(right.sum()),
        wrong=int((true & ~right & ~missed).sum()),
        missed=int(missed.sum()),
        false=int((tested & (slipped == 0.0) & ((told != 0.0) | doubted)).sum()),
        phases=int(tested.sum()),
    )


OURS: Final = "INS and phase"
BY_CODE: Final = "pseudorange and phase"
BY_RESIDUAL: Final = "ionospheric residual"


def method_scores(found: Slips, slips: Inserted) -> Mapping[str, Score]:
    """Of all three methods, each against what its own observable slips by.

    The classical ones work on double differences, whose reference satellite slips too; the
    residual counts once for a satellite's two signals, and does not know which slipped.
    """
    state, told = found.between.state, found.classical
    double = slips.between - slips.between[:, told.column]
    none = np.zeros(double.shape, np.bool_)
    scores = {
        OURS: score(
            slips.between,
            found.between.cycles,
            state == State.UNDECIDED,
            sure(found.between) | (state == State.UNDECIDED),
        ),
        BY_CODE: score(double, told.told_by_code, none, np.isfinite(told.code_cycles)),
    }
    pairs = [(one, two) for one, two in couples(found.pair) if told.column[one] != one]
    if pairs:
        one, two = np.array(pairs).T
        either = ((double[:, one] != 0.0) | (double[:, two] != 0.0)).astype(np.float64)
        jumps = told.told_by_residual[:, one].astype(np.float64)
        known = np.isfinite(told.residual_m[:, one])
        scores[BY_RESIDUAL] = score(either, jumps, np.zeros(known.shape, np.bool_), known)
    return scores
