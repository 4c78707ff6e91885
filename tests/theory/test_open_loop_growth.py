"""Open-loop errors against simulated clocks and navigations, and against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.records import FloatArray, ImuGrade, Oscillator
from deepgnss.theory.inertial import error_growth, total
from deepgnss.theory.open_loop import (
    ClockFit,
    Step,
    best_fit,
    clock_growth,
    entry_growth,
    filter_growth,
    inertial_growth,
    phase_kernel,
    rate_growth,
    share_below,
    shared_growth,
    together,
    trusted_s,
)
from deepgnss.theory.oscillators import allan_deviation, free_running_phase_sigma_cycles

L1_HZ = 1575.42e6
L1_M = 299_792_458.0 / L1_HZ
OCXO = Oscillator("OCXO", 2e-25, 0.0, 6e-25, 0.0)
POOR = Oscillator("poor", 1e-22, 0.0, 4e-24, 0.0)
GRADE = ImuGrade("g", 1e-5, 1e-5, 1e6, 1e-4, 0.0, 2e-3, 1e-3, 1e6, 1e-3, 1e-3, 0.01, 2e-4, 1e-3)


def clock_phases(oscillator: Oscillator, step_s: float, count: int, runs: int) -> FloatArray:
    """Phases (runs, count) in cycles: white noise of frequency and its random walk, exact steps."""
    rng = np.random.default_rng(7)
    white = math.sqrt(0.5 * oscillator.h0_s * step_s)
    walk = math.sqrt(2.0 * math.pi**2 * oscillator.h_2_hz * step_s)
    w = rng.normal(0.0, walk, (runs, count))
    y = np.cumsum(w, axis=1) - w
    rise = (y + 0.5 * w) * step_s + rng.normal(0.0, walk * step_s / math.sqrt(12.0), w.shape)
    return np.asarray(L1_HZ * np.cumsum(rise + rng.normal(0.0, white, w.shape), axis=1))


def predicted_by_polyfit(phases: FloatArray, fit: ClockFit, noise: FloatArray, ahead: int):
    """Error of the phase carried on from the last of the fitted phases, by numpy's own fit."""
    count = fit.times_s.size
    seen = phases[:, :count] + noise[:, :count]
    parts = np.polynomial.polynomial.polyfit(fit.times_s, seen.T, fit.order)
    told = sum(parts[k] * (ahead * fit.interval_s) ** k for k in range(1, fit.order + 1))
    return phases[:, count - 1 + ahead] - phases[:, count - 1] - told


@pytest.mark.parametrize("oscillator", [OCXO, POOR], ids=lambda o: o.name)
@pytest.mark.parametrize(("order", "span_s"), [(1, 0.1), (1, 2.0), (1, 15.0), (2, 4.0), (2, 20.0)])
def test_clock_carried_on_spreads_as_simulated(
    oscillator: Oscillator, order: int, span_s: float
) -> None:
    fit = ClockFit(order, span_s, 0.1, 0.004)
    phases = clock_phases(oscillator, 0.1, fit.times_s.size + 60, 6000)
    noise = np.random.default_rng(3).normal(0.0, 0.004, phases.shape)
    times_s = np.array([0.5, 5.0])
    growth = clock_growth(oscillator, L1_HZ, fit, times_s)
    for k, ahead in enumerate((5, 50)):
        error = predicted_by_polyfit(phases, fit, noise, ahead)
        before = predicted_by_polyfit(phases, fit, noise, ahead - 1)
        assert error.std() == pytest.approx(growth.phase_cycles[k], rel=0.03)
        assert (error - before).std() / 0.1 == pytest.approx(growth.frequency_hz[k], rel=0.03)


