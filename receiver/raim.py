"""Receiver autonomous integrity monitoring: do the residuals agree, and who is to blame if not."""

from __future__ import annotations

from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from deepgnss.core.records import FloatArray
from deepgnss.receiver.orbits import SatelliteStates, line_of_sight

GROSS_M = 1000.0
"""Range errors beyond this are no noise, no reflection: whole code periods or bits are wrong."""

_SCALES_M = (1e7, 1e6, 1e6, 1e5, 1e5, 1e4, 1e4, 1e3, 1e3, 1e3)

_MANY = 5000  # sets of one size, some 10 ms of trying


class RaimResult(NamedTuple):
    """Verdict over a set of measurements."""

    passed: bool
    statistic: float  # Σ(residual/σ)² of what is left
    limit: float  # its chi-square quantile; inf where nothing can be tested
    excluded: tuple[int, ...]  # rows to leave out


def check_residuals(
    H: FloatArray,
    residuals: FloatArray,
    sigma: FloatArray,
    false_alarm: float,
    at_once: int = 4,
    excludable: int | None = None,
) -> RaimResult:
    """Chi-square test of least-squares residuals and search for the rows that spoil it.

    If the test fails, the smallest set of rows whose removal makes it pass is taken; of equally
    large sets the one that leaves the least. All sets of up to `at_once` rows are tried together
    (greedy removal one by one blames the innocent when two faults pull the same way); when none
    of them suffices the best largest one goes and the search starts again. What is left must be
    testable: at least one more row than unknowns.

    Parameters
    ----------
    H: design matrix (n, p) of full rank. residuals: (n,) after adjustment with weights σ⁻².
    sigma: (n,) standard deviations. false_alarm: probability of a failed test without fault.
    excludable: only the first so many rows may go (the rest is prior knowledge); None: all.

    Source: chi-square and subset statistics of linear models; removing rows S lowers the sum of
    squares by e_Sᵀ Q_SS⁻¹ e_S, with Q the projector onto the residual space.
    """
    rows, unknowns = H.shape
    e = residuals / sigma
    statistic = float(e @ e)
    dof = rows - unknowns
    if dof == 0:
        return RaimResult(True, statistic, np.inf, ())
    limit = float(chdtri(dof, false_alarm))
    if statistic <= limit:
        return RaimResult(True, statistic, limit, ())
    A = H / sigma[:, np.newaxis]
    q, _ = np.linalg.qr(A)
    Q = np.eye(rows) - q @ q.T
    best: tuple[int, ...] = ()
    left = statistic
    candidates = rows if excludable is None else excludable
    for count in range(1, min(at_once, dof - 1, candidates) + 1):
        if comb(candidates, count) > _MANY:
            break
        sets = np.array(list(combinations(range(candidates), count)))
        left, best = _best_set(Q, e, sets, statistic)
        if best and left <= chdtri(dof - count, false_alarm):
            return RaimResult(True, left, float(chdtri(dof - count, false_alarm)), best)
    if not best or dof - len(best) < 2:
        return RaimResult(False, statistic, limit, ())
    kept = np.setdiff1d(np.arange(rows), best)
    x = np.linalg.lstsq(A[kept], e[kept], rcond=None)[0]
    again = check_residuals(
        H[kept],
        residuals[kept] - H[kept] @ x,
        sigma[kept],
        false_alarm,
        at_once,
        candidates - len(best),
    )
    if not again.passed:
        return RaimResult(False, statistic, limit, ())
    return again._replace(excluded=(*best, *(int(kept[row]) for row in again.excluded)))


def _best_set(
    Q: FloatArray, e: FloatArray, sets: np.ndarray, statistic: float
) -> tuple[float, tuple[int, ...]]:
    """The set whose removal leaves the least, and what it leaves; () where none can be spared."""
    blocks = Q[sets[:, :, np.newaxis], sets[:, np.newaxis, :]]
    spare = np.linalg.eigvalsh(blocks)[:, 0] > 1e-10  # otherwise the rest would be singular
    if not spare.any():
        return statistic, ()
    sets, blocks = sets[spare], blocks[spare]
    e_sets = e[sets][:, :, np.newaxis]
    gain = (e_sets * np.linalg.solve(blocks, e_sets)).sum(axis=(1, 2))
    winner = int(np.argmax(gain))
    return max(statistic - float(gain[winner]), 0.0), tuple(int(row) for row in sets[winner])


def gross_errors(
    states: SatelliteStates,
    ranges_m: FloatArray,
    active: NDArray[np.bool_],
    start_e_m: FloatArray,
) -> dict[int, float]:
    """Rows whose range is off by kilometres, and by how much.

    Such errors bend the equations too much for a linear test. They show in a fix in which misfits
    far beyond a shrinking scale weigh little. With fewer than two satellites to spare nothing is
    blamed: four agree on any wrong place.

    Parameters
    ----------
    states, ranges_m: satellites (k) and pseudoranges (k,) with the satellite clock taken off.
    active: (k,) rows to look at. start_e_m: a position to start from, or the geocentre.
    """
    rows = np.flatnonzero(active)
    if len(rows) < 6:
        return {}
    r_e_m, clock_m = start_e_m, None
    for scale_m in _SCALES_M:
        sight = line_of_sight(r_e_m, np.zeros(3), states)
        misfit = (ranges_m - sight.range_m)[rows]
        clock_m = float(np.median(misfit)) if clock_m is None else clock_m
        weight = 1.0 / np.hypot(scale_m, misfit - clock_m)
        H = np.column_stack([-sight.unit_e[rows], np.ones(len(rows))])
        x = np.linalg.lstsq(H * weight[:, np.newaxis], misfit * weight)[0]
        r_e_m, clock_m = r_e_m + x[:3], float(x[3])
    left = misfit - H @ x
    wrong = np.flatnonzero(np.abs(left) > GROSS_M)
    if len(rows) - len(wrong) < 5:
        return {}
    return {int(rows[k]): float(left[k]) for k in wrong}
