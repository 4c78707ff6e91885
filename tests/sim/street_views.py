"""Roads and views that the tests of surroundings share."""

from __future__ import annotations

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.road import Road, Waypoint, lay_road
from deepgnss.sim.scenario import View
from deepgnss.sim.surroundings.schema import ObstacleConfig, build_surroundings
from deepgnss.sim.surroundings.sight import Seen

L1_HZ = 1575.42e6
WAVELENGTH_M = 299_792_458.0 / L1_HZ
ANTENNA_M = 1.5


def northward(length_m: float = 1000.0) -> Road:
    """Straight and level to the north."""
    return lay_road([Waypoint(0.0, 0.0), Waypoint(length_m, 0.0)], radius_m=10.0)


def surrounded(
    *obstacles: dict[str, object],
    road: Road | None = None,
    seed: int = 1,
    seconds: float = 100.0,
    local: bool = False,
) -> Seen:
    """Surroundings of obstacles as in a scenario file; sharp edges are asked for as there."""
    built = build_surroundings(
        [ObstacleConfig.model_validate(one) for one in obstacles],
        road=None if local else road or northward(),
        seed=seed,
        seconds=seconds,
        antenna_height_m=ANTENNA_M,
    )
    if built is None:
        raise ValueError("nothing was built")
    return built


def view(
    azimuth_deg: FloatArray | float,
    elevation_deg: FloatArray | float,
    *,
    north_m: FloatArray | float = 500.0,
    east_m: FloatArray | float = 0.0,
    up_m: FloatArray | float = ANTENNA_M,
    t_s: FloatArray | float = 0.0,
    satellite: str = "G05",
) -> View:
    """A view whose inputs are broadcast against each other."""
    parts = [azimuth_deg, elevation_deg, north_m, east_m, up_m, t_s]
    az, el, n, e, u, t = (x.ravel().astype(float) for x in np.broadcast_arrays(*parts))
    az = np.atleast_1d(az)
    return View(satellite, t, np.column_stack([n, e, -u]), np.radians(az), np.radians(el))


def direct(around: Seen, seen: View) -> FloatArray:
    """Amplitude of the line of sight, (n,)."""
    return around.arrivals(seen, L1_HZ).direct
