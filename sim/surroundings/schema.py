"""Section `surroundings` of a scenario file: a list of obstacles, one key each."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from deepgnss.core.errors import ConfigError
from deepgnss.io.config.quantity import Choice, Quantity, Section, misfit
from deepgnss.sim.motion.road import Road
from deepgnss.sim.surroundings.decreed import DecreedRay
from deepgnss.sim.surroundings.foliage import Trees
from deepgnss.sim.surroundings.panels import lifted, ribbon
from deepgnss.sim.surroundings.reflections import Ground
from deepgnss.sim.surroundings.roadside import (
    BarrierConfig,
    CanyonConfig,
    Decibels,
    Factor,
    FootbridgeConfig,
    Length,
    Site,
    TreesConfig,
    TunnelConfig,
    ViaductConfig,
    passing,
)
from deepgnss.sim.surroundings.scene import Obstacle, scene
from deepgnss.sim.surroundings.sight import Seen, Together

Offset = Annotated[float, Quantity(-1e6, 1e6, "m")]
Seconds = Annotated[float, Quantity(0.0, 1e6, "s")]


class WallConfig(Section):
    """A straight upright wall placed in the local frame, with or without a road."""

    position: tuple[Offset, Offset]
    """Where it begins: north, east in m from the place."""
    heading: Annotated[float, Quantity(-360.0, 360.0, "deg")] = 0.0
    """Where it runs from there, deg from north over east."""
    length: Length
    """m."""
    height: Annotated[float, Quantity(-1000.0, 1000.0, "m")]
    """Of its top above the place, m."""
    foot: Annotated[float, Quantity(-1000.0, 1000.0, "m")] = -10.0
    """Of its foot above the place, m."""
    reflectivity: Factor = 0.0
    """Amplitude of its reflection against the line of sight."""
    attenuation: Decibels | None = None
    """Of what passes through it, dB; omitted: nothing does."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.foot < self.height:
            raise misfit(f"expected more than `foot`, {self.foot:g} m", "height")
        return self

    def obstacle(self, name: str) -> Obstacle:
        """Return the wall."""
        angle = np.radians(self.heading)
        begin = np.array([*self.position, 0.0])
        along = self.length * np.array([np.cos(angle), np.sin(angle), 0.0])
        line = np.stack([begin, begin + along])
        panels = ribbon(lifted(line, self.foot), lifted(line, self.height))
        rays = 1 if self.reflectivity else 0
        return Obstacle(name, panels, passing(self.attenuation), self.reflectivity, rays)


class GroundConfig(Section):
    """Reflection in level ground below the antenna."""

    depth: Length = 1.7
    """Of the ground below the antenna, m."""
    reflectivity: Factor = 0.3
    """Amplitude against the line of sight."""