@pytest.mark.parametrize("tau_s", [0.1, 3.0, 40.0])
def test_carrying_on_the_last_difference_is_the_allan_variance(tau_s: float) -> None:
    """Flicker noise included: x(τ) − 2x(0) + x(−τ) has √2·τ·σ_y(τ)."""
    oscillator = Oscillator("all", 1e-22, 3e-23, 2e-24, 0.0)
    fit = ClockFit(1, tau_s, tau_s)
    growth = clock_growth(oscillator, L1_HZ, fit, np.array([tau_s]))
    expected = L1_HZ * math.sqrt(2.0) * tau_s * allan_deviation(oscillator, tau_s)
    assert growth.phase_cycles[0] == pytest.approx(expected, rel=1e-6)


def test_kernel_of_flicker_noise_knows_other_spacings() -> None:
    """Steps of 1 and 2 s: the integral of S_x over |Σ w·e^(j2πft)|² instead of the kernel."""
    flicker = Oscillator("f", 0.0, 1e-22, 0.0, 0.0)
    weights, times_s = np.array([2.0, -3.0, 1.0]), np.array([0.0, 1.0, 3.0])
    f = np.geomspace(1e-5, 1e4, 400_001)
    response = np.abs(np.exp(2j * np.pi * np.outer(f, times_s)) @ weights) ** 2
    density = L1_HZ**2 * 1e-22 / f / (2.0 * np.pi * f) ** 2
    kernel = phase_kernel(flicker, L1_HZ, times_s[:, np.newaxis] - times_s)
    assert weights @ kernel @ weights == pytest.approx(
        np.trapezoid(density * response, f), rel=5e-3
    )


def test_best_fit_suits_the_oscillator() -> None:
    """A walking frequency wants the last moment, white noise the long mean; none does better."""
    walking = best_fit(OCXO, L1_HZ, 20.0, 0.003)
    white = best_fit(Oscillator("w", 1e-22, 0.0, 1e-30, 0.0), L1_HZ, 20.0, 0.003)
    assert walking.span_s < 3.0 < 30.0 < white.span_s
    at = np.array([20.0])
    best = clock_growth(OCXO, L1_HZ, walking, at).phase_cycles[0]
    assert free_running_phase_sigma_cycles(OCXO, L1_HZ, 20.0) < best
    for order, span_s in ((1, 0.2), (1, 5.0), (2, 5.0), (2, 30.0)):
        other = clock_growth(OCXO, L1_HZ, ClockFit(order, span_s, 0.1, 0.003), at)
        assert best < other.phase_cycles[0]


def test_a_line_of_sight_is_not_the_sum_of_its_axes() -> None:
    """A tilt turns the force into several axes at once: δv = f×φ along u, simulated."""
    rng = np.random.default_rng(5)
    f, u = np.array([3.0, 4.0, -9.8]), np.array([0.6, 0.48, -0.64])
    sigmas = np.array([GRADE.tilt_rad, GRADE.tilt_rad, GRADE.heading_rad])
    tilts = rng.normal(0.0, sigmas, (100_000, 3))
    moved = (np.cross(f, tilts) @ u) * 5.0**2 / 2.0 / L1_M
    growth = inertial_growth(GRADE, f, u, L1_M, np.array([1.0, 5.0]))
    attitude = next(term for term in growth if term.source == "initial attitude")
    assert attitude.phase_cycles[1] == pytest.approx(moved.std(), rel=0.01)


def test_every_source_along_an_axis_is_that_of_the_theory_of_velocity() -> None:
    f, at = np.array([1.0, -2.0, -9.8]), np.array([2.0, 7.0])
    velocity_mps, position_m = total(error_growth(GRADE, f, at))
    growth = together(inertial_growth(GRADE, f, np.array([0.0, 1.0, 0.0]), L1_M, at))
    np.testing.assert_allclose(growth.phase_cycles, position_m[:, 1] / L1_M)
    np.testing.assert_allclose(growth.frequency_hz, velocity_mps[:, 1] / L1_M)


