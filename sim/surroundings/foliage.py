"""Trees: foliage attenuates by a mean and log-normal fading that is a property of the place.

The fading is a Gaussian random field over the ground, white numbers hashed from a lattice and
smoothed by cubic B-splines: any point can be asked for, in any order, and a car at rest sees no
change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray
from deepgnss.sim.seeds import seed_sequence
from deepgnss.sim.surroundings.panels import Panels
from deepgnss.sim.surroundings.shadow import Rays

# The correlation of a field smoothed by cubic B-splines is nearly exp(−(d / (1.155·spacing))²).
_SPACINGS_PER_COHERENCE: Final = 1.155
_FULL_M: Final = 1.0  # way through leaves from which on they attenuate in full
_TWO_PI: Final = 2.0 * math.pi


class Crowns(NamedTuple):
    """Convex pieces of a canopy: inside where planes[..., :3]·r ≤ planes[..., 3]."""

    planes: FloatArray  # (m, faces, 4)
    centres_m: FloatArray  # (m, 3)
    radii_m: FloatArray  # (m,)


@dataclass(frozen=True, slots=True)
class Trees:
    """A row of trees: attenuation in dB is mean + σ·(unit Gaussian field of the place)."""

    name: str
    crowns: Crowns
    mean_db: float
    sigma_db: float
    coherence_m: float
    seed: int
    index: tuple[int, ...]  # tells their fading from that of other trees

    def amplitude(self, rays: Rays, satellite: str) -> FloatArray:
        """Amplitude factor (n,) along rays to a satellite; 1 where they miss the crowns."""
        way_m = np.zeros(len(rays.start_m))
        _way_inside(rays, self.crowns, way_m)
        left = np.ones(way_m.size)
        inside = np.flatnonzero(way_m)
        if inside.size:
            points = rays.start_m[inside, :2] * (_SPACINGS_PER_COHERENCE / self.coherence_m)
            field = gaussian_field(points, _key(self.seed, (*self.index, *map(ord, satellite))))
            through = np.minimum(way_m[inside] / _FULL_M, 1.0)
            loss_db = through * (self.mean_db + self.sigma_db * field)
            left[inside] = 10.0 ** (-loss_db / 20.0)
        return left


def crowns(solids: Panels) -> Crowns:
    """Canopy of the shape of convex solids of six faces."""
    corners, normals = solids.corners_m, solids.normals
    reach = np.einsum("ij,ij->i", normals, corners[:, 0])
    planes = np.column_stack([normals, reach]).reshape(-1, 6, 4)
    points = corners.reshape(-1, 24, 3)
    centres = points.mean(axis=1)
    radii = np.linalg.norm(points - centres[:, None], axis=2).max(axis=1)
    return Crowns(planes, centres, radii)


def gaussian_field(points: FloatArray, key: int) -> FloatArray:
    """Gaussian field of variance 1 at points (n, 2) in units of the lattice, (n,)."""
    values = np.empty(len(points))
    _field(np.ascontiguousarray(points), np.uint64(key), values)
    return values


def _key(seed: int, index: tuple[int, ...]) -> int:
    return int(seed_sequence(seed, "foliage", *index).generate_state(1, np.uint64)[0])


@kernel
def _way_inside(rays: Rays, crowns: Crowns, way_m: FloatArray) -> None:
    """Add the way of each ray inside the pieces."""
    for n in range(way_m.size):
        r, d = rays.start_m[n], rays.along[n]
        for m in range(crowns.radii_m.size):
            centre, radius = crowns.centres_m[m], crowns.radii_m[m]
            x, y, z = centre[0] - r[0], centre[1] - r[1], centre[2] - r[2]
            ahead = x * d[0] + y * d[1] + z * d[2]
            if ahead < -radius or x * x + y * y + z * z - ahead * ahead > radius * radius:
                continue
            enter, leave = 0.0, rays.reach_m[n]
            for plane in crowns.planes[m]:
                height = plane[0] * r[0] + plane[1] * r[1] + plane[2] * r[2] - plane[3]
                slope = plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]
                if slope < 0.0:
                    enter = max(enter, -height / slope)
                elif slope > 0.0:
                    leave = min(leave, -height / slope)
                elif height > 0.0:
                    leave = 0.0
            way_m[n] += max(leave - enter, 0.0)


@kernel
def _field(points: FloatArray, key: np.uint64, values: FloatArray) -> None:
    """Sum of 4 × 4 lattice numbers under a cubic B-spline, over the root of the weights' squares.

    Numbers are drawn anew only when the cell changes; which they are depends on the cell alone.
    """
    numbers = np.empty((4, 4))
    weight = np.empty((2, 4))
    row, column = 0, 0
    for n in range(values.size):
        i, j = math.floor(points[n, 0]), math.floor(points[n, 1])
        if n == 0 or i != row or j != column:
            row, column = i, j
            for a in range(4):
                for b in range(4):
                    numbers[a, b] = _normal(key, row + a, column + b)
        for axis, cell in enumerate((i, j)):
            u = points[n, axis] - cell
            weight[axis, 0] = (1.0 - u) ** 3 / 6.0
            weight[axis, 1] = (4.0 - 6.0 * u**2 + 3.0 * u**3) / 6.0
            weight[axis, 2] = (1.0 + 3.0 * u + 3.0 * u**2 - 3.0 * u**3) / 6.0
            weight[axis, 3] = u**3 / 6.0
        total = power = 0.0
        for a in range(4):
            for b in range(4):
                w = weight[0, a] * weight[1, b]
                total += w * numbers[a, b]
                power += w * w
        values[n] = total / math.sqrt(power)


@kernel
def _normal(key: np.uint64, i: int, j: int) -> float:
    """Gaussian number of a lattice point: hashed (splitmix64), then Box and Muller's."""
    mixed = _mix(_mix(key + np.uint64(i)) + np.uint64(j))
    u = (float(mixed >> np.uint64(11)) + 0.5) / 9007199254740992.0
    turn = float(_mix(mixed) >> np.uint64(11)) / 9007199254740992.0
    return math.sqrt(-2.0 * math.log(u)) * math.cos(_TWO_PI * turn)


@kernel
def _mix(x: np.uint64) -> np.uint64:
    """One step of splitmix64 (Steele, Lea, Flood 2014)."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
