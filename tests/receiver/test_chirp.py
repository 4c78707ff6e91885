"""The chirp estimator against a plain maximum-likelihood grid, its bounds, and theory's bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.records import ComplexArray
from deepgnss.receiver.chirp import find_chirp, find_squared_chirp, rate_step_hzps
from deepgnss.theory.chirp import squared_bound, tone_bound, unknown_signs_bound

COUNT, INTERVAL_S = 200, 1e-3
LARGEST = 1000.0


def _chirp(phase: float, frequency: float, rate: float, count: int = COUNT) -> ComplexArray:
    t = INTERVAL_S * (np.arange(count) - 0.5 * (count - 1))
    return np.asarray(np.exp(2j * np.pi * (phase + t * (frequency + 0.5 * rate * t))))


def _noise(generator: np.random.Generator, count: int = COUNT) -> ComplexArray:
    return np.asarray(generator.standard_normal((count, 2)) @ [1.0, 1.0j] / math.sqrt(2.0))


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.floats(-0.49, 0.49), st.floats(-400.0, 400.0), st.floats(-LARGEST, LARGEST))
def test_finds_what_is_there(phase: float, frequency: float, rate: float) -> None:
    """Without noise every chirp is found exactly, between lines and between rates."""
    found = find_chirp(_chirp(phase, frequency, rate), INTERVAL_S, LARGEST)
    assert found.rate_hzps == pytest.approx(rate, abs=0.02)
    assert found.frequency_hz == pytest.approx(frequency, abs=1e-3)
    assert math.remainder(found.phase_cycles - phase, 1.0) == pytest.approx(0.0, abs=1e-4)
    assert found.surplus > 0.0


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.floats(-200.0, 200.0), st.floats(-LARGEST, LARGEST), st.integers(0, 1000))
def test_signs_do_not_matter_to_squares(frequency: float, rate: float, seed: int) -> None:
    """Any signs: half of what the squares show."""
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), COUNT)
    found = find_squared_chirp(signs * _chirp(0.1, frequency, rate), INTERVAL_S, LARGEST)
    assert found.rate_hzps == pytest.approx(rate, abs=0.05)
    assert found.frequency_hz == pytest.approx(frequency, abs=2e-3)
    assert math.remainder(found.phase_cycles - 0.1, 0.5) == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_is_the_likelihoods_maximum(seed: int) -> None:
    """A plain grid about the truth knows no better place."""
    generator = np.random.default_rng(seed)
    frequency, rate = generator.uniform(-50.0, 50.0), generator.uniform(-800.0, 800.0)
    sums = _chirp(0.2, frequency, rate) + _noise(generator)
    found = find_chirp(sums, INTERVAL_S, LARGEST)
    best, place = 0.0, (0.0, 0.0)
    for a in rate + np.arange(-20.0, 20.0, 0.5):
        for f in frequency + np.arange(-1.0, 1.0, 0.02):
            height = abs(np.vdot(_chirp(0.0, f, a), sums))
            if height > best:
                best, place = height, (f, a)
    assert found.frequency_hz == pytest.approx(place[0], abs=0.02)
    assert found.rate_hzps == pytest.approx(place[1], abs=0.5)


@pytest.mark.parametrize("squared", [False, True])
def test_noise_is_no_chirp(squared: bool) -> None:
    """Nothing there: nothing seen."""
    generator = np.random.default_rng(7)
    find = find_squared_chirp if squared else find_chirp
    seen = [find(_noise(generator), INTERVAL_S, LARGEST).surplus for _ in range(40)]
    assert max(seen) < 0.0


def test_rates_are_tried_a_quarter_lobe_apart() -> None:
    """L: 15 Hz/s over 400 ms, whose main lobe is 60 Hz/s wide."""
    assert rate_step_hzps(0.4) == pytest.approx(15.0)


def test_bounds_are_the_published_ones() -> None:
    """L(40), and L(41) with N³; for many sums."""
    n, rate_hz, snr = 1600, 4e3, 2.5
    bound = tone_bound(snr, n, 1.0 / rate_hz)
    variance = 1.5 * rate_hz**2 / (math.pi**2 * snr * n**3)
    assert bound.frequency_hz == pytest.approx(math.sqrt(variance), rel=1e-5)
    variance = 90.0 * rate_hz**4 / (math.pi**2 * snr * float(n) ** 5)
    assert bound.rate_hzps == pytest.approx(math.sqrt(variance), rel=1e-5)


def test_bounds_are_those_of_the_information() -> None:
    """Against the inverse of the information matrix itself, few sums."""
    n, snr = 10, 4.0
    t = 0.02 * (np.arange(n) - 0.5 * (n - 1))
    gradient = 2.0 * np.pi * np.array([np.ones(n), t, 0.5 * t * t])
    information = 2.0 * snr * gradient @ gradient.T
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    bound = tone_bound(snr, n, 0.02)
    assert sigma[1:] == pytest.approx(bound[1:])
    assert 1.0 / math.sqrt(information[0, 0]) == pytest.approx(bound.phase_cycles)


@pytest.mark.parametrize("snr", [0.03, 0.3, 3.0, 30.0])
def test_squares_are_near_the_bound_of_unknown_signs(snr: float) -> None:
    """Known signs allow most, no estimate without them more than their bound."""
    known, unknown, squares = (
        bound(snr, 1600, 1e-3).frequency_hz
        for bound in (tone_bound, unknown_signs_bound, squared_bound)
    )
    assert known < unknown * (1.0 + 1e-9)
    assert unknown < squares * (1.0 + 1e-9)
    assert squares < 1.08 * unknown
