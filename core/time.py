"""GPS time. BDT = GPST − 14 s; UTC enters and leaves at file borders only."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from deepgnss.core.constants import SECONDS_PER_WEEK

_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)

# Dates (UTC) from which GPST − UTC holds the given whole seconds (IERS Bulletin C).
_LEAP_SECONDS = (
    (datetime(2017, 1, 1, tzinfo=UTC), 18),
    (datetime(2015, 7, 1, tzinfo=UTC), 17),
    (datetime(2012, 7, 1, tzinfo=UTC), 16),
    (datetime(2009, 1, 1, tzinfo=UTC), 15),
    (datetime(2006, 1, 1, tzinfo=UTC), 14),
    (datetime(1999, 1, 1, tzinfo=UTC), 13),
    (datetime(1997, 7, 1, tzinfo=UTC), 12),
    (datetime(1996, 1, 1, tzinfo=UTC), 11),
    (datetime(1994, 7, 1, tzinfo=UTC), 10),
    (datetime(1993, 7, 1, tzinfo=UTC), 9),
    (datetime(1992, 7, 1, tzinfo=UTC), 8),
    (datetime(1991, 1, 1, tzinfo=UTC), 7),
    (datetime(1990, 1, 1, tzinfo=UTC), 6),
    (datetime(1988, 1, 1, tzinfo=UTC), 5),
    (datetime(1985, 7, 1, tzinfo=UTC), 4),
    (datetime(1983, 7, 1, tzinfo=UTC), 3),
    (datetime(1982, 7, 1, tzinfo=UTC), 2),
    (datetime(1981, 7, 1, tzinfo=UTC), 1),
)


class GpsTime(NamedTuple):
    """A GPST instant: full week number (no rollover) and seconds of week in [0, 604800)."""

    week: int
    tow_s: float

    def plus(self, seconds: float) -> GpsTime:
        """Return the instant `seconds` later."""
        total_s = self.tow_s + seconds
        weeks = math.floor(total_s / SECONDS_PER_WEEK)
        tow_s = total_s - weeks * SECONDS_PER_WEEK
        if tow_s == SECONDS_PER_WEEK:  # rounded up from just before the week's start
            weeks, tow_s = weeks + 1, 0.0
        return GpsTime(self.week + weeks, tow_s)

    def since(self, other: GpsTime) -> float:
        """Seconds from `other` to this instant."""
        return (self.week - other.week) * SECONDS_PER_WEEK + (self.tow_s - other.tow_s)

    def utc(self, leap_seconds: int | None = None) -> datetime:
        """UTC of this instant; leap seconds from the table unless given (broadcast UTC)."""
        gpst = _GPS_EPOCH + timedelta(weeks=self.week, seconds=self.tow_s)
        if leap_seconds is None:  # the table is by UTC, which lags: look twice near a new leap
            latest = timedelta(seconds=leap_seconds_at(gpst))
            leap_seconds = leap_seconds_at(gpst - latest)
        return gpst - timedelta(seconds=leap_seconds)

    def calendar(self) -> datetime:
        """Calendar date and time counted in GPST (naive: no time zone, no leap seconds)."""
        return (_GPS_EPOCH + timedelta(weeks=self.week, seconds=self.tow_s)).replace(tzinfo=None)


def leap_seconds_at(instant: datetime) -> int:
    """GPST − UTC in whole seconds at an aware instant."""
    for since, seconds in _LEAP_SECONDS:
        if instant >= since:
            return seconds
    return 0


def from_utc(instant: datetime) -> GpsTime:
    """GPST of a UTC instant (a naive one is taken as UTC)."""
    aware = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
    return _from_elapsed(aware - _GPS_EPOCH, leap_seconds_at(aware))


def from_calendar(instant: datetime) -> GpsTime:
    """GPST of a calendar date already counted in GPST (RINEX files)."""
    return _from_elapsed(instant.replace(tzinfo=UTC) - _GPS_EPOCH, 0)


def _from_elapsed(elapsed: timedelta, extra_s: int) -> GpsTime:
    weeks, rest = divmod(elapsed, timedelta(weeks=1))
    tow_s = rest.days * 86_400 + rest.seconds + rest.microseconds * 1e-6
    return GpsTime(weeks, 0.0).plus(tow_s + extra_s)


def resolve_week(week_mod_1024: int, near: GpsTime | None) -> int:
    """Full week of a broadcast 10-bit week number, nearest to `near` (default: 2019–2038)."""
    reference = near.week if near else 2048 + 512
    return week_mod_1024 + 1024 * round((reference - week_mod_1024) / 1024)
