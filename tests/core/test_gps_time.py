"""GPST: leap seconds, weeks, calendar, and arithmetic across their borders."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.time import (
    GpsTime,
    from_calendar,
    from_utc,
    leap_seconds_at,
    resolve_week,
)


@pytest.mark.parametrize(
    ("utc", "week", "tow_s"),
    [
        (datetime(1980, 1, 6, tzinfo=UTC), 0, 0.0),
        (datetime(1999, 8, 21, 23, 59, 47, tzinfo=UTC), 1024, 0.0),  # the first roll-over
        (datetime(2012, 6, 30, 23, 59, 59, tzinfo=UTC), 1695, 14.0),
        (datetime(2012, 7, 1, tzinfo=UTC), 1695, 16.0),
        (datetime(2020, 6, 25, 12, tzinfo=UTC), 2111, 388_818.0),
        (datetime(2022, 1, 1, 12, 0, 10, tzinfo=UTC), 2190, 561_628.0),
    ],
)
def test_known_instants(utc: datetime, week: int, tow_s: float) -> None:
    assert from_utc(utc) == GpsTime(week, tow_s)
    assert from_utc(utc.replace(tzinfo=None)) == GpsTime(week, tow_s)


def test_other_time_zones_are_converted() -> None:
    zone = timezone(timedelta(hours=8))
    assert from_utc(datetime(2020, 6, 25, 20, tzinfo=zone)) == GpsTime(2111, 388_818.0)


@given(seconds=st.integers(0, 2_000_000_000), fraction_us=st.integers(0, 999_999))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_utc_and_calendar_come_back(seconds: int, fraction_us: int) -> None:
    utc = datetime(1982, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds, microseconds=fraction_us)
    time = from_utc(utc)
    assert 0.0 <= time.tow_s < SECONDS_PER_WEEK
    # GPST cannot name the second after a leap: around one, the tables may differ by that second.
    if leap_seconds_at(utc) == leap_seconds_at(utc + timedelta(seconds=20)):
        assert abs(time.utc() - utc) <= timedelta(microseconds=1)
    assert abs(from_calendar(time.calendar()).since(time)) < 2e-6


@pytest.mark.parametrize(("year", "month", "since"), [(2017, 1, 18), (2015, 7, 17), (2012, 7, 16)])
def test_utc_right_after_a_leap_second(year: int, month: int, since: int) -> None:
    """The first seconds of the new offset come back too."""
    utc = datetime(year, month, 1, 0, 0, 3, tzinfo=UTC)
    assert from_utc(utc).utc() == utc
    before = utc - timedelta(seconds=10)
    assert leap_seconds_at(before) == since - 1
    assert from_utc(before).utc() == before


@given(
    week=st.integers(0, 4000),
    tow_s=st.floats(0.0, 604_799.999),
    step_s=st.floats(-2e6, 2e6),
)
@settings(deadline=None, derandomize=True)
def test_plus_and_since_are_inverse(week: int, tow_s: float, step_s: float) -> None:
    start = GpsTime(week, tow_s)
    moved = start.plus(step_s)
    assert 0.0 <= moved.tow_s < SECONDS_PER_WEEK
    assert moved.since(start) == pytest.approx(step_s, abs=1e-9)
    assert (moved.since(start) > 0.0) == (start.since(moved) < 0.0)


@given(step_s=st.floats(-1e-6, 1e-6))
@settings(deadline=None, derandomize=True)
def test_seconds_of_week_never_reach_the_week(step_s: float) -> None:
    """A tiny step back over the week's start must not round to 604800 of the week before."""
    moved = GpsTime(2200, 0.0).plus(step_s)
    assert 0.0 <= moved.tow_s < SECONDS_PER_WEEK


def test_differences_keep_sub_nanoseconds_over_days() -> None:
    late = GpsTime(2200, 604_799.25).plus(0.75 + 1e-9)
    assert late.week == 2201
    assert late.since(GpsTime(2201, 0.0)) == pytest.approx(1e-9, abs=2e-10)


def test_broadcast_leap_seconds_go_before_the_table() -> None:
    time = GpsTime(2111, 388_818.0)
    assert time.utc() == datetime(2020, 6, 25, 12, tzinfo=UTC)
    assert time.utc(leap_seconds=19) == datetime(2020, 6, 25, 11, 59, 59, tzinfo=UTC)


@pytest.mark.parametrize(
    ("broadcast", "near", "week"),
    [
        (142, GpsTime(2190, 0.0), 2190),
        (1023, GpsTime(2048, 10.0), 2047),
        (0, GpsTime(2047, 604_000.0), 2048),
        (0, GpsTime(1020, 0.0), 1024),
        (142, None, 2190),
        (63, None, 2111),
    ],
)
def test_week_number_nearest_to_the_date(broadcast: int, near: GpsTime | None, week: int) -> None:
    assert resolve_week(broadcast, near) == week
