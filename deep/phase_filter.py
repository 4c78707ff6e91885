"""Kalman filter of what carrier phases say against the inertial navigation's prediction.

The phase of a satellite, in metres and less the range predicted since its arc began, is

    y = b + c + u·d + noise

with b the arc's own error, c the receiver's clock, u the direction to the satellite and d the error
of the antenna's way by the inertial navigation (its position corrections left out). The state is
(d, x, clock, (b, r)…): x are the navigation's errors without position, which make d grow (and the
scale of an odometer, where wheels say how fast the car rolls along its axes); the clock is an
oscillator of given power law. b walks, and grows by r, the error of the predicted range's rate:
what models leave of the atmosphere, and a place that is wrong (1 m makes up to 0.2 mm/s, as the
satellite goes on). A phase that is missing stays predicted, with its covariance:
differences over any stretch are as good as the phases at its ends, whoever else was there.

Errors are estimate − truth; clock and phases grow with range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.ins.error_model import POSITION
from deepgnss.ins.filter import correct

# Time constants of Gauss–Markov frequencies that add up to flicker, each h₋₁·ln(ratio).
_FLICKER_S: Final = np.array([0.3, 3.0, 30.0])
_FLICKER_RATIO: Final = 10.0
_FAR: Final = 4.0  # σ
_WAY: Final = slice(0, 3)
_FROM: Final = POSITION.stop  # what of the inertial errors is carried here

Chosen = NDArray[np.bool_]
Rows = Sequence[int]


class PhaseFilter:
    """State and covariance; the arcs stand in the order in which they were begun."""

    def __init__(
        self, P: FloatArray, oscillator: Oscillator, drift_mps: float, drift_sigma_mps: float
    ) -> None:
        """P (n, n): of the inertial errors; drift times c of the receiver's clock."""
        inertial = int(P.shape[0]) - _FROM
        self._oscillator = oscillator
        self._errors = slice(_WAY.stop, _WAY.stop + inertial)
        self._clock = self._errors.stop
        size = self._clock + 2 + _FLICKER_S.size
        self._base = size
        self._rates = np.zeros(size)  # what adds up to the clock's frequency
        self._rates[self._clock + 1 :] = 1.0
        self.mean = np.zeros(size)
        self.mean[self._clock + 1] = drift_mps
        self.P = np.zeros((size, size))
        self.P[self._errors, self._errors] = P[_FROM:, _FROM:]
        self.P[self._clock + 1, self._clock + 1] = drift_sigma_mps**2
        flicker = slice(self._clock + 2, size)
        self._flicker_mps2 = SPEED_OF_LIGHT_MPS**2 * oscillator.h_1 * math.log(_FLICKER_RATIO)
        self.P[flicker, flicker] = self._flicker_mps2 * np.eye(_FLICKER_S.size)

    @property
    def arcs(self) -> int:
        """How many there are."""
        return (int(self.mean.size) - self._base) // 2

    @property
    def _own(self) -> slice:
        """Of each arc's own error."""
        return slice(self._base, None, 2)

    @property
    def _own_rate(self) -> slice:
        """Of its growth."""
        return slice(self._base + 1, None, 2)

    @property
    def drift_mps(self) -> float:
        """Frequency of the receiver's clock, times c."""
        return float(self._rates @ self.mean[: self._base])

    @property
    def drift_sigma_mps(self) -> float:
        """1σ of it."""
        return math.sqrt(self._rates @ self.P[: self._base, : self._base] @ self._rates)

    @property
    def velocity_error_n_mps(self) -> FloatArray:
        """(3,) NED."""
        return self.mean[self._errors][:3].copy()

    def rate_sigma_mps(self, toward_n: FloatArray) -> FloatArray:
        """1σ of the predicted rate of ranges from directions (k, 3), the clock's included."""
        H = np.zeros((toward_n.shape[0], self._base))
        H[:, self._errors][:, :3] = toward_n
        H += self._rates
        P = self.P[: self._base, : self._base]
        return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", H, P, H)))

    @property
    def errors_covariance(self) -> FloatArray:
        """Of the navigation's errors but position."""
        return self.P[self._errors, self._errors].copy()

    @property
    def velocity_variance_m2ps2(self) -> float:
        """Sum over the three axes."""
        first = self._errors.start
        return float(np.trace(self.P[first : first + 3, first : first + 3]))

    # --- time ----------------------------------------------------------------------------------

    def carry(
        self,
        H_begin: FloatArray,
        H_end: FloatArray,
        Phi: FloatArray,
        Q: FloatArray,
        seconds: float,
        *,
        clock_shaken_m2: float = 0.0,
        arcs_walk_m2: FloatArray | float = 0.0,
        rates_walk_m2ps2: FloatArray | float = 0.0,
    ) -> None:
        """Go on to the next tag: the way's error grows by what the errors do to the antenna.

        H (3, n): slope of the antenna's position (NED) in the inertial errors at both ends;
        Phi, Q (n, n) of the errors in between; variances that come on top, those of arcs (arcs,).
        """
        clock = _clock_transition(
            seconds, self._oscillator.h0_s, self._oscillator.h_2_hz, self._flicker_mps2
        )
        F, added = _transition(H_begin, H_end, Phi, Q, *clock)
        added[self._clock, self._clock] += clock_shaken_m2
        walks = np.zeros(self.mean.size)
        walks[self._own], walks[self._own_rate] = arcs_walk_m2, rates_walk_m2ps2
        self.mean, self.P = _carried(self.mean, self.P, F, added, walks, seconds)

    def shift(self, correction: FloatArray) -> None:
        """The navigation's errors have changed by (n,); its way so far has not."""
        self.mean[self._errors] += correction[_FROM:]

    def restart_errors(self, P: FloatArray) -> None:
        """Believe the navigation's own word (n, n) on its errors, as it is corrected now."""
        errors = self._errors
        self.mean[errors] = 0.0
        self.P[errors] = 0.0
        self.P[:, errors] = 0.0
        self.P[errors, errors] = P[_FROM:, _FROM:]

    def open_clock(self, jump_m: float) -> None:
        """The clock has jumped by about so much."""
        self.mean[self._clock] += jump_m
        self.P[self._clock, self._clock] += jump_m**2

    def common(self, H: FloatArray) -> FloatArray:
        """What unit variances of way and clock are in phases (k, k) of rows H."""
        shared = np.column_stack([H[:, _WAY], H[:, self._clock]])
        return np.asarray(shared @ shared.T)

    def open_way(self, variance_m2: float) -> None:
        """Way and clock are known less well than they seemed."""
        for k in (*range(_WAY.stop), self._clock):
            self.P[k, k] += variance_m2

    def open_arc(self, arc: int, variance_m2: float) -> None:
        """An arc's own error is known less well than it seemed."""
        k = self._base + 2 * arc
        self.P[k, k] += variance_m2

    def rest_way(self, toward_n: FloatArray) -> None:
        """Move the way's mean error into the arcs' own: directions (arcs, 3) change."""
        self.mean[self._own] += toward_n @ self.mean[_WAY]
        self.mean[_WAY] = 0.0

    # --- phases --------------------------------------------------------------------------------

    def rows(self, toward_n: FloatArray, clocked: FloatArray) -> FloatArray:
        """H (arcs, size): directions (arcs, 3), and whether the clock is in them (1 or 0)."""
        H = np.zeros((self.arcs, self.mean.size))
        H[:, _WAY] = toward_n
        H[:, self._clock] = clocked
        H[:, self._own] = np.eye(self.arcs)
        return H

    def begin(
        self,
        y_m: FloatArray,
        variance_m2: FloatArray,
        rate_variance_m2ps2: FloatArray,
        toward_n: FloatArray,
        clocked: FloatArray,
    ) -> None:
        """New arcs (k): their own errors are what the phases are above all else."""
        size, count = self.mean.size, y_m.size
        h = np.zeros((count, size))
        h[:, _WAY], h[:, self._clock] = toward_n, clocked
        across = -h @ self.P
        own, own_rate = slice(size, None, 2), slice(size + 1, None, 2)
        mean, P = np.zeros(size + 2 * count), np.zeros((size + 2 * count, size + 2 * count))
        mean[:size], mean[own] = self.mean, y_m - h @ self.mean
        P[:size, :size] = self.P
        P[own, :size], P[:size, own] = across, across.T
        P[own, own] = -across @ h.T + np.diag(variance_m2)
        P[own_rate, own_rate] = np.diag(rate_variance_m2ps2)
        self.mean, self.P = mean, P

    def keep(self, kept: Chosen) -> None:
        """Forget arcs, (arcs,) false."""
        all_kept = np.concatenate([np.ones(self._base, dtype=np.bool_), np.repeat(kept, 2)])
        self.mean, self.P = self.mean[all_kept], self.P[np.ix_(all_kept, all_kept)]

    def apart(self, now: Rows, before: Rows) -> tuple[FloatArray, FloatArray]:
        """Arcs' own errors less those of others (k,), by their numbers; covariance (k, k)."""
        D = np.eye(self.arcs)[now] - np.eye(self.arcs)[before]
        return D @ self.mean[self._own], D @ self.P[self._own, self._own] @ D.T

    def join(self, now: int, before: int, apart_m: float, variance_m2: float) -> None:
        """An arc's own error is so much more than another's."""
        H = np.zeros((1, self.mean.size))
        own = H[0, self._own]
        own[now], own[before] = 1.0, -1.0
        self.update(H, np.array([apart_m]), np.array([variance_m2]))

    def raise_arc(self, arc: int, by_m: float) -> None:
        """An arc's phase is told with so much more from now on."""
        self.mean[self._own][arc] += by_m

    def update(self, H: FloatArray, y_m: FloatArray, variance_m2: FloatArray) -> None:
        """Take phases in."""
        if y_m.size:
            self.mean, self.P, _, _ = correct(self.mean, self.P, y_m, H, np.diag(variance_m2))

    def take_drift(self, drift_mps: float, sigma_mps: float) -> None:
        """Take in the clock's frequency, times c, as Doppler tells it; not when it is far off."""
        H = np.concatenate([self._rates, np.zeros(2 * self.arcs)])[np.newaxis]
        told = H, np.array([drift_mps]), np.array([sigma_mps**2])
        off_mps, covariance = self.innovation(*told)
        if off_mps[0] ** 2 < _FAR**2 * covariance[0, 0]:
            self.update(*told)

    def take_velocities(self, z_mps: FloatArray, H: FloatArray, variance_m2ps2: FloatArray) -> None:
        """Take in what wheels and road say, as the navigation does: not where it is far off.

        Predicted less measured velocities (k,), and their slope (k, n) in the errors.
        """
        rows = np.zeros((z_mps.size, self.mean.size))
        rows[:, self._errors] = H[:, _FROM:]
        kept = sound(*self.innovation(rows, z_mps, variance_m2ps2), _FAR)
        self.update(rows[kept], z_mps[kept], variance_m2ps2[kept])

    def innovation(
        self, H: FloatArray, y_m: FloatArray, variance_m2: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Phases less their prediction (k,), and the covariance of that (k, k)."""
        return y_m - H @ self.mean, H @ self.P @ H.T + np.diag(variance_m2)


@brief_kernel
def _clock_transition(
    seconds: float, h0_s: float, h_2_hz: float, flicker_mps2: float
) -> tuple[FloatArray, FloatArray]:
    """Phase by white noise of frequency, frequency by its random walk and by flicker."""
    size = 2 + _FLICKER_S.size
    kept = np.exp(-seconds / _FLICKER_S)
    F = np.eye(size)
    F[0, 1] = seconds
    F[0, 2:] = _FLICKER_S * (1.0 - kept)
    white = SPEED_OF_LIGHT_MPS**2 * h0_s / 2.0
    walk = SPEED_OF_LIGHT_MPS**2 * 2.0 * math.pi**2 * h_2_hz
    drawn = np.empty(size - 1)
    drawn[0], drawn[1:] = walk * seconds, flicker_mps2 * (1.0 - kept**2)
    Q = np.zeros((size, size))
    Q[0, 0] = white * seconds + np.sum(drawn) * seconds**2 / 3.0
    Q[0, 1:] = Q[1:, 0] = 0.5 * seconds * drawn  # each comes evenly over the step
    for k in range(1, size):
        Q[k, k] = drawn[k - 1]
        if k > 1:
            F[k, k] = kept[k - 2]
    return F, Q


@brief_kernel
def _transition(
    H_begin: FloatArray,
    H_end: FloatArray,
    Phi: FloatArray,
    Q: FloatArray,
    F_clock: FloatArray,
    Q_clock: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Transition and noise of way, errors and clock: d grows by (H_end·Φ − H_begin)·x."""
    H_end = H_end.copy()
    errors = slice(3, 3 + Phi.shape[0] - _FROM)
    clock = errors.stop
    size = clock + F_clock.shape[0]
    F, added = np.eye(size), np.zeros((size, size))
    F[_WAY, errors] = (H_end @ Phi - H_begin)[:, _FROM:]
    F[errors, errors] = Phi[_FROM:, _FROM:]
    into = np.concatenate((H_end, np.eye(Phi.shape[0])[_FROM:]))
    added[:clock, :clock] = into @ Q @ into.T
    F[clock:, clock:], added[clock:, clock:] = F_clock, Q_clock
    return F, added


@brief_kernel
def _carried(
    mean: FloatArray,
    P: FloatArray,
    F: FloatArray,
    added: FloatArray,
    walks: FloatArray,
    seconds: float,
) -> tuple[FloatArray, FloatArray]:
    """State and covariance so many seconds later: what the arcs have in common by F, then the arcs.

    F, added (b, b): transition and noise of the first b; walks (n,): variances that come on top.
    Behind them errors b and their growth r take turns: b + seconds·r.
    """
    base = F.shape[0]
    own, own_rate = slice(base, mean.size, 2), slice(base + 1, mean.size, 2)
    mean, P = mean.copy(), P.copy()
    mean[:base] = F @ mean[:base]
    mean[own] += seconds * mean[own_rate]
    P[:base] = F @ P[:base]
    P[:, :base] = P[:, :base].copy() @ F.T
    P[own] += seconds * P[own_rate]
    P[:, own] += seconds * P[:, own_rate]
    P[:base, :base] += added
    for k in range(base, mean.size):
        P[k, k] += walks[k]
    return mean, 0.5 * (P + P.T)


@brief_kernel
def sound(innovation: FloatArray, covariance: FloatArray, limit: float) -> Chosen:
    """Which of (k,) agree with the prediction and with each other.

    The one that lies furthest from what prediction and all others say of it goes, until none is
    more than `limit` of its σ away: one that jumps does not condemn the others.
    """
    kept = np.ones(innovation.size, dtype=np.bool_)
    while kept.any():
        inverse = np.linalg.inv(covariance[kept][:, kept])
        away = np.abs(inverse @ innovation[kept]) / np.sqrt(np.diag(inverse))
        worst = int(np.argmax(away))
        if away[worst] <= limit:
            break
        kept[np.flatnonzero(kept)[worst]] = False
    return kept


def common_jump(innovation: FloatArray, covariance: FloatArray, limit: float) -> float | None:
    """What most of three or more have in common beyond the prediction, None if nothing."""
    if innovation.size < 3:
        return None
    middle, share = _in_common(innovation, covariance, limit)
    return middle if share > 0.6 else None


@brief_kernel
def _in_common(innovation: FloatArray, covariance: FloatArray, limit: float) -> tuple[float, float]:
    """Their median, and the share of them beyond the prediction that lies near it."""
    middle, sigma = np.median(innovation), np.sqrt(np.diag(covariance))
    jumped = np.abs(innovation) > limit * sigma
    alike = np.abs(innovation - middle) < limit * sigma
    return middle, np.mean(jumped & alike)  # type: ignore[return-value]
