"""Logs of inertial unit and odometer, with the truth behind them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.ins.imu_errors import ImuErrors, SensorErrors
from deepgnss.io.container import ContainerWriter
from deepgnss.io.imu import ENDINGS, ImuWriter, OdometerLog
from deepgnss.io.imu import write_odometer as write_log
from deepgnss.io.imu.writer import section
from deepgnss.sim.imu.carried import Moving, Shaken, with_phases
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.imu.odometer import wheel_speed
from deepgnss.sim.motion.vehicle import geographic
from deepgnss.sim.output.columns import ColumnTable, time_columns
from deepgnss.sim.output.truth import MOTION_COLUMNS, motion_cells
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema.build import Simulation
from deepgnss.sim.schema.inertial import ImuLogConfig
from deepgnss.sim.seeds import random_stream

INERTIAL_FILES: Final = (*(f"imu{ending}" for ending in ENDINGS.values()), "imu_truth.csv")
ODOMETER_FILE: Final = "odometer.csv"

_MARGIN_S: Final = 1.0  # of the log before and after the recording
_HIGHEST_HZ: Final = 100.0  # in the motion of a vehicle
_MOVING_MPS: Final = 2.0  # a course to align by
_ERROR_FREE: Final = "STIM300"  # what a filter may take an error-free unit for

_SENSOR_COLUMNS: Final[Mapping[str, int | None]] = {
    **{f"gyro_bias_{axis}_radps": 12 for axis in "xyz"},
    **{f"accel_bias_{axis}_mps2": 9 for axis in "xyz"},
    **{f"gyro_scale_{axis}": 9 for axis in "xyz"},
    **{f"accel_scale_{axis}": 9 for axis in "xyz"},
}


def imu_name(simulation: Simulation) -> str | None:
    """Name of the log; None where the recording's container holds it."""
    config = _imu(simulation)
    in_container = simulation.config.container and config.format == "hdf5"
    return None if in_container else f"imu{ENDINGS[config.format]}"


def write_imu(
    folder: Path, simulation: Simulation, container: ContainerWriter | None = None
) -> list[tuple[Path, str]]:
    """Write the log, into an open container where there is one for it, and imu_truth.csv."""
    config, scenario = _imu(simulation), simulation.scenario
    name = imu_name(simulation)
    truth = folder / "imu_truth.csv"
    with (
        _writer(simulation, folder / name if name else _required(container)) as log,
        ColumnTable(truth, {**MOTION_COLUMNS, **_SENSOR_COLUMNS}) as table,
    ):
        for block, errors, body in _readings(config, scenario):
            log.write(block)
            table.write(
                *time_columns(block.origin, block.time_s),
                *motion_cells(body.pose(block.time_s)),
                *_sensor_cells(errors, block.time_s.size),
            )
    grade = config.grade.name if config.grade else "error-free"
    files = [(truth, "where the inertial unit was, and its sensors' true errors")]
    if name:
        holds = f"inertial log, {config.rate:g} Hz, {config.format} {config.kind}, {grade}"
        files.insert(0, (folder / name, holds))
    return files


def _required(container: ContainerWriter | None) -> ContainerWriter:
    if container is None:
        raise ValueError("an HDF5 log of a container needs the container")
    return container


def _writer(simulation: Simulation, place: Path | ContainerWriter) -> ImuWriter:
    config = _imu(simulation)
    return ImuWriter(place, config.format, config.kind, config.axes, config.model)


def _imu(simulation: Simulation) -> ImuLogConfig:
    config = simulation.config.imu
    if config is None:
        raise ValueError("the scenario has no inertial unit")
    return config


def _readings(
    config: ImuLogConfig, scenario: Scenario
) -> Iterator[tuple[ImuBlock, SensorErrors | None, Moving]]:
    """What the unit reads, block by block, with its true errors and its body."""
    body: Moving = scenario.vehicle
    highest_hz = _HIGHEST_HZ
    if config.vibration:
        lines = [line.build() for line in config.vibration]
        body = Shaken(body, with_phases(lines, random_stream(scenario.seed, "vibration")))
        highest_hz = max(highest_hz, body.highest_hz)
    errors = None
    if config.grade is not None:
        errors = ImuErrors(config.grade.build(), random_stream(scenario.seed, "imu"))
    first = -round(_MARGIN_S * config.rate)
    count = math.ceil((scenario.seconds + _MARGIN_S) * config.rate) - first
    for block in increments(body, scenario.start, config.rate, count, first, highest_hz):
        if errors is None:
            yield block, None, body
        else:
            yield *errors.apply(block), body


def _sensor_cells(errors: SensorErrors | None, count: int) -> list[FloatArray]:
    if errors is None:
        return [np.zeros(count)] * len(_SENSOR_COLUMNS)
    constants = (np.tile(scale, (count, 1)) for scale in (errors.gyro_scale, errors.accel_scale))
    return [
        *errors.gyro_bias_radps.T,
        *errors.accel_bias_mps2.T,
        *(x for c in constants for x in c.T),
    ]


def write_odometer(folder: Path, simulation: Simulation) -> tuple[Path, str]:
    """Write odometer.csv."""
    config, scenario = simulation.config.odometer, simulation.scenario
    if config is None:
        raise ValueError("the scenario has no odometer")
    random = random_stream(scenario.seed, "odometer")
    time_s, speed_mps = wheel_speed(
        scenario.vehicle, config.rate, scenario.seconds, config.build(), random
    )
    write_log(folder / ODOMETER_FILE, OdometerLog(scenario.start, time_s, speed_mps))
    return folder / ODOMETER_FILE, f"wheel speed, {config.rate:g} Hz"


# --- how `deepgnss process` reads them -----------------------------------------------------------


def imu_settings(simulation: Simulation) -> dict[str, Any]:
    """Section `imu` of the configuration."""
    config, scenario = _imu(simulation), simulation.scenario
    name = imu_name(simulation)
    grade: Any = _ERROR_FREE
    if config.grade is not None:
        grade = config.grade.model_dump(mode="json")
    return {
        **section(name, config.format, config.kind, config.axes, config.model),
        "grade": grade,
        "lever_arm": list(scenario.antennas[0].lever_b_m),
        "alignment": _alignment(scenario),
    }


def _alignment(scenario: Scenario) -> dict[str, Any]:
    """By motion where there is some; a unit that stands is told its attitude."""
    t_s = np.linspace(0.0, scenario.seconds, 200)
    seen = geographic(scenario.vehicle.pose(t_s))
    level_mps = np.hypot(*seen.v_n_mps[:, :2].T)
    if level_mps.max() > _MOVING_MPS:
        return {"method": "motion"}
    roll, pitch, yaw = (round(float(x), 9) + 0.0 for x in np.degrees(seen.euler_rad[0]))
    return {"method": "config", "roll": roll, "pitch": pitch, "yaw": yaw}


def odometer_settings() -> dict[str, Any]:
    """Sections `odometer` and `ins` of the configuration.

    A vehicle on a road rolls where the IMU is; the odometer's scale error is for the filter to
    find.
    """
    return {"odometer": {"file": ODOMETER_FILE}, "ins": {"vehicle": {"axle": [0.0, 0.0, 0.0]}}}
