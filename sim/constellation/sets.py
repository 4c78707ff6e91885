"""What the sets of all systems share: rounding to the message, UTC, sets in force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace

from deepgnss.core.records import Ephemeris, UtcParameters
from deepgnss.core.time import GpsTime, leap_seconds_at


def rounded(ephemeris: Ephemeris, scales: Mapping[str, float]) -> Ephemeris:
    """Every element rounded to its last bit in the message: what is broadcast is the truth."""
    real = [f.name for f in fields(ephemeris) if f.type == "float" and f.name in scales]
    values = {n: round(getattr(ephemeris, n) / scales[n]) * scales[n] for n in real}
    return replace(ephemeris, **values)


def utc_at(start: GpsTime) -> UtcParameters:
    """UTC parameters of a constellation's start, no new leap second in sight."""
    leap_s = leap_seconds_at(start.utc())
    return UtcParameters(
        a0_s=2.0**-30,
        a1_sps=-3 * 2.0**-50,
        reference=GpsTime(start.week, 0.0).plus(round(start.tow_s / 4096.0) * 4096.0),
        leap_s=leap_s,
        leap_future_s=leap_s,
        leap_week=start.week,
        leap_day=7,
    )
