"""The chain of integrators: against matrix exponentials, Van Loan and the theory of oscillators."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from deepgnss.core.carrier_model import carrier_covariance, driven_covariance, transition
from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.theory.oscillators import (
    free_running_frequency_sigma_hz,
    free_running_phase_sigma_cycles,
)

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
