"""What a log cannot be: every mistake is made once on purpose and named."""

import numpy as np
import pytest

from deepgnss.core.records import ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.ins.sanity import findings

START = GpsTime(2290, 1000.0)
RATE_HZ = 100.0
DEG = 180.0 / np.pi


def drive(gyro=1.0, accel=1.0, axes=None, origin=START, rate_hz=RATE_HZ):
    """Two minutes of a city drive: turns of 0.3 rad/s, braking, noise, a bias of 1 %."""
    rng = np.random.default_rng(1)
    n = round(120.0 * rate_hz)
    t = np.arange(1, n + 1) / rate_hz
    turn = 0.3 * np.sin(0.2 * t) ** 3
    rates = rng.normal(0.0, 0.01, (n, 3)) + np.outer(turn, [0.02, 0.01, 1.0])
    forces = rng.normal(0.0, 0.2, (n, 3)) + np.column_stack(
        [2.0 * np.sin(0.1 * t), 10.0 * turn, np.full(n, -9.9)]
    )
    turned = np.eye(3) if axes is None else np.array(axes, float)
    return ImuBlock(
        origin, t, np.full(n, 1.0 / rate_hz),
        rates @ turned.T * gyro / rate_hz, forces @ turned.T * accel / rate_hz,
    )  # fmt: skip


def test_nothing_is_said_of_a_log_that_is_as_stated():
    block = drive()
    around = (START.plus(0.2), START.plus(100.0))
    assert findings(block, stated_rate_hz=RATE_HZ, recording=around) == ()
    rest = drive(gyro=0.0)
    rest.dtheta_b_rad[:] = 1e-7
    rest.dv_b_mps[:] = [0.0, 0.0, -9.8 / RATE_HZ]
    assert findings(rest) == ()  # a log that begins at rest has no turns


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"accel": 1.0 / 9.80665}, "imu.units.accel: g"),
        ({"accel": 9.80665}, "imu.units.accel: m/s^2"),
        ({"accel": 1.0 / RATE_HZ, "gyro": 1.0 / RATE_HZ}, "imu.kind: increments"),
        ({"accel": RATE_HZ, "gyro": RATE_HZ}, "imu.kind: rates"),
        ({"accel": RATE_HZ / 9.80665, "gyro": RATE_HZ}, "imu.kind: rates, imu.units.accel: g"),
        ({"accel": 3.0}, "gravity 9.8"),
        ({"gyro": DEG}, "imu.units.gyro: deg"),
        ({"gyro": 1.0 / DEG}, "imu.units.gyro: rad"),
        ({"axes": [[0, 1, 0], [1, 0, 0], [0, 0, -1]]}, "points down"),
        ({"axes": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}, "points backward"),
        ({"axes": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}, "points right"),
    ],
)
def test_every_mistake_is_named(wrong, named):
    (found,) = findings(drive(**wrong))
    assert named in found and "\n" not in found


@pytest.mark.parametrize(
    ("shift_s", "named"),
    [
        (604_800.0, "another GPS week"),
        (-604_800.0, "another GPS week"),
        (-1024 * 604_800.0, "10-bit week"),
        (3600.0, "time zone"),
        (18.0, "UTC"),
        (14.0, "BeiDou"),
        (-5000.0, "no second in common"),
    ],
)
def test_other_clocks_are_named(shift_s, named):
    recording = (START, START.plus(110.0))
    block = drive(origin=START.plus(shift_s))
    last = block.origin.plus(120.0)
    (found,) = findings(block, recording=recording, last=last)
    assert named in found


def test_a_short_recording_beside_utc_has_no_second_in_common():
    block = drive(origin=START.plus(-18.0))
    recording = (START.plus(105.0), START.plus(115.0))
    (found,) = findings(block, recording=recording, last=block.origin.plus(120.0))
    assert "no second in common" in found and "apart" in found
    assert findings(block, recording=recording) == ()  # a log that may go on for hours


def test_a_rate_that_is_not_the_stated_one():
    assert "100 Hz, imu.rate says 200 Hz" in findings(drive(), stated_rate_hz=200.0)[0]


def test_two_rows_at_least():
    block = drive()
    one = ImuBlock(START, block.time_s[:1], block.dt_s[:1], block.dtheta_b_rad[:1],
                   block.dv_b_mps[:1])  # fmt: skip
    assert "fewer than two" in findings(one)[0]
