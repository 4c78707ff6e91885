"""Discriminators: null, unit slope, sign, range, and indifference to amplitude."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampled_code import CHIP_HZ, sampled, signal_command, stream

from deepgnss.receiver.baseband import correlate, running_sums
from deepgnss.receiver.discriminators import (
    costas_arctan,
    costas_decision,
    costas_product,
    dot_product,
    early_late_slope,
    early_minus_late_envelope,
    early_minus_late_power,
    frequency_arctan,
    frequency_squared,
)
from deepgnss.receiver.signals import SIGNALS, code_runs, neighbour_correlation, signal_of

TURN = 2.0 * math.pi
quick = settings(deadline=None, derandomize=True, max_examples=50)
costas = pytest.mark.parametrize("phase", [costas_arctan, costas_product, costas_decision])
code_loops = pytest.mark.parametrize("kind", ["envelope", "power", "dot"])

Phase = Callable[[complex], float]


# --- carrier phase -------------------------------------------------------------------------------


@costas
def test_phase_null_slope_and_blindness_to_the_bit(phase: Phase) -> None:
    """Received ahead of local by a little: that much, positive, whatever the bit."""
    for bit in (1.0, -1.0):
        assert phase(complex(bit * 3.0)) == 0.0
        for error in (1e-4, -1e-4):
            seen = phase(bit * 7.0 * cmath.exp(1j * TURN * error))
            assert seen == pytest.approx(error, rel=1e-5)


@costas
@given(error=st.floats(-0.245, 0.245), amplitude=st.floats(1e-3, 1e6))
@quick
def test_phase_sign_over_the_whole_range(phase: Phase, error: float, amplitude: float) -> None:
    seen = phase(amplitude * cmath.exp(1j * TURN * error))
    assert seen * error >= 0.0
    assert (seen == 0.0) == (error == 0.0) or abs(error) < 1e-12
    assert phase(cmath.exp(1j * TURN * error)) == pytest.approx(seen, abs=1e-12)


@given(error=st.floats(-0.2499, 0.2499))
@quick
def test_arctangent_is_linear_to_a_quarter_cycle(error: float) -> None:
    assert costas_arctan(cmath.exp(1j * TURN * error)) == pytest.approx(error, abs=1e-12)


@given(error=st.floats(-0.2499, 0.2499))
@quick
def test_the_other_two_follow_their_sines(error: float) -> None:
    prompt = -2.0 * cmath.exp(1j * TURN * error)
    assert costas_product(prompt) == pytest.approx(math.sin(2.0 * TURN * error) / (2.0 * TURN))
    assert costas_decision(prompt) == pytest.approx(math.sin(TURN * error) / TURN)


@costas
def test_no_signal_no_error(phase: Phase) -> None:
    assert phase(0j) == 0.0


# --- carrier frequency ---------------------------------------------------------------------------


@given(error_hz=st.floats(-240.0, 240.0), seed=st.integers(0, 99))
@quick
def test_squared_frequency_bears_any_bits(error_hz: float, seed: int) -> None:
    bits = np.random.default_rng(seed).choice([-1.0, 1.0], 20)
    prompts = 5.0 * bits * np.exp(1j * TURN * (error_hz * 1e-3 * np.arange(20) + 0.3))
    assert frequency_squared(prompts, 1e-3) == pytest.approx(error_hz, abs=1e-6)


@given(error_hz=st.floats(-480.0, 480.0))
@quick
def test_four_quadrant_frequency(error_hz: float) -> None:
    product = 3.0 * cmath.exp(1j * TURN * error_hz * 1e-3)
    assert frequency_arctan(product, 1e-3) == pytest.approx(error_hz, abs=1e-6)


# --- code ----------------------------------------------------------------------------------------


def _error(kind: str, early: complex, prompt: complex, late: complex, slope: float) -> float:
    if kind == "dot":
        return dot_product(early, prompt, late, slope)
    discriminator = early_minus_late_envelope if kind == "envelope" else early_minus_late_power
    return discriminator(abs(early), abs(late), slope)


def _triangle(chips: float) -> float:
    return max(0.0, 1.0 - abs(chips))


@code_loops
@pytest.mark.parametrize("spacing_chips", [0.1, 0.25, 0.5, 1.0])
def test_code_null_slope_and_sign_on_an_ideal_triangle(kind: str, spacing_chips: float) -> None:
    """Received ahead of local (the early replica fits better): positive; one of any amplitude."""
    slope = early_late_slope(spacing_chips, 0.0 + 1e-9)
    assert slope == pytest.approx(2.0 / (2.0 - spacing_chips))
    for error in (0.0, 0.01, -0.01):
        taps = [_triangle(error - offset * spacing_chips / 2.0) for offset in (1.0, 0.0, -1.0)]
        for scale in (1.0, -2000j):
            seen = _error(kind, *(scale * tap for tap in taps), slope)
            assert seen == pytest.approx(error, rel=0.02, abs=1e-15)


@code_loops
@given(error=st.floats(-1.2, 1.2), spacing_chips=st.sampled_from([0.1, 0.25, 1.0]))
@quick
def test_code_sign_over_the_whole_range(kind: str, error: float, spacing_chips: float) -> None:
    slope = early_late_slope(spacing_chips, 0.05)
    taps = [_triangle(error - offset * spacing_chips / 2.0) for offset in (1.0, 0.0, -1.0)]
    assert _error(kind, *map(complex, taps), slope) * error >= 0.0


@code_loops
def test_no_signal_no_code_error(kind: str) -> None:
    assert _error(kind, 0j, 0j, 0j, 2.0) == 0.0


@pytest.mark.parametrize("rate_hz", [2.6e6, 4.0e6, 16.0e6])
@pytest.mark.parametrize("spacing_chips", [0.1, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("prn", [1, 7, 8])  # −1, 63, −65 of 1023 a chip off
def test_slope_and_null_on_real_correlations(
    rate_hz: float, spacing_chips: float, prn: int
) -> None:
    """The mean over random sampling phases is what a loop sees; slope as stated, no bias."""
    generator = np.random.default_rng(3)
    runs, info = code_runs("GPS_L1CA", prn), stream(rate_hz)
    taps = np.array([0.5, 0.0, -0.5]) * spacing_chips
    neighbour = neighbour_correlation("GPS_L1CA", prn)
    slope = early_late_slope(spacing_chips, CHIP_HZ / rate_hz, neighbour)
    count = int(1.1e-3 * rate_hz)
    errors_chips = np.array([-0.02, 0.0, 0.02])
    seen = np.zeros(errors_chips.size)
    trials = 24
    for trial in range(trials):
        # Stratified sampling phases of the first chip edge, all chips' edges spread from there.
        late = (trial + generator.uniform()) / trials * CHIP_HZ / rate_hz
        truth = signal_command(8, doppler_hz=0.0, code_chips=-late)
        sums = running_sums(sampled(info, prn, truth, 0, count), info.centre_hz)
        for k, error in enumerate(errors_chips):
            local = truth._replace(code_chips=truth.code_chips - error)
            early, _, late_tap = correlate(sums, local, runs, taps, 1)[0]
            seen[k] += early_minus_late_envelope(abs(early), abs(late_tap), slope) / trials
    assert seen[1] == pytest.approx(0.0, abs=0.001)
    assert (seen[2] - seen[0]) / 0.04 == pytest.approx(1.0, abs=0.03)


ALL_CODES = [(name, prn) for name, kinds in SIGNALS.items() for kind in kinds for prn in kind.prns]


@pytest.mark.parametrize(("name", "prn"), ALL_CODES)
def test_slope_of_every_code(name: str, prn: int) -> None:
    """Of (E − L)/(E + L) on the periodic code itself, sampled finely."""
    per_chip = 40
    code = np.repeat(signal_of(name, prn).primary_code(prn), per_chip)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(code)) ** 2, code.size)
    for spacing_chips in (0.1, 0.25, 0.5, 1.0):
        offset = round(0.5 * spacing_chips * per_chip)
        early, late = correlation[[offset - 1, offset + 1]]
        measured = (early - late) / (early + late) * per_chip
        stated = early_late_slope(spacing_chips, 1e-9, neighbour_correlation(name, prn))
        assert stated == pytest.approx(measured, rel=1e-9)
