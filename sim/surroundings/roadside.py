"""Sections on what stands along a road; all positions in m along it, heights above its line."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from deepgnss.core.errors import ConfigError
from deepgnss.io.config.quantity import Quantity, Section, misfit
from deepgnss.sim.motion.road import Road
from deepgnss.sim.surroundings.foliage import Trees, crowns
from deepgnss.sim.surroundings.panels import FOOT_M, Stretch, joined, slab, stretch, tube, wall
from deepgnss.sim.surroundings.scene import Obstacle

Along = Annotated[float, Quantity(0.0, 1e6, "m")]
Length = Annotated[float, Quantity(0.0, 1e5, "m", above=True)]
Height = Annotated[float, Quantity(0.0, 500.0, "m", above=True)]
Aside = Annotated[float, Quantity(0.0, 1000.0, "m")]
Factor = Annotated[float, Quantity(0.0, 1.0, "")]
Decibels = Annotated[float, Quantity(0.0, 100.0, "dB")]
RayCount = Annotated[int, Quantity(1, 8, "rays", whole=True)]
Side = Literal["left", "right"]

_SIGN = {"left": -1.0, "right": 1.0}


class Site(NamedTuple):
    """What obstacles are placed in."""

    road: Road
    seed: int
    antenna_height_m: float  # of the highest antenna above the road's line


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] < span[1]:
        raise misfit("expected [from, to] in m along the road, from before to")
    return span


Gap = Annotated[tuple[Along, Along], AfterValidator(_in_order)]


class _Stretched(Section):
    """An obstacle along a stretch of road."""

    start: Along = Field(alias="from")
    """m along the road."""
    end: Along = Field(alias="to")
    """m along the road."""

    @model_validator(mode="after")
    def _runs_forward(self) -> Self:
        if not self.start < self.end:
            raise misfit(f"expected more than `from`, {self.start:g} m", "to")
        return self

    def reach(self) -> tuple[float, float]:
        """Beginning and end along the road, m."""
        return self.start, self.end


def _above_antenna(height_m: float, site: Site) -> float:
    if height_m <= site.antenna_height_m:
        raise ConfigError(
            f"height: {height_m:g} m is not above the antenna, {site.antenna_height_m:g} m"
        )
    return height_m


class TunnelConfig(_Stretched):
    """A tube around the road, open at its ends."""

    width: Length = 12.0
    """m, the road in its middle."""
    height: Height = 6.0
    """Of the ceiling above the trajectory, m."""

    def build(self, name: str, site: Site) -> list[Obstacle]:
        """Return its walls and ceiling."""
        half = self.width / 2.0
        lines = stretch(site.road, self.start, self.end, -half, half)
        return [Obstacle(name, tube(lines, _above_antenna(self.height, site)))]


class FootbridgeConfig(Section):
    """A deck straight across the road."""

    at: Along
    """Its middle, m along the road."""
    width: Length = 4.0
    """Of the deck, along the road, m."""
    height: Height = 6.0
    """Of its underside above the trajectory, m."""
    thickness: Length = 0.6
    """Of the deck with its railing, m."""
    span: Length = 40.0
    """Length across the road, which passes below its middle, m."""

    def reach(self) -> tuple[float, float]:
        """Beginning and end along the road, m."""
        return self.at - self.width / 2.0, self.at + self.width / 2.0

    def build(self, name: str, site: Site) -> list[Obstacle]:
        """Return the deck."""
        middle = site.road.centreline(np.array([self.at]))
        heading = float(middle.heading_rad[0])
        ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
        right = np.array([-np.sin(heading), np.cos(heading), 0.0])
        ends = middle.r_n_m + np.outer([-self.width / 2.0, self.width / 2.0], ahead)
        lines = Stretch(*(ends + side * self.span / 2.0 * right for side in (-1.0, 1.0)))
        return [Obstacle(name, slab(lines, _above_antenna(self.height, site), self.thickness))]


class PillarsConfig(Section):
    """A row of square pillars under the middle of a deck."""

    spacing: Length = 30.0
    """From pillar to pillar, m."""
    width: Length = 1.5
    """Of a side, m."""


class ViaductConfig(_Stretched):
    """An upper road on a deck above, or beside, this one."""

    height: Height = 7.0
    """Of its underside above the trajectory, m."""
    thickness: Length = 1.5
    """Of the deck, m."""
    width: Length = 12.0
    """Of the deck, m."""
    offset: Annotated[float, Quantity(-100.0, 100.0, "m")] = 0.0
    """Of its middle from the trajectory, to the right, m."""
    pillars: PillarsConfig | None = None
    """Below its middle; omitted: none."""

    def build(self, name: str, site: Site) -> list[Obstacle]:
        """Return the deck and its pillars."""
        height, half = _above_antenna(self.height, site), self.width / 2.0
        lines = stretch(site.road, self.start, self.end, self.offset - half, self.offset + half)
        parts = [slab(lines, height, self.thickness)]
        if self.pillars:
            side = self.pillars.width / 2.0
            if abs(self.offset) <= side:
                raise ConfigError(
                    f"pillars: they stand on the road; expected an offset above {side:g} m"
                )
            middles = np.arange(self.start + side, self.end - side, self.pillars.spacing)
            for s in middles.tolist():
                foot = stretch(
                    site.road, s - side, s + side, self.offset - side, self.offset + side
                )
                parts.append(slab(foot, -FOOT_M, FOOT_M + height))
        return [Obstacle(name, joined(parts))]


class FacadeConfig(Section):
    """One side of a canyon."""

    distance: Aside = 10.0
    """From the trajectory, m."""
    height: Height = 15.0
    """Above the trajectory, m."""
    reflectivity: Factor = 0.0
    """Amplitude of its reflections against the line of sight."""
    rays: RayCount = 2
    """Reflections it may send at once; a longer wall hands them on along the road."""
    gaps: tuple[Gap, ...] = ()
    """Side streets, [from, to] in m along the road, in order."""


class CanyonConfig(_Stretched):
    """Walls along the road."""

    left: FacadeConfig | None = FacadeConfig()
    """Wall to the left; null: none."""
    right: FacadeConfig | None = FacadeConfig()
    """Wall to the right; null: none."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for side, facade in (("left", self.left), ("right", self.right)):
            edges = [edge for gap in facade.gaps for edge in gap] if facade else []
            if edges != sorted(edges) or any(not self.start < s < self.end for s in edges):
                raise misfit(
                    f"expected gaps in order, within {self.start:g} to {self.end:g} m",
                    f"{side}.gaps",
                )
        return self

    def build(self, name: str, site: Site) -> list[Obstacle]:
        """Return a body for each side."""
        sides: list[tuple[Side, FacadeConfig | None]] = [
            ("left", self.left),
            ("right", self.right),
        ]
        return [
            self._side(f"{name} {side}", side, facade, site) for side, facade in sides if facade
        ]

    def _side(self, name: str, side: Side, facade: FacadeConfig, site: Site) -> Obstacle:
        edges = [self.start, *(edge for gap in facade.gaps for edge in gap), self.end]
        parts = []
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            aside = _SIGN[side] * facade.distance
            parts.append(wall(stretch(site.road, start, end, aside, aside).left_m, facade.height))
        rays = facade.rays if facade.reflectivity else 0
        return Obstacle(name, joined(parts), 0.0, facade.reflectivity, rays)


