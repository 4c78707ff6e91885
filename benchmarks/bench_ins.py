"""The INS alone: CPU time of an hour of increments, covariance and all, and of an epoch."""

from __future__ import annotations

import argparse
from statistics import median
from time import thread_time
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.core.records import ImuBlock, ImuGrade, InsState
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import (
    WITH_BIASES,
    WITH_SCALES,
    InitialSigmas,
    initial_covariance,
    process_noise,
)
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.increments import rows
from deepgnss.ins.navigator import InsNavigator

RATES_HZ = (100, 200, 1000)
HOUR_S = 3600
EPOCH_S = 0.1  # of the receiver
EPOCHS = 600
PREDICTIONS = 100  # per epoch: 1 kHz
START = GpsTime(2300, 100_000.0)
LEVER_B_M = np.array([0.4, 0.1, -1.2])
GRADE = ImuGrade(
    "MEMS", 1e-3, 1e-7, 1000.0, 1e-4, 1e-3, 0.02, 1e-5, 1000.0, 1e-3, 1e-3, 0.05, 1e-3, 0.01
)


class Cost(NamedTuple):
    hour_s: float  # in one piece
    epoch_ms: float  # of EPOCH_S
    prediction_ms: float  # of the antenna at PREDICTIONS instants


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3, help="runs whose median is printed")
    runs = parser.parse_args().runs
    table = Table(title="INS, one thread, CPU time", title_justify="left")
    for name in ("IMU, Hz", "states", "an hour", "an epoch of 0.1 s", "antenna at 1 kHz, 0.1 s"):
        table.add_column(name, justify="right")
    for rate_hz in RATES_HZ:
        block = hour(rate_hz)
        for states in (WITH_BIASES, WITH_SCALES):
            costs = [cost(block, rate_hz, states) for _ in range(runs + 1)][1:]  # first: compiles
            table.add_row(
                f"{rate_hz}",
                f"{states}",
                f"{median(c.hour_s for c in costs):.2f} s",
                f"{median(c.epoch_ms for c in costs):.2f} ms",
                f"{median(c.prediction_ms for c in costs):.2f} ms",
            )
    Console(width=100).print(table)


def hour(rate_hz: int) -> ImuBlock:
    """An hour of a noisy unit, level and slowly turning."""
    count, dt_s = HOUR_S * rate_hz, 1.0 / rate_hz
    noise = np.random.default_rng(1).normal(size=(2, count, 3)) * np.sqrt(dt_s)
    return ImuBlock(
        START,
        np.arange(1, count + 1) * dt_s,
        np.full(count, dt_s),
        np.array([0.0, 0.0, 0.05]) * dt_s + GRADE.gyro_noise_rad_rts * noise[0],
        np.array([0.3, 0.0, -9.8]) * dt_s + GRADE.accel_noise_mps_rts * noise[1],
    )


def cost(block: ImuBlock, rate_hz: int, states: int) -> Cost:
    """An hour at once, then epoch by epoch with predictions."""
    navigator = _navigator(states)
    began = thread_time()
    navigator.advance(block)
    hour_s = thread_time() - began

    advancing_s = predicting_s = 0.0
    per_epoch = round(EPOCH_S * rate_hz)
    for epoch in range(EPOCHS):
        piece = rows(block, epoch * per_epoch, (epoch + 1) * per_epoch)
        began = thread_time()
        navigator, trajectory = navigator.advance(piece)
        advanced = thread_time()
        instants_s = np.linspace(trajectory.time_s[0], trajectory.time_s[-1], PREDICTIONS)
        trajectory.antenna(instants_s, LEVER_B_M)
        advancing_s += advanced - began
        predicting_s += thread_time() - advanced
    return Cost(hour_s, advancing_s / EPOCHS * 1e3, predicting_s / EPOCHS * 1e3)


def _navigator(states: int) -> InsNavigator:
    zero = np.zeros(3)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    state = InsState(START, 0.55, 1.99, 60.0, zero, upright, zero, zero, zero, zero)
    P = initial_covariance(GRADE, InitialSigmas(1.0, 0.1, 1e-3, 1e-2), states)
    estimate = Estimate(Layout(states), state, np.zeros(0), P)
    return InsNavigator(estimate, process_noise(GRADE))


if __name__ == "__main__":
    main()
