"""Truth of a recording as CSV: antenna, clock, ranges, navigation symbols."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.vehicle import Pose, geographic
from deepgnss.sim.output.columns import TIME_COLUMNS, ColumnTable, instants, time_columns
from deepgnss.sim.output.sight import orbits_of, places_of, sight
from deepgnss.sim.scenario import Scenario

_POSITION: Final[Mapping[str, int | None]] = {"lat_deg": 11, "lon_deg": 11, "height_m": 5}
_VELOCITY: Final[Mapping[str, int | None]] = {"vn_mps": 6, "ve_mps": 6, "vd_mps": 6}
_ATTITUDE: Final[Mapping[str, int | None]] = {"roll_deg": 8, "pitch_deg": 8, "heading_deg": 8}
MOTION_COLUMNS: Final = {**TIME_COLUMNS, **_POSITION, **_VELOCITY, **_ATTITUDE}

_RANGES: Final[Mapping[str, int | None]] = {
    **{"week": None, "tow": 3, "prn": None, "az_deg": 6, "el_deg": 6, "pseudorange_m": 5},
    **{"carrier_cycles": 5, "geom_range_m": 5, "iono_m": 5, "range_rate_mps": 6},
    **{"cn0_dbhz": 2, "tropo_m": 5, "satellite_clock_m": 5},
    **{"satellite": None, "signal": None, "doppler_hz": 4, "visible": None, "direct": 4},
    **{"line_of_sight": None, "cause": None, "reflection": 4, "reflection_excess_m": 3},
}
"""The first ones as other tools have them; `prn` alone would not tell the systems apart."""


def motion_cells(pose: Pose) -> tuple[FloatArray, ...]:
    """Cells of MOTION_COLUMNS after the time."""
    seen = geographic(pose)
    roll, pitch, yaw = np.degrees(seen.euler_rad).T
    return (
        np.degrees(seen.lat_rad),
        np.degrees(seen.lon_rad),
        seen.height_m,
        *seen.v_n_mps.T,
        roll,
        pitch,
        np.mod(yaw, 360.0),
    )


def write_truth(path: Path, scenario: Scenario, rate_hz: float) -> None:
    """truth.csv: the first antenna, with the vehicle's attitude."""
    lever_b_m = scenario.antennas[0].lever_b_m
    with ColumnTable(path, MOTION_COLUMNS) as table:
        for t_s in instants(scenario.start, scenario.seconds, 1.0 / rate_hz):
            antenna = scenario.vehicle.point(t_s, lever_b_m)
            pose = scenario.vehicle.pose(t_s)._replace(r_e_m=antenna.r_m, v_e_mps=antenna.v_mps)
            table.write(*time_columns(scenario.start, t_s), *motion_cells(pose))


def write_ranges(path: Path, scenario: Scenario, step_s: float) -> None:
    """ranges.csv: what a perfect receiver with a perfect clock measures, time by time.

    Range rate is that of the geometric range; pseudorange and phase are those of the free line
    of sight, also where it is blocked (`visible` 0); C/N0 is that of the line of sight as it is.
    """
    names = [e.satellite for e in scenario.emitters]
    prns = [e.prn for e in scenario.emitters]
    signals = [e.signal.id.name for e in scenario.emitters]
    orbits = orbits_of(scenario)
    chunk = 2000
    with ColumnTable(path, _RANGES) as table:
        for t_s in instants(scenario.start, scenario.seconds, step_s, chunk):
            weeks, tows_s = time_columns(scenario.start, t_s)
            places = places_of(scenario, t_s)
            seen = [
                sight(scenario, emitter, orbit, places)
                for emitter, orbit in zip(scenario.emitters, orbits, strict=True)
            ]

            def by_time(values: list[FloatArray]) -> FloatArray:
                return np.array(values).T.reshape(-1)

            truths = [one.reception for one in seen]
            count = len(seen)
            table.write(
                np.repeat(weeks, count),
                np.repeat(tows_s, count),
                prns * t_s.size,
                np.degrees(by_time([one.azimuth_rad for one in truths])),
                np.degrees(by_time([one.elevation_rad for one in truths])),
                by_time([one.pseudorange_m for one in truths]),
                by_time([one.carrier_cycles for one in truths]),
                by_time([one.range_m for one in truths]),
                by_time([one.ionosphere_m for one in truths]),
                by_time([one.range_rate_mps for one in seen]),
                by_time([one.cn0_dbhz for one in seen]),
                by_time([one.troposphere_m for one in truths]),
                by_time([one.satellite_clock_m for one in truths]),
                names * t_s.size,
                signals * t_s.size,
                by_time([one.doppler_hz for one in seen]),
                np.array([one.visible for one in seen]).T.reshape(-1).astype(int),
                by_time([one.direct for one in seen]),
                np.array([one.state for one in seen]).T.reshape(-1),
                np.array([one.cause for one in seen]).T.reshape(-1),
                by_time([one.ray for one in seen]),
                by_time([one.ray_excess_m for one in seen]),
            )