class RayConfig(Section):
    """A ray by decree, with or without a road."""

    satellite: str = "all"
    """Which satellite has it, or all."""
    amplitude: Annotated[float, Quantity(0.0, 10.0, "", above=True)] = 0.5
    """Against the line of sight."""
    delay: Annotated[float, Quantity(0.0, 1e5, "m")]
    """Extra path at its beginning, m."""
    doppler: Annotated[float, Quantity(-1e4, 1e4, "Hz")] = 0.0
    """Against the line of sight, Hz at the signal's carrier; positive: the extra path shrinks."""
    start: Seconds = Field(0.0, alias="from")
    """Seconds since the start."""
    end: Seconds | None = Field(None, alias="to")
    """Seconds since the start; omitted: to the end."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not re.fullmatch(r"all|[GC]\d\d", self.satellite):
            raise misfit("expected a satellite such as G05, or all", "satellite")
        if self.end is not None and not self.start < self.end:
            raise misfit(f"expected more than `from`, {self.start:g} s", "to")
        return self

    def ray(self, seconds: float) -> DecreedRay:
        """Return the ray, in a scenario of a length in s."""
        end = seconds if self.end is None else self.end
        wavelength_m = 0.1903  # GPS L1; of B1I 1 % more
        if self.delay - self.doppler * wavelength_m * (end - self.start) < 0.0:
            raise ConfigError(
                f"doppler: {self.doppler:g} Hz brings the ray before the line of sight until"
                f" {end:g} s; a delay of {self.doppler * wavelength_m * (end - self.start):.4g} m"
                " or more would fit"
            )
        satellite = None if self.satellite == "all" else self.satellite
        return DecreedRay(satellite, self.amplitude, self.delay, self.doppler, self.start, end)


ROADSIDE = ("tunnel", "footbridge", "viaduct", "canyon", "barrier", "trees")


class ObstacleConfig(Choice):
    """One thing around the vehicle: exactly one key."""

    tunnel: TunnelConfig | None = None
    """A tube around the road."""
    footbridge: FootbridgeConfig | None = None
    """A deck across the road."""
    viaduct: ViaductConfig | None = None
    """An upper road on a deck along this one."""
    canyon: CanyonConfig | None = None
    """Walls along the road, which may reflect."""
    barrier: BarrierConfig | None = None
    """A sound barrier beside the road."""
    trees: TreesConfig | None = None
    """Crowns beside or above the road."""
    wall: WallConfig | None = None
    """A straight wall in the local frame, which may reflect."""
    ground: GroundConfig | None = None
    """Reflection in the ground."""
    ray: RayConfig | None = None
    """A reflected ray by decree."""
    edges: Literal["diffracting", "sharp"] | None = None
    """How signals pass the edges of all bodies: bent around them (default), or cut off."""

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if len(self.given) != 1:
            raise misfit(f"expected one of {', '.join(type(self).model_fields)}, with a value")
        return self

    @property
    def key(self) -> str:
        """Name of the one key that is there."""
        return self.given[0]


def build_surroundings(
    obstacles: Sequence[ObstacleConfig],
    *,
    road: Road | None,
    seed: int,
    seconds: float,
    antenna_height_m: float,
) -> Seen | None:
    """Everything around the vehicle; None under an open sky.

    Parameters
    ----------
    road
        What positions along the road refer to; None: the trajectory has none.
    seconds
        Length of the scenario.
    antenna_height_m
        Height of the highest antenna above the trajectory.

    Raises
    ------
    ConfigError: an obstacle cannot stand where it should; one line that names its key.
    """
    site = Site(road, seed, antenna_height_m) if road else None
    bodies: list[Obstacle] = []
    rows: list[Trees] = []
    rays: list[DecreedRay] = []
    ground: Ground | None = None
    bending = True
    counts: Counter[str] = Counter()
    for number, one in enumerate(obstacles):
        key = one.key
        counts[key] += 1
        name = f"{key} {counts[key]}"
        try:
            if key in ROADSIDE:
                _stand(one, name, number, site, bodies, rows)
            elif one.wall:
                bodies.append(one.wall.obstacle(name))
            elif one.ray:
                rays.append(one.ray.ray(seconds))
            elif counts[key] > 1:
                raise ConfigError("stands twice; expected once")
            elif one.ground:
                ground = Ground(one.ground.depth, one.ground.reflectivity)
            else:
                bending = one.edges == "diffracting"
        except ConfigError as error:
            raise ConfigError(f"surroundings[{number}].{key}: {error}") from error
    parts: list[Seen] = list(rays)
    if bodies or rows or ground:
        parts.insert(0, scene(tuple(bodies), tuple(rows), ground, bending))
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else Together(tuple(parts))


def _stand(
    one: ObstacleConfig,
    name: str,
    number: int,
    site: Site | None,
    bodies: list[Obstacle],
    rows: list[Trees],
) -> None:
    """Put an obstacle along the road among the bodies or the rows of trees."""
    if site is None:
        raise ConfigError("expected a trajectory with a road (`street`) to stand along")
    body = one.tunnel or one.footbridge or one.viaduct or one.canyon or one.barrier
    thing = body or one.trees
    if thing is None:
        return
    start, end = thing.reach()
    if start < 0.0 or end > site.road.length_m:
        raise ConfigError(
            f"{start:g} to {end:g} m lies beyond the road, 0 to {site.road.length_m:.1f} m"
        )
    if body:
        bodies.extend(body.build(name, site))
    elif one.trees:
        rows.extend(one.trees.rows(name, site, number))
