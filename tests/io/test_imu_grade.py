"""The error models of inertial units: T table 4.1 in SI units, names, refusals."""

import itertools
import math

import pytest

from deepgnss.core.errors import ConfigError
from deepgnss.io.config import imu_grade, imu_grade_names, load_config

DEG = math.pi / 180.0


def test_table_of_t_in_si_units():
    fsas, mti = imu_grade("FSAS"), imu_grade("MTi-G")
    assert fsas.gyro_bias_radps == pytest.approx(4.8481e-7, rel=1e-4)  # 0.1 deg/h
    assert mti.gyro_bias_radps / fsas.gyro_bias_radps == pytest.approx(150.0)
    assert mti.gyro_drift_radps2_rthz == pytest.approx(100.0 / 3600.0 * DEG)
    assert fsas.gyro_drift_time_s == 10_800.0 and mti.accel_drift_time_s == 600.0
    # a random walk of 3 deg/√h is 3 deg after an hour
    assert mti.gyro_noise_rad_rts * math.sqrt(3600.0) == pytest.approx(3.0 * DEG)
    assert fsas.accel_noise_mps_rts * math.sqrt(3600.0) == pytest.approx(0.03)
    assert fsas.accel_bias_mps2 == pytest.approx(50e-5)  # 1 mGal = 1e-5 m/s²
    assert mti.accel_drift_mps3_rthz == pytest.approx(0.02)
    assert fsas.accel_scale == pytest.approx(3e-4) and mti.accel_scale == pytest.approx(1e-3)
    assert (fsas.velocity_mps, mti.velocity_mps) == (0.008, 0.05)
    assert mti.tilt_rad == pytest.approx(0.10 * DEG) and mti.heading_rad == pytest.approx(
        0.15 * DEG
    )


def test_grades_come_in_the_order_of_their_price():
    order = ["FSAS", "STIM300", "MTi-G", "automotive"]
    assert sorted(order) == imu_grade_names()
    for better, worse in itertools.pairwise(order[:3]):
        assert imu_grade(better).gyro_noise_rad_rts <= imu_grade(worse).gyro_noise_rad_rts
        assert imu_grade(better).accel_bias_mps2 < imu_grade(worse).accel_bias_mps2


def test_unknown_name_and_wrong_values_say_what_fits(tmp_path):
    with pytest.raises(ConfigError, match="FSAS, MTi-G, STIM300, automotive"):
        imu_grade("HG1700")
    path = tmp_path / "car.yaml"
    path.write_text("imu: {format: hdf5, grade: MTI}\n")
    with pytest.raises(ConfigError, match=r"imu\.grade.*MTi-G"):
        load_config(path)
    path.write_text(
        "imu: {format: hdf5, grade: {gyro: {bias: -1, noise: 3}, accelerometer: {bias: 1}}}\n"
    )
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    assert "imu.grade.gyro.bias" in str(refused.value) and "deg/h" in str(refused.value)
