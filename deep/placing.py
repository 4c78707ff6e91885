"""Positions that take the navigation as a measurement.

Where few satellites are left, or all in one direction, the ranges of a tag and the antenna as the
inertial navigation predicts it for that tag are adjusted together, each by its covariance. The
result goes into files only: the navigation is fed with ranges, or with positions made of ranges
alone, so that nothing comes back to it as news.

The prediction knows all tags before and nothing of this one; but ranges err for seconds in one
direction, and of c tags that count as one the prediction has had all but this. So a tag brings
only 1/c of its information about the place, as it does to the filter:

    C⁻¹ = P⁻¹ + N/c,   x = x⁻ + C·(N/c)·(x_r − x⁻)

with N of the tag's ranges, clocks eliminated. Both come from the plain adjustment of ranges and
prediction (C₁, x₁): N = C₁⁻¹ − P⁻¹ and N·(x_r − x⁻) = C₁⁻¹·(x₁ − x⁻). After a gap c is 1. Given
the place, the clock is the ranges' own: b = b₁ + g·(x − x₁), g the slope of b on x in C₁.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.deep.navigation import LASTING_M, Antenna, NavigationState
from deepgnss.receiver import pvt
from deepgnss.receiver.beside import Place
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.receiver import Fix

LOOSEST_M: Final = 10.0
"""Horizontal 1σ of a prediction beyond which it is of no use to a position."""

_BY_SCREEN = "range"  # how its reasons begin


class Placing:
    """Makes the positions of one run; remembers the bias between systems."""

    def __init__(self, parameters: PvtParameters) -> None:
        errors = replace(parameters.errors, lasting_m=LASTING_M)
        self._parameters = replace(parameters, errors=errors)
        self._last: NavSolution | None = None

    def take(self, fix: Fix, state: NavigationState) -> NavSolution:
        """The position of a tag with what the navigation expected there; without, if that fails.

        Who was refused by the outlier test stays out; RAIM judges anew, with one who knows better.
        """
        own = fix.solution
        if state.expected is None:
            return own
        place = _place(state.expected)
        if horizontal_sigma_m(place.covariance_m2, place.r_e_m) > LOOSEST_M:
            return own
        refused = {s: why for s, why in own.rejected.items() if why.startswith(_BY_SCREEN)}
        found = pvt.solve_measured(
            fix.measured, self._parameters, self._last or own, refused, place
        )
        if not found.valid:
            return own if own.valid else _by_dead_reckoning(fix.epoch.time, place, found)
        self._last = found
        return replace(_weighed(found, place, state.together), source="gnss+ins")


def _weighed(found: NavSolution, place: Place, together: float) -> NavSolution:
    """A plain adjustment with less weight on its ranges; formulas at the top."""
    r_e_m, clock_m, covariance = _less_news(
        found.r_e_m, found.covariance_m2, place.r_e_m, place.covariance_m2, together
    )
    moved_m = r_e_m - found.r_e_m
    return replace(
        found,
        r_e_m=r_e_m,
        clock_s=found.clock_s + clock_m / SPEED_OF_LIGHT_MPS,
        covariance_m2=covariance,
        residuals_m=_moved(found, moved_m, clock_m),
    )


@brief_kernel
def _less_news(
    r_1_e_m: FloatArray,
    C1: FloatArray,
    prior_e_m: FloatArray,
    P: FloatArray,
    together: float,
) -> tuple[FloatArray, float, FloatArray]:
    """Place x (3,), by how much the clock moves, m, and covariance (4, 4) of both."""
    both, prior = np.linalg.inv(C1[:3, :3].copy()), np.linalg.inv(P)
    C = np.linalg.inv(prior + (both - prior) / together)
    C = 0.5 * (C + C.T)
    r_e_m = prior_e_m + C @ both @ (r_1_e_m - prior_e_m) / together
    g = both @ C1[:3, 3].copy()
    covariance = np.empty((4, 4))
    covariance[:3, :3], covariance[:3, 3], covariance[3, :3] = C, C @ g, C @ g
    covariance[3, 3] = C1[3, 3] - C1[3, :3].copy() @ g + g @ C @ g
    return r_e_m, float(g @ (r_e_m - r_1_e_m)), covariance


def _moved(found: NavSolution, moved_m: FloatArray, clock_m: float) -> dict[str, float]:
    """Residuals from a place somewhat off: what is nearer by u·d has a range as much too long."""
    lat_rad, lon_rad, _ = geodetic(found.r_e_m)
    north_m, east_m, down_m = (C_ne(lat_rad, lon_rad) @ moved_m).tolist()
    residuals = {}
    for satellite, residual_m in found.residuals_m.items():
        azimuth, elevation = found.azimuth_elevation_rad[satellite]
        level_m = math.cos(azimuth) * north_m + math.sin(azimuth) * east_m
        nearer_m = math.cos(elevation) * level_m - math.sin(elevation) * down_m
        residuals[satellite] = residual_m + nearer_m - clock_m
    return residuals


def horizontal_sigma_m(covariance_m2: FloatArray, r_e_m: FloatArray) -> float:
    """1σ of a position in the horizontal plane, north and east together, of its covariance."""
    lat_rad, lon_rad, _ = geodetic(r_e_m)
    level = C_ne(lat_rad, lon_rad)[:2]
    return math.sqrt(np.trace(level @ covariance_m2[:3, :3] @ level.T))


def _place(expected: Antenna) -> Place:
    lat_rad, lon_rad, _ = geodetic(expected.r_e_m)
    to_e = C_ne(lat_rad, lon_rad).T
    P = expected.covariance
    return Place(
        expected.r_e_m,
        expected.v_e_mps,
        to_e @ P[:3, :3] @ to_e.T,
        to_e @ P[3:, 3:] @ to_e.T,
    )


def _by_dead_reckoning(time: GpsTime, place: Place, failed: NavSolution) -> NavSolution:
    """The prediction itself, where no range is left to say more."""
    covariance_m2, velocity_covariance_m2ps2 = np.full((4, 4), np.nan), np.full((4, 4), np.nan)
    covariance_m2[:3, :3] = place.covariance_m2
    velocity_covariance_m2ps2[:3, :3] = place.velocity_covariance_m2ps2
    return replace(
        pvt.unsolved(time, "", failed.rejected),
        valid=True,
        r_e_m=place.r_e_m,
        v_e_mps=place.v_e_mps,
        covariance_m2=covariance_m2,
        velocity_covariance_m2ps2=velocity_covariance_m2ps2,
        source="ins",
    )
