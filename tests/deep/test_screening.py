"""Outlier test: what is refused and what must not be, on a drive with an MEMS unit."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from ranging_drive import Driven, World, drive, world

from deepgnss.deep.screening import ScreenSettings

LATE, PAIR, SLOW = "G03", ("C22", "G28"), "G14"
UNSEEN = "C29"  # comes up during the outage, by its reflection alone


def _faults(name: str, t: float) -> float | None:
    if name == LATE and 16.0 <= t < 20.0:
        return 10.0
    if name in PAIR and 24.0 <= t < 28.0:
        return 14.0 if name == PAIR[0] else -11.0
    if name == SLOW:
        return 0.1 * max(t - 12.0, 0.0)  # as an orbit or the ionosphere might
    return 0.0


@lru_cache
def _faulty() -> Driven:
    return drive(world(32.0), _faults)


def _outage(name: str, t: float) -> float | None:
    if 14.0 <= t < 44.0 or (name == UNSEEN and t < 44.0):
        return None
    return 25.0 if name == UNSEEN else 0.0


@lru_cache
def _after_outage() -> Driven:
    return drive(world(50.0), _outage)


# --- while the navigation is good ----------------------------------------------------------------


def test_a_range_ten_metres_too_long_is_refused_at_once_and_taken_back() -> None:
    driven = _faulty()
    assert driven.first_refused_s(LATE, 16.0) <= 17.0
    assert driven.ever_refused(17.0, 19.9) == {LATE}
    assert LATE not in driven.ever_refused(20.5)


def test_two_of_ten_pulling_opposite_ways_are_both_found() -> None:
    driven = _faulty()
    assert driven.ever_refused(24.5, 27.9) == set(PAIR)
    assert not driven.ever_refused(28.5)


def test_the_sign_of_an_error_is_told() -> None:
    driven = _faulty()
    told = {flag.satellite: flag.reason for flag in driven.flags if flag.refused}
    assert told[LATE].startswith("range +")
    assert told[PAIR[1]].startswith("range -")


def test_stretches_begin_and_end_once() -> None:
    flags = _faulty().flags
    for name in (LATE, *PAIR):
        assert [flag.refused for flag in flags if flag.satellite == name] == [True, False]
    assert {flag.satellite for flag in flags} == {LATE, *PAIR}


def test_what_grows_slowly_is_followed() -> None:
    """0.1 m/s lags by 0.1/α = 2 m; the 100 m between the systems' clocks never matter."""
    assert SLOW not in _faulty().ever_refused()


@pytest.mark.parametrize(("alpha_ps", "refused"), [(0.2, False), (0.01, True)])
def test_alpha_counts_in_seconds(alpha_ps: float, refused: bool) -> None:
    """0.5 m/s for 18 s: the lag at 0.2/s is some 2.5 m, at 0.01/s all of the 9 m."""
    driven = drive(
        world(30.0),
        lambda name, t: 0.5 * max(t - 12.0, 0.0) if name == SLOW else 0.0,
        ScreenSettings(alpha_ps, 6.0),
    )
    assert driven.ever_refused() == ({SLOW} if refused else set())


# --- after an outage -----------------------------------------------------------------------------


def test_a_navigation_that_drifted_blames_no_sound_range() -> None:
    """After 30 s alone it is off by more than the threshold; the ranges agree that it is."""
    driven = _after_outage()
    drifted_m = np.linalg.norm(driven.error_m(43.8))
    assert drifted_m > 6.0
    assert driven.ever_refused() <= {UNSEEN}


def test_a_reflection_never_seen_before_is_held_against_the_others() -> None:
    driven = _after_outage()
    assert driven.first_refused_s(UNSEEN, 44.0) <= 45.0
    assert UNSEEN in driven.refused[-1]


def test_without_navigation_nothing_is_refused() -> None:
    """Before the alignment there is nothing to hold ranges against."""
    driven = _faulty()
    aligned_s = next(
        t
        for t, error in zip(driven.time_s, driven.error_n_m, strict=True)
        if np.isfinite(error).all()
    )
    assert 1.0 < aligned_s < 14.0
    assert not driven.ever_refused(0.0, aligned_s)


# --- where most are reflections ------------------------------------------------------------------

IN_SIGHT = ("G03", "G14", "C22")


def _canyon(name: str, t: float) -> float | None:
    """A code loop of 0.1 Hz leaves a direct signal for its reflection as slowly as that."""
    return 0.0 if name in IN_SIGHT else 12.0 * -math.expm1(-max(t - 20.0, 0.0) / 4.0)


def test_a_known_drift_tells_the_three_in_sight_from_seven_that_creep_away() -> None:
    """Without it, what most ranges share passes for the clock's."""
    given = world(30.0)
    told, alone = (drive(given, _canyon, drift_sigma_mps=s) for s in (0.02, None))
    assert told.ever_refused(24.0) == set(given.names) - set(IN_SIGHT)
    assert not told.ever_refused() & set(IN_SIGHT)
    assert alone.ever_refused() & set(IN_SIGHT)


# --- tight coupling ------------------------------------------------------------------------------


def _two_left(name: str, t: float) -> float | None:
    return 0.0 if t < 18.0 or name in ("G14", "C22") else None


def test_two_satellites_bound_the_drift() -> None:
    """Tight coupling takes them, loose coupling has no position to take."""
    tight, alone = (drive(world(44.0, coupling), _two_left) for coupling in ("tight", "loose"))
    off_m = [float(np.linalg.norm(driven.error_n_m[-1])) for driven in (tight, alone)]
    assert off_m[0] < 0.6 * off_m[1]
    assert np.linalg.norm(tight.sigma_n_m[-1]) < 0.8 * np.linalg.norm(alone.sigma_n_m[-1])
    assert (np.abs(tight.error_n_m[-1]) < 4.0 * tight.sigma_n_m[-1]).all()


def test_tight_coupling_finds_place_clock_and_the_systems_difference() -> None:
    """Any sign, satellite or frame wrong, and it drifts off within seconds."""
    given: World = world(30.0, "tight")
    driven = drive(given)
    assert driven.events[-1] == "started"
    errors_m = np.array(driven.error_n_m[-50:])
    assert np.abs(errors_m[:, :2]).max() < 0.5
    assert np.abs(errors_m[:, 2]).max() < 1.5
    assert not driven.ever_refused()


def _kicked(t: float) -> tuple[float, float]:
    """Tags run 7 m/s off for half a second, by a position of four satellites."""
    return -7.0 * min(max(t - 20.0, 0.0), 0.5), -7.0 * (20.0 < t <= 20.5)


def test_tight_coupling_does_not_mind_how_tags_are_steered() -> None:
    """What bends them is known: the clock of the filter is the counter's."""
    given = world(30.0, "tight", 0.1)
    smooth, bent = drive(given), drive(given, bend=_kicked)
    assert bent.events == smooth.events
    np.testing.assert_allclose(bent.error_n_m[-100:], smooth.error_n_m[-100:], atol=1e-3)
    pairs = zip(bent.innovations, smooth.innovations, strict=True)
    assert max(abs(one.nis - other.nis) for one, other in pairs) < 0.1
