"""A road: straight legs joined by bends of continuous curvature, with grades in height.

Lengths along the road are plan distances (chainage, seen from above). Curvature enters and leaves
a bend by smooth steps, grades pass into each other likewise, so that a vehicle at a smooth speed
feels finite jerk, and angular acceleration without steps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import PPoly

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.profile import STEEPNESS, smooth_profile

Points = list[tuple[float, float]]

_EASING: Final = 0.5  # of a bend's turn happens where its curvature grows and falls
_SHARPEST_RAD: Final = math.radians(160.0)
_STEEPEST: Final = 0.4
_CREST_M: Final = 40.0  # half the length over which grades pass into each other, at most
_PIECE_RAD: Final = 0.1  # turn of a piece of the plan, whose degree is then exact to rounding
_DEGREE: Final = 11


class Waypoint(NamedTuple):
    """A corner of the road in the local frame; None: the road's radius, the neighbours' height."""

    north_m: float
    east_m: float
    height_m: float | None = None
    radius_m: float | None = None


class Bend(NamedTuple):
    """Where along the road a bend begins and ends, and its smallest radius, m."""

    begin_m: float
    end_m: float
    radius_m: float


class Centreline(NamedTuple):
    """Points of the road at arc lengths (n,)."""

    r_n_m: FloatArray  # (n, 3) in the local NED frame
    heading_rad: FloatArray  # (n,) from north over east
    slope_rad: FloatArray  # (n,) positive uphill


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """A road as piecewise polynomials of the arc length; closed ones repeat after `length_m`."""

    length_m: float
    closed: bool
    heading: PPoly  # rad
    plan: PPoly  # north, east in m
    height: PPoly  # m, positive up
    bends: tuple[Bend, ...]
    crests: tuple[Bend, ...]  # and sags: where grades pass into each other

    def wrapped(self, s_m: FloatArray) -> FloatArray:
        """Arc lengths as the polynomials know them: within the first lap of a closed road."""
        return np.mod(s_m, self.length_m) if self.closed else np.asarray(s_m, dtype=np.float64)

    def centreline(self, s_m: FloatArray) -> Centreline:
        """Points at arc lengths (n,); beyond its ends an open road goes straight on."""
        s_m = self.wrapped(np.atleast_1d(s_m))
        return Centreline(
            np.column_stack([self.plan(s_m), -self.height(s_m)]),
            self.heading(s_m),
            np.arctan(self.height(s_m, 1)),
        )

    @property
    def knots_m(self) -> FloatArray:
        """Arc lengths within the road at which a derivative jumps."""
        knots = np.union1d(self.heading.x, self.height.x)
        return knots[(knots >= 0.0) & (knots <= self.length_m)]


def lay_road(
    waypoints: Sequence[Waypoint],
    *,
    radius_m: float,
    closed: bool = False,
    heights: Sequence[tuple[float, float]] = (),
) -> Road:
    """The road along waypoints.

    Parameters
    ----------
    waypoints
        Corners. An open road begins at the first and ends at the last; a closed one returns to
        the first, and its arc length counts from the end of the bend there.
    radius_m
        Smallest radius of a bend of 90° and more where the waypoint states none; slighter bends
        are wider, so that they begin about as far from their corner.
    heights
        (arc length, height) of a profile that replaces the waypoints' heights.

    Raises
    ------
    ConfigError: bends do not fit, waypoints coincide or turn back, the road is too steep.
    """
    corners = np.array([(w.north_m, w.east_m) for w in waypoints])
    legs = np.diff(corners, axis=0, append=corners[:1])[: None if closed else -1]
    lengths = [float(x) for x in np.hypot(*legs.T)]
    if min(lengths) <= 0.0:
        at = int(np.argmin(lengths))
        raise ConfigError(f"waypoints[{(at + 1) % len(corners)}]: the place of the one before it")
    courses = [math.atan2(east, north) for north, east in legs]
    turns = [_between(courses[i - 1], courses[i]) for i in range(len(legs))]
    if not closed:
        turns = [0.0, *turns[1:], 0.0]
    corner_bends = [_corner(i, w, turns[i], radius_m) for i, w in enumerate(waypoints)]
    for i, length in enumerate(lengths):
        following = (i + 1) % len(waypoints)
        taken = corner_bends[i].setback_m + corner_bends[following].setback_m
        if taken > length:
            raise ConfigError(
                f"waypoints[{following}]: the bends at both ends of the leg of {length:.4g} m to it"
                f" take {taken:.4g} m; radii of {length / taken * 0.99:.2g} times theirs would fit"
            )

    bends: list[Bend] = []
    curvature: Points = [(0.0, 0.0)]
    middles = [0.0]  # arc length of each waypoint
    s_m = 0.0
    for i, length in enumerate(lengths):
        corner = corner_bends[(i + 1) % len(waypoints)]
        s_m += length - corner_bends[i].setback_m - corner.setback_m
        middles.append(s_m + corner.length_m / 2.0)
        if corner.curvature_pm:
            bends.append(Bend(s_m, s_m + corner.length_m, 1.0 / abs(corner.curvature_pm)))
            curvature += [(s_m + s, k) for s, k in corner.points]
        s_m += corner.length_m
    heading = smooth_profile(_rising(curvature), flat=2)
    heading.c[-1] += courses[0]
    plan = _plan(heading)
    outset = corner_bends[0].setback_m * np.array([math.cos(courses[0]), math.sin(courses[0])])
    plan.c[-1] += corners[0] + outset - plan(0.0)
    if not heights:
        if closed:
            middles[0] = middles.pop() - s_m  # of the first waypoint, before the start
        heights = [
            (s, w.height_m)
            for s, w in zip(middles, waypoints, strict=True)
            if w.height_m is not None
        ]
    height, crests = _height(heights, s_m, closed)
    return Road(s_m, closed, heading, plan, height, tuple(bends), crests)


class _Corner(NamedTuple):
    """A bend by itself: curvature over its length, and what it takes of the legs."""

    curvature_pm: float  # at its sharpest, positive to the right
    length_m: float
    setback_m: float
    points: Points


def _between(course: float, following: float) -> float:
    """Turn from one course to another, rad in [−π, π)."""
    return (following - course + math.pi) % (2.0 * math.pi) - math.pi


def _corner(number: int, waypoint: Waypoint, turn: float, radius_m: float) -> _Corner:
    size = abs(turn)
    if size < 1e-9:
        return _Corner(0.0, 0.0, 0.0, [])
    if size > _SHARPEST_RAD:
        raise ConfigError(
            f"waypoints[{number}]: the road turns by {math.degrees(size):.0f}° here;"
            f" expected up to {math.degrees(_SHARPEST_RAD):.0f}° at one waypoint"
        )
    radius = waypoint.radius_m or radius_m * max(1.0, 1.0 / math.tan(size / 2.0))
    ramp, arc = _EASING * radius * size, (1.0 - _EASING) * radius * size
    k = math.copysign(1.0 / radius, turn)
    points = [(0.0, 0.0), (ramp, k), (ramp + arc, k), (2.0 * ramp + arc, 0.0)]
    length = points[-1][0]
    ahead = float(np.ptp(_plan(smooth_profile(points, flat=2))([0.0, length])[:, 0]))
    return _Corner(k, length, ahead / (1.0 + math.cos(turn)), points)


def _rising(points: Points) -> Points:
    """Points without those that repeat the arc length before them (bends that touch)."""
    return points[:1] + [
        point for before, point in itertools.pairwise(points) if point[0] > before[0]
    ]


def _plan(heading: PPoly) -> PPoly:
    """North and east along a heading: the integral of its direction, cut into slight turns."""
    knots = [heading.x[:1]]
    for begin, end in itertools.pairwise(heading.x):
        turn = float(np.ptp(heading([begin, end])))
        pieces = math.ceil(turn / _PIECE_RAD) + 3 if turn > 0.0 else 1
        knots.append(np.linspace(begin, end, pieces + 1)[1:])
    x = np.concatenate(knots)
    width = np.diff(x)
    u = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
    angles = heading(x[:-1] + np.outer(u, width))
    nodes = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    powers = np.linalg.solve(np.vander(u), nodes.reshape(u.size, -1)).reshape(nodes.shape)
    bent = (angles != angles[0]).any(axis=0)
    powers[:, ~bent] = 0.0  # straight, to the last bit and however far
    powers[-1, ~bent] = nodes[0, ~bent]
    scale = width ** -np.arange(_DEGREE, -1, -1)[:, None]
    return PPoly(powers * scale[..., None], x).antiderivative()


def _height(
    heights: Sequence[tuple[float, float]], length_m: float, closed: bool
) -> tuple[PPoly, tuple[Bend, ...]]:
    """Height along the road: straight grades, rounded where they meet; and where that is."""
    if len(heights) < 2:
        level = smooth_profile([(0.0, 0.0)], flat=2)
        level.c[-1] += heights[0][1] if heights else 0.0
        return level, ()
    known = np.array(heights)
    if closed:
        lap = np.array([length_m, 0.0])
        known = np.concatenate([known - lap, known, known + lap])
    apart = np.diff(known[:, 0])
    if not (apart > 0.0).all():
        raise ConfigError(f"heights: {known[np.argmin(apart) + 1][0]:g} m does not come later")
    grades = np.diff(known[:, 1]) / apart
    steepest = int(np.argmax(np.abs(grades)))
    if abs(grades[steepest]) > _STEEPEST:
        raise ConfigError(
            f"heights: the grade after {known[steepest][0] % length_m:.4g} m is"
            f" {abs(grades[steepest]):.0%}; expected up to {_STEEPEST:.0%}"
        )
    # Level beyond the heights given, unless they reach the road's end.
    first = grades[0] if closed or known[0][0] <= 0.0 else 0.0
    last = grades[-1] if closed or known[-1][0] >= length_m else 0.0
    slopes = np.concatenate([[first], grades, [last]])
    room = np.concatenate([[np.inf], apart, [np.inf]])
    half = np.minimum(0.4 * np.minimum(room[:-1], room[1:]), _CREST_M)
    points: Points = []
    crests = []
    for s, e, before, after in zip(known[:, 0], half, slopes, slopes[1:], strict=False):
        points += [(s - e, before), (s + e, after)]
        if before != after:
            crests.append(Bend(s - e, s + e, 2.0 * e / (STEEPNESS * abs(after - before))))
    height = smooth_profile(points, flat=2)
    middle = (known[0] + known[1]) / 2.0  # on a straight grade
    height.c[-1] += middle[1] - height(middle[0])
    return height, tuple(c for c in crests if c.end_m > 0.0 and c.begin_m < length_m)
