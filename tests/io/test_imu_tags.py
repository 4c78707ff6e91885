"""RTKLIB time tags: the clock of a log that has only ticks, from when its bytes came in."""

import struct
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.errors import InputFileError
from deepgnss.core.time import GpsTime
from deepgnss.io.config.aids import ImuConfig
from deepgnss.io.imu import ImuLog
from deepgnss.io.imu.tag import read_tags

OPENED = GpsTime(2374, 243_261.5)  # 2025-07-08 19:34:21.5
SLOPE = 1.0 + 25e-6  # the log's clock is slow: its ticks are longer than they say
FIRST_TICK = 777_000


def logged(folder: Path, ending="\r\n", kept="\r\n", seconds=300.0, seed=5):
    """A log at 100 Hz whose rows come in 0 to 15 ms late, and its tags in steps of 15.6 ms."""
    rng = np.random.default_rng(seed)
    n = round(seconds * 100.0)
    ticks = FIRST_TICK + 10 * np.arange(n)
    true_s = 0.2 + (ticks - FIRST_TICK) * 1e-3 * SLOPE
    lines = [f"0.1,0.2,1.0,0.5,0.1,0.2,{tick}" for tick in ticks]
    log = folder / "imu.csv"
    log.write_text("".join(line + kept for line in lines), newline="")
    written = np.cumsum([len(line) + len(ending) for line in lines])
    came = np.maximum.accumulate(true_s + rng.uniform(0.0, 0.015, n))
    pairs, at = [], np.ceil(came / 0.0156) * 0.0156
    for moment in np.unique(at):
        pairs.append((round(moment * 1e3), written[np.flatnonzero(at <= moment)[-1]]))
    head = b"TIMETAG RTKLIB test".ljust(60, b"\0") + struct.pack("<IId", 123, 1_752_003_261, 0.5)
    tags = folder / "imu.csv.tag"
    tags.write_bytes(head + b"".join(struct.pack("<II", *pair) for pair in pairs))
    return log, tags, true_s


def settings(log, tags):
    return ImuConfig(
        file=log,
        columns=("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "tick"),
        kind="rates",
        units={"gyro": "deg/s", "accel": "g"},
        time="tick",
        tick=1e-3,
        tag_file=tags,
    )


@pytest.mark.parametrize("kept", ["\r\n", "\n"])
def test_ticks_fall_on_gpst_but_for_the_least_delay(tmp_path, kept):
    log, tags, true_s = logged(tmp_path, kept=kept)
    blocks = list(ImuLog(settings(log, tags)))
    time_s = np.concatenate([block.time_s for block in blocks])
    assert blocks[0].origin == OPENED
    late_s = time_s - true_s
    assert np.abs(late_s).max() < 1e-3  # of delays from 0 to 31 ms, told in whole ms
    assert np.ptp(late_s) < 1e-3  # over 300 s: 25e-6 of drift found to 3e-6


def test_start_of_the_tags_is_gpst_by_calendar(tmp_path):
    _, tags, _ = logged(tmp_path, seconds=1.0)
    assert read_tags(tags)[0] == OPENED


def test_tags_of_another_log_are_refused(tmp_path):
    log, tags, _ = logged(tmp_path, seconds=20.0)
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:500]))
    with pytest.raises(InputFileError, match="not its time tags"):
        list(ImuLog(settings(log, tags)))
    tags.write_bytes(b"something else")
    with pytest.raises(InputFileError, match="not an RTKLIB time tag file"):
        list(ImuLog(settings(log, tags)))
