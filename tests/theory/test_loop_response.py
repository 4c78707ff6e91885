"""Loops fed by a wrong frequency: closed forms of T, numerical integration, limits, units."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.theory.loop_response import (
    OPEN,
    Loop,
    bandwidth_per_omega,
    carrier_loop,
    drawn_response,
    white_response,
)
from deepgnss.theory.oscillators import pll_oscillator_sigma_cycles
from deepgnss.theory.tracking_error import acceleration_response

TIMES = np.linspace(0.0, 1.0, 21)[1:]
LOOPS = [OPEN, *(carrier_loop(order, 7.0) for order in (1, 2, 3)), carrier_loop(2, 15.0, 1.0)]


def integrated(loop: Loop, order: int, decay: float) -> tuple[FloatArray, FloatArray]:
    """Phase of a loop fed by e^(−t/T) integrated k times, and its square summed: Runge–Kutta.

    In the form of T figure 4.2: phase error x, ẋ = f − Σ cₖωᵏ·∫…∫x, integrators one by one.
    """
    n = loop.order

    def rates(_: float, state: FloatArray) -> FloatArray:
        loops, chain, _total = state[: n + 1], state[n + 1 : -1], state[-1]
        out = np.empty_like(state)
        fed = chain[0]
        taken = sum(
            loop.polynomial[k] * loop.omega_radps**k * loops[k - 1] for k in range(1, n + 1)
        )
        out[0] = fed - taken
        out[1 : n + 1] = loops[:n]  # each integrates the one before
        out[n + 1 : -2] = chain[1:]
        out[-2] = -decay * chain[-1]
        out[-1] = loops[0] ** 2
        return out

    start = np.zeros(n + 1 + order + 1 + 1)
    start[-2] = 1.0
    found = solve_ivp(rates, (0.0, 1.0), start, t_eval=TIMES, rtol=1e-10, atol=1e-16)
    return found.y[0], found.y[-1]


@pytest.mark.parametrize("loop", LOOPS, ids=lambda loop: f"order {loop.order}")
@pytest.mark.parametrize("order", [0, 1, 2])
def test_responses_are_those_of_the_differential_equations(loop: Loop, order: int) -> None:
    phase, power = integrated(loop, order, 0.0)
    np.testing.assert_allclose(
        drawn_response(loop, order, TIMES).phase, phase, rtol=1e-6, atol=1e-9
    )
    np.testing.assert_allclose(
        white_response(loop, order, TIMES).phase, np.sqrt(power), rtol=1e-6, atol=1e-9
    )
    _, power = integrated(loop, order, 1.0 / 0.3)
    np.testing.assert_allclose(
        white_response(loop, order, TIMES, 0.3).phase, np.sqrt(power), rtol=1e-6, atol=1e-9
    )


def test_closed_forms_of_a_critically_damped_loop() -> None:
    """T(4.50–4.52) and the powers T(4.63–4.65), as printed."""
    loop, t = carrier_loop(2, 15.0, 1.0), TIMES
    w, e = loop.omega_radps, np.exp(-loop.omega_radps * TIMES)
    assert w == pytest.approx(1.6 * 15.0)
    printed = (
        t * e,
        1.0 / w**2 - e / w**2 * (1.0 + w * t),
        e / w**3 * (2.0 + w * t) - (2.0 - w * t) / w**3,
    )
    powers = (
        1.0 / (4.0 * w**3) - e**2 / (4.0 * w**3) * (2.0 * w**2 * t**2 + 2.0 * w * t + 1.0),
        e**2
        * (16 / e - 2 * w**2 * t**2 - 6 * w * t + 8 / e * w * t + 4 / e**2 * w * t - 5)
        / (4.0 * w**5)
        - 11.0 / (4.0 * w**5),
        t**3 / (3.0 * w**4)
        - 3.0 / (4.0 * w**7)
        + e**2 * (16.0 / e - 13.0) / (4.0 * w**7)
        - t**2 * e**2 * (2.0 / e + 1.0) ** 2 / (2.0 * w**5)
        - t * e**2 * (8.0 / e - 8.0 / e**2 + 5.0) / (2.0 * w**6),
    )
    for order, (response, power) in enumerate(zip(printed, powers, strict=True)):
        np.testing.assert_allclose(drawn_response(loop, order, t).phase, response, atol=1e-15)
        np.testing.assert_allclose(white_response(loop, order, t).phase ** 2, power, rtol=1e-6)


@pytest.mark.parametrize("order", [2, 3])
def test_a_frequency_ramp_is_an_acceleration(order: int) -> None:
    at = np.linspace(0.0, 2.0, 101)[1:]
    ours = drawn_response(carrier_loop(order, 5.0), 1, at).phase
    np.testing.assert_allclose(ours, acceleration_response(at, order, 5.0), atol=1e-9)


@pytest.mark.parametrize("order", [2, 3])
def test_a_walking_oscillator_settles_at_k7(order: int) -> None:
    """Random-walk frequency, f0²·2π²·h₋₂ a second, in a loop: K(7), twice the h₋₂ of K(8)."""
    walking = Oscillator("w", 0.0, 0.0, 2e-20, 0.0)
    density = 1575.42e6 * math.sqrt(2.0 * math.pi**2 * walking.h_2_hz)
    settled = white_response(carrier_loop(order, 10.0), 0, np.array([5.0])).phase[0]
    expected = pll_oscillator_sigma_cycles(order, 10.0, 1575.42e6, walking)
    assert density * settled == pytest.approx(expected, rel=1e-6)


def test_noise_bandwidths() -> None:
    assert bandwidth_per_omega((1.0, 1.0)) == pytest.approx(0.25)
    assert bandwidth_per_omega((1.0, 2.0, 2.0, 1.0)) == pytest.approx(5.0 / 6.0)
    assert bandwidth_per_omega((1.0, 2.4, 1.1, 1.0)) == pytest.approx(0.7845, abs=1e-4)  # T 2.2.5
    for damping in (0.5, math.sqrt(0.5), 1.0, 2.0):
        assert bandwidth_per_omega((1.0, 2.0 * damping, 1.0)) == pytest.approx(
            0.5 * (damping + 0.25 / damping)
        )


@given(
    order=st.integers(0, 2),
    bandwidth=st.floats(1.0, 30.0),
    steps=st.lists(st.floats(1e-3, 5.0), min_size=1, max_size=6),
)
@settings(max_examples=30)
def test_steps_do_not_matter_and_a_loop_only_helps(
    order: int, bandwidth: float, steps: list[float]
) -> None:
    times, loop = np.cumsum(steps), carrier_loop(3, bandwidth)
    for make in (drawn_response, white_response):
        many = make(loop, order, times).phase[-1]
        once = make(loop, order, times[-1:]).phase[-1]
        assert many == pytest.approx(once, rel=1e-6, abs=1e-12)
    ends = times[-1:]
    assert white_response(loop, order, ends).phase[0] <= white_response(OPEN, order, ends).phase[0]


def test_what_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="loop order 4"):
        carrier_loop(4, 1.0)
    with pytest.raises(ValueError, match="damping 1"):
        carrier_loop(3, 1.0, 1.0)
    with pytest.raises(ValueError, match="rising"):
        drawn_response(OPEN, 1, np.array([1.0, 0.5]))
