"""The scene around an antenna: everything that has a place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray
from deepgnss.sim.scenario import Arrivals, View
from deepgnss.sim.surroundings.foliage import Trees
from deepgnss.sim.surroundings.panels import Panels
from deepgnss.sim.surroundings.reflections import Ground, Mirror, image, in_reach, owners
from deepgnss.sim.surroundings.shadow import Rays, Screens, caught, screens, shade
from deepgnss.sim.surroundings.sight import STATES, Sight

_FREE_FROM: Final = 0.97
_BLOCKED_BELOW: Final = 0.1  # −20 dB


class Obstacle(NamedTuple):
    """A named body, what passes through it, and what it reflects."""

    name: str
    panels: Panels
    passing: float = 0.0  # amplitude factor
    reflectivity: float = 0.0
    rays: int = 0  # that its pieces, thin ones, share


@dataclass(frozen=True, slots=True)
class Scene:
    """Bodies, trees and ground. Build with `scene`."""

    screens: Screens
    bodies: tuple[str, ...]  # their names
    trees: tuple[Trees, ...]
    mirrors: tuple[Mirror, ...]
    ground: Ground | None
    bending: bool  # around edges; otherwise they are sharp

    @property
    def rays(self) -> int:
        """Mirrors, and the ground."""
        return len(self.mirrors) + (self.ground is not None)

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        """Line of sight, one ray per mirror, ground last."""
        wavelength_m = SPEED_OF_LIGHT_MPS / carrier_hz
        sight = _lines_of_sight(view)
        direct = self._left(sight, view.satellite, wavelength_m)
        amplitude = np.zeros((self.rays, direct.size))
        excess_m = np.zeros_like(amplitude)
        shining = in_reach(self.screens, self.mirrors, sight, wavelength_m)
        for row, mirror in enumerate(self.mirrors):
            if shining.isdisjoint(mirror.pieces):
                continue
            owner, weight = owners(mirror, self.screens, sight.start_m)
            for piece in np.unique(owner).tolist():
                at = np.flatnonzero(owner == piece)
                part, excess_m[row, at] = self._reflection(
                    piece, Rays(*(x[at] for x in sight)), view.satellite, wavelength_m
                )
                amplitude[row, at] = mirror.reflectivity * weight[at] * part
        if self.ground:
            amplitude[-1] = self.ground.reflectivity * direct
            excess_m[-1] = self.ground.excess_m(view.elevation_rad)
        return Arrivals(direct, amplitude, excess_m)

    def visibility(self, view: View, carrier_hz: float) -> Sight:
        """State of the line of sight and the body or trees that take most of it."""
        sight = _lines_of_sight(view)
        wavelength_m = SPEED_OF_LIGHT_MPS / carrier_hz
        left, cause = shade(self.screens, sight, wavelength_m, self.bending)
        # Whether a body lets signals through tells attenuation from diffraction.
        clear = np.zeros(len(self.bodies) + 1, dtype=np.bool_)
        clear[self.screens.body] = self.screens.passing > 0.0
        state = np.where(clear[cause], STATES.index("attenuated"), STATES.index("diffracted"))
        most = left.copy()
        for number, row in enumerate(self.trees, len(self.bodies)):
            through = row.amplitude(sight, view.satellite)
            cause = np.where(through < most, number, cause)
            state = np.where(through < most, STATES.index("attenuated"), state)
            most = np.minimum(most, through)
            left = left * through
        state = np.where(left < _BLOCKED_BELOW, STATES.index("blocked"), state)
        state = np.where(left >= _FREE_FROM, STATES.index("free"), state)
        cause = np.where(left >= _FREE_FROM, -1, cause)
        names = (*self.bodies, *(row.name for row in self.trees))
        return Sight(state.astype(np.int8), cause.astype(np.int16), names)

    def _left(
        self, rays: Rays, satellite: str, wavelength_m: float, skip: Sequence[int] = ()
    ) -> FloatArray:
        """Amplitude (n,) left by all pieces but `skip`, and by the trees."""
        left, _ = shade(self.screens, rays, wavelength_m, self.bending, skip)
        for row in self.trees:
            left *= row.amplitude(rays, satellite)
        return left

    def _reflection(
        self, piece: int, sight: Rays, satellite: str, wavelength_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Amplitude (n,) of a perfect mirror's ray and its extra path, m."""
        seen = image(self.screens, piece, sight)
        part = caught(self.screens, piece, seen.to_image, wavelength_m, self.bending, alone=True)
        part[seen.excess_m <= 0.0] = 0.0
        # Its own neighbours touch the specular point where the ray passes from one to the next.
        bodies, around = self.screens.body, range(max(piece - 1, 0), piece + 2)
        skip = [k for k in around if k < bodies.size and bodies[k] == bodies[piece]]
        lit = np.flatnonzero(part)
        if lit.size:
            for way in (seen.to_wall, seen.from_wall):
                cut = Rays(*(x[lit] for x in way))
                part[lit] *= self._left(cut, satellite, wavelength_m, skip)
        return part, seen.excess_m


def scene(
    obstacles: tuple[Obstacle, ...],
    trees: tuple[Trees, ...] = (),
    ground: Ground | None = None,
    bending: bool = True,
) -> Scene:
    """A scene of bodies, rows of trees and reflecting ground."""
    starts = np.cumsum([0] + [o.panels.pieces for o in obstacles]).tolist()
    mirrors = tuple(
        Mirror(tuple(range(start + ray, end, obstacle.rays)), obstacle.reflectivity)
        for obstacle, (start, end) in zip(obstacles, itertools.pairwise(starts), strict=True)
        for ray in range(min(obstacle.rays, end - start))
    )
    return Scene(
        screens([o.panels for o in obstacles], [o.passing for o in obstacles]),
        tuple(o.name for o in obstacles),
        trees,
        mirrors,
        ground,
        bending,
    )


def directions(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) of the local NED frame."""
    level = np.cos(elevation_rad)
    return np.column_stack(
        [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), -np.sin(elevation_rad)]
    )


def _lines_of_sight(view: View) -> Rays:
    along = directions(view.azimuth_rad, view.elevation_rad)
    return Rays(np.ascontiguousarray(view.r_n_m), along, np.full(view.t_s.size, np.inf))
