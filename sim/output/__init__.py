"""A simulated recording on disk: samples, config to process them, truth, ranges, NAV file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pymap3d
import yaml

from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.io.output import part_path, reporting, write_whole
from deepgnss.io.rinex_nav import write_nav
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import recording
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Scenario

_TRUTH_STEP_S: Final = 0.02
_RANGES_STEP_S: Final = 0.1
_NEIGHBOURS: Final = (-1.0e-3, 1.0e-3)  # s, whose difference gives the range rate
_TRUTH_HEAD: Final = "gps_week,gps_tow_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps"
_RANGES_HEAD: Final = (
    "week,tow,prn,az_deg,el_deg,pseudorange_m,carrier_cycles,geom_range_m,iono_m,"
    "range_rate_mps,cn0_dbhz,tropo_m,satellite_clock_m"
)


def write_scenario(
    scenario: Scenario,
    directory: Path,
    threads: int = 1,
    progress: Callable[[float], None] = lambda seconds: None,
) -> None:
    """Write rec.bin, config.yaml, truth.csv, ranges.csv and nav.rnx into a folder.

    `progress` is told the seconds of recording written so far.

    Raises
    ------
    OutputError: the folder or a file cannot be written.
    """
    with reporting(directory):
        directory.mkdir(parents=True, exist_ok=True)
    write_nav(directory / "nav.rnx", scenario.nav)
    write_whole(directory / "truth.csv", "\n".join([_TRUTH_HEAD, *_truth_rows(scenario), ""]))
    write_whole(directory / "ranges.csv", "\n".join([_RANGES_HEAD, *_range_rows(scenario), ""]))
    write_whole(directory / "config.yaml", yaml.safe_dump(config_of(scenario), sort_keys=False))
    _write_samples(scenario, directory / "rec.bin", threads, progress)


def config_of(scenario: Scenario) -> dict[str, Any]:
    """The configuration that processes the recording: format, front end, signals, truth."""
    (out,) = scenario.streams
    front_end = out.front_end
    stream = {
        "name": out.name,
        "format": front_end.format,
        "samples": "iq" if front_end.is_complex else "real",
        "sample_rate": front_end.sample_rate_hz,
        "centre_frequency": front_end.centre_hz,
        "intermediate_frequency": front_end.intermediate_hz,
    }
    start = scenario.start.utc().isoformat(timespec="seconds").replace("+00:00", "Z")
    return {
        "recording": {"start_time": start, "streams": [stream]},
        "signals": sorted({emitter.signal.id.name for emitter in scenario.emitters}),
        "truth": {"file": "truth.csv", "format": "csv"},
    }


def _write_samples(
    scenario: Scenario, path: Path, threads: int, progress: Callable[[float], None]
) -> None:
    front_end = scenario.streams[0].front_end
    total = 0
    with reporting(path), part_path(path).open("wb") as file:
        for piece in recording(scenario, threads=threads):
            file.write(piece)
            total += len(piece)
            progress(total / front_end.bytes_per_second)
    with reporting(path):
        part_path(path).replace(path)


def instants(scenario: Scenario, step_s: float) -> FloatArray:
    """True times, s from the start, that are multiples of `step_s` of GPST within the recording."""
    tow_s = scenario.start.tow_s
    first = math.ceil(round(tow_s / step_s, 6))
    last = math.floor(round((tow_s + scenario.seconds) / step_s, 6))
    return np.asarray(np.arange(first, last + 1) * step_s - tow_s, dtype=np.float64)


def _truth_rows(scenario: Scenario) -> Iterator[str]:
    """Antenna position and velocity, one row per instant of true time."""
    t_s = instants(scenario, _TRUTH_STEP_S)
    motion = scenario.vehicle.point(t_s)
    geodetic = np.column_stack(pymap3d.ecef2geodetic(*motion.r_m.T, deg=False))
    for t, (lat, lon, height), v_e in zip(t_s, geodetic, motion.v_mps, strict=True):
        north, east, down = C_ne(lat, lon) @ v_e + 0.0  # no -0.000000
        yield (
            f"{_time(scenario, t)},{math.degrees(lat):.11f},{math.degrees(lon):.11f},"
            f"{height:.5f},{north:.6f},{east:.6f},{down:.6f}"
        )


def _range_rows(scenario: Scenario) -> Iterator[str]:
    """What a perfect receiver with a perfect clock measures, time by time and PRN by PRN.

    Range rate is that of the geometric range; azimuth and elevation, the true ones.
    """
    t_s = instants(scenario, _RANGES_STEP_S)
    columns = []
    for emitter in scenario.emitters:
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        now = receive(scenario, emitter, orbit, t_s)
        before, after = (receive(scenario, emitter, orbit, t_s + d).range_m for d in _NEIGHBOURS)
        columns.append((emitter, now, (after - before) / (_NEIGHBOURS[1] - _NEIGHBOURS[0])))
    for k, t in enumerate(t_s):
        for emitter, now, rate_mps in columns:
            yield (
                f"{_time(scenario, t)},{emitter.prn},{math.degrees(now.azimuth_rad[k]):.6f},"
                f"{math.degrees(now.elevation_rad[k]):.6f},{now.pseudorange_m[k]:.5f},"
                f"{now.carrier_cycles[k]:.5f},{now.range_m[k]:.5f},{now.ionosphere_m[k]:.5f},"
                f"{rate_mps[k]:.6f},{emitter.cn0_at(t):.2f},{now.troposphere_m[k]:.5f},"
                f"{now.satellite_clock_m[k]:.5f}"
            )


def _time(scenario: Scenario, t_s: float) -> str:
    time = scenario.start.plus(float(t_s))
    return f"{time.week},{time.tow_s:.3f}"
