"""Open loop: how far a carrier runs off while nobody corrects it, T 4.5, T(4.77–4.99).

A channel without signal carries its phase on by prediction. What the prediction gets wrong adds up:
the inertial navigation along the line of sight, the receiver's clock (carried on from before, or
known from satellites still tracked) and what the models leave of the atmosphere. The sources are
independent; 1σ here, in cycles and Hz of the carrier, after times since the loop opened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from deepgnss.core.records import FloatArray, ImuGrade, Oscillator
from deepgnss.theory.inertial import error_growth

MEAN_S = 0.1
"""Frequency errors of a clock are means over this: its white noise has none at an instant."""


class Growth(NamedTuple):
    """1σ over time from one source of error, or from several together."""

    source: str
    phase_cycles: FloatArray  # (n,) since the loop opened
    frequency_hz: FloatArray  # (n,)


def together(growths: Sequence[Growth], source: str = "total") -> Growth:
    """Independent sources as one."""
    phase2 = np.sum([growth.phase_cycles**2 for growth in growths], axis=0)
    frequency2 = np.sum([growth.frequency_hz**2 for growth in growths], axis=0)
    return Growth(source, np.sqrt(phase2), np.sqrt(frequency2))


def share_below(limit_cycles: float, sigma_cycles: float) -> float:
    """Share of normal errors of mean 0 whose size is below a limit."""
    return float(erf(limit_cycles / (math.sqrt(2.0) * sigma_cycles))) if sigma_cycles else 1.0


def trusted_s(time_s: FloatArray, growth: Growth, limit_cycles: float) -> float:
    """How long 1σ of the phase stays below a limit; the last time if it always does."""
    above = np.flatnonzero(growth.phase_cycles > limit_cycles)
    if above.size == 0:
        return float(time_s[-1])
    k = int(above[0])
    if k == 0:
        return float(time_s[0])
    ends = slice(k - 1, k + 1)
    return float(np.interp(limit_cycles, growth.phase_cycles[ends], time_s[ends]))


# --- inertial navigation --------------------------------------------------------------------------


def inertial_growth(
    grade: ImuGrade,
    f_n_mps2: FloatArray,
    unit_n: FloatArray,
    wavelength_m: float,
    time_s: FloatArray,
) -> tuple[Growth, ...]:
    """What a navigation that has just lost its corrections adds, source by source, T(4.77–4.99).

    Parameters: constant specific force (3,) and line of sight (3,) in NED; times (n,).
    """
    terms = error_growth(grade, f_n_mps2, time_s, unit_n[np.newaxis])
    return tuple(
        Growth(
            term.name, term.position_m[:, 0] / wavelength_m, term.velocity_mps[:, 0] / wavelength_m
        )
        for term in terms
    )


class Step(NamedTuple):
    """A navigation's errors over a step, and what they do to the antenna along a line of sight."""

    seconds: float
    Phi: FloatArray  # (size, size)
    Q: FloatArray  # (size, size)
    h_begin: (
        FloatArray  # (size,) cycles by which the antenna is nearer for an error, at its begin …
    )
    h_end: FloatArray  # … and at its end


def filter_growth(P: FloatArray, steps: Sequence[Step]) -> Growth:
    """1σ after each of the steps from a filter's covariance P (size, size) when the loop opens.

    What counts is how far the antenna went since, not where it is: an error of position at the
    start was in the phase already. The error carried is therefore (way, x), the way growing by
    h_end·x − h_begin·x. Frequency is the mean over the step.
    """
    size = P.shape[0]
    covariance = np.zeros((1 + size, 1 + size))
    covariance[1:, 1:] = P
    phase2, frequency2 = [], []
    for step in steps:
        grown = np.concatenate([[0.0], step.h_end @ step.Phi - step.h_begin])
        frequency2.append(grown @ covariance @ grown + step.h_end @ step.Q @ step.h_end)
        frequency2[-1] /= step.seconds**2
        forward = np.zeros_like(covariance)
        forward[0], forward[1:, 1:] = grown, step.Phi
        forward[0, 0] = 1.0
        into = np.vstack([step.h_end, np.eye(size)])
        covariance = forward @ covariance @ forward.T + into @ step.Q @ into.T
        phase2.append(covariance[0, 0])
    return Growth("inertial navigation", np.sqrt(phase2), np.sqrt(frequency2))


# --- receiver clock -------------------------------------------------------------------------------


class ClockFit(NamedTuple):
    """A polynomial through the clock's phase of the last seconds, by least squares.

    Order 1 carries the mean drift on, order 2 a drift that changes evenly.
    """

    order: int
    span_s: float
    interval_s: float = 0.1  # between phases
    noise_cycles: float = 0.0  # 1σ of each, independent

    @property
    def times_s(self) -> FloatArray:
        """Of the phases, the last at 0, when the loop opens."""
        count = max(round(self.span_s / self.interval_s), self.order)
        return np.asarray(np.arange(-count, 1) * self.interval_s, dtype=np.float64)

    def weights(self, ahead_s: float) -> FloatArray:
        """What each phase counts in the fit's phase after a time less that at 0."""
        powers = np.arange(1.0, self.order + 1.0)
        scale_s = self.times_s[0]
        basis = (self.times_s / scale_s)[:, np.newaxis] ** np.arange(self.order + 1)
        rising: FloatArray = np.linalg.pinv(basis)[1:]
        return np.asarray((ahead_s / scale_s) ** powers @ rising)


