"""GNSS solutions of three programs say the same; what cannot be used is said or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.time import GpsTime
from deepgnss.io.gnss import is_weekless, read_gnss
from deepgnss.io.truth import read_truth

LAT, LON, HEIGHT = 30.5, 114.25, 36.0
OURS = (
    "week,tow_s,valid,lat_deg,lon_deg,height_m,x_e_m,v_n_mps,v_e_mps,v_d_mps,"
    "sigma_n_m,sigma_e_m,sigma_d_m,sigma_vn_mps,sigma_ve_mps,sigma_vd_mps\n"
)
POS = (
    "% program\n%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m)"
    " sdeu(m) sdun(m) age(s) ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun\n"
)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_three_programs_say_the_same(tmp_path: Path) -> None:
    place = f"{LAT} {LON} {HEIGHT}"
    ours = written(
        tmp_path / "solution.csv",
        OURS
        + f"2300,100.0,1,{LAT},{LON},{HEIGHT},0,1,2,3,1.5,2.5,3.5,0.1,0.2,0.3\n"
        + "2300,101.0,0,,,,,,,,,,,,,\n"
        + f"2300,102.0,1,{LAT},{LON},{HEIGHT},0,1,2,3,1.5,2.5,3.5,0.1,0.2,0.3\n",
    )
    rest = "1.5 2.5 3.5 0 0 0 0 9 1 2 -3 0.1 0.2 0.3 0 0 0\n"
    pos = written(
        tmp_path / "rtk.pos",
        POS + f"2300 100.0 {place} 1 9 {rest}" + f"2300 102.0 {place} 1 9 {rest}",
    )
    line = "{} " + f"{place} 1 2 3 1.5 2.5 3.5 0.1 0.2 0.3\n"
    kfgins = written(tmp_path / "gnss.txt", line.format(100.0) + line.format(102.0))
    assert [is_weekless(path) for path in (ours, pos, kfgins)] == [False, False, True]
    near = GpsTime(2301, 5.0)
    logs = [read_gnss(ours), read_gnss(pos), read_gnss(kfgins, GpsTime(2300, 5000.0))]
    assert read_gnss(kfgins, near).time(0) == GpsTime(2301, 100.0)
    for log in logs:
        assert [log.time(k) for k in range(2)] == [GpsTime(2300, 100.0), GpsTime(2300, 102.0)]
        np.testing.assert_allclose(log.r_e_m[0], ecef(*np.radians([LAT, LON]), HEIGHT), atol=1e-6)
        np.testing.assert_allclose(log.v_n_mps, [[1.0, 2.0, 3.0]] * 2)
        np.testing.assert_allclose(log.covariance_n_m2[1], np.diag([1.5, 2.5, 3.5]) ** 2)
        V = log.velocity_covariance_n_m2ps2[1]
        np.testing.assert_allclose(V, np.diag([0.1, 0.2, 0.3]) ** 2)
        assert log.faults == ()


def test_signs_of_rtklibs_covariances(tmp_path: Path) -> None:
    row = f"2300 100.0 {LAT} {LON} {HEIGHT} 1 9 2 3 4 1 -1.5 -0.5 0 9\n"
    path = written(tmp_path / "a.pos", POS + row + row.replace("100.0", "101.0"))
    P = read_gnss(path).covariance_n_m2[0]
    # sdeu = -1.5: east against up is -2.25, against down +2.25; sdun = -0.5 likewise
    np.testing.assert_allclose(P, [[4, 1, 0.25], [1, 9, 2.25], [0.25, 2.25, 16]])


def test_ecef_covariances_are_turned(tmp_path: Path) -> None:
    x, y, z = ecef(*np.radians([LAT, LON]), HEIGHT)
    head = POS.replace("latitude(deg) longitude(deg) height(m)", "x-ecef(m) y-ecef(m) z-ecef(m)")
    head = head.replace("sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m)", "sdx(m) sdy(m) sdz(m)"
                        " sdxy(m) sdyz(m) sdzx(m)")  # fmt: skip
    row = f"2300 100.0 {x} {y} {z} 1 9 2 3 4 1 -1.5 0.5 0 9\n"
    path = written(tmp_path / "a.pos", head + row + row.replace("100.0", "101.0"))
    log, to_n = read_gnss(path), C_ne(*np.radians([LAT, LON]))
    np.testing.assert_allclose(log.r_e_m[0], [x, y, z], atol=1e-6)
    in_e = np.array([[4, 1, 0.25], [1, 9, -2.25], [0.25, -2.25, 16]])
    np.testing.assert_allclose(log.covariance_n_m2[0], to_n @ in_e @ to_n.T, atol=1e-6)


def test_seven_columns_have_no_velocity_and_turn_with_the_week(tmp_path: Path) -> None:
    text = "".join(f"{tow} {LAT} {LON} {HEIGHT} 1 1 2\n" for tow in (604799.0, 0.0, 1.0))
    log = read_gnss(written(tmp_path / "g.txt", text), GpsTime(2300, 604_700.0))
    assert [log.time(k).week for k in range(3)] == [2300, 2301, 2301]
    assert np.isnan(log.v_n_mps).all()


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    rows = [f"{tow} {LAT} {LON} {HEIGHT} {sigma} 1 2\n" for tow, sigma in
            ((1, 1), (2, 0), (3, 1), (3, 1), (4, "nan"), (5, 1))]  # fmt: skip
    log = read_gnss(written(tmp_path / "g.txt", "".join(rows)))
    assert log.tow_s.tolist() == [1.0, 3.0, 5.0]
    text = "\n".join(log.faults)
    assert "g.txt:2: fixes without a position or its σ left out: 2" in text
    assert "g.txt:4: fixes with the time of the fix before left out: 1" in text


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("a b c\n", "expected a solution.csv"),
        (f"1 {LAT} {LON} {HEIGHT} 0 0 0\n", "no fix with a position"),
        (f"2 {LAT} {LON} {HEIGHT} 1 1 1\n1 {LAT} {LON} {HEIGHT} 1 1 1\n", "fix 2: time goes back"),
        (f"1e9 {LAT} {LON} {HEIGHT} 1 1 1\n", "no GPST second of week"),
        ("week,tow_s\n1,2\n", "'lat_deg' is missing"),
        ("% (m)\n", "no solutions"),
        ("", "expected a solution.csv"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, text: str, cause: str) -> None:
    path = written(tmp_path / "g.txt", text)
    with pytest.raises(InputFileError, match=cause) as caught:
        read_gnss(path)
    assert "g.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_real_solution_is_that_of_the_truth_reader(shared_data: Path) -> None:
    path = shared_data / "real" / "imu" / "rtklibexplorer-drive" / "gnss_1934_sf.pos"
    log, truth = read_gnss(path), read_truth(path, "rtklib_pos")
    np.testing.assert_allclose(log.r_e_m, truth.r_e_m, atol=1e-6)
    assert log.time(0) == truth.start
    sigma = np.sqrt(np.diagonal(log.covariance_n_m2, axis1=1, axis2=2))
    assert 0.005 < np.median(sigma) < 0.02


def test_fixes_with_a_navigation_in_them_are_no_news_to_one(tmp_path: Path) -> None:
    row = f"1,{LAT},{LON},{HEIGHT},0,1,2,3,1.5,2.5,3.5,0.1,0.2,0.3"
    head = OURS.replace("\n", ",source\n")
    rows = [f"2300,{100.0 + k},{row},{s}\n" for k, s in enumerate(("gnss", "gnss+ins", "ins"))]
    log = read_gnss(written(tmp_path / "solution.csv", head + "".join(rows)))
    assert log.tow_s.tolist() == [100.0]
    (fault,) = log.faults
    assert fault.endswith("fixes that have an inertial navigation in them left out: 2")
    with pytest.raises(InputFileError, match="no fix"):
        read_gnss(written(tmp_path / "aided.csv", head + rows[1]))
