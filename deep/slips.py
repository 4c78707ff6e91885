"""Cycle slips between two antennas whose baseline an INS knows, S(1.2): detection and repair.

What goes in is a phase less all that is known of it (range by orbits and by the antennas' places),
in metres, over epochs: between two antennas their difference, second − first; of one antenna the
phase itself. Carrier phase grows with range. A value then changes from epoch to epoch by the
receivers' clocks, the same for all phases in metres, by noise, by what the INS got wrong
meanwhile, and by whole cycles where a phase slipped: by half ones only where it is flagged that
the polarity was not known.

S takes one reference satellite and calls what is left of the others' triple difference a slip.
Here the clock is what most phases of all satellites and signals agree on, so that a slip of any
satellite, several at once among them, is told as its own; with two satellites it is S's test. What
the INS got wrong since is one small vector (a turn, a step), which the agreeing phases correct
within what the INS is expected to be worth, also for those that are back after a gap. A slip common
to all phases of an epoch looks like the clock and leaves every double difference whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


class State(IntEnum):
    """What became of a phase at an epoch."""

    ABSENT = 0
    NEW = 1  # first of its arc, or after too long a gap: nothing to hold it against
    ALONE = 2  # no other satellite to hold it against
    CONTINUOUS = 3
    SLIPPED = 4  # by a number of cycles that is sure
    UNDECIDED = 5  # something is off, and not by a number of cycles that is sure: until it goes on


class Phases(NamedTuple):
    """Phases less what is known of them, n epochs of m phases (a satellite's signal each)."""

    time_s: FloatArray  # (n,) rising
    satellite: IntArray  # (m,) phases of one satellite have one number
    wavelength_m: FloatArray  # (m,)
    value_m: FloatArray  # (n, m), NaN without phase
    arm: FloatArray  # (n, m, 3) change of a value by the unknown vector (m per rad, or a cosine)
    lost: BoolArray  # (n, m) LLI bit 0
    half: BoolArray  # (n, m) LLI bit 1: half cycles open
    height: FloatArray  # (n, m) sine of the elevation: whom to trust where votes are even
    corrected: FloatArray  # (n,) variance by which the INS corrected the vector so far, rising


class Limits(NamedTuple):
    """What is expected of the values."""

    noise_m: float  # 1σ of a value
    growth: float  # 1σ by axis of the vector's change over a second (rad, m); grows with time
    longest_s: float = 30.0  # gap across which a phase is still held against what it was
    check_m: float = 0.025  # four-difference check: half of what one cycle on both L1 and L2 makes


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was found, each (n, m)."""

    state: NDArray[np.int8]
    value_cycles: FloatArray  # what the phase changed by beyond clock and prediction
    sigma_cycles: FloatArray  # 1σ expected of that
    cycles: FloatArray  # by which it slipped, in whole or half cycles; 0 unless SLIPPED
    check_m: FloatArray  # four-difference check against the satellite's other signal, NaN without
    gap_s: FloatArray  # since the phase it was held against
    scale: float  # by which values scatter more than `Limits` expects, at least 1


_VOTE: Final = 4.0  # σ within which two phases agree, as S's threshold …
_VOTE_CYCLES: Final = (0.1, 0.4)  # … but at least and at most
_ROUNDS: Final = 4  # of fit and vote
_STEP_CYCLES: Final = 0.15  # of a phase, by which changes of the vector are tried …
_REACH: Final = 3.5  # … out to these σ …
_MOST_STEPS: Final = 12  # … but no further than these steps
_PRIOR: Final = 0.05  # of a vote for a change by one σ
_FLAGGED: Final = 0.5  # of a vote is lost by a phase that is flagged
_HEIGHT: Final = 0.01  # of a vote is the sine of the elevation worth
_SURE: Final = 8.0  # log likelihood ratio of the number of cycles chosen to the next
_FITS: Final = 5.0  # σ by which a value may lie off its number …
_FITS_CYCLES: Final = 0.15  # … or this
_CHECK: Final = 4.0  # σ
_MEDIAN: Final = 0.6745  # of |x|, x of 1σ


def judge(phases: Phases, limits: Limits) -> Judgement:
    """Go through the epochs; once more where values scatter more than expected."""
    found = _pass(phases, limits, 1.0)
    told = sure(found)
    if not told.any():
        return found
    left = np.abs(found.value_cycles - found.cycles)[told] / found.sigma_cycles[told]
    scale = float(np.median(left)) / _MEDIAN
    return _pass(phases, limits, scale) if scale > 1.0 else found


class _Known(NamedTuple):
    """What all phases have in common since the first epoch, and how well that is known."""

    clock_m: float
    vector: FloatArray  # (3,)
    spread: FloatArray  # (3, 3) of the vector's changes, added up


def _pass(phases: Phases, limits: Limits, scale: float) -> Judgement:
    shape = phases.value_m.shape
    state = np.full(shape, State.ABSENT, np.int8)
    value, sigma, check, gap = (np.full(shape, np.nan) for _ in range(4))
    cycles = np.zeros(shape)
    level_m, seen_s = np.full(shape[1], np.nan), np.full(shape[1], np.nan)
    was_half, doubted = np.zeros((2, shape[1]), np.bool_)
    spread = np.zeros((shape[1], 3, 3))  # as it was when a phase was last seen
    common = _Known(0.0, np.zeros(3), np.zeros((3, 3)))
    last = 0
    for k, now_s in enumerate(phases.time_s):
        here = np.isfinite(phases.value_m[k])
        known = np.flatnonzero(here & (now_s - seen_s <= limits.longest_s))
        state[k, here] = State.NEW
        if known.size:
            gap[k, known] = now_s - seen_s[known]
            one = _Changes(
                phases.value_m[k, known] - level_m[known],
                common.spread - spread[known],
                phases.satellite[known],
                phases.wavelength_m[known],
                phases.arm[k, known],
                phases.lost[k, known],
                phases.half[k, known] | was_half[known],
                phases.height[k, known],
            )
            by_itself = scale * limits.growth * (now_s - phases.time_s[last])
            corrected = float(phases.corrected[k] - phases.corrected[last])
            grown = limits._replace(
                noise_m=scale * limits.noise_m, growth=math.hypot(by_itself, math.sqrt(corrected))
            )
            common, verdict = _epoch(one, grown, common)
            state[k, known], value[k, known], sigma[k, known], *rest = verdict
            cycles[k, known], check[k, known] = rest
            again = doubted & (state[k] == State.SLIPPED)  # a phase that runs away hits any number
            state[k, again], cycles[k, again] = State.UNDECIDED, 0.0
        doubted = np.where(here, state[k] == State.UNDECIDED, doubted)
        level_m[here] = phases.value_m[k, here] - common.clock_m
        level_m[here] -= phases.arm[k, here] @ common.vector
        seen_s[here], was_half[here], spread[here] = now_s, phases.half[k, here], common.spread
        last = k if here.any() else last
    return Judgement(state, value, sigma, cycles, check, gap, max(scale, 1.0))


class _Changes(NamedTuple):
    """Phases of an epoch that were known before, (p,): their changes hold what all have in common.

    `spread` (p, 3, 3): of the vector's changes from a phase's last epoch to the one before this.
    """

    change_m: FloatArray
    spread: FloatArray
    satellite: IntArray
    wavelength_m: FloatArray
    arm: FloatArray  # (p, 3)
    lost: BoolArray
    half: BoolArray
    height: FloatArray

    def within_m(self, sigma_m: FloatArray) -> FloatArray:
        """Up to where a change counts as none, by its 1σ."""
        least, most = (share * self.wavelength_m for share in _VOTE_CYCLES)
        return np.clip(_VOTE * sigma_m, least, np.where(self.half, 0.5 * most, most))


_Verdict = tuple[NDArray[np.int8], FloatArray, FloatArray, FloatArray, FloatArray]


def _epoch(one: _Changes, limits: Limits, before: _Known) -> tuple[_Known, _Verdict]:
    """What the phases have in common now, and what became of each."""
    own_m2 = 2.0 * limits.noise_m**2 + np.einsum("pi,pij,pj->p", one.arm, one.spread, one.arm)
    moved_m = one.change_m - one.arm @ before.vector
    group = _most(one, moved_m, own_m2, limits.growth)
    for _ in range(_ROUNDS):
        step, P = _fit(one.arm[group], moved_m[group], own_m2[group], limits.growth)
        H = np.column_stack([np.ones(len(one.arm)), one.arm])
        left_m, sigma_m = moved_m - H @ step, np.sqrt(own_m2 + np.einsum("pi,ij,pj->p", H, P, H))
        agree = np.abs(left_m) <= one.within_m(sigma_m)
        if not agree.any() or (agree == group).all():
            break
        group = agree
    common = _Known(float(step[0]), before.vector + step[1:], before.spread + P[1:, 1:])
    return common, _verdict(one, limits, left_m, sigma_m, 2 * int(group.sum()) >= group.size)


def _most(one: _Changes, moved_m: FloatArray, own_m2: FloatArray, growth: float) -> BoolArray:
    """The phases whose changes agree with each other, of those the most, whatever the vector.

    Where the vector may have changed by more than phases tolerate, changes of it are tried on a
    grid over the directions that matter; each σ off costs a little of a vote.
    """
    arm = one.arm - one.arm.mean(axis=0)
    sigma_m = np.sqrt(own_m2[:, np.newaxis] + own_m2)
    far_m = np.linalg.norm(arm, axis=1).max() * growth
    step_m = _STEP_CYCLES * float(one.wavelength_m.min())
    if far_m <= step_m:
        apart = np.linalg.norm(one.arm[:, np.newaxis] - one.arm, axis=2)
        sigma_m, steps = np.hypot(sigma_m, apart * growth), np.zeros((1, 3))
    else:
        axes = np.linalg.svd(arm, full_matrices=False)[2][:2]
        reach = min(int(np.ceil(_REACH * far_m / step_m)), _MOST_STEPS)
        line = np.arange(-reach, reach + 1) * (growth * step_m / far_m)
        steps = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) @ axes
    limit_m = one.within_m(sigma_m)
    left_m = moved_m - steps @ one.arm.T
    agree = np.abs(left_m[:, :, np.newaxis] - left_m[:, np.newaxis]) <= np.minimum(
        limit_m, limit_m.T
    )
    votes = (1.0 + _HEIGHT * one.height - _FLAGGED * one.lost) @ agree
    if growth > 0.0:
        votes -= _PRIOR * np.sum(steps**2, axis=1, keepdims=True) / growth**2
    number, phase = np.unravel_index(int(np.argmax(votes)), votes.shape)
    return np.asarray(agree[number, :, phase])


def _fit(
    arm: FloatArray, moved_m: FloatArray, own_m2: FloatArray, growth: float
) -> tuple[FloatArray, FloatArray]:
    """Clock and step of the vector that fit best, (4,), and their covariance.

    The INS says how little the vector can have changed; the phases say the rest.
    """
    H = np.column_stack([np.ones(len(arm)), arm])
    if growth == 0.0 or not arm.any():
        P: FloatArray = np.zeros((4, 4))
        P[0, 0] = 1.0 / np.sum(1.0 / own_m2)
        return np.array([P[0, 0] * np.sum(moved_m / own_m2), 0.0, 0.0, 0.0]), P
    N = (H.T / own_m2) @ H + np.diag([0.0, *[growth**-2] * 3])
    P = np.asarray(np.linalg.inv(N))
    return P @ ((H.T / own_m2) @ moved_m), P


def _verdict(
    one: _Changes, limits: Limits, left_m: FloatArray, sigma_m: FloatArray, trusted: bool
) -> _Verdict:
    """State, value, sigma, cycles, check of each phase; `trusted`: half of them agree."""
    value, sigma = left_m / one.wavelength_m, sigma_m / one.wavelength_m
    unit = np.where(one.half, 0.5, 1.0)
    cycles = unit * np.round(value / unit)
    left = np.abs(value - cycles)
    certain = unit * (unit - 2.0 * left) > 2.0 * _SURE * sigma**2
    certain &= left <= np.maximum(_FITS * sigma, _FITS_CYCLES)
    certain &= trusted | (cycles == 0.0)
    check = _checks(one, value - cycles)
    with np.errstate(invalid="ignore"):
        certain &= ~(np.abs(check) > np.maximum(_CHECK * 2.0 * limits.noise_m, limits.check_m))
    state = np.where(cycles == 0.0, State.CONTINUOUS, State.SLIPPED)
    state = np.where(certain, state, State.UNDECIDED)
    if np.unique(one.satellite).size < 2:
        state = np.full_like(state, State.ALONE)
    cycles[state != State.SLIPPED] = 0.0
    return state.astype(np.int8), value, sigma, cycles, check


def _checks(one: _Changes, left_cycles: FloatArray) -> FloatArray:
    """Four-difference check of each phase against another signal of its satellite, m.

    S's v: what was repaired on the two frequencies less what their phases differ by, in metres;
    geometry, clocks and whatever the INS got wrong are gone from it.
    """
    left_m = left_cycles * one.wavelength_m
    check = np.full(left_m.size, np.nan)
    for satellite in np.unique(one.satellite):
        own = np.flatnonzero(one.satellite == satellite)
        if own.size > 1:
            check[own] = left_m[np.roll(own, 1)] - left_m[own]
            check[own[0]] = left_m[own[1]] - left_m[own[0]]
    return check


class Shares(NamedTuple):
    """Cycles slipped at the first and at the second antenna, (n, m) each."""

    first: FloatArray
    second: FloatArray
    known: BoolArray  # it is known which; where not, the second is taken


def shares(between: Judgement, first: Judgement, second: Judgement) -> Shares:
    """Tell which antenna's phase slipped, by each antenna's own phases against the INS's way.

    between: of differences second − first. Slips by equal cycles on both antennas leave every
    difference whole: they are told where both antennas are sure of them.
    """
    slip, one, two = between.cycles, first.cycles, second.cycles
    at_first, at_second = sure(first), sure(second)
    both, agree = at_first & at_second, two - one == slip
    in_second = np.where(at_second, two, np.where(at_first, one + slip, slip))
    in_second = np.where(both & ~agree, slip, in_second)
    told = sure(between) & ((slip != 0.0) | (both & agree))
    known = (both & agree) | (at_first ^ at_second) | (slip == 0.0)
    return Shares(
        np.where(told, in_second - slip, 0.0),
        np.where(told, in_second, 0.0),
        known,
    )


def sure(found: Judgement) -> BoolArray:
    """Where the number of cycles, none among them, is sure."""
    return np.asarray((found.state == State.CONTINUOUS) | (found.state == State.SLIPPED))
