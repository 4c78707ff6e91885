"""Tracks from CSV: through their points, consistent, and refused with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pymap3d
import pytest

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.attitude import EllipseAttitude
from deepgnss.sim.motion.paths import Ellipse
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.table import Place, read_track
from deepgnss.sim.motion.vehicle import Vehicle, geographic

PLACE = Place(0.91, 0.18, 120.0)
# Stands, drives three quarters of a round of 80 m radius, stands again.
ROUND = Ellipse(
    80.0, 80.0, smooth_profile([(3.0, 0.0), (8.0, 0.14), (35.0, 0.14), (40.0, 0.0)], flat=2)
)
CAR = Vehicle(*PLACE, ROUND, EllipseAttitude(ROUND, bank=0.4))
GRID_S = np.arange(0.0, 45.01, 0.1)


def _write(path: Path, header: str, columns: FloatArray) -> Path:
    np.savetxt(path, columns, fmt="%.13g", delimiter=",", header=header, comments="")
    return path


@pytest.fixture(name="geodetic", scope="module")
def _geodetic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    seen = geographic(CAR.pose(GRID_S))
    columns = [
        *(np.full(GRID_S.size, 2290.0), GRID_S + 1000.0),
        *(np.degrees(seen.lat_rad), np.degrees(seen.lon_rad), seen.height_m),
        *np.degrees(seen.euler_rad).T,
    ]
    header = "week,tow_s,lat_deg,lon_deg,height_m,roll_deg,pitch_deg,heading_deg"
    return _write(tmp_path_factory.mktemp("track") / "car.csv", header, np.column_stack(columns))


def test_track_is_the_drive_it_was_taken_from(geodetic: Path) -> None:
    track = Vehicle(*PLACE, *read_track(geodetic, PLACE))
    assert track.path.span_s == pytest.approx((0.0, 45.0))
    between_s = GRID_S[:-1] + 0.037
    for t_s, limit in ((GRID_S, 1e-5), (between_s, 3e-5)):
        ours, truth = track.pose(t_s), CAR.pose(t_s)
        assert np.abs(ours.r_e_m - truth.r_e_m).max() < limit
        assert np.abs(ours.v_e_mps - truth.v_e_mps).max() < 2e-4
        assert np.abs(ours.a_e_mps2 - truth.a_e_mps2).max() < 1e-2
        assert np.abs(ours.C_eb - truth.C_eb).max() < 1e-6
        assert np.abs(ours.omega_eb_b_radps - truth.omega_eb_b_radps).max() < 1e-5


@pytest.mark.parametrize(
    ("header", "of_local"),
    [
        ("time_s,north_m,east_m,height_m", lambda r: r * np.array([1.0, 1.0, -1.0])),
        (
            "tow_s,x_e_m,y_e_m,z_e_m",
            lambda r: CAR.point(np.zeros(1)).r_m + r @ C_ne(*PLACE[:2]),
        ),
    ],
)
def test_course_is_followed_without_an_attitude(
    header: str, of_local: object, tmp_path: Path
) -> None:
    assert callable(of_local)
    columns = np.column_stack([GRID_S + 7.0, of_local(ROUND(GRID_S).r_m)])
    track = Vehicle(*PLACE, *read_track(_write(tmp_path / "t.csv", header, columns), PLACE))
    t_s = np.linspace(-2.0, 47.0, 2000)
    assert np.abs(track.point(t_s).r_m - CAR.point(t_s).r_m).max() < 5e-4
    pose = track.pose(t_s)
    v_b_mps = np.einsum("kji,kj->ki", pose.C_eb, pose.v_e_mps)
    brisk = v_b_mps[:, 0] > 2.0
    assert brisk.sum() > 1000
    assert np.abs(v_b_mps[brisk, 1:]).max() < 2e-3
    yaw = np.degrees(geographic(pose).euler_rad[:, 2])
    held = np.degrees(geographic(CAR.pose(np.array([44.0]))).euler_rad[0, 2])
    assert yaw[t_s > 42.0] == pytest.approx(held, abs=1.0)


def test_derivatives_are_consistent_also_beyond_the_rows(geodetic: Path) -> None:
    track = Vehicle(*PLACE, *read_track(geodetic, PLACE))
    t_s = np.concatenate([np.linspace(-3.0, 48.0, 700), [-1e4, 1e4]])
    h = 1e-3

    def slope(f: object) -> FloatArray:
        assert callable(f)
        parts = ((1, 8.0), (2, -1.0))
        total: FloatArray = sum((w * (f(t_s + k * h) - f(t_s - k * h)) for k, w in parts))
        return total / (12.0 * h)

    pose, local = track.pose(t_s), track.path(t_s)
    np.testing.assert_allclose(slope(lambda t: track.path(t).r_m), local.v_mps, atol=1e-7)
    np.testing.assert_allclose(slope(lambda t: track.path(t).v_mps), local.a_mps2, atol=1e-6)
    turn = np.swapaxes(pose.C_eb, 1, 2) @ slope(lambda t: track.pose(t).C_eb)
    omega = np.column_stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])
    np.testing.assert_allclose(omega, pose.omega_eb_b_radps, atol=1e-9)
    alpha = slope(lambda t: track.pose(t).omega_eb_b_radps)
    np.testing.assert_allclose(alpha, pose.alpha_eb_b_radps2, atol=1e-6)
    assert np.abs(local.a_mps2[[-2, -1]]).max() == 0.0


GOOD = ["time_s,north_m,east_m,height_m,note"] + [f"{k},{k * k},{3 * k},1,a" for k in range(12)]


@pytest.mark.parametrize(
    ("line", "text", "cause"),
    [
        (6, "5,x,3,1,a", ":6: north_m: 'x' is not a number"),
        (6, "5,nan,3,1,a", ":6: north_m: 'nan' is not a finite number"),
        (6, "5,,3,1,a", ":6: north_m: '' is not a number"),
        (6, "5,1,3,1", ":6: 4 cells, the header has 5"),
        (6, "3,1,3,1,a", ":6: the time of the row before it again"),
        (6, "2,1,3,1,a", ":6: time goes back by 1 s"),
        (13, "90,1,3,1,a", ":13: a gap of 80 s in rows every 1 s"),
        (1, "time_s,north,east,height,note", ": no columns of position; expected lat_deg"),
        (1, "time,north_m,east_m,height_m,note", ": no column of time; expected time_s or tow_s"),
        (1, "time_s,north_m,east_m,height_m,yaw_deg", ":2: yaw_deg: 'a' is not a number"),
    ],
)
def test_refusals_name_file_and_line(line: int, text: str, cause: str, tmp_path: Path) -> None:
    rows = list(GOOD)
    rows[line - 1] = text
    path = tmp_path / "track.csv"
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(InputFileError) as caught:
        read_track(path, PLACE)
    assert str(caught.value).startswith(f"{path}{cause}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("angles", "cause"),
    [
        ([(0, 0, 0), (0, 85, 0)], ":3: pitch_deg: expected up to 80°"),
        ([(0, 0, 0), (0, 0, 100)], ":3: turned by more than 90° since the row before it"),
    ],
)
def test_attitudes_no_spline_can_follow(
    angles: list[tuple[int, int, int]], cause: str, tmp_path: Path
) -> None:
    rows = ["time_s,north_m,east_m,height_m,roll_deg,pitch_deg,yaw_deg"]
    rows += [f"{k},0,{k},0,{r},{p},{y}" for k, (r, p, y) in enumerate(angles)]
    path = tmp_path / "track.csv"
    path.write_text("\n".join(rows))
    with pytest.raises(InputFileError) as caught:
        read_track(path, PLACE)
    assert str(caught.value).startswith(f"{path}{cause}")


def test_yaw_may_pass_south_and_comments_stand_anywhere(tmp_path: Path) -> None:
    rows = ["# a track", "time_s,north_m,east_m,height_m,roll_deg,pitch_deg,yaw_deg"]
    yaws = [170.0, 178.0, -174.0, -166.0, -158.0]
    rows += [f"{k},0,{k},0,0,0,{yaw}" for k, yaw in enumerate(yaws)]
    rows.insert(4, "# halfway")
    path = tmp_path / "track.csv"
    path.write_text("\n".join(rows) + "\n\n")
    track = Vehicle(*PLACE, *read_track(path, PLACE))
    turning = track.pose(np.array([1.5, 2.0])).omega_eb_b_radps
    np.testing.assert_allclose(turning[:, 2], np.radians(8.0), atol=np.radians(0.7))
    with pytest.raises(InputFileError, match="cannot read: No such file"):
        read_track(tmp_path / "none.csv", PLACE)
    path.write_text("time_s,north_m,east_m,height_m\n0,0,0,0\n")
    with pytest.raises(InputFileError, match="1 rows; two at least make a track"):
        read_track(path, PLACE)


def test_independent_drive_has_our_lever_arm_and_velocity(shared_data: Path) -> None:
    """An INS library of others laid IMU, antenna, velocity and attitude along one drive."""
    file = shared_data / "independent" / "drive" / "truth.csv"
    truth = pd.read_csv(file)
    truth = truth[truth["gps_tow_s"] > truth["gps_tow_s"][0] + 1.0]  # the spline's own start
    place = Place(*np.radians(truth[["lat_deg", "lon_deg"]].to_numpy()[0]), 35.0)
    vehicle = Vehicle(*place, *read_track(file, place))
    t_s = truth["gps_tow_s"].to_numpy() - 561_628.0
    antenna_e_m = pymap3d.geodetic2ecef(*truth[["lat_deg", "lon_deg", "height_m"]].to_numpy().T)
    off_m = vehicle.point(t_s, (0.40, 0.10, -1.20)).r_m - np.column_stack(antenna_e_m)
    assert np.abs(off_m).max() < 2e-4
    seen = geographic(vehicle.pose(t_s))
    v_n_mps = truth[["vn_mps", "ve_mps", "vd_mps"]].to_numpy()
    assert np.ptp(v_n_mps, axis=0)[:2].min() > 5.0
    assert np.sqrt(((seen.v_n_mps - v_n_mps) ** 2).mean()) < 5e-3
    angles = np.radians(truth[["roll_deg", "pitch_deg", "heading_deg"]].to_numpy())
    assert np.abs(np.sin(seen.euler_rad - angles)).max() < 1e-6
