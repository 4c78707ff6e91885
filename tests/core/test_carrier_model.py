"""The chain of integrators: against matrix exponentials, Van Loan and the theory of oscillators."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from deepgnss.core.carrier_model import (
    carrier_covariance,
    driven_covariance,
    transition,
    wander_covariance,
)
from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.theory.oscillators import (
    free_running_frequency_sigma_hz,
    free_running_phase_sigma_cycles,
)

CARRIER_HZ = 1.57542e9
OSCILLATOR = Oscillator("some", 2e-21, 0.0, 3e-22, 0.0)


def _van_loan(F: FloatArray, G: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
    n = F.shape[0]
    block = np.block([[-F, G], [np.zeros((n, n)), F.T]]) * seconds
    big = expm(block)
    phi = big[n:, n:].T
    return phi, phi @ big[:n, n:]


@pytest.mark.parametrize("states", [3, 4])
@pytest.mark.parametrize("seconds", [0.02, 0.4])
def test_is_what_van_loan_gives(states: int, seconds: float) -> None:
    """Transition and covariance, every state driven at once."""
    densities = np.array([0.3, 2.0, 5.0, 7.0])[:states]
    F = np.diag(np.ones(states - 1), 1)
    phi, Q = _van_loan(F, np.diag(densities), seconds)
    ours = sum(driven_covariance(states, seconds, k, q) for k, q in enumerate(densities))
    assert transition(states, seconds) == pytest.approx(phi, rel=1e-12)
    assert ours == pytest.approx(Q, rel=1e-9)


def test_oscillator_is_the_theorys() -> None:
    """Phase and frequency of a free-running one."""
    Q = carrier_covariance(4, 0.3, OSCILLATOR, 1.5e9, 0.0)
    phase = free_running_phase_sigma_cycles(OSCILLATOR, 1.5e9, 0.3)
    assert math.sqrt(Q[0, 0]) == pytest.approx(phase)
    assert math.sqrt(Q[1, 1]) == pytest.approx(
        free_running_frequency_sigma_hz(OSCILLATOR, 1.5e9, 0.3)
    )
    assert not Q[2:].any()


@pytest.mark.parametrize("driven", [1, 3])
def test_time_may_be_cut(driven: int) -> None:
    """Two halves are the whole: Q(T) = Φ Q(T/2) Φᵀ + Q(T/2)."""
    half, phi = driven_covariance(4, 0.1, driven, 3.0), transition(4, 0.1)
    whole = driven_covariance(4, 0.2, driven, 3.0)
    assert phi @ half @ phi.T + half == pytest.approx(whole, rel=1e-12)


def test_wander_about_an_instant_is_that_of_drawn_clocks() -> None:
    """White noise of frequency and its walk, less phase and frequency in the middle."""
    oscillator = Oscillator("TCXO", 1e-21, 0.0, 2e-20, 0.0)
    random, step_s, count, half = np.random.default_rng(2), 1e-3, 20_000, 100
    white = CARRIER_HZ * np.sqrt(0.5 * oscillator.h0_s * step_s)
    walk = CARRIER_HZ * np.pi * np.sqrt(2.0 * oscillator.h_2_hz * step_s)
    hz = np.cumsum(walk * random.standard_normal((count, 2 * half)), axis=1)
    before = np.concatenate([np.zeros((count, 1)), hz[:, :-1]], axis=1)
    steps = 0.5 * step_s * (before + hz) + white * random.standard_normal(hz.shape)
    phase = np.cumsum(steps, axis=1)
    t = step_s * np.arange(1 - half, half + 1)
    off = phase - phase[:, [half - 1]] - hz[:, [half - 1]] * t
    at = [9, 59, 98, 139, 199]
    found, expected = np.cov(off[:, at].T), wander_covariance(t[at], oscillator, CARRIER_HZ)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.03)
    assert expected[0, 4] == 0.0
