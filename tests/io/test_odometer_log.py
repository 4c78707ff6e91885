"""Odometer logs: round trip, names and units of others, what is left out and what is refused."""

import numpy as np
import pytest

from deepgnss.core.errors import InputFileError
from deepgnss.core.time import GpsTime
from deepgnss.io.config.aids import OdometerConfig
from deepgnss.io.imu import OdometerLog, read_odometer, write_odometer


def read(path, text, scale=1.0, near=None):
    path.write_text(text)
    return read_odometer(OdometerConfig(file=path, scale=scale), near)


def test_round_trip_through_the_turn_of_a_week(tmp_path):
    path = tmp_path / "odometer.csv"
    log = OdometerLog(GpsTime(2290, 604_799.0), np.arange(1, 31) / 10.0, np.linspace(-1, 20, 30))
    write_odometer(path, log)
    back, said = read_odometer(OdometerConfig(file=path))
    assert said == () and back.origin.week == 2290
    np.testing.assert_allclose(back.time_s + back.origin.since(log.origin), log.time_s, atol=1e-9)
    np.testing.assert_array_equal(back.speed_mps, log.speed_mps)


def test_scale_names_and_the_nearest_week(tmp_path):
    text = "time,speed\n10,36\n11,72\n"
    log, _ = read(tmp_path / "o.csv", text, 1.0 / 3.6, GpsTime(2291, 604_000.0))
    assert log.origin == GpsTime(2292, 10.0)
    np.testing.assert_allclose(log.speed_mps, [10.0, 20.0])
    np.testing.assert_allclose(log.time_s, [0.0, 1.0])


def test_what_is_left_out_is_said(tmp_path):
    path = tmp_path / "o.csv"
    text = "tow_s,speed_mps\n1,5\n2,x\n3,6\n3,6\n4,7\n"
    log, said = read(path, text)
    np.testing.assert_array_equal(log.speed_mps, [5, 6, 7])
    assert said == (
        f"{path}:3: rows that are no numbers left out: 1",
        f"{path}:5: rows with the time of the row before left out: 1",
    )


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("", "cannot read"),
        ("tow_s,rpm\n1,2\n", "speed"),
        ("tow_s,speed\na,b\n", "holds no speeds"),
        ("tow_s,speed\n1,5\n2,5\n1.5,5\n", r":4: time goes back"),
        ("tow_s,speed\n1,500\n", "km/h"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, text, cause):
    path = tmp_path / "o.csv"
    with pytest.raises(InputFileError, match=cause) as refused:
        read(path, text)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)
