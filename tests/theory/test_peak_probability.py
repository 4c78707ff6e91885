"""Correct-peak probability against what it is known to be elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.theory.peak_probability import (
    correct_peak_probability,
    frequency_sigma_hz,
    squared_sum_snr,
    sum_snr,
)


@pytest.mark.parametrize(("snr", "sums", "searched"), [(0.3, 16, 16), (1.0, 16, 3), (0.05, 25, 5)])
def test_integral_is_that_of_orthogonal_signals(snr: float, sums: int, searched: int) -> None:
    """Non-coherent detection of one of m orthogonal signals (Proakis) has a closed form."""
    closed = sum(
        (-1) ** k * math.comb(searched - 1, k) / (k + 1) * math.exp(-k / (k + 1) * sums * snr)
        for k in range(searched)
    )
    assert correct_peak_probability(snr, sums, searched) == pytest.approx(closed, abs=1e-8)


def test_ends_of_the_curve() -> None:
    assert correct_peak_probability(0.0, 16) == pytest.approx(1.0 / 16.0, abs=1e-8)
    assert correct_peak_probability(0.0, 16, 3) == pytest.approx(1.0 / 3.0, abs=1e-8)
    assert correct_peak_probability(100.0, 16) == pytest.approx(1.0, abs=1e-8)


def test_snr_of_a_sum() -> None:
    assert sum_snr(17.0, 0.02) == pytest.approx(1.0, rel=0.01)
    generator = np.random.default_rng(2)
    noise = (generator.standard_normal(400_000) + 1j * generator.standard_normal(400_000)) / 2**0.5
    squares = (1.5 + noise) ** 2
    assert 1.5**4 / np.var(squares) == pytest.approx(squared_sum_snr(1.5**2), rel=0.02)


def test_frequency_error_is_the_bound_where_every_peak_is_right() -> None:
    """A grid of likelihoods finds the frequency of a strong tone this well and not better."""
    snr, sums, interval_s = 20.0, 16, 0.02
    generator = np.random.default_rng(3)
    t = interval_s * np.arange(sums)
    grid_hz = np.linspace(-0.5, 0.5, 401)
    noise = generator.standard_normal((2, 1500, sums)) / math.sqrt(2.0 * snr)
    powers = np.abs((1.0 + noise[0] + 1j * noise[1]) @ np.exp(-2j * np.pi * np.outer(t, grid_hz)))
    measured = np.std(grid_hz[np.argmax(powers, axis=1)])
    assert measured == pytest.approx(frequency_sigma_hz(snr, sums, interval_s), rel=0.06)


def test_frequency_error_is_the_whole_range_where_no_peak_is_right() -> None:
    range_hz = 1.0 / 0.02
    share = 1.0 - 1.0 / 16.0
    expected = range_hz * math.sqrt(share / 12.0)
    bound_free = (
        frequency_sigma_hz(1e-9, 16, 0.02) ** 2
        - 6.0 / ((2.0 * math.pi * 0.02) ** 2 * 16 * 255 * 1e-9) / 16.0
    )
    assert math.sqrt(bound_free) == pytest.approx(expected, rel=0.01)
    few = frequency_sigma_hz(2.0, 16, 0.02, 3, squared=True)
    assert few < frequency_sigma_hz(2.0, 16, 0.02, squared=True)
