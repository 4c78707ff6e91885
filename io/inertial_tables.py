"""CSV tables of an inertial navigation, and its trajectory as KF-GINS writes it.

Angles are in degrees, gyro biases in deg/h; a blank cell is a number that does not exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.output import OutputFile
from deepgnss.io.tables import Table, number


class TrajectoryTable(Table):
    """trajectory.csv: one row per epoch; places of antenna and IMU, velocity of the IMU.

    Reads back as a truth. σ are those of the IMU; attitude σ about north, east, down.
    """

    columns = (
        *("week", "tow_s", "lat_deg", "lon_deg", "height_m"),
        *("imu_lat_deg", "imu_lon_deg", "imu_height_m", "v_n_mps", "v_e_mps", "v_d_mps"),
        *("roll_deg", "pitch_deg", "heading_deg", "sigma_n_m", "sigma_e_m", "sigma_d_m"),
        *("sigma_vn_mps", "sigma_ve_mps", "sigma_vd_mps"),
        *("sigma_phi_n_deg", "sigma_phi_e_deg", "sigma_phi_d_deg"),
    )

    def write(
        self,
        time: GpsTime,
        antenna: FloatArray,
        imu: FloatArray,
        v_n_mps: FloatArray,
        euler_deg: FloatArray,
        sigmas: FloatArray,
    ) -> None:
        """Append an epoch; places are degrees and metres, sigmas (9,) m, m/s and degrees."""
        self._row(
            [
                *(str(time.week), f"{time.tow_s:.6f}"),
                *_place(antenna),
                *_place(imu),
                *_each(v_n_mps, 5),
                *_each(euler_deg, 5),
                *_each(sigmas, 5),
            ]
        )


SENSORS = (
    *("gyro_x_degph", "gyro_y_degph", "gyro_z_degph"),
    *("accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
    *("gyro_scale_x", "gyro_scale_y", "gyro_scale_z"),
    *("accel_scale_x", "accel_scale_y", "accel_scale_z"),
)
"""What the filter knows of the sensors, in its order."""


class BiasTable(Table):
    """biases.csv: what the sensors read too much, and how well that is known."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.columns = ("week", "tow_s", *names, *(f"sigma_{name}" for name in names))  # type: ignore[misc]
        super().__init__(path)

    def write(self, time: GpsTime, values: FloatArray, sigmas: FloatArray) -> None:
        """Append an epoch."""
        cells = [*_each(values, 7), *_each(sigmas, 7)]
        self._row([str(time.week), f"{time.tow_s:.6f}", *cells])


class InnovationTable(Table):
    """innovations.csv: predicted − measured of every measurement, its NIS, whether believed."""

    columns = ("week", "tow_s", "kind", "size", "nis", "accepted", "z_1", "z_2", "z_3")

    def write(
        self, time: GpsTime, kind: str, innovation: FloatArray, nis: float, accepted: bool
    ) -> None:
        """Append a measurement of up to three components, in the unit of its kind."""
        z = [*_each(innovation, 5), "", "", ""][:3]
        facts = [kind, str(innovation.size), number(nis, 4), str(int(accepted))]
        self._row([str(time.week), f"{time.tow_s:.6f}", *facts, *z])


class KfginsNav:
    """trajectory.nav, KF-GINS text: week, tow, place of the IMU, velocity NED, attitude."""

    def __init__(self, path: Path) -> None:
        self.file = OutputFile(path)

    def write(
        self, time: GpsTime, imu: FloatArray, v_n_mps: FloatArray, euler_deg: FloatArray
    ) -> None:
        """Append an epoch; degrees, metres, m/s."""
        roll, pitch, yaw = euler_deg
        numbers = [*_place(imu), *_each(v_n_mps, 5), *_each(np.array([roll, pitch, yaw % 360]), 6)]
        self.file.write(" ".join([str(time.week), f"{time.tow_s:.6f}", *numbers]) + "\n")


def _place(place: FloatArray) -> list[str]:
    lat_deg, lon_deg, height_m = place
    return [number(lat_deg, 10), number(lon_deg, 10), number(height_m, 4)]


def _each(values: FloatArray, digits: int) -> list[str]:
    return [number(float(value), digits) for value in values]
