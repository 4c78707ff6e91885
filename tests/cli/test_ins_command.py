"""`deepgnss ins` on files in KF-GINS's formats: outputs, errors within σ, exit codes, one line."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

from deepgnss.cli.main import cli
from deepgnss.core.attitude import euler_rad, quaternion_from_matrix
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.ins.imu_errors import ImuErrors
from deepgnss.ins.increments import joined
from deepgnss.io.config import imu_grade
from deepgnss.io.gnss import read_gnss
from deepgnss.io.imu import OdometerLog, write_odometer
from deepgnss.io.truth import read_truth
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import EllipseAttitude
from deepgnss.sim.motion.paths import Ellipse
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

LEVER_M = (0.4, 0.1, -1.2)
START = GpsTime(2300, 604_760.0)  # the week ends on the way
SECONDS = 60
RATE_HZ = 50


@lru_cache(maxsize=1)
def drive() -> tuple[Vehicle, ImuBlock]:
    """Rounds on an ellipse at changing speed."""
    turns = [(float(t), 0.1 + 0.03 * np.sin(0.9 * t)) for t in range(0, 96, 12)]
    path = Ellipse(150.0, 100.0, smooth_profile(turns, flat=2))
    vehicle = Vehicle(0.53, 1.99, 30.0, path, EllipseAttitude(path, 0.2))
    return vehicle, joined(*increments(vehicle, START, RATE_HZ, SECONDS * RATE_HZ, highest_hz=2.0))


def fixes(vehicle: Vehicle, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """KF-GINS rows of 13 columns: tow, place, velocity, σ of both."""
    motion, rows = vehicle.point(time_s, LEVER_M), []
    for at_s, r_e, v_e in zip(time_s, motion.r_m, motion.v_mps, strict=True):
        to_n = C_ne(*geodetic(r_e)[:2])
        lat, lon, height = geodetic(r_e + to_n.T @ rng.normal(size=3))
        v_n = to_n @ v_e + 0.05 * rng.normal(size=3)
        place = (np.degrees(lat), np.degrees(lon), height)
        rows.append([START.plus(at_s).tow_s, *place, *v_n, 1, 1, 1, 0.05, 0.05, 0.05])
    return np.array(rows)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """imu.txt, gnss.txt, truth.nav, odometer.csv and a config."""
    folder = tmp_path_factory.mktemp("kfgins")
    vehicle, block = drive()
    sensed, _ = ImuErrors(imu_grade("FSAS"), np.random.default_rng(1)).apply(block)
    tow_s = [START.plus(float(t)).tow_s for t in sensed.time_s]
    np.savetxt(
        folder / "imu.txt",
        np.column_stack([tow_s, sensed.dtheta_b_rad, sensed.dv_b_mps]),
        fmt="%.12f",
    )
    rng = np.random.default_rng(2)
    np.savetxt(folder / "gnss.txt", fixes(vehicle, np.arange(0.5, SECONDS), rng), fmt="%.10f")
    time_s = np.arange(0.0, SECONDS + 0.01, 0.1)
    pose, rows = vehicle.pose(time_s), []
    for k, at_s in enumerate(time_s):
        lat, lon, height = geodetic(pose.r_e_m[k])
        to_n, time = C_ne(lat, lon), START.plus(float(at_s))
        angles = np.degrees(euler_rad(quaternion_from_matrix(to_n @ pose.C_eb[k])))
        place = (np.degrees(lat), np.degrees(lon), height)
        rows.append([time.week, time.tow_s, *place, *(to_n @ pose.v_e_mps[k]), *angles])
    np.savetxt(folder / "truth.nav", np.array(rows), fmt="%.10f")
    speed = np.linalg.norm(pose.v_e_mps, axis=1)
    write_odometer(folder / "odometer.csv", OdometerLog(START, time_s[1:], speed[1:]))
    (folder / "car.yaml").write_text(
        "recording: {start_time: 2024-02-10T23:59:00Z}\n"  # week 2300, 604758 s
        "imu: {file: imu.txt, format: kfgins, grade: FSAS, lever_arm: [0.4, 0.1, -1.2]}\n"
        "truth: {file: truth.nav, format: kfgins_nav}\n"
    )
    return folder


def run(folder: Path, *options: object) -> Result:
    arguments = ["ins", "--gnss", folder / "gnss.txt", "--config", folder / "car.yaml", *options]
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def test_kfgins_files_are_coupled_and_told_about(files: Path) -> None:
    out = files / "a"
    result = run(files, "-o", out, "--withhold", "40:10")
    assert result.exit_code == 0, result.output
    names = {path.name for path in out.iterdir()}
    assert names == {
        *("trajectory.csv", "trajectory_smoothed.csv", "biases.csv", "innovations.csv"),
        *("trajectory.nav", "errors.csv", "outages.csv", "inertial.png"),
    }
    for word in ("40 s", "position", "45 tested", "started: aligned", "smoothed attitude"):
        assert word in result.output
    truth = read_truth(files / "truth.nav", "kfgins_nav", lever_arm_m=LEVER_M)
    for name, worst_m in (("trajectory.csv", 4.0), ("trajectory_smoothed.csv", 2.0)):
        table = pd.read_csv(out / name)
        seen = read_truth(out / name)
        r_e_m, _ = truth.at(seen.week, seen.tow_s)
        assert np.linalg.norm(seen.r_e_m - r_e_m, axis=1).max() < worst_m
        assert table["week"].min() == 2300
        assert table["week"].max() == 2301
        assert (table["sigma_n_m"] < 3.0).all()
    errors = pd.read_csv(out / "errors.csv")
    for axis in ("north_m", "east_m", "down_m", "v_north_mps", "phi_down_deg"):
        assert (errors[axis].abs() < 3.5 * errors[f"sigma_{axis}"]).mean() > 0.98
    outage = pd.read_csv(out / "outages.csv").iloc[0]
    assert outage["nees"] < 5.0
    assert outage["end_tow_s"] - outage["start_tow_s"] == pytest.approx(9.0)
    innovations = pd.read_csv(out / "innovations.csv")
    assert innovations.query("kind == 'position'")["nis"].mean() == pytest.approx(3.0, abs=1.2)
    again = read_truth(out / "trajectory.nav", "kfgins_nav", lever_arm_m=LEVER_M)
    np.testing.assert_allclose(
        again.r_e_m, read_truth(out / "trajectory_smoothed.csv").r_e_m, atol=2e-3
    )


def test_its_trajectory_is_taken_for_a_solution(files: Path) -> None:
    assert run(files, "-o", files / "s", "--set", "output.report=false").exit_code == 0
    log = read_gnss(files / "s" / "trajectory.csv")
    assert np.isfinite(log.v_n_mps).all()


def test_road_and_wheels_are_used_and_counted(files: Path) -> None:
    options = ["--set", "ins.vehicle={}", "--set", f"odometer.file={files / 'odometer.csv'}"]
    quick = ["--set", "output.report=false", "--set", "ins.smoother=false"]
    result = run(files, "-o", files / "b", *options, *quick)
    assert result.exit_code == 0, result.output
    assert "odometer" in result.output
    scale = pd.read_csv(files / "b" / "biases.csv")["odometer_scale"]
    assert abs(scale.iloc[-1]) < 0.005
    innovations = pd.read_csv(files / "b" / "innovations.csv")
    assert set(innovations["kind"]) == {"position", "velocity", "non-holonomic", "odometer"}
    assert (innovations.query("kind == 'odometer'")["accepted"]).mean() > 0.99


def test_without_alignment_exit_code_1_says_why(files: Path) -> None:
    options = ["--set", "imu.alignment.method=static", "--set", "output.report=false"]
    result = run(files, "-o", files / "c", *options)
    assert result.exit_code == 1
    assert "no alignment: no rest of 3 s" in result.output


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        (["--withhold", "100:10"], "no fix there"),
        (["--withhold", "100"], "expected FROM:SECONDS"),
        (["--withhold", "10:0"], "above 0 s"),
        (["--imu", "absent.txt"], "no such file"),
        (["--set", "ins.state=21"], "ins.state"),
        (["--set", "odometer.file=odometer.csv"], "ins.vehicle"),
        (["--set", "imu.time_offset=-14.5e3"], "no second in common"),
    ],
)
def test_what_cannot_be_used_ends_with_2_and_one_line(
    files: Path, options: list[str], cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    result = run(files, "-o", files / "d", *options)
    assert result.exit_code == 2, result.output
    assert cause in result.output
    assert len(result.output.strip().splitlines()) <= 4  # click's own are longer


def test_oddities_of_the_log_are_warned_of(files: Path) -> None:
    lines = (files / "imu.txt").read_text().splitlines()
    del lines[1000:1030]
    lines.insert(500, lines[500])
    (files / "gappy.txt").write_text("\n".join(lines) + "\n")
    options = ["--set", "output.report=false", "--set", "ins.smoother=false"]
    result = run(files, "-o", files / "e", "--imu", files / "gappy.txt", *options)
    assert result.exit_code == 0, result.output
    assert "gaps of up to 1 s: 1" in result.output
    assert "rows with the time of the row before left out: 1" in result.output
    assert "bridged: no increments for 0.600 s" in result.output
    turned = run(files, "-o", files / "f", "--set", "imu.axes=FLU", *options)
    assert "points down" in turned.output
