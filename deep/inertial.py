"""From the configuration to what the inertial navigation is told."""

from __future__ import annotations

import numpy as np

from deepgnss.core.attitude import matrix_from_euler
from deepgnss.core.errors import ConfigError
from deepgnss.core.records import ImuBlock
from deepgnss.deep.tight import clock_sigmas
from deepgnss.ins import AlignmentSettings, Layout, Settings, Vehicle, WheelSpeeds
from deepgnss.ins.standstill import standstill_limits
from deepgnss.io.config import Config
from deepgnss.io.config.aids import ImuConfig
from deepgnss.io.imu import OdometerLog


def imu_section(config: Config) -> ImuConfig:
    """The section `imu`; ConfigError where there is none."""
    if config.imu is None:
        raise ConfigError("imu: found nothing; expected the section on the inertial unit")
    return config.imu


def layout_of(config: Config, wheels: WheelSpeeds | None) -> Layout:
    """Errors the filter carries."""
    return Layout(config.ins.states, odometer=wheels is not None)


def coupling_settings(config: Config, block: ImuBlock, wheels: WheelSpeeds | None) -> Settings:
    """How the filter is run on an inertial log."""
    imu, ins = imu_section(config), config.ins
    vehicle = None
    if ins.vehicle is not None:
        per_epoch = 1.0 / np.sqrt(ins.epoch)  # of the mean over a second
        vehicle = Vehicle(
            np.array(ins.vehicle.axle),
            matrix_from_euler(np.radians(ins.vehicle.mounting)),
            (ins.vehicle.lateral * per_epoch, ins.vehicle.vertical * per_epoch),
        )
    rate_hz = 1.0 / float(np.median(block.dt_s))
    return Settings(
        lever_b_m=np.array(imu.lever_arm),
        vehicle=vehicle,
        odometer_sigma_mps=ins.odometer.sigma if wheels is not None else None,
        standstill=standstill_limits(imu.grade.build(), rate_hz) if ins.standstill else None,
        epoch_s=ins.epoch,
        false_alarm=ins.false_alarm,
        restart_after=ins.restart_after,
    )


def alignment_settings(config: Config, layout: Layout) -> AlignmentSettings:
    """How the first attitude is found."""
    imu = imu_section(config)
    alignment = imu.alignment
    given = (alignment.roll, alignment.pitch, alignment.yaw)
    roll, pitch, yaw = (0.0 if angle is None else np.radians(angle) for angle in given)
    mounted = config.ins.vehicle.mounting[2] if config.ins.vehicle else 0.0
    return AlignmentSettings(
        alignment.method,
        np.array(imu.lever_arm),
        (roll, pitch, yaw) if alignment.method == "config" else None,
        mounting_yaw_rad=float(np.radians(mounted)),
        layout=layout,
        extras=np.zeros(layout.extras),
        extra_sigmas=np.append(
            np.full(int(layout.odometer), config.ins.odometer.scale),
            clock_sigmas(layout.systems) if layout.systems else [],
        ),
    )


def wheel_speeds(log: OdometerLog) -> WheelSpeeds:
    """Speeds at the middle of the times they are means over."""
    if log.time_s.size < 2:
        return WheelSpeeds(*log)
    usual_s = np.median(np.diff(log.time_s))
    length_s = np.minimum(np.diff(log.time_s, prepend=log.time_s[0] - usual_s), 1.5 * usual_s)
    return WheelSpeeds(log.origin, log.time_s - 0.5 * length_s, log.speed_mps)
