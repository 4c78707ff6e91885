"""Which satellites stand where over a vehicle's place."""

from __future__ import annotations

import numpy as np

from deepgnss.core.records import FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.sim.delays import look
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import nearest_set, orbit_of, travel


def elevations(nav: NavData, start: GpsTime, vehicle: Vehicle) -> dict[str, float]:
    """Elevation of every satellite of `nav` at the start, rad."""
    over = elevations_over(nav, start, vehicle, np.zeros(1))
    return {satellite: float(angles[0]) for satellite, angles in over.items()}


def elevations_over(
    nav: NavData, start: GpsTime, vehicle: Vehicle, t_s: FloatArray
) -> dict[str, FloatArray]:
    """Elevation of every satellite of `nav`, rad, at true times (n,), s from the start."""
    r_e_m = vehicle.point(t_s).r_m
    middle = start.plus(float(np.mean(t_s)))
    seen = {}
    for satellite, sets in nav.ephemerides.items():
        orbit = orbit_of(nearest_set(sets, middle), start)
        seen[satellite] = look(vehicle, travel(orbit, t_s, r_e_m), r_e_m)[1]
    return seen
