"""Alignment on drives none of us made: within its own σ, all along them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from driving import LEVER_B_M, MTI_G

from deepgnss.core import attitude
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import ImuBlock
from deepgnss.core.time import GpsTime, from_calendar
from deepgnss.ins.alignment import Alignment, AlignmentSettings
from deepgnss.ins.error_model import process_noise
from deepgnss.ins.error_state import Estimate
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.increments import joined
from deepgnss.ins.navigator import InsNavigator
from deepgnss.io.config import imu_grade
from deepgnss.io.config.aids import ImuConfig
from deepgnss.io.imu.reader import ImuLog


@pytest.mark.parametrize("method", ["static", "motion"])
def test_independent_drive_is_aligned_within_its_own_sigma(shared_data: Path, method: str) -> None:
    """At the start, and in motion again and again: tilt and yaw below 3.5σ of what is claimed."""
    folder = shared_data / "independent" / "drive"
    origin = GpsTime(2190, 561_628.0)
    imu = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    time_s, truth_s = imu[:, 1] - origin.tow_s, truth[:, 1] - origin.tow_s
    block = ImuBlock(origin, time_s, np.full(time_s.size, 0.005), imu[:, 2:5], imu[:, 5:8])
    rng = np.random.default_rng(1)
    fixes = []
    places = np.column_stack([np.radians(truth[:, 2:4]), truth[:, 4]])
    antenna_e = np.array([ecef(*place) for place in places])
    v_e = np.gradient(antenna_e, truth_s, axis=0)
    for k in range(0, truth_s.size, 25):
        v_n = C_ne(*places[k, :2]) @ v_e[k] + 0.05 * rng.normal(size=3)
        r_e = antenna_e[k] + rng.normal(size=3)
        at = origin.plus(float(truth_s[k]))
        fixes.append(GnssFix(at, r_e, np.eye(3), v_n, 0.05**2 * np.eye(3)))
    settings = AlignmentSettings("static" if method == "static" else "motion", LEVER_B_M)
    find = Alignment(block, fixes, MTI_G, settings)
    for from_s in (float(time_s[0]) - 0.005, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0):
        found = find(from_s)
        assert isinstance(found, Estimate), found
        k = int(np.argmin(np.abs(truth_s - found.ins.time.since(origin))))
        q_nb = attitude.quaternion_from_euler(np.radians(truth[k, 11:14]))
        phi = attitude.attitude_error_n(found.ins.q_nb, q_nb)
        assert np.all(np.abs(phi) < 3.5 * np.sqrt(np.diagonal(found.P))[6:9])
        assert np.abs(phi).max() < 0.15


def test_real_car_is_aligned_anywhere_on_its_way(shared_data: Path) -> None:
    """A consumer unit against RTK: its known pitch of −6.6° in the car, and ten seconds alone."""
    folder = shared_data / "real" / "imu" / "rtklibexplorer-drive"
    config = ImuConfig.model_validate(
        {
            "file": str(folder / "imu_1934.csv"),
            "kind": "rates",
            "columns": ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "time"],
            "units": {"gyro": "deg/s", "accel": "g"},
            "time": "tick",
            "tick": 1e-3,
            "tag_file": str(folder / "imu_1934.csv.tag"),
            "axes": "BRU",
        }
    )
    block = joined(*ImuLog(config))
    log = pd.read_csv(folder / "gnss_1934_sf.pos", sep=r"\s+", comment="%", header=None)
    fixes = []
    for row in log.itertuples(index=False):
        at = from_calendar(datetime.strptime(f"{row[0]} {row[1]}", "%Y/%m/%d %H:%M:%S.%f"))
        r_e = ecef(np.radians(row[2]), np.radians(row[3]), row[4])
        v_n = np.array([row[15], row[16], -row[17]])
        fixes.append(GnssFix(at, r_e, 0.02**2 * np.eye(3), v_n, 0.06**2 * np.eye(3)))
    grade = imu_grade("automotive")
    find = Alignment(block, fixes, grade, AlignmentSettings("motion", np.zeros(3)))
    pitches, ratios = [], []
    for from_s in range(60, 540, 30):
        found = find(float(from_s))
        assert isinstance(found, Estimate), found
        roll, pitch, _ = np.degrees(attitude.euler_rad(found.ins.q_nb))
        assert abs(roll) < 5.0
        pitches.append(pitch)
        start_s = found.ins.time.since(block.origin)
        alone, _ = InsNavigator(found, process_noise(grade)).advance(block, start_s + 10.0)
        state = alone.state
        fix = min(fixes, key=lambda fix: abs(fix.time.since(state.time)))
        ahead_s = fix.time.since(state.time)
        assert abs(ahead_s) < 0.01
        there = ecef(state.lat_rad, state.lon_rad, state.height_m) - fix.r_e_m
        error = C_ne(state.lat_rad, state.lon_rad) @ there + state.v_n_mps * ahead_s
        ratios.append(error / np.sqrt(np.diagonal(alone.estimate.P))[:3])
    assert np.mean(pitches) == pytest.approx(-6.6, abs=0.8)  # as those who drove it found
    assert np.abs(ratios).max() < 3.5
    assert np.mean(np.square(ratios)) < 2.0
