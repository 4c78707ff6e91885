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
_SIDES: Final = (1, 3)  # edges of a ribbon towards the pieces before and after
_CLEAR_V: Final = -0.78  # P.526: no loss from here on
_DARK_V: Final = 22.5  # 40 dB: taken as nothing
_LEVEL: Final = 10.0 ** (6.9 / 20.0)

_Vector = tuple[float, float, float]


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
    screens: Screens,
    rays: Rays,
    wavelength_m: float,
    bending: bool,
    skip: Sequence[int] = (),
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Amplitude (n,) left of far sources by all pieces but `skip`, and the body that hides most.

    The body's number (n,) is −1 where none hides more than a hundredth.
    """
    left = np.ones(len(rays.start_m))
    worst = np.full(left.size, -1, dtype=np.int64)
    darkest = np.full(left.size, 0.01)
    chosen = [p for p in near(screens, rays, wavelength_m).tolist() if p not in skip]
    for body, pieces in itertools.groupby(chosen, lambda piece: screens.body[piece]):
        hidden = np.zeros(left.size)
        for piece in pieces:
            np.maximum(hidden, caught(screens, piece, rays, wavelength_m, bending), out=hidden)
        hidden *= 1.0 - screens.passing[piece]
        left *= 1.0 - hidden
        worst[hidden > darkest] = body
        np.maximum(darkest, hidden, out=darkest)
    return left, worst


def caught(
    screens: Screens,
    piece: int,
    rays: Rays,
    wavelength_m: float,
    bending: bool,
    alone: bool = False,
) -> FloatArray:
    """Part (n,) of the amplitude that one piece catches, whatever it lets through.

    `alone`: as if a wall ended with this piece, since the next one looks another way.
    """
    part = np.empty(len(rays.start_m))
    _hide(rays, screens, piece, wavelength_m, bending, alone, part)
    return part


@kernel
def _hide(
    rays: Rays,
    screens: Screens,
    piece: int,
    wavelength: float,
    bending: bool,
    alone: bool,
    part: FloatArray,
) -> None:
    """Part of the amplitude of each ray's source that a piece hides.

    Vectors are tuples here: views of arrays would cost more than the arithmetic.
    """
    corners, edges, cut, normals = screens.corners_m, screens.edges, screens.cut, screens.normals
    first, end = screens.first[piece], screens.first[piece + 1]
    centre, radius = _row(screens.centres_m, piece), screens.radii_m[piece]
    for n in range(part.size):
        r, d = _row(rays.start_m, n), _row(rays.along, n)
        part[n] = 0.0
        if _near(r, d, centre, radius, wavelength if bending else 0.0):
            enter, part[n] = _hidden(
                r, d, corners, edges, cut, normals, first, end, wavelength, bending, alone
            )
            if enter >= rays.reach_m[n]:
                part[n] = 0.0


@kernel
def _hidden(
    r: _Vector,
    d: _Vector,
    corners: FloatArray,
    edges: NDArray[np.int64],
    cut: NDArray[np.bool_],
    normals: FloatArray,
    first: int,
    end: int,
    wavelength: float,
    bending: bool,
    alone: bool,
) -> tuple[float, float]:
    """Way to the piece of panels [first, end), and the part that it hides of a source along d."""
    hidden, enter = 1.0, 0.0
    limit = 0.5 * wavelength * _CLEAR_V**2
    passed, share = 0.0, -math.inf  # at the edge that bounds the piece where the ray misses it
    for m in range(first, end):
        height = _height(r, corners, normals, m)
        if height <= 0.0 and end - first > 1:
            continue  # a solid's outline bounds the faces that are seen
        slope = _dot(d, _row(normals, m))
        if height * slope < 0.0:
            enter = max(enter, -height / slope)
        for i in range(4):
            kind = edges[m, i]
            if kind >= 0 and _height(r, corners, normals, kind) > 0.0:
                continue  # between two faces that are seen
            corner = _corner(corners, m, i)
            p = _minus(corner, r)
            e = _minus(_corner(corners, m, (i + 1) % 4), corner)
            # common perpendicular d × e of ray and edge: its part of p is by how much they miss
            c = _cross(d, e)
            inside = _dot(p, c)
            if height < 0.0:
                inside = -inside
            goes_on = _goes_on(edges, cut, m, i) and not (alone and i in _SIDES)
            if not bending or cut[m] or goes_on:
                if inside < 0.0:
                    return enter, 0.0
                continue
            moment = _cross(p, e)
            if inside < 0.0 and inside**2 * abs(height) > limit * _dot(moment, moment):
                return enter, 0.0  # all of the piece lies further from the ray than its bend
            # where along ray and edge (0 to 1) they are nearest
            square = _dot(c, c) + 1.0e-12
            way = _dot(moment, c) / square
            at = _dot(_cross(p, d), c) / square
            bent = 1.0 if inside < 0.0 else 0.0
            if way > 0.0:
                bent = _knife_edge(inside * math.sqrt(2.0 / (wavelength * way * square)))
            # Past its ends an edge fades out over the width of the bend: others bound there.
            beyond = max(-at, at - 1.0, 0.0)
            if beyond > 0.0 and _goes_on(edges, cut, m, (i + 1 if at > 1.0 else i - 1) % 4):
                beyond = 0.0
            width = -_CLEAR_V * math.sqrt(0.5 * wavelength * max(way, 1.0e-3))
            fade = 1.0 - beyond * math.sqrt(square) / width
            if inside < 0.0 and fade > share:  # the edge that reaches furthest counts in full
                bent, passed = passed, bent
                fade, share = share, fade
            hidden *= 1.0 - bent * max(fade, 0.0)
            if hidden == 0.0 or (passed == 1.0 and share == 1.0):
                return enter, 0.0
    return enter, hidden * (1.0 - passed)


@kernel
def _goes_on(edges: NDArray[np.int64], cut: NDArray[np.bool_], m: int, i: int) -> bool:
    """Whether the body goes on beyond edge i of panel m."""
    kind = edges[m, i]
    return bool(kind == _SEAM or (kind >= 0 and cut[kind]))


@kernel
def _near(r: _Vector, d: _Vector, centre: _Vector, radius: float, wavelength: float) -> bool:
    """Whether a ray comes near a sphere, or within its bend."""
    to = _minus(centre, r)
    ahead, square = _dot(to, d), _dot(to, to)
    wide = radius - _CLEAR_V * math.sqrt(0.5 * wavelength * (math.sqrt(square) + radius))
    return bool(ahead > -wide and square - ahead * ahead < wide * wide)


@kernel
def _height(r: _Vector, corners: FloatArray, normals: FloatArray, m: int) -> float:
    """Distance of r in front of panel m's plane, m."""
    return _dot(_minus(r, _corner(corners, m, 0)), _row(normals, m))


@kernel
def _row(array: FloatArray, n: int) -> _Vector:
    return array[n, 0], array[n, 1], array[n, 2]


@kernel
def _corner(array: FloatArray, m: int, i: int) -> _Vector:
    return array[m, i, 0], array[m, i, 1], array[m, i, 2]


@kernel
def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
