"""Flat panels that shade and reflect, and the bodies along a road that they make up.

A body is a chain of panels between stations of the road, so few that no panel strays more than
`STRAY_M` from the road's course. All coordinates are local NED.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.road import Road

FREE: Final = -1
"""An edge in the open: signals bend around it."""
SEAM: Final = -2
"""An edge where the body goes on."""
STRAY_M: Final = 0.2
FOOT_M: Final = 3.0  # how far walls reach below the road
_STEP_M: Final = 0.5


@dataclass(frozen=True, slots=True)
class Panels:
    """Convex flat quadrilaterals, corners anticlockwise seen from the side of their normal.

    They make up pieces, each a single thin panel or the closed hull of a convex solid. edges: what
    lies beyond the edge from corner i to corner i + 1: FREE, SEAM, or the number of the
    neighbouring panel of the same solid.
    """

    corners_m: FloatArray  # (m, 4, 3)
    edges: NDArray[np.int64]  # (m, 4)
    cut: NDArray[np.bool_]  # (m,) an inner face, behind which the body goes on
    piece: NDArray[np.int64]  # (m,) rising from 0

    @property
    def normals(self) -> FloatArray:
        """Unit normals (m, 3)."""
        c = self.corners_m
        normal = np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return int(self.piece[-1]) + 1 if self.piece.size else 0


def joined(parts: Sequence[Panels]) -> Panels:
    """One table of all panels; numbers of neighbours and pieces move along."""
    starts = np.cumsum([0] + [len(p.corners_m) for p in parts])
    pieces = np.cumsum([0] + [p.pieces for p in parts])
    edges = [
        np.where(p.edges >= 0, p.edges + s, p.edges) for p, s in zip(parts, starts, strict=False)
    ]
    return Panels(
        np.concatenate([np.empty((0, 4, 3))] + [p.corners_m for p in parts]),
        np.concatenate([np.empty((0, 4), np.int64)] + edges),
        np.concatenate([np.empty(0, np.bool_)] + [p.cut for p in parts]),
        np.concatenate(
            [np.empty(0, np.int64)] + [p.piece + s for p, s in zip(parts, pieces, strict=False)]
        ),
    )


class Stretch(NamedTuple):
    """Two lines along a stretch of road, at the same stations."""

    left_m: FloatArray  # (k, 3)
    right_m: FloatArray


def stretch(road: Road, start_m: float, end_m: float, left_m: float, right_m: float) -> Stretch:
    """Lines at lateral distances from the centreline (right positive, left ≤ right).

    Stations are as few as keep chords within STRAY_M of both lines.

    Raises
    ------
    ConfigError: a line would turn back on itself in a bend.
    """
    count = max(int(np.ceil((end_m - start_m) / _STEP_M)), 1) + 1
    s = np.linspace(start_m, end_m, count)
    centre, heading, _ = road.centreline(s)
    right = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(count)])
    lines = [centre + offset * right for offset in (left_m, right_m)]
    ahead = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    for line, offset in zip(lines, (left_m, right_m), strict=True):
        back = np.einsum("ij,ij->i", np.diff(line, axis=0), ahead[:-1]) <= 0.0
        if back.any():
            raise ConfigError(
                f"{abs(offset):g} m to the {'left' if offset < 0 else 'right'} lies beyond the"
                f" middle of the bend at {s[int(np.argmax(back))]:.0f} m of the road"
            )
    keep = _stations(s, np.hstack(lines), 0, count - 1)
    return Stretch(*(line[keep] for line in lines))


def _stations(s: FloatArray, lines: FloatArray, first: int, last: int) -> list[int]:
    """Indices at which to break lines (n, 3·k) so that no chord strays too far."""
    part = (s[first : last + 1] - s[first]) / (s[last] - s[first])
    chord = lines[first] + np.outer(part, lines[last] - lines[first])
    stray = np.abs(lines[first : last + 1] - chord).max(axis=1)
    worst = first + int(np.argmax(stray))
    if stray.max() <= STRAY_M:
        return [first, last]
    return _stations(s, lines, first, worst)[:-1] + _stations(s, lines, worst, last)


def lifted(line_m: FloatArray, height_m: float) -> FloatArray:
    """A line (k, 3) raised by a height."""
    return np.asarray(line_m - np.array([0.0, 0.0, height_m]))


def ribbon(low_m: FloatArray, high_m: FloatArray, low: int = SEAM, high: int = FREE) -> Panels:
    """Chain of thin panels between two lines (k, 3), free at its ends; kinds of the long edges.

    With `low` below and `high` above, the normal points to those who see the lines run from left
    to right.
    """
    corners = np.stack([low_m[:-1], low_m[1:], high_m[1:], high_m[:-1]], axis=1)
    edges = np.tile(np.array([low, SEAM, high, SEAM], dtype=np.int64), (len(corners), 1))
    edges[0, 3] = edges[-1, 1] = FREE
    return Panels(corners, edges, np.zeros(len(corners), dtype=np.bool_), np.arange(len(corners)))


def wall(line_m: FloatArray, height_m: float) -> Panels:
    """Thin upright wall on a line at road level."""
    return ribbon(lifted(line_m, -FOOT_M), lifted(line_m, height_m))


def tube(lines: Stretch, height_m: float) -> Panels:
    """Tunnel: two walls and a ceiling, open at its ends."""
    left, right = lines
    ceiling = ribbon(lifted(left, height_m), lifted(right, height_m), SEAM, SEAM)
    sides = [
        ribbon(lifted(line, -FOOT_M), lifted(line, height_m), SEAM, SEAM) for line in (left, right)
    ]
    return joined([ceiling, *sides])


def slab(lines: Stretch, height_m: float, thickness_m: float) -> Panels:
    """Solid between two lines at road level, its underside `height_m` above them."""
    left, right = (lifted(line, height_m) for line in lines)
    top_left, top_right = (lifted(line, height_m + thickness_m) for line in lines)
    rings = np.stack([left, right, top_right, top_left], axis=1)
    last = len(rings) - 2
    return joined([_box(rings[i], rings[i + 1], i > 0, i < last) for i in range(last + 1)])


# Underside, right, top, left; start and end: the neighbours across each edge.
_BOX: Final = np.array(
    [(3, 5, 1, 4), (0, 5, 2, 4), (1, 5, 3, 4), (2, 5, 0, 4), (0, 1, 2, 3), (3, 2, 1, 0)]
)


def _box(start_m: FloatArray, end_m: FloatArray, goes_before: bool, goes_on: bool) -> Panels:
    """Solid between two cross-sections (4, 3), anticlockwise for those behind the start."""
    sides = [(start_m[n], end_m[n], end_m[n - 3], start_m[n - 3]) for n in range(4)]
    corners = np.array([*sides, start_m, end_m[[0, 3, 2, 1]]])
    cut = np.array([False, False, False, False, goes_before, goes_on])
    return Panels(corners, _BOX.copy(), cut, np.zeros(6, dtype=np.int64))
