"""How much of a far source bodies leave: rays against convex pieces, with bending at free edges.

A piece hides the part Π(1 − F(v_i)) of the amplitude, over the edges of its outline: Babinet's
principle with F the knife edge of ITU-R P.526 (4.1), amplitude only, no ripple. On the edge of a
half plane ½ is left, on the corner of a quarter plane ¾. A body hides what its darkest piece does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray
from deepgnss.sim.surroundings.panels import SEAM, Panels, joined

_SEAM: Final = SEAM
_CLEAR_V: Final = -0.78  # P.526: no loss from here on
_DARK_V: Final = 22.5  # 40 dB: taken as nothing
_LEVEL: Final = 10.0 ** (6.9 / 20.0)


class Screens(NamedTuple):
    """Panels (m), their pieces (p) and bodies made ready for the kernels."""

    corners_m: FloatArray  # (m, 4, 3)
    edges: NDArray[np.int64]  # (m, 4)
    cut: NDArray[np.bool_]  # (m,)
    normals: FloatArray  # (m, 3)
    first: NDArray[np.int64]  # (p + 1,) panel with which a piece begins
    centres_m: FloatArray  # (p, 3) of the spheres around the pieces
    radii_m: FloatArray  # (p,)
    body: NDArray[np.int64]  # (p,) rising
    passing: FloatArray  # (p,) amplitude that goes through the piece itself


def screens(bodies: Sequence[Panels], passing: Sequence[float]) -> Screens:
    """Bodies, each with the amplitude factor that it lets through."""
    panels = joined(bodies)
    pieces = [body.pieces for body in bodies]
    first = np.searchsorted(panels.piece, np.arange(sum(pieces) + 1))
    centres, radii = np.empty((sum(pieces), 3)), np.empty(sum(pieces))
    for number, (start, end) in enumerate(itertools.pairwise(first)):
        corners = panels.corners_m[start:end].reshape(-1, 3)
        centres[number] = corners.mean(axis=0)
        radii[number] = np.linalg.norm(corners - centres[number], axis=1).max()
    return Screens(
        panels.corners_m,
        panels.edges,
        panels.cut,
        panels.normals,
        first,
        centres,
        radii,
        np.repeat(np.arange(len(bodies)), pieces),
        np.repeat(np.array(passing, dtype=np.float64), pieces),
    )


class Rays(NamedTuple):
    """Straight ways from points (n, 3) along unit vectors (n, 3), ending after `reach_m` (n,)."""

    start_m: FloatArray
    along: FloatArray
    reach_m: FloatArray


def knife_edge(v: float) -> float:
    """Amplitude behind a knife edge, v > 0 in its shadow: 10^(−J(v)/20), ITU-R P.526 (31)."""
    if v <= _CLEAR_V:
        return 1.0
    if v >= _DARK_V:
        return 0.0
    return 1.0 / (_LEVEL * (math.sqrt((v - 0.1) ** 2 + 1.0) + v - 0.1))


_knife_edge = kernel(knife_edge)


class Swath(NamedTuple):
    """All rays of a bundle at once: a middle ray and how far the others stray from it."""

    middle_m: FloatArray  # (3,)
    along: FloatArray  # (3,)
    around_m: float
    turn: float

    @staticmethod
    def of(rays: Rays) -> Swath:
        """The swath of rays."""
        middle, along = rays.start_m.mean(axis=0), rays.along.mean(axis=0)
        around = math.sqrt(np.max(np.sum((rays.start_m - middle) ** 2, axis=1)))
        turn = math.sqrt(np.max(np.sum((rays.along - along) ** 2, axis=1)))
        return Swath(middle, along / np.linalg.norm(along), around, turn)

    def meets(
        self, start_m: FloatArray, centres_m: FloatArray, radii_m: FloatArray, wavelength_m: float
    ) -> NDArray[np.bool_]:
        """Whether any ray of the swath, its middle moved to `start_m`, comes near spheres (k,)."""
        to = centres_m - start_m
        ahead = to @ self.along
        square = np.einsum("ki,ki->k", to, to)
        distance = np.sqrt(square) + self.around_m
        bend = -_CLEAR_V * np.sqrt(wavelength_m * (distance + radii_m) / 2.0)
        wide = radii_m + self.around_m + self.turn * distance + bend
        return np.asarray((ahead > -wide) & (square - ahead**2 < wide**2))


def near(screens: Screens, rays: Rays, wavelength_m: float) -> NDArray[np.int64]:
    """Numbers of the pieces that any of the rays may touch, or bend around."""
    swath = Swath.of(rays)
    return np.flatnonzero(
        swath.meets(swath.middle_m, screens.centres_m, screens.radii_m, wavelength_m)
    )


def shade(
    screens: Screens, rays: Rays, wavelength_m: float, bending: bool, skip: int = -1
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Amplitude (n,) left of far sources by all pieces but `skip`, and the body that hides most.

    The body's number (n,) is −1 where none hides more than a hundredth.
    """
    left = np.ones(len(rays.start_m))
    worst = np.full(left.size, -1, dtype=np.int64)
    chosen = near(screens, rays, wavelength_m)
    chosen = chosen[chosen != skip]
    if chosen.size:
        _shade(rays, screens, chosen, wavelength_m, bending, left, worst)
    return left, worst


