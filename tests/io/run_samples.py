"""Records as the receiver hands them to the writers."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import (
    GPS_L1CA,
    Epoch,
    NavSolution,
    Observation,
    SampleInstant,
)
from deepgnss.core.time import GpsTime

WAVELENGTH_M = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
NOON = GpsTime(2190, 561_628.0)  # 2022-01-01 12:00:28 GPST


def observation(satellite: str = "G05", signal: str = "GPS_L1CA", **changes: object) -> Observation:
    values: dict[str, object] = {
        "satellite": satellite,
        "signal": signal,
        "pseudorange_m": 21_234_567.891,
        "carrier_cycles": 111_589_123.456,
        "doppler_hz": -1234.567,
        "cn0_dbhz": 45.25,
        "lock_time_s": 3.0,
        "slip": False,
        "half_cycle": False,
        "carrier_valid": True,
        "transmit": NOON.plus(-0.07),
    }
    return Observation(**(values | changes))  # type: ignore[arg-type]


def epoch(observations: Sequence[Observation], time: GpsTime = NOON) -> Epoch:
    return Epoch(time, SampleInstant(0, 0.0), tuple(observations))


def solution(
    lat_deg: float = 48.0,
    lon_deg: float = 11.5,
    height_m: float = 512.25,
    v_n_mps: Sequence[float] = (3.0, 4.0, -0.5),
    time: GpsTime = NOON,
    **changes: object,
) -> NavSolution:
    lat, lon = np.radians((lat_deg, lon_deg))
    to_n = C_ne(lat, lon)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = to_n.T @ np.diag((4.0, 1.0, 9.0)) @ to_n  # σ N 2, E 1, D 3 m
    covariance[3, 3] = 16.0
    values: dict[str, object] = {
        "time": time,
        "valid": True,
        "reason": "",
        "r_e_m": ecef(lat, lon, height_m),
        "v_e_mps": to_n.T @ np.asarray(v_n_mps),
        "clock_s": 1.5e-7,
        "drift_sps": -2.5e-9,
        "isb_s": {},
        "covariance_m2": covariance,
        "velocity_covariance_m2ps2": covariance / 100.0,
        "dops": {"gdop": 2.5, "pdop": 2.0, "hdop": 1.1, "vdop": 1.6, "tdop": 1.2},
        "used": ("G05", "G12", "G25", "G31"),
        "rejected": {"G22": "unhealthy"},
        "residuals_m": {"G05": 1.0, "G12": -1.0, "G25": 1.0, "G31": -1.0, "G22": 40.0},
        "azimuth_elevation_rad": {
            "G05": (0.1, 1.0),
            "G12": (np.radians(359.7), 0.5),
            "G25": (3.0, 0.25),
            "G31": (5.0, 0.75),
            "G22": (2.0, 0.4),
        },
    }
    return NavSolution(**(values | changes))  # type: ignore[arg-type]


def no_solution(reason: str = "3 satellites", time: GpsTime = NOON) -> NavSolution:
    nan = np.full(3, np.nan)
    return solution(
        time=time,
        valid=False,
        reason=reason,
        r_e_m=nan,
        v_e_mps=nan,
        clock_s=np.nan,
        drift_sps=np.nan,
        covariance_m2=np.full((4, 4), np.nan),
        velocity_covariance_m2ps2=np.full((4, 4), np.nan),
        dops={},
        used=(),
        rejected={},
        residuals_m={},
        azimuth_elevation_rad={},
    )


def rtklib(program: str, *arguments: str | Path) -> str:
    """Run a program of RTKLIB where it is installed; return what it printed on stderr."""
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"RTKLIB's {program} is not installed")
    done = subprocess.run(
        [found, *map(str, arguments)], capture_output=True, text=True, timeout=60, check=True
    )
    return done.stderr
