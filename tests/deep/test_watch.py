"""The watch on the navigation: when trust begins and ends, and what a log is blamed for."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.earth import gravity_mps2
from deepgnss.core.frames import ecef
from deepgnss.core.records import ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.deep.guard import Guard, Unit
from deepgnss.deep.time_offset import CarrierLoop, StretchFit
from deepgnss.deep.watch import (
    PATIENCE_S,
    Turn,
    Watch,
    bias_finding,
    travel_finding,
    turn_on_finding,
)
from deepgnss.ins import GnssFix
from deepgnss.ins.turn_on import TurnOn, TurnOnBias
from deepgnss.ins.updates import Innovation
from deepgnss.io.config.imu_grade import imu_grade

START = GpsTime(2300, 604_790.0)  # the week ends on the way
SURE_MPS = 0.05
STIM300 = imu_grade("STIM300")
ZERO = np.zeros(3)


def _innovations(time_s: float, nis: float) -> list[Innovation]:
    """Those of a fix: the position's is small, as its σ are generous."""
    time = START.plus(time_s)
    return [
        Innovation(time, "position", ZERO, 0.02, True),
        Innovation(time, "velocity", ZERO, nis, nis < 16.3),
        Innovation(time, "nonholonomic", np.zeros(2), 90.0, False),
    ]


def _run(
    watch: Watch,
    from_s: float,
    until_s: float,
    nis: float,
    step_s: float = 0.1,
    stands_s: float = 0.0,
) -> list[Turn]:
    turns = []
    for time_s in np.arange(from_s, until_s, step_s):
        turns += watch.take(_innovations(float(time_s), nis), SURE_MPS, stands_s)
    return turns


def test_trust_is_earned_lost_and_earned_again_with_growing_patience() -> None:
    watch = Watch()
    (first,) = _run(watch, 0.0, 10.0, 2.5)
    assert first.trusted
    assert first.time.since(START) == pytest.approx(PATIENCE_S, abs=0.11)
    for turn in range(1, 4):
        from_s = 300.0 * turn
        (lost,) = _run(watch, from_s, from_s + 5.0, 60.0)
        assert not lost.trusted
        assert "times what the navigation expects" in lost.reason
        assert lost.time.since(START) - from_s < 1.0
        (again,) = _run(watch, from_s + 5.0, from_s + 290.0, 2.5)
        assert again.trusted
        assert again.time.since(lost.time) > PATIENCE_S * 3.0**turn
        assert watch.distrusts == turn


def test_a_doppler_that_stands_for_half_a_second_is_one_measurement() -> None:
    """Three wild windows in a row are not a wrong log; more of them are."""
    ends = {}
    for stands_s in (0.0, 0.5):
        watch = Watch()
        _run(watch, 0.0, 20.0, 2.5, stands_s=stands_s)
        assert watch.trusted
        turns = _run(watch, 20.0, 40.0, 60.0, stands_s=stands_s)
        ends[stands_s] = next(turn.time.since(START) for turn in turns if not turn.trusted) - 20.0
    assert ends[0.0] < 1.2
    assert 1.5 < ends[0.5] < 5.0


def test_a_log_that_never_fits_is_never_trusted() -> None:
    assert _run(Watch(), 0.0, 120.0, 200.0) == []


def test_wild_fixes_cost_no_trust() -> None:
    """After a tunnel velocities may be wild, one here and there or a few on end."""
    watch = Watch()
    _run(watch, 0.0, 10.0, 2.0)
    assert _run(watch, 10.0, 10.4, 500.0) == []
    for k in range(110, 300):
        nis = 300.0 if k % 10 == 0 else 1.0
        assert watch.take(_innovations(0.1 * k, nis), SURE_MPS) == []
    assert watch.trusted


def test_little_by_little_counts_too() -> None:
    """Twice the σ it should have, for a minute; fixes once a second."""
    watch = Watch()
    _run(watch, 0.0, 10.0, 2.0, 1.0)
    assert watch.trusted
    (lost,) = _run(watch, 10.0, 90.0, 3.0 * 2.2, 1.0)
    assert not lost.trusted
    assert 20.0 < lost.time.since(START) < 75.0


def test_a_vague_velocity_is_no_aid() -> None:
    watch = Watch()
    for k in range(100):
        assert watch.take(_innovations(0.1 * k, 2.0), 0.5) == []
    (turn,) = watch.take(_innovations(10.0, 2.0), SURE_MPS)
    assert turn.trusted


def test_a_new_start_is_trusted_anew() -> None:
    watch = Watch()
    _run(watch, 0.0, 10.0, 2.0)
    watch.restart(contradicted=False)
    assert not watch.trusted
    assert watch.patience_s == PATIENCE_S
    _run(watch, 10.0, 15.0, 2.0)
    watch.restart(contradicted=True)
    assert watch.patience_s == 3.0 * PATIENCE_S


def test_a_navigation_that_failed_before_it_was_trusted_counts_too() -> None:
    """And one that was ended by the watch counts once, when it stops as well."""
    watch = Watch()
    for failed in range(1, 3):
        assert _run(watch, 100.0 * failed, 100.0 * failed + 5.0, 200.0) == []
        watch.restart(contradicted=True)
        assert watch.distrusts == failed
    (gained,) = _run(watch, 300.0, 330.0, 2.0)
    assert gained.time.since(START) > 300.0 + 9.0 * PATIENCE_S - 0.11
    (lost,) = _run(watch, 330.0, 335.0, 60.0)
    assert not lost.trusted
    watch.restart(contradicted=True)
    assert watch.distrusts == 3


