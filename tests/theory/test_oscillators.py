"""Oscillator noise against numerical integrals and against simulated oscillators."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from deepgnss.core.records import Oscillator
from deepgnss.theory.oscillators import (
    allan_deviation,
    allan_phase_sigma_cycles,
    free_running_frequency_sigma_hz,
    free_running_phase_sigma_cycles,
    pll_oscillator_sigma_cycles,
    pll_vibration_sigma_cycles,
)

L1 = 1575.42e6
OCXO = Oscillator("OCXO", 2e-25, 0.0, 6e-25, 0.0)
TCXO = Oscillator("TCXO", 1e-21, 1e-21, 2e-20, 0.0)
# characteristic polynomials of the loops in core.loops, and their bandwidth per natural frequency
LOOPS = {2: ((1.0, math.sqrt(2.0), 1.0), 0.53033), 3: ((1.0, 2.0, 2.0, 1.0), 0.83333)}


def loop_integral(order: int, bandwidth_hz: float, density) -> float:
    """√∫ |1 − H|² S_x df in cycles, for one-sided relative-frequency density S_y(f)."""
    polynomial, per_omega = LOOPS[order]
    omega = bandwidth_hz / per_omega

    def integrand(log_f):
        f = math.exp(log_f)
        s = 2j * math.pi * f / omega
        error = abs(s**order / np.polyval(polynomial, s)) ** 2
        return error * density(f) * (L1 / (2.0 * math.pi * f)) ** 2 * f

    return math.sqrt(quad(integrand, math.log(1e-5), math.log(1e7), limit=500)[0])


def test_free_running_spread_is_as_stated_for_the_oscillators():
    for oscillator, five, twenty in ((OCXO, 0.035, 0.28), (TCXO, 6.0, 51.0)):
        assert free_running_phase_sigma_cycles(oscillator, L1, 5.0) == pytest.approx(five, rel=0.1)
        assert free_running_phase_sigma_cycles(oscillator, L1, 20.0) == pytest.approx(
            twenty, rel=0.02
        )


def test_simulated_oscillator_has_the_predicted_spread_and_allan_deviation():
    # h large and τ such that white and random-walk frequency noise weigh about the same
    oscillator = Oscillator("x", 4e-20, 0.0, 1e-21, 0.0)
    rng = np.random.default_rng(1)
    step, steps, runs = 0.01, 300, 4000
    white = rng.normal(0.0, math.sqrt(oscillator.h0_s / 2.0 / step), (runs, steps))
    walk = np.cumsum(
        rng.normal(0.0, math.sqrt(2.0 * math.pi**2 * oscillator.h_2_hz * step), (runs, steps)),
        axis=1,
    )
    phase = L1 * step * np.cumsum(white + walk, axis=1)
    predicted = free_running_phase_sigma_cycles(oscillator, L1, step * steps)
    assert phase[:, -1].std() == pytest.approx(predicted, rel=0.04)
    assert (L1 * walk[:, -1]).std() == pytest.approx(
        free_running_frequency_sigma_hz(oscillator, L1, step * steps), rel=0.04
    )
    half = steps // 2
    means = (white + walk).reshape(runs, 2, half).mean(axis=2)
    allan = math.sqrt(0.5 * np.mean((means[:, 1] - means[:, 0]) ** 2))
    assert allan == pytest.approx(allan_deviation(oscillator, half * step), rel=0.04)


def test_flicker_floor():
    assert allan_deviation(Oscillator("f", 0.0, 1e-22, 0.0, 0.0), 7.0) == pytest.approx(1.17741e-11)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize(
    "oscillator",
    [
        Oscillator("white", 1e-21, 0.0, 0.0, 0.0),
        Oscillator("flicker", 0.0, 1e-21, 0.0, 0.0),
        Oscillator("walk", 0.0, 0.0, 2e-20, 0.0),
        TCXO,
    ],
    ids=lambda o: o.name,
)
def test_loop_residual_is_the_integral(order, oscillator):
    expected = loop_integral(
        order, 7.0, lambda f: oscillator.h0_s + oscillator.h_1 / f + oscillator.h_2_hz / f**2
    )
    sigma = pll_oscillator_sigma_cycles(order, 7.0, L1, oscillator)
    assert sigma == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("order", [2, 3])
def test_vibration_is_the_integral(order):
    # k_g 1e-9 /g and 0.05 g²/Hz, as T figure 2.16
    sigma = pll_vibration_sigma_cycles(order, 10.0, L1, 1e-9, 0.05)
    assert sigma == pytest.approx(loop_integral(order, 10.0, lambda f: 1e-18 * 0.05), rel=1e-3)


def test_vibration_of_order_2_is_the_printed_formula():
    omega = 10.0 / 0.53
    printed_rad = math.sqrt(math.pi**2 * L1**2 * 1e-18 * 0.05 / (math.sqrt(2.0) * omega))
    sigma = pll_vibration_sigma_cycles(2, 10.0, L1, 1e-9, 0.05)
    assert 2.0 * math.pi * sigma == pytest.approx(printed_rad, rel=1e-3)


def test_allan_phase():
    assert allan_phase_sigma_cycles(L1, 0.02, 1e-10) == pytest.approx(3.15084e-3)