def caught(
    screens: Screens, piece: int, rays: Rays, wavelength_m: float, bending: bool
) -> FloatArray:
    """Part (n,) of the amplitude that one piece catches, whatever it lets through."""
    part = np.empty(len(rays.start_m))
    _caught(rays, screens, piece, wavelength_m, bending, part)
    return part


@kernel
def _shade(
    rays: Rays,
    screens: Screens,
    chosen: NDArray[np.int64],
    wavelength: float,
    bending: bool,
    left: FloatArray,
    worst: NDArray[np.int64],
) -> None:
    """Multiply `left` by what each body of the chosen pieces leaves; note the darkest."""
    for n in range(left.size):
        darkest = 0.01
        taken, body = 0.0, -1
        for piece in chosen:
            if screens.body[piece] != body:
                left[n] *= 1.0 - taken
                taken, body = 0.0, screens.body[piece]
            part = _hidden(rays, n, screens, piece, wavelength, bending)
            taken = max(taken, part * (1.0 - screens.passing[piece]))
            if taken > darkest:
                darkest = taken
                worst[n] = body
        left[n] *= 1.0 - taken


@kernel
def _caught(
    rays: Rays, screens: Screens, piece: int, wavelength: float, bending: bool, part: FloatArray
) -> None:
    """Part of the amplitude that one piece hides."""
    for n in range(part.size):
        part[n] = _hidden(rays, n, screens, piece, wavelength, bending)


@kernel
def _hidden(
    rays: Rays, n: int, screens: Screens, piece: int, wavelength: float, bending: bool
) -> float:
    """Part of the amplitude of ray n's source that a piece hides."""
    r, d = rays.start_m[n], rays.along[n]
    if not _touches(r, d, screens, piece, wavelength, bending):
        return 0.0
    first, end = screens.first[piece], screens.first[piece + 1]
    hidden, enter = 1.0, 0.0
    outside = far_outside = False
    for m in range(first, end):
        height = _height(r, screens, m)
        if height <= 0.0 and end - first > 1:
            continue  # a solid's outline bounds the faces that are seen
        normal = screens.normals[m]
        slope = d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]
        if height * slope < 0.0:
            enter = max(enter, -height / slope)
        for i in range(4):
            kind = screens.edges[m, i]
            if kind >= 0 and _height(r, screens, kind) > 0.0:
                continue  # between two faces that are seen
            p, q = screens.corners_m[m, i], screens.corners_m[m, (i + 1) % 4]
            px, py, pz = p[0] - r[0], p[1] - r[1], p[2] - r[2]
            ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            # common perpendicular d × e of ray and edge: its part of p is by how much they miss
            cx, cy, cz = d[1] * ez - d[2] * ey, d[2] * ex - d[0] * ez, d[0] * ey - d[1] * ex
            inside = px * cx + py * cy + pz * cz
            if height < 0.0:
                inside = -inside
            sharp = not bending or kind == _SEAM or screens.cut[m]
            if sharp or (kind >= 0 and screens.cut[kind]):
                if inside < 0.0:
                    return 0.0
                continue
            # where along ray (times |d × e|²) and edge (0 to 1) they are nearest
            square = cx * cx + cy * cy + cz * cz + 1.0e-12
            way = (py * ez - pz * ey) * cx + (pz * ex - px * ez) * cy + (px * ey - py * ex) * cz
            at = (py * d[2] - pz * d[1]) * cx + (pz * d[0] - px * d[2]) * cy
            at = (at + (px * d[1] - py * d[0]) * cz) / square
            # Beyond its ends an edge fades out over the width of the bend: others bound there.
            width = -_CLEAR_V * math.sqrt(0.5 * wavelength * max(way / square, 1.0e-3))
            fade = 1.0 - max(-at, at - 1.0, 0.0) * math.sqrt(square) / width
            if fade <= 0.0:
                far_outside = far_outside or inside < 0.0
                continue
            outside = outside or inside < 0.0
            if way > 0.0:
                v = inside * math.sqrt(2.0 / (wavelength * way))
                hidden *= 1.0 - _knife_edge(v) * fade
            elif inside < 0.0:
                hidden *= 1.0 - fade
            if hidden == 0.0:
                return 0.0
    if enter >= rays.reach_m[n] or (far_outside and not outside):
        return 0.0
    return hidden


@kernel
def _touches(
    r: FloatArray, d: FloatArray, screens: Screens, piece: int, wavelength: float, bending: bool
) -> bool:
    """Whether the ray comes near the sphere around a piece."""
    centre, radius = screens.centres_m[piece], screens.radii_m[piece]
    x, y, z = centre[0] - r[0], centre[1] - r[1], centre[2] - r[2]
    ahead = x * d[0] + y * d[1] + z * d[2]
    square = x * x + y * y + z * z
    if bending:
        radius -= _CLEAR_V * math.sqrt(wavelength * (math.sqrt(square) + radius) / 2.0)
    aside = square - ahead * ahead
    return bool(ahead > -radius and aside < radius * radius)


@kernel
def _height(r: FloatArray, screens: Screens, m: int) -> float:
    """Distance of r in front of panel m's plane, m."""
    corner, normal = screens.corners_m[m, 0], screens.normals[m]
    height = 0.0
    for axis in range(3):
        height += (r[axis] - corner[axis]) * normal[axis]
    return height
