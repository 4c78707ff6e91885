"""A car on a level ellipse with changing speed, its sensors by grade, fixes with known noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from deepgnss.core.attitude import quaternion_from_matrix
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade, InsState
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import InitialSigmas, initial_covariance
from deepgnss.ins.error_state import Estimate, Layout, corrected
from deepgnss.ins.fixes import GnssFix, WheelSpeeds
from deepgnss.ins.imu_errors import ImuErrors, SensorErrors
from deepgnss.ins.increments import joined
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import EllipseAttitude
from deepgnss.sim.motion.paths import Ellipse
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

DEG = np.pi / 180.0
HOUR = DEG / 3600.0
START = GpsTime(2300, 604_700.0)  # the week ends on the way
LEVER_B_M = np.array([0.4, 0.1, -1.2])

FSAS = ImuGrade(
    "FSAS", 0.1 * HOUR, 0.1 * HOUR, 10800.0, 0.15 * DEG / 60, 1e-5, 50e-5, 100e-5, 10800.0,
    0.03 / 60, 300e-6, 0.008, 0.01 * DEG, 0.05 * DEG,
)  # fmt: skip
MTI_G = ImuGrade(
    "MTi-G", 15 * HOUR, 100 * HOUR, 600.0, 3 * DEG / 60, 1e-3, 800e-5, 2000e-5, 600.0,
    0.12 / 60, 1000e-6, 0.05, 0.10 * DEG, 0.15 * DEG,
)  # fmt: skip


@dataclass(frozen=True)
class Drive:
    """True motion and error-free increments."""

    vehicle: Vehicle
    block: ImuBlock

    def state(self, time_s: float, errors: SensorErrors | None = None) -> InsState:
        """Truth at an instant, with the true errors of the sensors where given."""
        pose = self.vehicle.pose(np.array([time_s]))
        lat, lon, height = geodetic(pose.r_e_m[0])
        to_n = C_ne(lat, lon)
        row = min(int(np.searchsorted(self.block.time_s, time_s)), self.block.time_s.size - 1)
        zero = np.zeros(3)
        return InsState(
            START.plus(time_s),
            lat,
            lon,
            height,
            to_n @ pose.v_e_mps[0],
            quaternion_from_matrix(to_n @ pose.C_eb[0]),
            zero if errors is None else errors.gyro_bias_radps[row],
            zero if errors is None else errors.accel_bias_mps2[row],
            zero if errors is None else errors.gyro_scale,
            zero if errors is None else errors.accel_scale,
        )

    def fixes(
        self,
        times_s: FloatArray,
        rng: np.random.Generator,
        position_m: float = 1.0,
        velocity_mps: float = 0.05,
    ) -> list[GnssFix]:
        """Antenna fixes with white errors."""
        motion = self.vehicle.point(times_s, (0.4, 0.1, -1.2))
        found = []
        for time_s, r_e, v_e in zip(times_s, motion.r_m, motion.v_mps, strict=True):
            lat, lon, _ = geodetic(r_e)
            found.append(
                GnssFix(
                    START.plus(float(time_s)),
                    r_e + rng.normal(size=3) * position_m,
                    position_m**2 * np.eye(3),
                    C_ne(lat, lon) @ v_e + rng.normal(size=3) * velocity_mps,
                    velocity_mps**2 * np.eye(3),
                )
            )
        return found

    def wheels(
        self, times_s: FloatArray, rng: np.random.Generator, scale: float, sigma_mps: float
    ) -> WheelSpeeds:
        """Speeds of a wheel at the IMU that reads too much by a scale."""
        speed = np.linalg.norm(self.vehicle.pose(times_s).v_e_mps, axis=1)
        noise = rng.normal(size=times_s.size) * sigma_mps
        return WheelSpeeds(START, times_s, speed * (1.0 + scale) + noise)


@lru_cache(maxsize=4)
def drive(seconds: float = 300.0, rate_hz: float = 100.0) -> Drive:
    """Rounds of some 8–16 m/s, right-hand, 150 m by 100 m."""
    turns = [(float(t), 0.1 + 0.03 * np.sin(0.9 * k)) for k, t in enumerate(range(0, 4000, 12))]
    path = Ellipse(150.0, 100.0, smooth_profile(turns, flat=2))
    vehicle = Vehicle(0.53, 1.99, 30.0, path, EllipseAttitude(path, 0.2))
    blocks = increments(vehicle, START, rate_hz, round(seconds * rate_hz), highest_hz=2.0)
    return Drive(vehicle, joined(*blocks))


def sensed(truth: Drive, grade: ImuGrade, seed: int) -> tuple[ImuBlock, SensorErrors]:
    """Readings of a unit of a grade, and its true errors."""
    return ImuErrors(grade, np.random.default_rng([seed, 1])).apply(truth.block)


def started(
    truth: Drive,
    grade: ImuGrade,
    errors: SensorErrors,
    layout: Layout,
    rng: np.random.Generator,
    position_m: float = 1.0,
    at_s: float = 0.0,
) -> Estimate:
    """Estimate off the truth by errors drawn from its own covariance."""
    sigmas = InitialSigmas(position_m, grade.velocity_mps, grade.tilt_rad, grade.heading_rad)
    P = np.zeros((layout.size, layout.size))
    inertial = layout.inertial
    P[:inertial, :inertial] = initial_covariance(grade, sigmas, inertial)
    if layout.odometer:
        P[layout.odometer_scale, layout.odometer_scale] = 0.02**2
    drawn = rng.normal(size=21) * np.sqrt(np.diagonal(initial_covariance(grade, sigmas, 21)))
    drawn[9:] = 0.0  # the sensors' errors are their own: the estimate starts without any
    nominal = replace(corrected(truth.state(at_s), -drawn), time=START.plus(at_s))
    return Estimate(layout, nominal, np.zeros(layout.extras), P)
