"""Budget of a carrier loop and of a Kalman one against simulation, limits and figures in print."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.carrier_model import carrier_covariance
from deepgnss.core.records import Oscillator
from deepgnss.theory.loop_response import carrier_loop, drawn_response
from deepgnss.theory.phase_budget import (
    THRESHOLD_CYCLES,
    Stress,
    best_bandwidth_hz,
    lag_cycles,
    phase_budget,
)
from deepgnss.theory.update_filter import (
    oscillator_step_sigma,
    steady_phase_sigma_cycles,
    tone_bounds,
)

L1_HZ = 1575.42e6
TCXO = Oscillator("TCXO", 1e-21, 0.0, 2e-20, 1e-9)
NONE = Oscillator("none", 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("order", [2, 3])
def test_lag_is_where_the_response_settles(order: int) -> None:
    settled = drawn_response(carrier_loop(order, 7.0), order - 1, np.array([5.0])).phase[0]
    assert lag_cycles(order, 7.0, -12.0) == pytest.approx(12.0 * settled, rel=1e-6)


def test_parts_and_total() -> None:
    stress = Stress(35.0, 0.02, L1_HZ, TCXO, 0.05, 30.0)
    budget = phase_budget(3, 10.0, stress)
    assert min(budget) > 0.0
    assert budget.jitter == pytest.approx(
        math.sqrt(budget.thermal**2 + budget.vibration**2 + budget.oscillator**2)
    )
    assert budget.total == pytest.approx(budget.jitter + budget.dynamic / 3.0)
    assert pytest.approx(0.0417, abs=1e-4) == THRESHOLD_CYCLES
    quiet = phase_budget(3, 10.0, Stress(35.0, 0.02, L1_HZ, NONE))
    assert quiet.vibration == quiet.oscillator == quiet.dynamic == 0.0
    assert quiet.total == quiet.thermal == budget.thermal


@pytest.mark.parametrize("order", [2, 3])
def test_no_other_bandwidth_is_better(order: int) -> None:
    stress = Stress(30.0, 0.02, L1_HZ, TCXO, 0.0, 20.0)
    best = best_bandwidth_hz(order, stress)
    least = phase_budget(order, best, stress).total
    assert all(phase_budget(order, best * x, stress).total > least for x in (0.8, 0.97, 1.03, 1.3))


def test_an_oscillator_in_a_step() -> None:
    """White noise and walk of frequency added up in 2000 parts: by impulse responses."""
    step_s, clock, parts = 0.2, Oscillator("c", 4e-22, 0.0, 3e-23, 0.0), 2000
    left_s = (np.arange(parts) + 0.5) * step_s / parts
    walk = L1_HZ**2 * 2.0 * math.pi**2 * clock.h_2_hz * step_s / parts
    white = L1_HZ**2 * 0.5 * clock.h0_s * step_s
    phase, frequency = oscillator_step_sigma(clock, L1_HZ, step_s)
    assert phase**2 == pytest.approx(white + walk * np.sum(left_s**2), rel=1e-5)
    assert frequency**2 == pytest.approx(walk * parts)


def test_bounds_of_a_tone_are_reached_by_least_squares() -> None:
    """Phases of strong sums fitted by a line; per cycle, not per radian."""
    rng, sums, interval_s, cn0 = np.random.default_rng(4), 200, 0.2, 45.0
    snr = 10.0**4.5 * interval_s / sums
    noise = rng.standard_normal((2, 4000, sums)) / math.sqrt(2.0 * snr)
    phases = np.angle(1.0 + noise[0] + 1j * noise[1]) / (2.0 * math.pi)
    t = (np.arange(sums) - 0.5 * (sums - 1)) * interval_s / sums
    slope, middle = np.polyfit(t, phases.T, 1)
    phase, frequency = tone_bounds(cn0, interval_s, sums)
    assert middle.std() == pytest.approx(phase, rel=0.04)
    assert slope.std() == pytest.approx(frequency, rel=0.04)


def test_the_filter_settles_as_simulated() -> None:
    """A Riccati recursion run until it stands still; never worse than one update alone."""
    clock, step_s, cn0 = Oscillator("c", 2e-25, 0.0, 6e-25, 0.0), 0.2, 35.0
    Q = carrier_covariance(4, step_s, clock, L1_HZ, 64.0**2)
    sigmas = tone_bounds(cn0, step_s, 200)
    Phi = np.array([[1, 0.2, 0.02, 0.2**3 / 6], [0, 1, 0.2, 0.02], [0, 0, 1, 0.2], [0, 0, 0, 1]])
    P, H, R = np.diag([1.0, 1e2, 1e4, 1e6]), np.eye(4)[:2], np.diag(np.square(sigmas))
    for _ in range(200):
        P = Phi @ P @ Phi.T + Q
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        P = P - gain @ H @ P
    settled = steady_phase_sigma_cycles(cn0, step_s, Q)
    assert settled == pytest.approx(math.sqrt(P[0, 0]), rel=1e-3)
    assert settled < sigmas[0]


def test_figures_of_l() -> None:
    """L 1.3.1: its text has √(h0·T) and √(h₋₂·T) where its own equations have h0/2 and 2π²·h₋₂."""
    _, frequency = oscillator_step_sigma(Oscillator("TCXO_L", 2e-19, 0.0, 3e-20, 0.0), L1_HZ, 0.1)
    assert frequency / math.sqrt(2.0 * math.pi**2) == pytest.approx(0.086, abs=5e-4)
    phase, frequency = oscillator_step_sigma(Oscillator("OCXO", 2e-25, 0.0, 6e-25, 0.0), L1_HZ, 0.1)
    assert frequency / math.sqrt(2.0 * math.pi**2) == pytest.approx(0.0004, abs=5e-5)
    assert math.sqrt(2.0) * phase == pytest.approx(0.0002, abs=7e-5)
