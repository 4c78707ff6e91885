"""A satellite that is back: by how many half cycles its new arc differs from the one before.

Behind a gap the clock and the way may be off by many half cycles, but they are off for all
satellites alike: constants of the phases' filter before and behind the gap differ by whole numbers
of half cycles (whole cycles where the polarity is known on both sides), all at once. Codes say to
some metres what they have in common. Where no other numbers fit nearly as well, the polarity is
known before symbols tell, and with it what code less phase was before the gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.special import gammainccinv

from deepgnss.core.records import FloatArray
from deepgnss.deep.arcs import Arc
from deepgnss.deep.integers import nearest_integers
from deepgnss.deep.phase_filter import PhaseFilter

_BENT_M: Final = 0.004  # 1σ by which diffraction moves a phase before its fall or at its return
_CODE_M: Final = 3.0  # 1σ of a code that has just come back
_MARGIN: Final = 16.0  # of −2 log likelihood, by which all other numbers fit worse
_MOST: Final = 500  # sets of numbers looked at
_FALSE_ALARM: Final = 1e-3
_ALIKE_M: Final = 0.03  # by which a common step differs for BeiDou, whose cycles are longer


class Return(NamedTuple):
    """A satellite's new arc and the one before it, with their places in the filter."""

    now: Arc
    before: Arc
    place: int
    place_before: int
    code_m: float  # less phase, now
    sound: bool = True  # the range is not known to be wrong


class Rejoined(NamedTuple):
    """A new arc that the one before goes on in."""

    back: Return
    halves: int  # cycles too much in the new one, times two


def rejoin(known: PhaseFilter, back: Sequence[Return]) -> list[Rejoined]:
    """Arcs whose numbers are beyond doubt; they are joined in the filter.

    Sound ones that cannot be brought to fit are counted as misfits of the arcs before.
    """
    if not back:
        return []
    places, before = [one.place for one in back], [one.place_before for one in back]
    apart_m, Q = known.apart(places, before)
    apart_m = apart_m + [one.now.range_m - one.before.range_m for one in back]
    Q = Q + _BENT_M**2 * np.eye(len(back))
    by_code_m = np.array([one.before.code.mean_m - one.code_m for one in back])
    weights = np.array([one.sound for one in back]) / _CODE_M**2
    P = np.linalg.inv(np.linalg.inv(Q) + np.diag(weights))
    apart_m = P @ (np.linalg.solve(Q, apart_m) + weights * by_code_m)
    unit_m = np.array([one.now.wavelength_m * (1.0 if one.now.upright else 0.5) for one in back])
    fitting, numbers = _numbers(apart_m / unit_m, P / np.outer(unit_m, unit_m))
    for k in set(range(len(back))) - set(fitting):
        back[k].before.misfits += back[k].sound
    found = []
    wavelengths_m = np.array([back[k].now.wavelength_m for k in fitting])
    for j in _sure(numbers * unit_m[fitting], wavelengths_m):
        one, step_m = back[fitting[j]], float(numbers[0, j] * unit_m[fitting[j]])
        grown_m = one.now.range_m - one.before.range_m
        known.join(one.place, one.place_before, step_m - grown_m, _BENT_M**2)
        found.append(Rejoined(one, round(2.0 * step_m / one.now.wavelength_m)))
    return found


def _numbers(x: FloatArray, P: FloatArray) -> tuple[list[int], FloatArray]:
    """Which of (n,) fit whole numbers together, and the sets of numbers that do, best first.

    Who lies furthest from what all others say goes; no sets (0, …): too many fit.
    """
    fitting = list(range(x.size))
    while fitting:
        part = np.ix_(fitting, fitting)
        found = nearest_integers(x[fitting], P[part], _MARGIN, _MOST)
        if found is None:
            break
        numbers, distances = found
        if distances[0] <= 2.0 * gammainccinv(0.5 * len(fitting), _FALSE_ALARM):
            return fitting, numbers.astype(np.float64)
        inverse = np.linalg.inv(P[part])
        away = np.abs(inverse @ (x[fitting] - numbers[0])) / np.sqrt(np.diagonal(inverse))
        del fitting[int(np.argmax(away))]
    return fitting, np.zeros((0, len(fitting)))


def _sure(steps_m: FloatArray, wavelength_m: FloatArray) -> list[int]:
    """Which of n steps all sets (sets, n) agree on, but for whole cycles that all have in common.

    Those are the clock's, and do no harm; half ones would.
    """
    if not steps_m.size:
        return []
    halves = np.rint(2.0 * steps_m / wavelength_m)
    of_one_sign = (halves % 2.0 == halves[0] % 2.0).all(axis=0)
    alone_m = steps_m - np.median(steps_m, axis=1, keepdims=True)
    return list(np.flatnonzero(of_one_sign & (np.ptp(alone_m, axis=0) < _ALIKE_M)))
