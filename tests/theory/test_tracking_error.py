"""Thermal noise formulas against the integrals they stand for, and against figures in print."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from deepgnss.core.loops import loop_gains
from deepgnss.theory.tracking_error import (
    acceleration_peak_cycles,
    acceleration_response,
    dll_thermal_sigma_chips,
    loop_states,
    pll_thermal_sigma_cycles,
    reported_share,
    root_sum_square,
)

CHIP_M = 299_792_458.0 / 1.023e6
CHIP_RATE = 1.023e6


def betz_integral(cn0_dbhz: float, b_hz: float, t_s: float, d: float, band: float) -> float:
    """σ in chips of the early-minus-late power loop, ideal band-pass front end (Betz 2000)."""
    cn0 = 10.0 ** (cn0_dbhz / 10.0)
    f = np.linspace(-band / 2, band / 2, 100_001)
    s = np.sinc(f) ** 2

    def integral(y):
        return np.trapezoid(y, f)

    noise = integral(s * np.sin(np.pi * f * d) ** 2)
    slope = 2.0 * np.pi * integral(f * s * np.sin(np.pi * f * d))
    squaring = 1.0 + integral(s * np.cos(np.pi * f * d) ** 2) / (
        t_s * cn0 * integral(s * np.cos(np.pi * f * d)) ** 2
    )
    return math.sqrt(b_hz / cn0 * noise * squaring) / slope


def test_pll_known_values():
    # 7 Hz, 20 ms: √(7/10^4.85) rad = 0.9946e-2 rad, squaring loss 3.5e-4
    assert pll_thermal_sigma_cycles(48.5, 7.0, 0.020) == pytest.approx(1.5828e-3, rel=1e-3)
    # L1 wavelength: 0.30 mm; √2 of it 0.43 mm, the order of the published 0.5 mm
    assert pll_thermal_sigma_cycles(48.5, 7.0, 0.020) * 190.29 == pytest.approx(0.301, abs=0.001)
    # squaring loss doubles the variance where C/N0 · T = ½
    low = 10.0 * math.log10(0.5 / 0.001)
    assert pll_thermal_sigma_cycles(low, 10.0, 0.001) == pytest.approx(
        math.sqrt(2.0 * 10.0 / 500.0) / (2.0 * math.pi)
    )


def test_dll_known_values():
    # published 21.5 dB-Hz, 0.05 Hz, D 0.25, 9 MHz, times √2: 2.4 m (512 ms), 2.85 m (20 ms)
    for coherent, metres in ((0.512, 2.4), (0.020, 2.85)):
        sigma = dll_thermal_sigma_chips(21.5, 0.05, coherent, 0.25, 9e6, CHIP_RATE)
        assert math.sqrt(2.0) * sigma * CHIP_M == pytest.approx(metres, rel=0.02)


def test_dll_with_an_ideal_front_end_is_exact():
    for d in (1.0, 0.5, 0.1):
        sigma = dll_thermal_sigma_chips(40.0, 1.0, 0.02, d, math.inf, CHIP_RATE)
        assert sigma == pytest.approx(betz_integral(40.0, 1.0, 0.02, d, 4000.0), rel=2e-3)


@pytest.mark.parametrize(("band", "limit"), [(4.0, 0.1), (8.8, 0.08), (20.0, 0.08), (30.0, 0.08)])
def test_dll_approximates_the_integral_in_all_regions(band, limit):
    for cn0, coherent in ((48.0, 0.02), (25.0, 0.02), (35.0, 0.001)):
        for d in (1.0, 0.5, 0.25, 0.125, 0.1, 0.05):
            sigma = dll_thermal_sigma_chips(cn0, 1.0, coherent, d, band * CHIP_RATE, CHIP_RATE)
            assert sigma == pytest.approx(betz_integral(cn0, 1.0, coherent, d, band), rel=limit)


@given(st.floats(3.2, 40.0), st.sampled_from([1.0, math.pi]))
@settings(deadline=None, derandomize=True)
def test_dll_regions_join(band, border):
    def sigma(d):
        return dll_thermal_sigma_chips(30.0, 1.0, 0.02, d, band * CHIP_RATE, CHIP_RATE)

    d = border / band
    assert sigma(d * (1.0 - 1e-9)) == pytest.approx(sigma(d * (1.0 + 1e-9)), rel=1e-7)


@given(st.floats(15.0, 55.0), st.sampled_from([0.001, 0.004, 0.020]), st.floats(0.1, 20.0))
@settings(deadline=None, derandomize=True)
def test_noise_falls_with_power_time_and_narrowness(cn0, coherent, bandwidth):
    def pll(c=cn0, b=bandwidth, t=coherent):
        return pll_thermal_sigma_cycles(c, b, t)

    def dll(c=cn0, b=bandwidth, t=coherent, d=0.5):
        return dll_thermal_sigma_chips(c, b, t, d, 30e6, CHIP_RATE)

    assert pll(c=cn0 + 1.0) < pll() > pll(t=2.0 * coherent)
    assert dll(c=cn0 + 1.0) < dll() > dll(t=2.0 * coherent)
    assert pll(b=4.0 * bandwidth) == pytest.approx(2.0 * pll())
    assert dll(b=4.0 * bandwidth) == pytest.approx(2.0 * dll())
    assert dll(d=0.25) < dll()


def test_root_sum_square():
    assert root_sum_square(3.0, 4.0, 12.0) == pytest.approx(13.0)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_loop_follows_the_polynomial_of_its_order(order):
    t = 0.02 * np.arange(400)
    phase = 0.3 + sum(c * t**k for k, c in enumerate((0.0, 5.0, 40.0)[:order]))
    states = loop_states(phase, order, 10.0, 0.02)
    assert states[-1, 0] == pytest.approx(phase[-1], abs=1e-6)
    if order == 3:
        assert states[-1] == pytest.approx([phase[-1], 5.0 + 80.0 * t[-1], 80.0], rel=1e-6)
    beyond = phase + 10.0 * t**order
    error = loop_states(beyond, order, 2.0, 0.02)[-1, 0] - beyond[-1]
    wider = loop_states(beyond, order, 4.0, 0.02)[-1, 0] - beyond[-1]
    assert error < 0.0
    assert error / wider == pytest.approx(2.0**order, rel=0.35)  # lag goes as 1 / bandwidth^order


@pytest.mark.parametrize(
    ("order", "bandwidth_hz", "times_b2"), [(2, 5.0, 0.2934), (2, 10.0, 0.2934), (3, 7.0, 0.2809)]
)
def test_peak_after_a_step_of_acceleration(order, bandwidth_hz, times_b2):
    """Order 2: the number of T(4.47). Its steady error is 1/ω², its bandwidth 0.53 ω."""
    peak = acceleration_peak_cycles(13.0, order, bandwidth_hz)
    assert peak == pytest.approx(13.0 * times_b2 / bandwidth_hz**2, rel=1e-3)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("bandwidth_hz", [5.0, 10.0])
def test_response_to_acceleration_is_the_one_of_the_loop_run(order, bandwidth_hz):
    """Updated every 0.1 ms the loops of `core.loops` are those of the transfer functions."""
    interval_s, count = 1e-4, 10_000
    edges_s = interval_s * np.arange(count + 1)
    rate_hzps = 40.0
    means = np.diff(rate_hzps * edges_s**3 / 6.0) / interval_s
    errors = means - loop_states(means, order, bandwidth_hz, interval_s)[:, 0]
    middle_s = edges_s[:-1] + 0.5 * interval_s
    expected = rate_hzps * acceleration_response(middle_s, order, bandwidth_hz)
    assert np.abs(errors - expected).max() < 0.01 * expected.max()


def test_response_to_acceleration_begins_with_the_step():
    response = acceleration_response(np.array([-1.0, 0.0, 0.01]), 3, 5.0)
    assert response[:2].tolist() == [0.0, 0.0]
    assert response[2] == pytest.approx(0.5 * 0.01**2, rel=0.1)
    with pytest.raises(ValueError, match="loop order 1"):
        acceleration_response(np.zeros(1), 1, 5.0)


@pytest.mark.parametrize(("order", "bandwidth", "interval"), [(3, 7.0, 0.02), (2, 15.0, 0.01)])
def test_noise_of_a_reported_phase(order: int, bandwidth: float, interval: float) -> None:
    """Loops run on noise: the prediction spreads as T(2.20), the estimate anywhere in it less."""
    rng, loops, steps = np.random.default_rng(6), 4000, 300
    gains = np.array(loop_gains(order, bandwidth, interval))
    T = interval
    forward = np.array([[1.0, T, 0.5 * T * T], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    state = np.zeros((loops, 3))
    for _ in range(steps):
        predicted = state
        state = predicted + (rng.standard_normal(loops) - predicted[:, 0])[:, np.newaxis] * gains
        estimate, state = state, state @ forward.T
    at = rng.uniform(-0.5 * T, 0.5 * T, loops)
    told = estimate[:, 0] + estimate[:, 1] * at + 0.5 * estimate[:, 2] * at**2
    assert predicted[:, 0].std() == pytest.approx(math.sqrt(2.0 * bandwidth * T), rel=0.04)
    share = told.std() / math.sqrt(2.0 * bandwidth * T)
    assert reported_share(order, bandwidth, interval) == pytest.approx(share, rel=0.04)


def test_a_phase_updated_without_end_is_the_prediction() -> None:
    assert reported_share(3, 7.0, 0.02) == pytest.approx(0.889, abs=1e-3)
    assert reported_share(3, 7.0, 1e-4) == pytest.approx(1.0, abs=2e-3)
