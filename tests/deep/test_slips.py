"""Slips between two antennas: signs, whose they are, what is left alone, what is not believed."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import Judgement, Limits, Phases, State, judge, shares

L1, L2 = 0.1902936728, 0.2442102134
_NOISE_M = 0.001
LIMITS = Limits(noise_m=0.004, growth=0.0026)


def phases(
    epochs: int = 40, satellites: int = 8, bands: int = 2, seed: int = 1, turn_rad: float = 0.0
) -> Phases:
    """Clocks that jump by metres, phases of any size, and an attitude error that walks."""
    rng = np.random.default_rng(seed)
    count = satellites * bands
    satellite = np.repeat(np.arange(satellites), bands)
    wavelength_m = np.tile([L1, L2][:bands], satellites)
    sights = rng.standard_normal((satellites, 3))
    sights[:, 2] = np.abs(sights[:, 2]) + 0.3
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    arm = np.cross(sights, np.array([2.5, 0.3, 0.1]))[satellite]
    clock_m = rng.normal(0.0, 50.0, (epochs, 1))
    walk = np.cumsum(turn_rad * rng.standard_normal((epochs, 3)), axis=0)
    value_m = clock_m + rng.integers(-1000, 1000, count) * wavelength_m + walk @ arm.T
    value_m += _NOISE_M * rng.standard_normal((epochs, count))
    none = np.zeros((epochs, count), np.bool_)
    height = np.tile(sights[satellite, 2], (epochs, 1))
    return Phases(
        np.arange(float(epochs)),
        satellite,
        wavelength_m,
        value_m,
        np.tile(arm, (epochs, 1, 1)),
        none,
        none.copy(),
        height,
        np.zeros(epochs),
    )


def slipped(given: Phases, slips: FloatArray) -> Phases:
    return given._replace(value_m=given.value_m + np.cumsum(slips, axis=0) * given.wavelength_m)


def told(found: Judgement) -> set[int]:
    return {int(k) for k in np.unique(found.state)}


def test_without_slips_nothing_is_told() -> None:
    for turn_rad in (0.0, 0.002):
        found = judge(phases(turn_rad=turn_rad), LIMITS)
        assert told(found) == {State.NEW, State.CONTINUOUS}
        assert (found.state[0] == State.NEW).all() and not found.cycles.any()


@pytest.mark.parametrize("seed", range(5))
def test_slips_come_out_with_sign_and_size(seed: int) -> None:
    """Several at once, up to nearly half of the satellites, the highest one among them."""
    given, rng = phases(turn_rad=0.0015, seed=seed), np.random.default_rng(100 + seed)
    slips = np.zeros_like(given.value_m)
    for k in range(2, 40, 2):
        many = rng.permutation(slips.shape[1])[: rng.integers(1, 7)]
        slips[k, many] = rng.choice([-3, -2, -1, 1, 2, 3], many.size)
    slips[3, int(np.argmax(given.height[0]))] = 1.0
    found = judge(slipped(given, slips), LIMITS)
    np.testing.assert_array_equal(found.cycles, slips)
    assert told(found) == {State.NEW, State.CONTINUOUS, State.SLIPPED}


def test_pairs_that_leave_the_ionospheric_residual_alone_are_found() -> None:
    given = phases()
    slips = np.zeros_like(given.value_m)
    for k, pair in enumerate(((1, 1), (3, 2), (4, 3), (5, 4), (9, 7))):
        slips[3 + 4 * k, 4:6] = pair
    found = judge(slipped(given, slips), LIMITS)
    np.testing.assert_array_equal(found.cycles, slips)
    assert np.nanmax(np.abs(found.check_m)) < 8.0 * _NOISE_M * np.sqrt(8.0)


def test_check_value_tells_a_number_that_fits_one_frequency_only() -> None:
    """An error of 0.3 cycle on one frequency alone is neither attitude nor slip."""
    given = phases()
    slips = np.zeros_like(given.value_m)
    slips[7, 4] = 0.3
    found = judge(slipped(given, slips), LIMITS)
    assert found.state[7, 4] == State.UNDECIDED and found.state[7, 5] == State.UNDECIDED
    assert abs(found.check_m[7, 4]) == pytest.approx(0.3 * L1, abs=0.01)
    assert found.check_m[7, 4] == -found.check_m[7, 5]


def test_a_correction_of_the_ins_is_no_slip_of_all() -> None:
    """A turn by 5° between two epochs, which the INS says it made."""
    given = phases()
    value_m = given.value_m.copy()
    value_m[9:] += given.arm[9:] @ np.array([0.06, -0.05, 0.04])
    told_so = np.where(np.arange(40) >= 9, 0.05**2, 0.0)
    slips = np.zeros_like(value_m)
    slips[9, [2, 5, 6, 9, 12, 13]] = (2.0, -1.0, 1.0, 1.0, -3.0, 3.0)
    silent = judge(slipped(given._replace(value_m=value_m), slips), LIMITS)
    found = judge(slipped(given._replace(value_m=value_m, corrected=told_so), slips), LIMITS)
    assert (silent.state == State.UNDECIDED).any()
    np.testing.assert_array_equal(found.cycles, slips)
    assert told(found) == {State.NEW, State.CONTINUOUS, State.SLIPPED}


def test_slip_of_all_phases_by_the_clock_is_none() -> None:
    given = phases()
    value_m = given.value_m.copy()
    value_m[9:] += 299_792.458  # a millisecond
    found = judge(given._replace(value_m=value_m), LIMITS)
    assert told(found) == {State.NEW, State.CONTINUOUS}


def test_across_a_gap_and_beyond() -> None:
    """What slipped while a satellite was hidden is repaired, after too long it is new."""
    given = phases(epochs=60)
    slips = np.zeros_like(given.value_m)
    slips[8, 2:4] = (2.0, -1.0)
    given = slipped(given, slips)
    given.value_m[5:15, 2:4] = np.nan
    given.value_m[20:55, 6:8] = np.nan
    found = judge(given, LIMITS)
    np.testing.assert_array_equal(found.cycles[15, 2:4], (2.0, -1.0))
    np.testing.assert_array_equal(found.gap_s[15, 2:4], 11.0)
    assert (found.state[55, 6:8] == State.NEW).all()
    assert (found.state[5:15, 2:4] == State.ABSENT).all()


def test_all_hidden_at_once_come_back_whole() -> None:
    given = phases(epochs=30)
    given.value_m[10:14] = np.nan
    slips = np.zeros_like(given.value_m)
    slips[14, 3] = 1.0
    found = judge(slipped(given, slips), LIMITS)
    np.testing.assert_array_equal(found.cycles, slips)


def test_half_cycles_only_where_the_polarity_was_open() -> None:
    given = phases()
    slips = np.zeros_like(given.value_m)
    slips[6, 2], slips[12, 5] = 0.5, 0.5
    given.half[:6, 2] = True
    found = judge(slipped(given, slips), LIMITS)
    assert found.cycles[6, 2] == 0.5 and found.state[6, 2] == State.SLIPPED
    assert found.cycles[12, 5] == 0.0 and found.state[12, 5] == State.UNDECIDED


def test_votes_are_even_the_flag_tells() -> None:
    """Two satellites on one frequency: the difference slipped, the flag says whose."""
    for flagged in (0, 1):
        given = phases(satellites=2, bands=1)
        slips = np.zeros_like(given.value_m)
        slips[6, flagged] = 1.0
        given.lost[6, flagged] = True
        found = judge(slipped(given, slips), LIMITS)
        np.testing.assert_array_equal(found.cycles, slips)


def test_one_satellite_is_held_against_nothing() -> None:
    found = judge(phases(satellites=1), LIMITS)
    assert told(found) == {State.NEW, State.ALONE}


def test_a_phase_that_runs_away_is_not_repaired_over_and_over() -> None:
    given = phases()
    rng = np.random.default_rng(4)
    slips = np.zeros_like(given.value_m)
    slips[5:, 4] = 2500.0 + np.cumsum(rng.normal(0.0, 1.0, 35))
    found = judge(slipped(given, slips), LIMITS)
    assert (found.state[5:, 4] == State.UNDECIDED).sum() >= 32
    others = np.delete(found.state, [4, 5], axis=1)
    assert set(np.unique(others)) == {State.NEW, State.CONTINUOUS}


def test_noise_beyond_expectation_is_noticed() -> None:
    found = judge(phases(), Limits(noise_m=0.0002, growth=0.0))
    assert 3.0 < found.scale < 7.0
    assert told(found) == {State.NEW, State.CONTINUOUS}


def test_expected_sigma_holds_after_a_gap() -> None:
    """Satellites that stay tell the attitude; without them its error grows with the gap."""
    many, few = phases(epochs=30), phases(epochs=30, satellites=2)
    for given in (many, few):
        given.value_m[5:20, :2] = np.nan
    after = [judge(given, LIMITS).sigma_cycles[20, 0] for given in (many, few)]
    assert after[0] < 0.7 * after[1]
    assert after[1] > 0.1


def test_shares_of_the_antennas() -> None:
    first, second = phases(seed=1), phases(seed=2)
    one, two = np.zeros_like(first.value_m), np.zeros_like(first.value_m)
    one[5, 2], two[9, 3] = 2.0, -1.0
    one[13, 4], two[13, 4] = 1.0, 3.0
    one[20, 5], two[20, 5] = 2.0, 2.0
    first, second = slipped(first, one), slipped(second, two)
    between = first._replace(value_m=second.value_m - first.value_m)
    found = shares(*(judge(given, LIMITS) for given in (between, first, second)))
    np.testing.assert_array_equal(found.first, one)
    np.testing.assert_array_equal(found.second, two)
    assert found.known[one != 0.0].all()
