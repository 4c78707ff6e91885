from pathlib import Path

import numpy as np
import pytest
from run_samples import NOON, no_solution, solution

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.core.time import GpsTime
from deepgnss.io.tables import SolutionTable
from deepgnss.io.truth import Trajectory, read_truth

_LAT, _LON = np.radians((48.0, 11.5))
_TO_N = C_ne(_LAT, _LON)
_ORIGIN_E_M = ecef(_LAT, _LON, 500.0)


def _circle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Position and velocity in ECEF on a circle of 50 m, 10 m/s."""
    w = 0.2
    zero = np.zeros_like(t)
    r_n = np.column_stack((50.0 * np.sin(w * t), 50.0 * np.cos(w * t), zero))
    v_n = np.column_stack((10.0 * np.cos(w * t), -10.0 * np.sin(w * t), zero))
    return _ORIGIN_E_M + r_n @ _TO_N, v_n @ _TO_N


@pytest.mark.parametrize("with_velocity", [True, False])
def test_between_samples_and_across_the_week_end(with_velocity: bool) -> None:
    t = np.arange(0.0, 20.0, 0.5)
    r_e_m, v_e_mps = _circle(t)
    times = [GpsTime(2190, 604_790.0).plus(x) for x in t]
    trajectory = Trajectory(
        np.array([x.week for x in times]),
        np.array([x.tow_s for x in times]),
        r_e_m,
        v_e_mps if with_velocity else None,
    )
    asked = np.arange(2.0, 17.0, 0.13)
    at = [times[0].plus(x) for x in asked]
    r, v = trajectory.at(np.array([x.week for x in at]), np.array([x.tow_s for x in at]))
    true_r, true_v = _circle(asked)
    assert np.abs(r - true_r).max() < 1e-3
    assert np.abs(v - true_v).max() < 1e-2


def test_no_truth_outside_nor_in_gaps() -> None:
    t = np.concatenate((np.arange(0.0, 5.0, 0.1), np.arange(8.0, 10.0, 0.1)))
    r_e_m, _ = _circle(t)
    trajectory = Trajectory(np.full(len(t), 2190), 1000.0 + t, r_e_m)
    asked = 1000.0 + np.array([-0.01, 0.0, 4.9, 5.5, 7.9, 8.0, 9.9, 10.0])
    known = np.isfinite(trajectory.at(2190, asked)[0][:, 0])
    assert known.tolist() == [False, True, True, False, False, True, True, False]


def test_csv_of_the_drive_is_the_antenna(shared_data: Path) -> None:
    truth = read_truth(shared_data / "independent/drive/truth.csv")
    assert truth.start == GpsTime(2190, 561_628.0)
    assert truth.v_e_mps is None  # the file's velocity is the IMU's
    lat, lon, height = geodetic(truth.r_e_m[0])
    assert np.degrees((lat, lon)) == pytest.approx((30.52780184146, 114.3577037326), abs=1e-10)
    assert height == pytest.approx(36.2, abs=1e-6)
    assert truth.attitude_rad is not None
    assert np.degrees(truth.attitude_rad[0, 2]) == pytest.approx(46.28527299691)


def test_csv_with_velocity_agrees_with_its_positions(shared_data: Path) -> None:
    truth = read_truth(shared_data / "independent/dual/truth.csv")
    assert truth.v_e_mps is not None
    moved = np.diff(truth.r_e_m, axis=0) / np.diff(truth.tow_s)[:, None]
    mean = (truth.v_e_mps[1:] + truth.v_e_mps[:-1]) / 2.0
    # Its north is that of the start: 0.1 mrad off after 0.7 km at 55° north, 2 mm/s at 20 m/s.
    assert np.abs(moved - mean).max() < 3e-3
    assert np.linalg.norm(truth.v_e_mps[-1]) > 15.0


def test_rtklib_pos(shared_data: Path) -> None:
    folder = shared_data / "real/imu/rtklibexplorer-drive"
    truth = read_truth(folder / "gnss_1934_sf.pos", "rtklib_pos")
    assert len(truth.week) == 2197
    assert truth.start == GpsTime(2374, 2 * 86_400 + 19 * 3600 + 34 * 60 + 18.499)
    assert truth.v_e_mps is not None
    moved = np.diff(truth.r_e_m, axis=0) / np.diff(truth.tow_s)[:, None]
    mean = (truth.v_e_mps[1:] + truth.v_e_mps[:-1]) / 2.0
    assert np.median(np.linalg.norm(moved - mean, axis=1)) < 0.1
    assert np.linalg.norm(truth.v_e_mps, axis=1).max() == pytest.approx(16.4, abs=0.1)


_POS = "%  {time:<20} {place}   Q  ns\n{rows}"
_LLH = "latitude(deg) longitude(deg)  height(m)"
_XYZ = "x-ecef(m)      y-ecef(m)      z-ecef(m)"


def _pos(tmp_path: Path, time: str, place: str, *rows: str) -> Trajectory:
    path = tmp_path / "a.pos"
    path.write_text(_POS.format(time=time, place=place, rows="\n".join(rows)) + "\n")
    return read_truth(path, "rtklib_pos")


def test_kinds_of_rtklib_pos(tmp_path: Path) -> None:
    x, y, z = _ORIGIN_E_M
    place, xyz = "48.0 11.5 500.0 5 7", f"{x:.4f} {y:.4f} {z:.4f} 5 7"
    by_week = _pos(tmp_path, "GPST", _LLH, f"2190 561628.0 {place}", f"2190 561629.0 {place}")
    by_date = _pos(
        tmp_path, "GPST", _LLH,
        f"2022/01/01 12:00:28.000 {place}", f"2022/01/01 12:00:29.000 {place}",
    )  # fmt: skip
    utc = _pos(
        tmp_path, "UTC", _XYZ,
        f"2022/01/01 12:00:10.000 {xyz}", f"2022/01/01 12:00:11.000 {xyz}",
    )  # fmt: skip
    for trajectory in (by_week, by_date, utc):
        assert trajectory.start == NOON
        assert trajectory.r_e_m[0] == pytest.approx(_ORIGIN_E_M, abs=1e-4)


_NAV = "{week} {tow:.1f} 48.0 11.5 500.0 0.0 0.0 0.0 {roll} {pitch} {yaw}\n"


def _nav(tmp_path: Path, week: int = 2190, attitude=(0.0, 0.0, 90.0), **options) -> Trajectory:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.nav"
    roll, pitch, yaw = attitude
    rows = (_NAV.format(week=week, tow=100.0 + k, roll=roll, pitch=pitch, yaw=yaw) for k in (0, 1))
    path.write_text("".join(rows))
    return read_truth(path, "kfgins_nav", **options)


@pytest.mark.parametrize(
    ("attitude", "arm_n_m"),
    [
        ((0.0, 0.0, 0.0), (1.0, 2.0, -3.0)),
        ((0.0, 0.0, 90.0), (-2.0, 1.0, -3.0)),  # forward is east, right is south
        ((90.0, 0.0, 0.0), (1.0, 3.0, 2.0)),  # right wing down: right is down, up is east… left
        ((0.0, 90.0, 0.0), (-3.0, 2.0, -1.0)),  # nose up: forward is up, down is forward
    ],
)
def test_lever_arm_turns_with_the_body(tmp_path: Path, attitude, arm_n_m) -> None:  # type: ignore[no-untyped-def]
    imu = _nav(tmp_path, attitude=attitude)
    antenna = _nav(tmp_path, attitude=attitude, lever_arm_m=(1.0, 2.0, -3.0))
    assert _TO_N @ (antenna.r_e_m[0] - imu.r_e_m[0]) == pytest.approx(arm_n_m, abs=1e-6)
    assert imu.v_e_mps is not None
    assert antenna.v_e_mps is None


def test_week_zero_of_a_nav_file(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="week 0 in the file"):
        _nav(tmp_path, week=0)
    path = tmp_path / "a.nav"
    assert read_truth(path, "kfgins_nav", week=2190).start == GpsTime(2190, 100.0)


def test_own_solution_as_truth(tmp_path: Path) -> None:
    with SolutionTable(tmp_path / "s.csv") as table:
        for k in range(4):
            fix = solution if k != 1 else no_solution
            table.write(fix(time=NOON.plus(k)))
    truth = read_truth(tmp_path / "s.csv")
    assert (truth.tow_s - NOON.tow_s).tolist() == [0.0, 2.0, 3.0]
    assert truth.r_e_m[0] == pytest.approx(solution().r_e_m, abs=1e-3)
    assert truth.v_e_mps is not None
    assert truth.v_e_mps[0] == pytest.approx(solution().v_e_mps, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "No columns to parse"),
        ("a,b\n1,2\n", "column 'week' is missing"),
        ("week,tow_s,lat_deg,lon_deg,height_m\n2190,1,2,x,3\n2190,2,2,3,3\n", "cannot read: could"),
        ("week,tow_s,lat_deg,lon_deg,height_m\n2190,1,2,,3\n", "data row 1: time or position"),
        ("week,tow_s,lat_deg,lon_deg,height_m\n2190,1,2,3,4\n", "1 epochs"),
    ],
)
def test_damaged_csv_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(InputFileError, match=message) as caught:
        read_truth(path)
    assert "\n" not in str(caught.value)


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    for kind in ("csv", "rtklib_pos", "kfgins_nav"):
        with pytest.raises(InputFileError, match="No such file"):
            read_truth(tmp_path / "none", kind)  # type: ignore[arg-type]
    (tmp_path / "a").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(InputFileError, match=r"not an RTKLIB \.pos file"):
        read_truth(tmp_path / "a", "rtklib_pos")
    with pytest.raises(InputFileError, match="3 columns"):
        read_truth(tmp_path / "a", "kfgins_nav")
