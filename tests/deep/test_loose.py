"""Loose coupling of files on drives none of us made: errors against the filter's own σ."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from deepgnss.core.errors import ConfigError
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.inertial import wheel_speeds
from deepgnss.deep.loose import LooseRun, Outage, read_inputs, run_loose, through_outage
from deepgnss.evaluate.inertial import (
    consistency,
    inertial_errors,
    outage_errors,
    outage_statistics,
    outages_along,
)
from deepgnss.ins.increments import between
from deepgnss.io.config import load_config
from deepgnss.io.imu import OdometerLog
from deepgnss.io.truth import read_truth

CAR_DRIVE = Path(__file__).resolve().parents[2] / "benchmarks" / "car_drive.yaml"


# --- a consumer unit on a real car ---------------------------------------------------------------


def car_drive(
    shared_data: Path, *overrides: str, until_s: float = np.inf, outages: tuple[Outage, ...] = ()
) -> LooseRun:
    folder = shared_data / "real" / "imu" / "rtklibexplorer-drive"
    imu = folder / "imu_1934.csv"
    config = load_config(
        CAR_DRIVE, [f"imu.file={imu}", f"imu.tag_file={imu}.tag", "ins.smoother=false", *overrides]
    )
    inputs = read_inputs(config, folder / "gnss_1934_sf.pos")
    block = between(inputs.block, 0.0, until_s)
    end = block.origin.plus(float(block.time_s[-1]))
    fixes = tuple(fix for fix in inputs.fixes if fix.time.since(end) < 0.0)
    return run_loose(config, inputs._replace(block=block, fixes=fixes), outages)


def test_first_two_minutes_of_a_real_drive(shared_data: Path) -> None:
    """One start, no fix refused, and outages of ten seconds at four places within 3σ."""
    run = car_drive(shared_data, until_s=125.0)
    assert [event.what for event in run.integration.events] == ["started"]
    assert all(i.accepted for i in run.integration.innovations)
    assert np.mean([i.nis for i in run.integration.innovations if i.kind == "position"]) < 3.0
    held = outages_along(run, 10.0, np.array([75.0, 85.0, 95.0, 105.0]))
    statistics = outage_statistics(held)
    print(statistics)
    assert statistics.rms_m < 3.0
    assert statistics.worst_ratio < 3.0
    free = replace(run, settings=replace(run.settings, vehicle=None))
    loose = outage_statistics(outages_along(free, 10.0, np.array([75.0, 85.0, 95.0, 105.0])))
    assert loose.sigma_m > 1.5 * statistics.sigma_m
    assert loose.worst_ratio < 3.0


def test_an_outage_by_itself_is_that_of_a_run_without_its_fixes(shared_data: Path) -> None:
    outage = Outage(60.0, 10.0)
    run = car_drive(shared_data, until_s=75.0)
    (alone,) = outage_errors(through_outage(run, outage))
    (within,) = outage_errors(car_drive(shared_data, until_s=75.0, outages=(outage,)))
    assert alone is not None
    assert within is not None
    assert alone.end == within.end
    np.testing.assert_allclose(alone.error_n_m, within.error_n_m, atol=1e-3)
    np.testing.assert_allclose(alone.sigma_n_m, within.sigma_n_m, rtol=1e-3)
    with pytest.raises(ConfigError, match="starts later"):
        through_outage(run, Outage(1.0, 5.0))


# After 10, 30, 60 s: RMS in m and the largest error over its σ, at most; free, held by the road.
LIMITS = {
    False: ((6.0, 3.0), (65.0, 3.0), (400.0, 3.0)),
    True: ((2.0, 2.0), (12.0, 2.0), (35.0, 2.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True], ids=["free", "held by the road"])
def test_whole_real_drive_with_positions_withheld(shared_data: Path, held: bool) -> None:
    run = car_drive(shared_data, *([] if held else ["ins.vehicle=null"]))
    assert [event.what for event in run.integration.events] == ["started"]
    refused = [i for i in run.integration.innovations if not i.accepted]
    assert len(refused) <= 0.005 * len(run.integration.innovations)
    for length_s, (rms_m, worst) in zip((10.0, 30.0, 60.0), LIMITS[held], strict=True):
        from_s = np.linspace(75.0, 525.0 - length_s, 10)
        statistics = outage_statistics(outages_along(run, length_s, from_s))
        print(length_s, statistics)
        assert statistics.places == 10
        assert statistics.rms_m < rms_m
        assert statistics.worst_ratio < worst
        assert 0.2 < statistics.ratio < 1.3  # neither overconfident nor saying nothing


# --- another library's sensors -------------------------------------------------------------------


def independent(shared_data: Path, folder: Path, seed: int) -> LooseRun:
    """MTi-G at 200 Hz with fixes at 1 Hz: truth and white noise of 1 m and 5 cm/s."""
    source, rng = shared_data / "independent" / "drive", np.random.default_rng(seed)
    table = pd.read_csv(source / "truth.csv").iloc[::50]
    week, tow_s = table["gps_week"].to_numpy(), table["gps_tow_s"].to_numpy()
    r_e, v_e = read_truth(source / "truth.csv").at(week, tow_s)
    rows: list[FloatArray] = []
    for at_s, r, v in zip(tow_s, r_e, v_e, strict=True):
        to_n = C_ne(*geodetic(r)[:2])
        lat, lon, height = geodetic(r + to_n.T @ rng.normal(size=3))
        v_n = to_n @ v + 0.05 * rng.normal(size=3)
        place = [at_s, np.degrees(lat), np.degrees(lon), height]
        rows.append(np.concatenate([place, v_n, np.ones(3), np.full(3, 0.05)]))
    np.savetxt(folder / "gnss.txt", np.array(rows), fmt="%.10f")
    config = load_config(
        None,
        [
            f"imu.file={source / 'imu.csv'}",
            "imu.lever_arm=[0.4, 0.1, -1.2]",
            "recording.start_time=2022-01-01T12:00:28Z",
        ],
    )
    return run_loose(config, read_inputs(config, folder / "gnss.txt"))


def summary(shared_data: Path, folder: Path, seeds: range) -> FloatArray:
    """Mean over seeds: NEES/3 of position, velocity, attitude, share within 3σ, NIS/3 of both."""
    truth = read_truth(shared_data / "independent" / "drive" / "truth.csv")
    found = []
    for seed in seeds:
        run = independent(shared_data, folder, seed)
        parts = consistency(inertial_errors(run.forward, truth))
        nis = [
            np.mean([i.nis for i in run.integration.innovations if i.kind == kind]) / 3.0
            for kind in ("position", "velocity")
        ]
        found.append([*(p.nees for p in parts), *(p.within for p in parts), *nis])
    mean = np.mean(found, axis=0)
    print("NEES/3, within 3σ of position, velocity, attitude; NIS/3:", mean.round(3))
    return np.asarray(mean)


def test_independent_drive_within_its_sigma(shared_data: Path, tmp_path: Path) -> None:
    mean = summary(shared_data, tmp_path, range(3))
    assert np.all(mean[:3] < 1.8)
    assert np.all(mean[3:6] > 0.97)
    assert np.all((mean[6:] > 0.6) & (mean[6:] < 1.3))


@pytest.mark.slow
def test_independent_drive_within_its_sigma_over_50_seeds(
    shared_data: Path, tmp_path: Path
) -> None:
    """One realization of the sensors' errors, fifty of the fixes'."""
    mean = summary(shared_data, tmp_path, range(50))
    assert np.all(mean[:3] < 1.3)  # attitude well below: the drift of T's table is not in the log
    assert np.all(mean[:2] > 0.7)
    assert np.all(mean[3:6] > 0.99)
    assert np.all((mean[6:] > 0.75) & (mean[6:] < 1.1))


@pytest.mark.slow
def test_our_own_solution_of_the_independent_recording(shared_data: Path, tmp_path: Path) -> None:
    """IF samples to positions, positions and increments to a trajectory: within 3σ of truth."""
    source = shared_data / "independent" / "drive"
    stream = {
        "format": "bits1",
        "samples": "iq",
        "packing": {"order": "msb_first", "code": "sign_magnitude"},
        "sample_rate": 2.6e6,
    }
    config = {
        "recording": {"streams": [stream]},
        "signals": ["GPS_L1CA"],
        "tracking": {"carrier": {"loop": "pll3", "bandwidth": 15.0, "coherent": 0.02}},
        "positioning": {"troposphere": "none"},  # as simulated
        "output": {"interval": 0.1, "report": False},
    }
    (tmp_path / "car.yaml").write_text(yaml.safe_dump(config))
    command = [Path(sys.executable).parent / "deepgnss", "process", source / "rec.bin"]
    ended = subprocess.run(
        [*command, "--config", tmp_path / "car.yaml"], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    settings = load_config(
        None,
        [
            f"imu.file={source / 'imu.csv'}",
            "imu.lever_arm=[0.4, 0.1, -1.2]",
            "ins.gnss.correlation=1",  # of the receiver's code loop at 0.1 Hz and more
        ],
    )
    run = run_loose(settings, read_inputs(settings, tmp_path / "out" / "solution.csv"))
    errors = inertial_errors(run.forward, read_truth(source / "truth.csv"))
    for part in consistency(errors):
        print(part)
        assert part.within > 0.99
        assert part.nees < 1.5
    position, velocity, attitude = consistency(errors)
    assert np.linalg.norm(position.rms) < 1.0
    assert velocity.rms.max() < 0.05
    assert np.degrees(attitude.rms).max() < 1.0
    assert all(i.accepted for i in run.integration.innovations if i.kind == "velocity")


# --- what is led over on the way -----------------------------------------------------------------


def test_wheel_speeds_are_means_and_stand_in_the_middle() -> None:
    run = OdometerLog(GpsTime(2300, 0.0), np.array([1.0, 1.1, 1.2, 3.0, 3.1]), np.arange(5.0))
    wheels = wheel_speeds(run)
    np.testing.assert_allclose(wheels.time_s, [0.95, 1.05, 1.15, 2.925, 3.05])
