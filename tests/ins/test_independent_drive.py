"""Loose coupling on increments another library made of a motion, against that motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from driving import LEVER_B_M, MTI_G

from deepgnss.core.attitude import quaternion_from_euler, rotation_matrix
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray, ImuBlock, InsState
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import InitialSigmas, initial_covariance, process_noise
from deepgnss.ins.error_state import Estimate, Layout, difference
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.integration import Settings, integrate
from deepgnss.ins.smoother import smoothed

START = GpsTime(2190, 561_628.0)
OUTAGE_S = (30.0, 50.0)


def truth_at(truth: pd.DataFrame, row: int) -> InsState:
    now = truth.iloc[row]
    angles = np.radians([now.roll_deg, now.pitch_deg, now.heading_deg])
    return InsState(
        GpsTime(2190, float(now.gps_tow_s)),
        float(np.radians(now.imu_lat_deg)),
        float(np.radians(now.imu_lon_deg)),
        float(now.imu_height_m),
        np.array([now.vn_mps, now.ve_mps, now.vd_mps]),
        quaternion_from_euler(angles),
        *(np.zeros(3) for _ in range(4)),
    )


def antenna(state: InsState) -> FloatArray:
    lever_n = rotation_matrix(state.q_nb) @ LEVER_B_M
    here = ecef(state.lat_rad, state.lon_rad, state.height_m)
    return here + C_ne(state.lat_rad, state.lon_rad).T @ lever_n


def test_errors_stay_within_what_the_filter_says(shared_data: Path) -> None:
    folder = shared_data / "independent/drive"
    truth = pd.read_csv(folder / "truth.csv")
    imu = pd.read_csv(folder / "imu.csv").to_numpy()
    time_s = imu[:, 1] - START.tow_s
    block = ImuBlock(START, time_s, np.full(time_s.size, 0.005), imu[:, 2:5], imu[:, 5:8])
    tow_s = truth.gps_tow_s.to_numpy() - START.tow_s
    rng = np.random.default_rng(0)
    fixes = []
    for row in np.flatnonzero(np.isclose(tow_s % 1.0, 0.0) & (tow_s > 0.5)):
        state = truth_at(truth, int(row))
        place = truth.iloc[row]
        given = ecef(np.radians(place.lat_deg), np.radians(place.lon_deg), place.height_m)
        assert np.linalg.norm(antenna(state) - given) < 0.002  # our lever arm is theirs
        if OUTAGE_S[0] < tow_s[row] < OUTAGE_S[1]:
            continue
        fixes.append(
            GnssFix(state.time, given + rng.normal(size=3), np.eye(3))
        )  # no velocity: it would be that of the IMU
    sigmas = InitialSigmas(0.1, 0.05, MTI_G.tilt_rad, MTI_G.heading_rad)
    start = Estimate(
        Layout(21), truth_at(truth, 0), np.zeros(0), initial_covariance(MTI_G, sigmas, 21)
    )
    run = integrate(
        block, fixes, lambda _: start, process_noise(MTI_G), Settings(LEVER_B_M, epoch_s=0.5)
    )
    assert not run.reason
    assert all(innovation.accepted for innovation in run.innovations)
    back = smoothed(run.epochs)
    ratios, worst = [], {"forward": 0.0, "smoothed": 0.0}
    for k, epoch in enumerate(run.epochs[1:], start=1):
        at_s = epoch.estimate.ins.time.since(START)
        row = round(at_s * 50)
        if abs(at_s * 50 - row) > 1e-6:
            continue
        x = difference(epoch.estimate.ins, truth_at(truth, row))[:9]
        ratios.append(np.abs(x) / np.sqrt(np.diagonal(epoch.estimate.P)[:9]))
        later = difference(back[k].ins, truth_at(truth, row))[:9]
        worst["forward"] = max(worst["forward"], float(np.linalg.norm(x[:2])))
        worst["smoothed"] = max(worst["smoothed"], float(np.linalg.norm(later[:2])))
    found = np.array(ratios)
    print(f"errors over σ: {np.sqrt(np.mean(found**2, axis=0)).round(2)}, worst {worst}")
    assert np.mean(found < 3.0) > 0.98
    assert np.sqrt(np.mean(found**2)) == pytest.approx(0.9, abs=0.5)
    assert worst["smoothed"] < 0.5 * worst["forward"]
