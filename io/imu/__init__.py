"""Logs of inertial units and odometers: readers and writers."""

from deepgnss.io.imu.odometer import OdometerLog, read_odometer, write_odometer
from deepgnss.io.imu.reader import ImuLog
from deepgnss.io.imu.writer import ENDINGS, ImuFormat, ImuKind, ImuWriter

__all__ = [
    "ENDINGS",
    "ImuFormat",
    "ImuKind",
    "ImuLog",
    "ImuWriter",
    "OdometerLog",
    "read_odometer",
    "write_odometer",
]
