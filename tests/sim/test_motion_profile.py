"""Profiles: what they pass through, what they integrate to, how smooth they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.errors import ConfigError
from deepgnss.sim.motion.profile import acceleration_profile, constant_rate, smooth_profile

POINTS = [(2.0, 0.0), (7.0, 13.0), (9.0, 13.0), (12.0, 0.0)]


@pytest.mark.parametrize("flat", [1, 2])
def test_passes_through_its_points(flat: int) -> None:
    drive = smooth_profile(POINTS, flat)
    assert drive([-5.0, 2.0, 7.0, 8.0, 12.0, 900.0], 1) == pytest.approx([0, 0, 13, 13, 0, 0])
    # means of the steps: 6.5 m/s for 5 s, 13 for 2 s, 6.5 for 3 s
    assert drive(1.0e5) == pytest.approx(6.5 * 5 + 13 * 2 + 6.5 * 3, abs=1e-12)
    assert drive(8.3, 1) == 13.0
    assert constant_rate(2.5)(-4.0e4) == pytest.approx(-1.0e5, rel=1e-15)


@pytest.mark.parametrize("flat", [1, 2])
def test_derivatives_join(flat: int) -> None:
    drive = smooth_profile(POINTS, flat)
    for second, rate in POINTS:
        for order in range(2, flat + 2):
            sides = drive([second - 1e-9, second, second + 1e-9], order)
            assert np.abs(sides).max() < 1e-6
        assert drive(second, 1) == pytest.approx(rate)
    # the order after that jumps: the blend is no flatter than it says
    assert abs(np.subtract(*drive([7.0 - 1e-9, 7.0 + 1e-9], flat + 2))) > 1.0


def test_zero_at_zero_and_rest_to_the_last_bit() -> None:
    drive = smooth_profile([(-3.0, 5.0), (1.1, 4.7), (2.3, 0.0), (5.9, 0.0), (7.0, 1.3)])
    assert drive(0.0) == pytest.approx(0.0, abs=1e-14)
    assert np.ptp(drive(np.linspace(2.3, 5.9, 50))) == 0.0
    assert not drive(np.linspace(2.3, 5.9, 50)[:-1], 1).any()


def test_acceleration_steps() -> None:
    distance = acceleration_profile([(1.0, 981.0), (3.0, -981.0), (6.0, 0.0)], 981.0, 3.0)
    assert distance([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 6.5, 7.0, 99.0], 2) == pytest.approx(
        [0.0, 0.0, 490.5, 981.0, 981.0, 0.0, -981.0, -981.0, -490.5, 0.0, 0.0]
    )
    # ramp ½, 1 s, ramps that cancel, 1 s, ramp ½: as much braking as acceleration
    assert distance([0.0, 2.0, 3.0, 4.0, 7.0], 1) == pytest.approx(
        [3.0, 3.0 + 490.5, 3.0 + 1471.5, 3.0 + 1962.0, 3.0]
    )
    assert distance(0.0) == 0.0
    assert distance(1.0) == pytest.approx(3.0)
    assert np.abs(distance(np.linspace(-2.0, 9.0, 999), 3)).max() <= 981.0 * (1 + 1e-12)
    # the path is symmetric in time about the fastest moment, t = 4 s
    assert distance(7.0) - distance(4.0) == pytest.approx(distance(4.0) - distance(1.0))


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    st.lists(st.tuples(st.floats(0.5, 5.0), st.floats(-50.0, 50.0)), min_size=1, max_size=6),
    st.floats(250.0, 900.0),
)
def test_acceleration_is_held_between_ramps(
    steps: list[tuple[float, float]], jerk_mps3: float
) -> None:
    begins = np.cumsum([gap for gap, _ in steps])
    values = [value for _, value in steps]
    distance = acceleration_profile(list(zip(begins, values, strict=True)), jerk_mps3)
    assert distance(0.0, 1) == 0.0
    for begin, before, value in zip(begins, [0.0, *values], values, strict=False):
        ramp_s = abs(value - before) / jerk_mps3
        assert distance([begin, begin + ramp_s / 2, begin + ramp_s], 2) == pytest.approx(
            [before, (before + value) / 2, value], abs=1e-9
        )


def test_refusals() -> None:
    with pytest.raises(ConfigError, match=r"step at 1.5 s begins before .* done at 2 s") as caught:
        acceleration_profile([(1.0, 100.0), (1.5, 0.0)], 100.0)
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match="2 after 3: expected rising"):
        smooth_profile([(1.0, 0.0), (3.0, 1.0), (2.0, 1.0)])
