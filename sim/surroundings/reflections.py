"""Reflected rays: mirror images in upright walls and in the ground below.

The image of antenna r in a plane lies at r − 2D·n, D its distance in front; a far source along d
reaches the image 2D·(d·n) later, and the wall lets through what its outline catches on that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.sim.surroundings.shadow import Rays, Screens, Swath

_HANDOVER_M: Final = 4.0  # lead in distance with which a panel owns its ray in full


class Mirror(NamedTuple):
    """A ray that the thin pieces of a wall share: at a place it belongs to the nearest of them."""

    pieces: tuple[int, ...]
    reflectivity: float


class Image(NamedTuple):
    """Mirror image of an antenna in the plane of a piece, for a far source."""

    excess_m: FloatArray  # (n,) negative: the source stands behind the wall
    to_image: Rays  # from the image to the source, which crosses the wall
    to_wall: Rays  # from the antenna to the specular point
    from_wall: Rays  # from there to the source


def image(screens: Screens, piece: int, rays: Rays) -> Image:
    """Geometry of the reflection of `rays` (antenna to source) in a thin piece's plane."""
    panel = screens.first[piece]
    normal = screens.normals[panel]
    height_m = (rays.start_m - screens.corners_m[panel, 0]) @ normal
    slope = rays.along @ normal
    turned = rays.along - 2.0 * np.outer(slope, normal)
    way_m = height_m / np.where(np.abs(slope) > 1.0e-9, slope, 1.0e-9)
    return Image(
        2.0 * height_m * slope,
        Rays(rays.start_m - 2.0 * np.outer(height_m, normal), rays.along, rays.reach_m),
        Rays(rays.start_m, turned, way_m),
        Rays(rays.start_m + way_m[:, None] * turned, rays.along, rays.reach_m),
    )


def in_reach(
    screens: Screens, mirrors: Sequence[Mirror], rays: Rays, wavelength_m: float
) -> set[int]:
    """Pieces of mirrors that may reflect any of the rays: all that do, and few others."""
    pieces = np.array([piece for mirror in mirrors for piece in mirror.pieces], dtype=np.int64)
    if not pieces.size:
        return set()
    panels, swath = screens.first[pieces], Swath.of(rays)
    normals = screens.normals[panels]
    behind = np.einsum("ki,ki->k", swath.middle_m - screens.corners_m[panels, 0], normals)
    images = swath.middle_m - 2.0 * behind[:, None] * normals
    spheres = screens.centres_m[pieces], screens.radii_m[pieces]
    return set(pieces[swath.meets(images, *spheres, wavelength_m)].tolist())


def owners(
    mirror: Mirror, screens: Screens, start_m: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Piece (n,) that owns the mirror's ray at antennas (n, 3), and its weight (n,).

    The weight falls to zero where ownership changes, so that a ray never jumps while it sounds.
    """
    pieces = np.array(mirror.pieces)
    if pieces.size == 1:
        return np.full(len(start_m), pieces[0]), np.ones(len(start_m))
    panels = screens.first[pieces]
    foot = screens.corners_m[panels, 0, :2]
    along = screens.corners_m[panels, 1, :2] - foot
    to = start_m[:, None, :2] - foot
    part = np.clip(np.einsum("npi,pi->np", to, along) / np.sum(along**2, axis=1), 0.0, 1.0)
    distance = np.linalg.norm(to - part[:, :, None] * along, axis=2)
    nearest = np.sort(distance, axis=1)
    lead = np.minimum((nearest[:, 1] - nearest[:, 0]) / _HANDOVER_M, 1.0)
    return pieces[np.argmin(distance, axis=1)], lead**2 * (3.0 - 2.0 * lead)


class Ground(NamedTuple):
    """Level ground at a constant depth below the antenna."""

    depth_m: float
    reflectivity: float

    def excess_m(self, elevation_rad: FloatArray) -> FloatArray:
        """Extra path (n,) of the reflection in the ground."""
        return 2.0 * self.depth_m * np.sin(elevation_rad)
