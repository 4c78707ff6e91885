"""Sections `satellites` and `atmosphere`: who transmits, how strongly, and through what."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepgnss.io.config.quantity import ExistingFile, Quantity, Section, Switch, misfit

EVERY = "all"
"""Key of a schedule that holds for every satellite without one of its own."""

Seconds = Annotated[float, Quantity(0.0, 1e6, "s")]
Dbhz = Annotated[float, Quantity(0.0, 70.0, "dB-Hz")]


def _satellite(value: str) -> str:
    if not re.fullmatch(r"G(0[1-9]|[12]\d|3[0-2])|C(0[1-9]|[1-5]\d|6[0-3])", value):
        raise misfit("expected a satellite, G01 to G32 or C01 to C63")
    return value


def _satellite_or_every(value: str) -> str:
    return value if value == EVERY else _satellite(value)


SatelliteName = Annotated[str, AfterValidator(_satellite)]
ScheduleKey = Annotated[str, AfterValidator(_satellite_or_every)]


def _rising(steps: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    seconds = [second for second, _ in steps]
    if seconds[:1] != [0.0] or seconds != sorted(set(seconds)):
        raise misfit("expected [second, dB-Hz] of rising seconds that start at 0")
    return steps


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] < span[1]:
        raise misfit("expected [from, to] in seconds, from before to")
    return span


Steps = Annotated[tuple[tuple[Seconds, Dbhz], ...], Field(min_length=1), AfterValidator(_rising)]
Span = Annotated[tuple[Seconds, Seconds], AfterValidator(_in_order)]


class Cn0Config(Section):
    """C/N0 of the free line of sight by elevation: horizon + (zenith − horizon)·sin(elevation)."""

    zenith: Dbhz = 48.0
    """Straight above, dB-Hz."""
    horizon: Dbhz = 38.0
    """At elevation zero, dB-Hz."""


def _same_everywhere(value: object) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"zenith": value, "horizon": value}
    return value


class SatellitesConfig(Section):
    """Which satellites transmit, how strongly, and when they are switched off."""

    systems: Annotated[tuple[Literal["GPS", "BDS"], ...], Field(min_length=1, max_length=2)] = (
        "GPS",
    )
    """Systems, each with its signal: GPS L1 C/A, BeiDou B1I."""
    nav: ExistingFile | None = None
    """RINEX NAV file with orbits, clocks and ionosphere; omitted: a synthetic nominal
    constellation, drawn from no seed but its own."""
    mask: Annotated[float, Quantity(0.0, 90.0, "deg")] = 5.0
    """Satellites below this elevation at the start, deg, are left out."""
    limit: Annotated[int, Quantity(1, 63, "satellites", whole=True)] | None = None
    """At most so many of each system, the highest first."""
    only: Annotated[tuple[SatelliteName, ...], Field(min_length=1)] | None = None
    """Exactly these, whatever `systems`, `mask` and `limit` say."""
    cn0: Annotated[
        Cn0Config,
        BeforeValidator(_same_everywhere, json_schema_input_type=float | dict[str, Any]),
    ] = Cn0Config()
    """C/N0 by elevation, or one number for all."""
    schedule: dict[ScheduleKey, Steps] = {}  # noqa: RUF012 (frozen by the schema)
    """C/N0 over time instead: satellite or `all` to steps [second, dB-Hz] from second 0 on."""
    blocked: dict[ScheduleKey, tuple[Span, ...]] = {}  # noqa: RUF012
    """Satellite or `all` to spans [from, to] in seconds without any signal of it."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.systems)) < len(self.systems):
            raise misfit("expected every system once", "systems")
        if self.only is not None and len(set(self.only)) < len(self.only):
            raise misfit("expected every satellite once", "only")
        return self


class AtmosphereConfig(Section):
    """Delays on the way; both are those that a receiver corrects by the same models."""

    ionosphere: Switch = True
    """Klobuchar's model with the coefficients broadcast: delays the code, advances the carrier."""
    troposphere: Switch = True
    """Saastamoinen's model in the standard atmosphere."""
