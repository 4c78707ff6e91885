"""Files of a loose coupling: trajectories, biases, innovations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
import pymap3d

from deepgnss.core.attitude import euler_rad
from deepgnss.core.frames import geodetic
from deepgnss.core.records import FloatArray
from deepgnss.deep.loose import Epochs, LooseRun
from deepgnss.deep.navigation import NavigationState
from deepgnss.io.inertial_tables import (
    SENSORS,
    BiasTable,
    InnovationTable,
    KfginsNav,
    TrajectoryTable,
)

FILES: Final = (
    *("trajectory.csv", "trajectory_smoothed.csv", "biases.csv", "innovations.csv"),
    *("trajectory.nav", "errors.csv", "outages.csv", "inertial.png"),
)
"""Names of all files a run may leave."""

_DEGREES_PER_HOUR: Final = np.degrees(1.0) * 3600.0


def write_run(folder: Path, run: LooseRun) -> None:
    """Write everything but what needs a truth."""
    best = run.smooth or run.forward
    with ExitStack() as stack:
        _write_trajectory(
            stack.enter_context(TrajectoryTable(folder / "trajectory.csv")), run.forward
        )
        if run.smooth is not None:
            table = TrajectoryTable(folder / "trajectory_smoothed.csv")
            _write_trajectory(stack.enter_context(table), run.smooth)
        names = [*SENSORS[: run.layout.inertial - 9], *["odometer_scale"] * run.layout.odometer]
        biases = stack.enter_context(BiasTable(folder / "biases.csv", names))
        unit = np.ones(len(names))
        unit[:3] = _DEGREES_PER_HOUR
        for k in range(run.forward.time_s.size):
            values, sigmas = run.forward.sensors[k], run.forward.sensor_sigmas[k]
            biases.write(run.forward.time(k), values * unit, sigmas * unit)
        innovations = stack.enter_context(InnovationTable(folder / "innovations.csv"))
        for i in run.integration.innovations:
            innovations.write(i.time, i.kind, i.innovation, i.nis, i.accepted)
        nav = KfginsNav(folder / "trajectory.nav")
        for k, _, imu, euler_deg in _places(best):
            nav.write(best.time(k), imu, best.v_n_mps[k], euler_deg)
        nav.file.close()


def write_state(table: TrajectoryTable, state: NavigationState) -> None:
    """Append the navigation of a receiver's tag."""
    ins, P = state.estimate.ins, state.estimate.P
    degrees = float(np.degrees(1.0))
    lat_rad, lon_rad, height_m = geodetic(state.antenna.r_e_m)
    antenna = np.array([lat_rad * degrees, lon_rad * degrees, height_m])
    imu = np.array([ins.lat_rad * degrees, ins.lon_rad * degrees, ins.height_m])
    euler_deg = euler_rad(ins.q_nb) * degrees
    euler_deg[2] %= 360.0
    sigmas = np.sqrt(np.diagonal(P)[:9])
    sigmas[6:] *= degrees
    table.write(state.time, antenna, imu, ins.v_n_mps, euler_deg, sigmas)


def _write_trajectory(table: TrajectoryTable, epochs: Epochs) -> None:
    unit = np.ones(9)
    unit[6:] = np.degrees(1.0)
    sigmas = np.sqrt(np.diagonal(epochs.covariance, axis1=1, axis2=2)) * unit
    for k, antenna, imu, euler_deg in _places(epochs):
        table.write(epochs.time(k), antenna, imu, epochs.v_n_mps[k], euler_deg, sigmas[k])


def _places(epochs: Epochs) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Index, antenna, IMU (degrees and metres), roll, pitch, heading in [0, 360)."""
    antenna = np.column_stack(pymap3d.ecef2geodetic(*epochs.antenna_r_e_m.T))
    imu = epochs.place * np.array([np.degrees(1.0), np.degrees(1.0), 1.0])
    euler_deg = np.degrees(euler_rad(epochs.q_nb))
    euler_deg[:, 2] %= 360.0
    for k in range(epochs.time_s.size):
        yield k, antenna[k], imu[k], euler_deg[k]
