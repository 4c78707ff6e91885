"""GNSS/INS software receiver for recordings of raw samples and of an IMU."""

__version__ = "0.1.0"
