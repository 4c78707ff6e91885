"""Frequency discriminators on tones whose frequency and phase are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.records import ComplexArray
from deepgnss.receiver.spectral import (
    Interpolation,
    Tone,
    amplitude_ratio,
    early_minus_late_hz,
    fft_tone,
    half_bins,
    lines,
    neighbours,
    refinement_hz,
    squared_tone,
    two_stage_hz,
)

T_S, COUNT = 0.02, 16
BIN_HZ = 1.0 / (COUNT * T_S)
ENERGY: tuple[Callable[[ComplexArray, float], float], ...] = (
    early_minus_late_hz,
    refinement_hz,
    two_stage_hz,
)
INTERPOLATIONS: tuple[Interpolation, ...] = (amplitude_ratio, neighbours, half_bins)


def _tone(frequency_hz: float, phase_cycles: float = 0.0, count: int = COUNT) -> ComplexArray:
    """Sums of a carrier that stands at a phase in the middle of them all."""
    t = T_S * (np.arange(count) - 0.5 * (count - 1))
    return np.asarray(3.0 * np.exp(2j * np.pi * (frequency_hz * t + phase_cycles)))


def _with_symbols(sums: ComplexArray, seed: int = 3) -> ComplexArray:
    return np.asarray(sums * np.random.default_rng(seed).choice((-1.0, 1.0), sums.size))


# --- lines ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 16, 25])
def test_lines_are_those_of_the_definition(count: int) -> None:
    generator = np.random.default_rng(count)
    sums = generator.standard_normal(count) + 1j * generator.standard_normal(count)
    n = np.arange(count) - 0.5 * (count - 1)
    for step in (1.0, 0.5):
        wanted = [sums @ np.exp(-2j * np.pi * step * k * n / count) for k in range(-2, 3)]
        assert lines(sums, 2, step) == pytest.approx(wanted, abs=1e-12)


# --- FFT discriminators --------------------------------------------------------------------------


@given(frequency_hz=st.floats(-24.0, 24.0), phase_cycles=st.floats(-0.49, 0.49))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_frequency_and_phase_of_a_tone(frequency_hz: float, phase_cycles: float) -> None:
    seen = fft_tone(_tone(frequency_hz, phase_cycles), T_S)
    assert seen.frequency_hz == pytest.approx(frequency_hz, abs=1e-6)
    assert seen.phase_cycles == pytest.approx(phase_cycles, abs=1e-9)
    assert abs(seen.peak - frequency_hz / BIN_HZ) < 0.5 + 1e-9


@given(frequency_hz=st.floats(-12.0, 12.0), phase_cycles=st.floats(-0.24, 0.24))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_squares_see_through_symbols(frequency_hz: float, phase_cycles: float) -> None:
    seen = squared_tone(_with_symbols(_tone(frequency_hz, phase_cycles)), T_S)
    assert seen.frequency_hz == pytest.approx(frequency_hz, abs=1e-6)
    assert seen.phase_cycles == pytest.approx(phase_cycles, abs=1e-9)


@pytest.mark.parametrize("off_hz", [25.0, -25.0, 50.0])
def test_squares_take_25_hz_for_zero(off_hz: float) -> None:
    at_zero, off = squared_tone(_tone(1.2), T_S), squared_tone(_tone(1.2 + off_hz), T_S)
    assert off.frequency_hz == pytest.approx(at_zero.frequency_hz, abs=1e-9)
    seen = fft_tone(_tone(-3.0 + 0.4 * off_hz), T_S).frequency_hz
    assert seen == pytest.approx(-3.0 + 0.4 * off_hz)


@pytest.mark.parametrize("bins", [1, 3, 5, 15])
def test_few_bins_reach_half_a_bin_beyond_the_last(bins: int) -> None:
    reach_hz = 0.5 * bins * BIN_HZ
    for share in (-0.98, -0.5, 0.0, 0.3, 0.98):
        wanted = share * reach_hz
        assert fft_tone(_tone(wanted), T_S, bins).frequency_hz == pytest.approx(wanted, abs=1e-6)
        seen = squared_tone(_with_symbols(_tone(0.5 * wanted)), T_S, bins)
        assert seen.frequency_hz == pytest.approx(0.5 * wanted, abs=1e-6)
    far = fft_tone(_tone(reach_hz + 1.5 * BIN_HZ), T_S, bins)
    assert abs(far.frequency_hz) < reach_hz + 0.51 * BIN_HZ


@pytest.mark.parametrize("interpolate", INTERPOLATIONS)
def test_interpolation_is_odd_and_right_on_and_between_the_bins(
    interpolate: Interpolation,
) -> None:
    for offset in (0.1, 0.3, 0.49):
        above = interpolate(_tone(offset * BIN_HZ))
        assert interpolate(_tone(-offset * BIN_HZ)) == pytest.approx(-above)
        # T(3.13) takes sinc for the kernel of sixteen sums.
        assert above == pytest.approx(offset, abs=0.01 if interpolate is amplitude_ratio else 1e-6)
    assert interpolate(_tone(0.0)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("offset", [0.0, 0.2, 0.5])
def test_default_interpolation_is_the_best(offset: float) -> None:
    """Root mean square error against the Cramér–Rao bound, 26 dB-Hz."""
    generator = np.random.default_rng(5)
    snr = 10.0**2.6 * T_S
    noise = generator.standard_normal((2, 400, COUNT)) / np.sqrt(2.0 * snr) * 3.0
    windows = _tone(offset * BIN_HZ) + noise[0] + 1j * noise[1]
    bound_hz = np.sqrt(6.0 / (snr * COUNT * (COUNT**2 - 1))) / (2.0 * np.pi * T_S)
    spread = {}
    for interpolate in INTERPOLATIONS:
        seen = [fft_tone(w, T_S, 3, interpolate).frequency_hz for w in windows]
        errors = np.array(seen) - offset * BIN_HZ
        spread[interpolate] = float(np.sqrt(np.mean(errors**2))) / bound_hz
    assert 0.9 < spread[half_bins] < 1.2
    assert spread[neighbours] > 1.2
    if offset < 0.5:  # near a bin the sign of T(3.13) is noise
        assert spread[amplitude_ratio] > 2.0


# --- energy discriminators -----------------------------------------------------------------------


@pytest.mark.parametrize("discriminate", ENERGY)
def test_energy_discriminators_are_odd_with_unit_slope(
    discriminate: Callable[[ComplexArray, float], float],
) -> None:
    small = 0.02 * BIN_HZ
    assert discriminate(_tone(small, 0.2), T_S) == pytest.approx(small, rel=0.01)
    assert discriminate(_tone(-small, -0.4), T_S) == pytest.approx(-small, rel=0.01)
    assert discriminate(_tone(0.0), T_S) == pytest.approx(0.0, abs=1e-12)


def test_energy_discriminators_away_from_zero() -> None:
    third, half = BIN_HZ / 3.0, 0.5 * BIN_HZ
    assert two_stage_hz(_tone(half), T_S) == pytest.approx(half, rel=1e-9)
    assert two_stage_hz(_tone(half), T_S, 0.25) == pytest.approx(half, rel=1e-9)
    assert refinement_hz(_tone(0.95 * third), T_S) == pytest.approx(0.95 * third, rel=0.01)
    assert early_minus_late_hz(_tone(0.25 * BIN_HZ), T_S) == pytest.approx(0.25 * BIN_HZ, rel=0.1)
    many = 200  # sums: the kernel is a sinc, and the refinement exact
    narrow_hz = 0.2 / (many * T_S)
    assert refinement_hz(_tone(narrow_hz, 0.1, many), T_S) == pytest.approx(narrow_hz, rel=1e-4)


# --- silence -------------------------------------------------------------------------------------


def test_nothing_in_nothing_out() -> None:
    nothing = np.zeros(COUNT, dtype=np.complex128)
    assert fft_tone(nothing, T_S) == fft_tone(nothing, T_S, 3) == Tone(0.0, 0.0, 0)
    assert squared_tone(nothing, T_S, 3) == Tone(0.0, 0.0, 0)
    assert [discriminate(nothing, T_S) for discriminate in ENERGY] == [0.0, 0.0, 0.0]
