"""A drive along a road: speed limits, stops and bends become a smooth arc length over time.

Between stretches of constant speed the speed passes over by steps 10u³ − 15u⁴ + 6u⁵, as quickly as
acceleration and jerk allow; it has come down to a limit where the limit begins.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import PPoly

from deepgnss.core.constants import STANDARD_GRAVITY_MPS2
from deepgnss.core.errors import ConfigError
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.attitude import Angles, banked
from deepgnss.sim.motion.jets import Jet, arctan
from deepgnss.sim.motion.paths import Motion
from deepgnss.sim.motion.profile import (
    BENDING,
    STEEPNESS,
    breaks,
    derivatives,
    smooth_profile,
)
from deepgnss.sim.motion.road import Road

_SAME_M: Final = 1e-6
_SAME_MPS: Final = 1e-9
_SAME_S: Final = 1e-9
_HALVINGS: Final = 60


class Limits(NamedTuple):
    """What the driver keeps to, all along the road."""

    speed_mps: float
    acceleration_mps2: float = 2.0
    braking_mps2: float = 2.5
    jerk_mps3: float = 2.0
    lateral_mps2: float = 2.5  # in bends, and up and down over crests and sags


class Zone(NamedTuple):
    """A stretch of road with a speed limit of its own."""

    begin_m: float
    end_m: float
    speed_mps: float


class Stop(NamedTuple):
    """A place to stand at for a while, on every lap."""

    at_m: float
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class StreetPath:
    """Motion along a road, `distance` in m of arc length over time."""

    road: Road
    distance: PPoly
    breaks_s: tuple[float, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Find when the vehicle passes from one piece of the road to the next."""
        crossings = _crossings(self.road, self.distance)
        object.__setattr__(self, "breaks_s", tuple(sorted({*breaks(self.distance), *crossings})))

    @property
    def arrival_s(self) -> float:
        """When the drive ends; the vehicle stands from then on."""
        return float(self.distance.x[-2])

    def __call__(self, t_s: FloatArray) -> Motion:
        """Motion at seconds since the start."""
        s, v, a = derivatives(self.distance, t_s, 3)
        s = self.road.wrapped(s)
        heading, curvature = derivatives(self.road.heading, s, 2)
        height, grade, rounding = derivatives(self.road.height, s, 3)
        north, east = np.cos(heading), np.sin(heading)
        bend, v2 = curvature * v * v, v * v
        return Motion(
            np.column_stack([self.road.plan(s), -height]),
            np.column_stack([north * v, east * v, -grade * v]),
            np.column_stack(
                [north * a - east * bend, east * a + north * bend, -grade * a - rounding * v2]
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class StreetAttitude:
    """Forward along the road, up and down with it.

    `bank` rolls into a turn by a share of the angle at which the lateral acceleration is not felt
    (negative: a soft car that leans out of it); `squat` raises the nose by a share of the angle
    whose tangent is the acceleration in g. With squat the velocity has a part along the body's
    down axis.
    """

    path: StreetPath
    bank: float = 0.0
    squat: float = 0.0

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Instants at which a derivative jumps."""
        return self.path.breaks_s

    def __call__(self, t_s: FloatArray) -> Angles:
        """Angles at seconds since the start."""
        road = self.path.road
        s, v, a, jerk, snap = derivatives(self.path.distance, t_s, 5)
        s = road.wrapped(s)
        along, speed = Jet(s, v, a), Jet(v, a, jerk)
        heading, *curvatures = derivatives(road.heading, s, 4)
        grades = derivatives(road.height, s, 4)[1:]
        curvature = along.through(*curvatures)
        pitch = arctan(along.through(*grades))
        if self.squat:
            pitch += arctan(Jet(a, jerk, snap) * (1.0 / STANDARD_GRAVITY_MPS2)) * self.squat
        return Angles(
            roll=banked(speed * speed * curvature, self.bank),
            pitch=pitch,
            yaw=along.through(heading, *curvatures[:2]),
        )


def drive(
    road: Road,
    limits: Limits,
    *,
    zones: Sequence[Zone] = (),
    stops: Sequence[Stop] = (),
    start_m: float = 0.0,
    laps: int = 1,
    speed_mps: float = 0.0,
) -> PPoly:
    """Arc length over time of a drive from `start_m` to the road's end, where it stands still.

    On a closed road it ends after `laps` laps, where it began; zones and stops hold on every lap.
    `speed_mps` is the speed at t = 0 (and before). The length is that of the plan: on a grade of
    10 % a speed is 0.5 % higher.

    Raises
    ------
    ConfigError: a stop, zone or start lies beyond the road, or the first speed is too high.
    """
    _check_places(road, zones, stops, start_m)
    end_m = start_m + laps * road.length_m if road.closed else road.length_m
    offsets = [lap * road.length_m for lap in range(laps + 1)] if road.closed else [0.0]
    slow = [
        Zone(bend.begin_m, bend.end_m, math.sqrt(limits.lateral_mps2 * bend.radius_m))
        for bend in (*road.bends, *road.crests)
    ]
    zones = [
        Zone(zone.begin_m + offset, zone.end_m + offset, zone.speed_mps)
        for offset in offsets
        for zone in (*zones, *slow)
    ]
    waits = {
        stop.at_m + offset: stop.seconds
        for offset in offsets
        for stop in stops
        if start_m <= stop.at_m + offset < end_m - _SAME_M
    }
    cells = _cells(start_m, end_m, zones, waits, limits.speed_mps)
    nodes = _node_speeds(cells, limits, speed_mps)
    points = [(0.0, speed_mps)]
    for cell, reached, left in zip(cells, nodes, nodes[1:], strict=False):
        if cell.wait_s:
            points.append((points[-1][0] + cell.wait_s, 0.0))
        points += _passage(points[-1][0], cell, reached, left, limits)
    distance = smooth_profile(points, flat=2)
    distance.c[-1] += start_m
    return distance


def _check_places(road: Road, zones: Sequence[Zone], stops: Sequence[Stop], start_m: float) -> None:
    places = [("start", start_m)]
    places += [(f"stops[{i}].at", stop.at_m) for i, stop in enumerate(stops)]
    places += [(f"zones[{i}].from", zone.begin_m) for i, zone in enumerate(zones)]
    for key, place in places:
        if not 0.0 <= place < road.length_m:
            raise ConfigError(
                f"{key}: {place:g} m is not on the road, which is {road.length_m:.1f} m long"
            )
    for i, zone in enumerate(zones):
        if zone.end_m <= zone.begin_m:
            raise ConfigError(f"zones[{i}].to: {zone.end_m:g} m is not after {zone.begin_m:g} m")


class _Cell(NamedTuple):
    """A stretch of one speed limit; the vehicle first stands at its beginning for `wait_s`."""

    length_m: float
    speed_mps: float
    wait_s: float


def _cells(
    start_m: float, end_m: float, zones: Sequence[Zone], waits: Mapping[float, float], most: float
) -> list[_Cell]:
    edges = {edge for zone in zones for edge in (zone.begin_m, zone.end_m)}
    inner = sorted(x for x in edges | set(waits) if start_m < x < end_m)
    places = [start_m]
    for place in (*inner, end_m):
        if place - places[-1] > _SAME_M:
            places.append(place)
    cells: list[_Cell] = []
    for begin, end in itertools.pairwise(places):
        middle = (begin + end) / 2.0
        inside = [zone.speed_mps for zone in zones if zone.begin_m <= middle < zone.end_m]
        wait_s = sum(wait for at, wait in waits.items() if 0.0 <= at - begin <= _SAME_M)
        cells.append(_Cell(end - begin, min([most, *inside]), wait_s))
    return _merged(cells)


def _merged(cells: Sequence[_Cell]) -> list[_Cell]:
    """Neighbours of one limit without a stop between them as one."""
    merged = [cells[0]]
    for cell in cells[1:]:
        last = merged[-1]
        if cell.speed_mps == last.speed_mps and not cell.wait_s:
            merged[-1] = last._replace(length_m=last.length_m + cell.length_m)
        else:
            merged.append(cell)
    return merged


def _node_speeds(cells: Sequence[_Cell], limits: Limits, first_mps: float) -> list[float]:
    """Speeds at the beginnings of the cells and at the end, with room to change between them."""
    if cells[0].wait_s and first_mps:
        raise ConfigError(f"initial_speed: {first_mps:g} m/s at a place to stop")
    speeds = [first_mps]
    for before, cell in itertools.pairwise(cells):
        speeds.append(0.0 if cell.wait_s else min(before.speed_mps, cell.speed_mps))
    speeds.append(0.0)
    for i, cell in reversed(list(enumerate(cells))):  # brake in time
        speeds[i] = _largest(speeds[i + 1], speeds[i], _braking_fits(speeds[i + 1], cell, limits))
    most = min(speeds[0], cells[0].speed_mps)
    if first_mps > most:
        raise ConfigError(
            f"initial_speed: {first_mps:g} m/s; the road ahead allows up to {most:.3g} m/s"
        )
    for i, cell in enumerate(cells):  # not faster than there was room to reach
        speeds[i + 1] = _largest(speeds[i], speeds[i + 1], _gaining_fits(speeds[i], cell, limits))
    return speeds


class _Change(NamedTuple):
    seconds: float
    metres: float


def _change(before_mps: float, after_mps: float, limits: Limits) -> _Change:
    """The quickest smooth step from one speed to another."""
    step = abs(after_mps - before_mps)
    most = limits.acceleration_mps2 if after_mps > before_mps else limits.braking_mps2
    seconds = max(STEEPNESS * step / most, math.sqrt(BENDING * step / limits.jerk_mps3))
    return _Change(seconds, (before_mps + after_mps) / 2.0 * seconds)


def _braking_fits(after_mps: float, cell: _Cell, limits: Limits) -> Callable[[float], bool]:
    """Whether there is room to come down from a speed."""
    return lambda speed: _change(speed, after_mps, limits).metres <= cell.length_m


def _gaining_fits(before_mps: float, cell: _Cell, limits: Limits) -> Callable[[float], bool]:
    """Whether there is room to reach a speed."""
    return lambda speed: _change(before_mps, speed, limits).metres <= cell.length_m


def _largest(low: float, high: float, fits: Callable[[float], bool]) -> float:
    """The largest value of [low, high] that fits; low does, and `high` below it is as it is."""
    if high <= low or fits(high):
        return high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _passage(
    t_s: float, cell: _Cell, before_mps: float, after_mps: float, limits: Limits
) -> list[tuple[float, float]]:
    """(time, speed) points through a cell: up to what its limit and length allow, and down."""
    least = max(before_mps, after_mps)

    def ends(speed: float) -> tuple[_Change, _Change]:
        return _change(before_mps, speed, limits), _change(speed, after_mps, limits)

    top = _largest(
        least, cell.speed_mps, lambda speed: sum(c.metres for c in ends(speed)) <= cell.length_m
    )
    if top - least < _SAME_MPS:
        top = least
    rise, fall = ends(top)
    steady_s = (cell.length_m - rise.metres - fall.metres) / top
    points = []
    for seconds, speed in ((rise.seconds, top), (steady_s, top), (fall.seconds, after_mps)):
        if seconds > _SAME_S:
            t_s += seconds
            points.append((t_s, speed))
    return points


def _crossings(road: Road, distance: PPoly) -> FloatArray:
    """Times at which the vehicle passes the road's knots, by bisection: it never goes back."""
    first, last = distance.x[1], distance.x[-2]
    begin, end = distance([first, last])
    laps = range(math.floor(end / road.length_m) + 1) if road.closed else range(1)
    knots = np.concatenate([road.knots_m + lap * road.length_m for lap in laps])
    knots = knots[(knots > begin) & (knots < end)]
    low, high = np.full(knots.size, first), np.full(knots.size, last)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        ahead = distance(middle) < knots
        low, high = np.where(ahead, middle, low), np.where(ahead, high, middle)
    return np.unique(low)