def phase_kernel(oscillator: Oscillator, carrier_hz: float, lag_s: FloatArray) -> FloatArray:
    """K with which Σ w x(t) of a clock's phase has the variance ΣΣ wᵢ wⱼ K(tᵢ − tⱼ), cycles².

    For weights with Σw = Σw·t = 0, which see no offset and no drift; a phase itself has no
    variance. f0²·(−h0·|τ|/4 + h₋₁·τ²·ln|τ|/2 + π²·h₋₂·|τ|³/6), from S_x = f0²·S_y/(2πf)²: the
    second difference, weights 1, −2, 1, gives 2τ² times the Allan variance.
    """
    lag = np.abs(lag_s)
    flicker = np.where(lag > 0.0, lag**2 * np.log(np.where(lag > 0.0, lag, 1.0)), 0.0)
    relative = (
        -0.25 * oscillator.h0_s * lag
        + 0.5 * oscillator.h_1 * flicker
        + math.pi**2 / 6.0 * oscillator.h_2_hz * lag**3
    )
    return np.asarray(carrier_hz**2 * relative)


def clock_growth(
    oscillator: Oscillator, carrier_hz: float, fit: ClockFit, time_s: FloatArray
) -> Growth:
    """What a clock carried on by a fit adds: its own noise since, and that of the fit."""
    phase = [_carried_sigma(oscillator, carrier_hz, fit, 0.0, float(t)) for t in time_s]
    frequency = [
        _carried_sigma(oscillator, carrier_hz, fit, float(t) - MEAN_S, float(t)) / MEAN_S
        for t in time_s
    ]
    return Growth("clock", np.array(phase), np.array(frequency))


def _carried_sigma(
    oscillator: Oscillator, carrier_hz: float, fit: ClockFit, from_s: float, to_s: float
) -> float:
    """1σ of what the clock's phase does between two times less what the fit says of it."""
    told = fit.weights(to_s) - fit.weights(from_s)
    at_s = np.concatenate([fit.times_s, [from_s, to_s]])
    weights = np.concatenate([-told, [-1.0, 1.0]])
    kernel = phase_kernel(oscillator, carrier_hz, at_s[:, np.newaxis] - at_s)
    return math.sqrt(weights @ kernel @ weights + fit.noise_cycles**2 * (told @ told))


def best_fit(
    oscillator: Oscillator,
    carrier_hz: float,
    ahead_s: float,
    noise_cycles: float,
    interval_s: float = 0.1,
    longest_s: float = 60.0,
) -> ClockFit:
    """The fit whose phase is best after a time: order 1 or 2, over which span."""
    ratio = 1.25
    spans = interval_s * np.unique(
        np.round(ratio ** np.arange(0.0, math.log(longest_s / interval_s, ratio)))
    )
    fits = [
        ClockFit(order, float(span_s), interval_s, noise_cycles)
        for order in (1, 2)
        for span_s in spans[spans >= order * interval_s]
    ]
    return min(fits, key=lambda fit: _carried_sigma(oscillator, carrier_hz, fit, 0.0, ahead_s))


def shared_growth(
    unit_n: FloatArray,
    others_n: FloatArray,
    phase_sigma_cycles: float,
    moved_sigma_cycles: FloatArray,
) -> Growth:
    """What one blocked satellite's phase lacks while others are tracked.

    Their phases since the loop opened tell the way the antenna went and the clock; the inertial
    navigation's word on the way counts with its own 1σ.

    Parameters: line of sight (3,), those of the others (m, 3) in NED; 1σ of a tracked phase; 1σ
    of the navigation's way since then (n,), the same in all directions. Frequency is not told.
    """
    rows = np.column_stack([others_n, -np.ones(len(others_n))])
    told = rows.T @ rows / (2.0 * phase_sigma_cycles**2)  # a difference of two phases
    asked = np.append(unit_n, -1.0)
    sigmas = []
    for moved_cycles in moved_sigma_cycles:
        known = np.diag([max(moved_cycles, 1e-9) ** -2.0] * 3 + [0.0])
        sigmas.append(math.sqrt(asked @ np.linalg.solve(told + known, asked)))
    return Growth("others", np.array(sigmas), np.full(len(sigmas), np.nan))


# --- code -----------------------------------------------------------------------------------------


def way_bound(sigma: float, rate_sigma: float, seconds: float) -> float:
    """Most that 1σ of a way can be after a step over which its rate errs by a 1σ.

    Spreads add up at most by their size, as they do where errors keep their sign: what is drawn
    once. The drift of an accelerometer, √t further, makes 3 % less.
    """
    return sigma + rate_sigma * seconds


# --- atmosphere, phase at the start ---------------------------------------------------------------


def rate_growth(source: str, rate_mps: float, wavelength_m: float, time_s: FloatArray) -> Growth:
    """A constant error of range rate: what models leave of the atmosphere, of orbits and clocks."""
    hz = rate_mps / wavelength_m
    return Growth(source, hz * np.asarray(time_s), np.full(len(time_s), hz))


def entry_growth(phase_sigma_cycles: float, time_s: FloatArray) -> Growth:
    """The error of phase that the closed loop left when it opened."""
    return Growth(
        "phase at the start", np.full(len(time_s), phase_sigma_cycles), np.zeros(len(time_s))
    )