class BarrierConfig(_Stretched):
    """A sound barrier beside the road."""

    side: Side = "right"
    """Of the road."""
    distance: Aside = 5.0
    """From the trajectory, m."""
    height: Height = 4.0
    """Above the trajectory, m."""
    attenuation: Decibels | None = None
    """Of what passes through it, dB; omitted: nothing does."""

    def build(self, name: str, site: Site) -> list[Obstacle]:
        """Return the wall."""
        aside = _SIGN[self.side] * self.distance
        line = stretch(site.road, self.start, self.end, aside, aside).left_m
        return [Obstacle(name, wall(line, self.height), passing(self.attenuation))]


def passing(attenuation_db: float | None) -> float:
    """Amplitude factor of an attenuation; None lets nothing through."""
    return 0.0 if attenuation_db is None else 10.0 ** (-attenuation_db / 20.0)


class TreesConfig(_Stretched):
    """Crowns of a row of trees beside, or above, the road."""

    side: Literal["left", "right", "both"] = "both"
    """Of the road."""
    distance: Aside = 2.0
    """Of the nearer edge of the crowns from the trajectory, m."""
    depth: Length = 8.0
    """Of the crowns, across the road, m."""
    bottom: Height = 3.0
    """Of the crowns above the trajectory, m."""
    top: Height = 12.0
    """Of the crowns above the trajectory, m."""
    attenuation: Decibels = 8.0
    """Mean, dB."""
    deviation: Annotated[float, Quantity(0.0, 20.0, "dB")] = 3.0
    """Standard deviation of the fading, dB."""
    coherence: Annotated[float, Quantity(0.05, 100.0, "m")] = 2.0
    """Distance travelled at which the fading's correlation has fallen to 1/e, m."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.bottom < self.top:
            raise misfit(f"expected more than `bottom`, {self.bottom:g} m", "top")
        return self

    def rows(self, name: str, site: Site, number: int) -> list[Trees]:
        """Return a row for each side; `number` tells their fading from that of other trees."""
        return [
            self._row(f"{name} {side}", site, sign, (number, index))
            for index, (side, sign) in enumerate(_SIGN.items())
            if self.side in (side, "both")
        ]

    def _row(self, name: str, site: Site, sign: float, index: tuple[int, ...]) -> Trees:
        near, far = sign * self.distance, sign * (self.distance + self.depth)
        lines = stretch(site.road, self.start, self.end, min(near, far), max(near, far))
        return Trees(
            name,
            crowns(slab(lines, self.bottom, self.top - self.bottom)),
            self.attenuation,
            self.deviation,
            self.coherence,
            site.seed,
            index,
        )