def test_path_of_a_filter_is_what_its_errors_add_up_to() -> None:
    """Position, velocity and a walking acceleration: Monte Carlo, position error not counted."""
    step_s, steps, runs = 0.1, 50, 20_000
    Phi = np.array([[1.0, step_s, 0.5 * step_s**2], [0.0, 1.0, step_s], [0.0, 0.0, 1.0]])
    Q = np.diag([0.0, 1e-4, 4e-4]) * step_s
    root = np.array([[2.0, 0.0, 0.0], [0.03, 0.05, 0.0], [0.0, -0.01, 0.02]])
    P = root @ root.T
    h = np.array([1.0 / L1_M, 0.0, 0.0])
    turned = np.array([1.0 / L1_M, 0.0, 0.3])  # a lever arm that turns in the last step
    shape = [Step(step_s, Phi, Q, h, h)] * (steps - 1) + [Step(step_s, Phi, Q, h, turned)]
    growth = filter_growth(P, shape)
    rng = np.random.default_rng(11)
    x = rng.standard_normal((runs, 3)) @ root.T
    path = np.zeros(runs)
    for step in shape:
        after = x @ Phi.T + rng.standard_normal((runs, 3)) @ np.sqrt(Q)
        grown = after @ step.h_end - x @ step.h_begin
        path += grown
        x = after
    assert growth.phase_cycles[-1] == pytest.approx(path.std(), rel=0.02)
    assert growth.frequency_hz[-1] == pytest.approx(grown.std() / step_s, rel=0.02)
    still = filter_growth(np.diag([1e4, 0.0, 0.0]), [Step(step_s, Phi, 0.0 * Q, h, h)])
    assert still.phase_cycles[-1] == pytest.approx(0.0, abs=1e-12)


def test_others_tell_clock_and_way() -> None:
    """Monte Carlo of the estimate with four, and the two limits of what the navigation knows."""
    rng = np.random.default_rng(2)
    units = rng.normal(size=(5, 3)) - [0.0, 0.0, 1.5]
    units /= np.linalg.norm(units, axis=1)[:, np.newaxis]
    blocked, others = units[0], units[1:]
    way, sigma = 0.05, 0.004
    growth = shared_growth(blocked, others, sigma, np.array([0.0, way, 1e6]))
    moved = rng.normal(0.0, way, (40_000, 3))  # what the navigation has wrong
    seen = moved @ others.T + rng.normal(0.0, math.sqrt(2.0) * sigma, (40_000, 4))
    # Generalized least squares over (way, clock), the navigation's way a measurement of zero.
    rows = np.column_stack([others, -np.ones(4)])
    weight = rows.T / (2.0 * sigma**2)
    normal = weight @ rows + np.diag([way**-2] * 3 + [0.0])
    found = np.linalg.solve(normal, weight @ seen.T).T
    error = found @ np.append(blocked, -1.0) - moved @ blocked
    assert growth.phase_cycles[1] == pytest.approx(error.std(), rel=0.02)
    assert growth.phase_cycles[0] == pytest.approx(math.sqrt(2.0) * sigma / 2.0, rel=1e-6)
    free = math.sqrt(2.0) * sigma * np.linalg.norm(np.linalg.solve(rows.T, np.append(blocked, -1)))
    assert growth.phase_cycles[2] == pytest.approx(free, rel=1e-3)


def test_shares_and_trusted_time() -> None:
    assert share_below(0.5, 0.5) == pytest.approx(0.6827, abs=1e-4)
    assert share_below(0.5, 0.7413) == pytest.approx(0.5, abs=1e-4)
    assert share_below(0.1, 0.0) == 1.0
    times_s = np.linspace(0.0, 10.0, 11)
    line = rate_growth("troposphere", 0.02, L1_M, times_s)
    assert line.phase_cycles[5] == pytest.approx(0.02 / L1_M * 5.0)
    assert trusted_s(times_s, line, 0.5) == pytest.approx(0.5 * L1_M / 0.02)
    assert trusted_s(times_s, line, 5.0) == 10.0
    assert trusted_s(times_s, entry_growth(0.6, times_s), 0.5) == 0.0
    both = together([line, entry_growth(0.3, times_s)])
    assert both.phase_cycles[10] == pytest.approx(math.hypot(0.02 / L1_M * 10.0, 0.3))
    np.testing.assert_allclose(both.frequency_hz, line.frequency_hz)
