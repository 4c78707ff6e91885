"""CSV tables of a run, one row at a time: solution, satellites, channels, observations, events.

A blank cell is a number that does not exist (no fix, not finite). Angles are in degrees.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import ChannelReport, Epoch, Event, FloatArray, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.io.output import OutputFile, Writer


class Table(Writer):
    """A CSV file with a header line; rows are lists of text."""

    columns: ClassVar[tuple[str, ...]]

    def __init__(self, path: Path) -> None:
        file = OutputFile(path)
        self._file = file
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(self.columns)

    def _row(self, cells: Sequence[str]) -> None:
        self._rows.writerow(cells)


_FIXED = tuple(f".{digits}f" for digits in range(16))


def number(value: float, digits: int) -> str:
    """Fixed-point text, blank when the value is not finite; never −0."""
    if not math.isfinite(value):
        return ""
    text = format(value, _FIXED[digits])
    return text if value > 0.0 or text.strip("-0.") else text.lstrip("-")


def _time(time: GpsTime) -> list[str]:
    return [str(time.week), f"{time.tow_s:.6f}"]


def _numbers(values: Iterable[float], digits: int) -> list[str]:
    return [number(float(value), digits) for value in values]


class SolutionTable(Table):
    """solution.csv: one row per epoch, fix or not; sigmas and velocity in NED."""

    columns = (
        *("week", "tow_s", "valid", "lat_deg", "lon_deg", "height_m", "x_e_m", "y_e_m", "z_e_m"),
        *("v_n_mps", "v_e_mps", "v_d_mps", "clock_s", "drift_sps", "isb_bds_s"),
        *("sigma_n_m", "sigma_e_m", "sigma_d_m", "sigma_clock_m"),
        *("sigma_vn_mps", "sigma_ve_mps", "sigma_vd_mps"),
        *("gdop", "pdop", "hdop", "vdop", "tdop", "used", "satellites", "rejected", "reason"),
        "source",
    )

    def write(self, solution: NavSolution) -> None:
        """Append one epoch."""
        s = solution
        rejected = "; ".join(f"{name} {s.rejected[name]}" for name in sorted(s.rejected))
        satellites = [str(len(s.used)), " ".join(sorted(s.used)), rejected, s.reason]
        satellites.append(s.source if s.valid else "")
        dops = _numbers((s.dops.get(name, math.nan) for name in _DOPS), 3)
        if not s.valid:
            blanks = [""] * (len(self.columns) - 3 - len(dops) - len(satellites))
            self._row([*_time(s.time), "0", *blanks, *dops, *satellites])
            return
        lat, lon, height_m = geodetic(s.r_e_m)
        to_n = C_ne(lat, lon)
        self._row(
            [
                *_time(s.time),
                "1",
                *_numbers((math.degrees(lat), math.degrees(lon)), 10),
                *_numbers((height_m, *s.r_e_m), 4),
                *_numbers(to_n @ s.v_e_mps, 4),
                number(s.clock_s, 12),
                number(s.drift_sps, 14),
                number(s.isb_s.get("C", math.nan), 12),
                *_numbers(_sigmas(to_n, s.covariance_m2), 4),
                *_numbers(_sigmas(to_n, s.velocity_covariance_m2ps2)[:3], 4),
                *dops,
                *satellites,
            ]
        )


_DOPS = ("gdop", "pdop", "hdop", "vdop", "tdop")


def _sigmas(to_n: FloatArray, covariance: FloatArray) -> FloatArray:
    """NED and clock standard deviations (4,) of an ECEF covariance (4, 4)."""
    local = np.diag(to_n @ covariance[:3, :3] @ to_n.T)
    sigmas: FloatArray = np.sqrt(np.maximum(np.append(local, covariance[3, 3]), 0.0))
    return sigmas


class SatelliteTable(Table):
    """satellites.csv: direction, pseudorange residual and use of each satellite per epoch."""

    columns = (
        *("week", "tow_s", "satellite", "azimuth_deg", "elevation_deg", "residual_m"),
        *("used", "rejected"),
    )

    def write(self, solution: NavSolution) -> None:
        """Append the satellites of one epoch."""
        names = {*solution.azimuth_elevation_rad, *solution.residuals_m, *solution.rejected}
        for name in sorted(names | set(solution.used)):
            direction = solution.azimuth_elevation_rad.get(name, (math.nan, math.nan))
            self._row(
                [
                    *_time(solution.time),
                    name,
                    *_numbers((math.degrees(x) for x in direction), 3),
                    number(solution.residuals_m.get(name, math.nan), 3),
                    str(int(name in solution.used)),
                    solution.rejected.get(name, ""),
                ]
            )


class ChannelTable(Table):
    """channels.csv: state of every channel per navigation epoch."""

    columns = (
        *("recording_s", "week", "tow_s", "satellite", "signal", "stage", "mode", "cn0_dbhz"),
        *("doppler_hz", "carrier_lock", "aiding_minus_loop_hz", "lock_time_s", "coherent_s"),
        *("carrier_bandwidth_hz", "code_bandwidth_hz"),
    )

    def write(
        self, recording_s: float, time: GpsTime | None, reports: Iterable[ChannelReport]
    ) -> None:
        """Append the channels of one epoch, `recording_s` after sample 0; time: None as yet."""
        start = [f"{recording_s:.6f}", *(_time(time) if time else ("", ""))]
        self._rows.writerows(
            [
                *start,
                *(r.satellite, r.signal, r.stage, r.mode),
                number(r.cn0_dbhz, 2),
                number(r.doppler_hz, 3),
                number(r.carrier_lock, 4),
                number(r.aiding_minus_loop_hz, 3),
                number(r.lock_time_s, 3),
                number(r.coherent_s, 4),
                number(r.carrier_bandwidth_hz, 2),
                number(r.code_bandwidth_hz, 3),
            ]
            for r in reports
        )


class ObservationTable(Table):
    """observations.csv: what RINEX holds, with lock times and transmission times."""

    columns = (
        *("week", "tow_s", "satellite", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz"),
        *("cn0_dbhz", "lock_time_s", "slip", "half_cycle", "carrier_valid"),
        *("transmit_week", "transmit_tow_s"),
    )

    def write(self, epoch: Epoch) -> None:
        """Append the observations of one epoch."""
        for o in sorted(epoch.observations, key=lambda o: (o.satellite, o.signal)):
            self._row(
                [
                    *_time(epoch.time),
                    *(o.satellite, o.signal),
                    *(number(o.pseudorange_m, 4), number(o.carrier_cycles, 4)),
                    *(number(o.doppler_hz, 4), number(o.cn0_dbhz, 2), number(o.lock_time_s, 3)),
                    *(str(int(flag)) for flag in (o.slip, o.half_cycle, o.carrier_valid)),
                    *(str(o.transmit.week), f"{o.transmit.tow_s:.11f}"),
                ]
            )


class EventTable(Table):
    """events.csv: every transition with its reason."""

    columns = ("sample", "recording_s", "satellite", "what", "reason")

    def __init__(self, path: Path, sample_rate_hz: float) -> None:
        super().__init__(path)
        self._sample_rate_hz = sample_rate_hz

    def write(self, events: Iterable[Event]) -> None:
        """Append events in the order given."""
        for e in events:
            seconds = f"{e.sample / self._sample_rate_hz:.6f}"
            self._row([str(e.sample), seconds, e.satellite, e.what, e.reason])
