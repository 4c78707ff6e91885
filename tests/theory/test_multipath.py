"""Code error by one ray: closed form on a triangle, sign, reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.theory.multipath import multipath_error_chips, triangle

quick = settings(deadline=None, derandomize=True, max_examples=60)


@pytest.mark.parametrize(("spacing", "largest"), [(1.0, 0.25), (0.1, 0.025)])
def test_largest_error_of_half_the_amplitude(spacing: float, largest: float) -> None:
    """T 5.5.3: a quarter chip for D 1, a tenth of it for D 0.1; either way."""
    delays = np.arange(0.01, 1.8, 0.01)
    late = [multipath_error_chips(spacing, 0.5, delay, 0.0) for delay in delays]
    early = [multipath_error_chips(spacing, 0.5, delay, 0.5) for delay in delays]
    assert max(late) == pytest.approx(largest, abs=1e-6)
    assert min(early) == pytest.approx(-largest, abs=1e-6)
    assert min(late) > -1e-6
    assert max(early) < 1e-6


@given(
    spacing=st.floats(0.05, 1.0),
    amplitude=st.floats(0.05, 0.7),
    delay=st.floats(0.01, 1.9),
    phase=st.floats(0.0, 1.0),
)
@quick
def test_balance_lies_between_those_in_and_against_phase(
    spacing: float, amplitude: float, delay: float, phase: float
) -> None:
    """|E| = |L| where it says, never beyond α·D/2."""
    error = multipath_error_chips(spacing, amplitude, delay, phase)
    assert abs(error) <= 0.5 * amplitude * spacing + 1e-6
    ray = amplitude * np.exp(2j * np.pi * phase)
    taps = np.array([error - 0.5 * spacing, error + 0.5 * spacing])
    early, late = np.abs(triangle(taps) + ray * triangle(taps - delay))
    assert early == pytest.approx(late, abs=1e-7)


@pytest.mark.parametrize("spacing", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5])
def test_a_ray_a_chip_and_a_half_late_does_nothing(spacing: float, phase: float) -> None:
    assert multipath_error_chips(spacing, 0.5, 1.01 + 0.5 * spacing, phase) == pytest.approx(
        0.0, abs=1e-6
    )