def test_most_of_the_ranges_decide() -> None:
    """Tight coupling: one reflected range is not the log's fault, half of them are."""
    watch = Watch()
    for k in range(300):
        found = [
            Innovation(START.plus(0.1 * k), "pseudorange", np.zeros(1), nis, nis < 10.0)
            for nis in (0.5, 1.0, 0.8, 400.0, 1.1)
        ]
        turns = watch.take(found, SURE_MPS)
        assert all(turn.trusted for turn in turns)
    assert watch.trusted


# --- what is wrong -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("forward_b", "yaw_deg", "expected"),
    [
        ((1.0, 0.05, 0.0), 0.0, ""),
        ((0.0, 1.0, 0.0), 0.0, "right"),
        ((0.0, -1.0, 0.1), 0.0, "left"),
        ((0.1, 0.0, 1.0), 0.0, "down"),
        ((0.0, -1.0, 0.0), 90.0, ""),  # mounted with its x axis to the right
        ((-1.0, 0.0, 0.0), 0.0, ""),  # reversing
        ((0.0, 0.0, 0.0), 0.0, ""),  # too slow to tell
    ],
)
def test_direction_of_travel_tells_axes(
    forward_b: tuple[float, ...], yaw_deg: float, expected: str
) -> None:
    found = travel_finding([np.array(forward_b)] * 3, np.radians(yaw_deg))
    assert bool(found) is bool(expected)
    assert expected in found


def test_biases_tell_the_grade() -> None:
    """Ten times those of its grade; the drift of a long run is allowed for."""
    grade = STIM300
    tenfold = np.array([0.0, 10.0 * grade.gyro_bias_radps, 0.0])
    assert "10 times" in bias_finding(tenfold, ZERO, grade, 60.0)
    assert "gyros" in bias_finding(tenfold, ZERO, grade, 60.0)
    assert bias_finding(0.3 * tenfold, ZERO, grade, 60.0) == ""
    assert bias_finding(tenfold, ZERO, grade, 20.0) == ""  # it may be the alignment's
    force = np.array([10.0 * grade.accel_bias_mps2, 0.0, 0.0])
    assert "accelerometers" in bias_finding(ZERO, force, grade, 60.0)
    wandering = grade._replace(gyro_drift_radps2_rthz=grade.gyro_bias_radps)
    assert bias_finding(tenfold, ZERO, wandering, 600.0) == ""


def test_biases_at_the_start_tell_the_grade() -> None:
    """In multiples of what is stated, where they are beyond all that the grade allows."""
    grade = imu_grade("MTi-G")
    told = TurnOnBias(10.0 * grade.accel_bias_mps2, 0.014)
    within = TurnOnBias(10.0 * grade.gyro_bias_radps, 9.0 * grade.gyro_bias_radps)
    found = turn_on_finding(TurnOn(within, told), grade)
    assert found == (
        "biases at its start are 10 times those of its grade in the accelerometers: imu.grade?"
    )
    assert turn_on_finding(TurnOn(within, told._replace(sigma=0.03)), grade) == ""


@pytest.mark.parametrize("times", [0.0, 10.0])
def test_a_log_that_begins_with_biases_is_said(times: float) -> None:
    """At the first fix that can tell, of a vehicle that has been at rest."""
    dt_s, place_e_m = np.full(1000, 0.01), ecef(0.5, 2.0, 30.0)
    felt = -float(gravity_mps2(0.5, 30.0)) + times * STIM300.accel_bias_mps2
    block = ImuBlock(
        START, np.cumsum(dt_s), dt_s, np.zeros((1000, 3)), np.outer(dt_s, [0.0, 0.0, felt])
    )
    guard = Guard(Unit(STIM300, ZERO, 0.0, 0.0), CarrierLoop(3, 7.0, 0.02))
    for at_s, v_mps, sigma_mps in ((1.0, 0.0, 0.01), (4.0, 9.0, 5.0), (5.0, 0.0, 0.01)):
        v_n = np.array([v_mps, 0.0, 0.0])
        fix = GnssFix(START.plus(at_s), place_e_m, np.eye(3), v_n, sigma_mps**2 * np.eye(3))
        assert guard.warnings() == ()
        guard._begin(block, fix)
    assert len(guard.warnings()) == (times > 0.0)
    assert all("10 times" in line for line in guard.warnings())


@pytest.mark.parametrize("late_s", [0.1, -0.1])
def test_a_late_log_is_said_with_the_setting_that_mends_it(late_s: float) -> None:
    """Late by 0.1 s on top of a setting of 0.02 s: −0.08 s it must be."""
    guard = Guard(Unit(STIM300, ZERO, 0.0, 0.02), CarrierLoop(3, 7.0, 0.02))
    fits = [StretchFit(10.0 * k, late_s, 0.003, 0.006, 1.0, ZERO, ZERO, ZERO) for k in range(4)]
    guard._offsets.fits.extend(fits)
    (line,) = guard.warnings()
    assert f"0.100 s {'late' if late_s > 0.0 else 'early'}" in line
    assert f"imu.time_offset: {0.02 - late_s:.3f}" in line
    assert guard.correction_s() is None  # nobody asked
    assert guard.summary()["late_s"] == pytest.approx(late_s)


def test_auto_takes_it_off_and_keeps_the_account() -> None:
    guard = Guard(Unit(STIM300, ZERO, 0.0, None), CarrierLoop(3, 7.0, 0.02))
    fits = [StretchFit(10.0 * k, 0.1, 0.003, 0.006, 1.0, ZERO, ZERO, ZERO) for k in range(4)]
    guard._offsets.fits.extend(fits)
    moved_s = guard.correction_s()
    assert moved_s == pytest.approx(-0.1)
    assert moved_s is not None
    guard.corrected(moved_s)
    assert guard.correction_s() is None
    assert guard.offset.late_s == pytest.approx(0.1)
    assert guard.summary()["taken_off_s"] == pytest.approx(0.1)
