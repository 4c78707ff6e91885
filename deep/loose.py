"""Loose coupling of files: an inertial log and a GNSS solution to a trajectory with its σ."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime, from_utc
from deepgnss.deep.inertial import (
    alignment_settings,
    coupling_settings,
    imu_section,
    layout_of,
    wheel_speeds,
)
from deepgnss.ins import (
    Alignment,
    Estimate,
    GnssFix,
    Integration,
    Layout,
    Settings,
    WheelSpeeds,
    integrate,
    process_noise,
    smoothed,
)
from deepgnss.ins.error_model import ProcessNoise
from deepgnss.ins.fixes import with_lasting_errors
from deepgnss.ins.increments import SAME_INSTANT_S, between, joined
from deepgnss.ins.integration import SAME_EPOCH_S
from deepgnss.ins.measurements import body_point
from deepgnss.ins.sanity import findings
from deepgnss.io.config import Config
from deepgnss.io.config.ins import GnssErrorConfig
from deepgnss.io.gnss import GnssLog, is_weekless, read_gnss
from deepgnss.io.imu import ImuLog, read_odometer

NAVIGATION = 9
"""Errors of position, velocity and attitude: the first of the filter's."""


class Inputs(NamedTuple):
    """What the files hold, and what is odd about it, a line each."""

    block: ImuBlock
    fixes: tuple[GnssFix, ...]
    wheels: WheelSpeeds | None
    warnings: tuple[str, ...]


class Outage(NamedTuple):
    """Fixes to withhold, seconds since the first fix."""

    from_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Epochs:
    """Estimates of the filter, or the smoother, at n instants, seconds since `origin`."""

    origin: GpsTime
    time_s: FloatArray  # (n,)
    place: FloatArray  # (n, 3) latitude and longitude in rad, height in m, of the IMU
    v_n_mps: FloatArray  # (n, 3) of the IMU
    q_nb: FloatArray  # (n, 4)
    covariance: FloatArray  # (n, 9, 9) of position (m, NED), velocity and attitude (phi-angle)
    antenna_r_e_m: FloatArray  # (n, 3)
    antenna_v_n_mps: FloatArray  # (n, 3)
    antenna_covariance: FloatArray  # (n, 6, 6) of its position and velocity, NED
    sensors: FloatArray  # (n, m) biases, scales (with 21 states), odometer scale (with odometer)
    sensor_sigmas: FloatArray  # (n, m)

    def time(self, k: int) -> GpsTime:
        """GPST of an epoch."""
        return self.origin.plus(float(self.time_s[k]))


@dataclass(frozen=True, slots=True)
class LooseRun:
    """A finished run; `withheld` are the fixes kept from the filter, by outage."""

    inputs: Inputs
    noise: ProcessNoise
    settings: Settings
    layout: Layout
    integration: Integration
    forward: Epochs
    smooth: Epochs | None
    withheld: tuple[tuple[GnssFix, ...], ...]


# --- what the files hold -------------------------------------------------------------------------


def read_inputs(config: Config, gnss_file: Path) -> Inputs:
    """Read the IMU's log, the GNSS solution and the odometer's log, all on one time.

    Raises
    ------
    ConfigError, InputFileError: one of them cannot be used, or they have no second in common.
    """
    imu = imu_section(config)
    start = config.recording.start_time
    near = None if start is None else from_utc(start)
    gnss = None if is_weekless(gnss_file) else read_gnss(gnss_file)
    log = ImuLog(imu, near=gnss.time(0) if gnss else near)
    block = joined(*log)
    if gnss is None:
        gnss = read_gnss(gnss_file, near or block.origin)
    first, last = gnss.time(0), gnss.time(len(gnss.week) - 1)
    imu_last = block.origin.plus(float(block.time_s[-1]))
    warnings = [*log.faults, *gnss.faults]
    if imu.time_offset == "auto":
        warnings.append("imu.time_offset: auto: not found from files, 0 s taken")
    found = findings(block, stated_rate_hz=imu.rate, recording=(first, last), last=imu_last)
    if min(imu_last.since(first), last.since(block.origin.plus(float(block.time_s[0])))) < 0.0:
        raise InputFileError(f"{log.path}: {found[-1].replace('recording', gnss_file.name)}")
    warnings += [f"{log.path}: {line.replace('recording', gnss_file.name)}" for line in found]
    wheels = None
    if config.odometer is not None:
        if config.ins.vehicle is None:
            raise ConfigError("ins.vehicle: found nothing; the odometer needs to know the axle")
        speeds, faults = read_odometer(config.odometer, first)
        wheels = wheel_speeds(speeds)
        warnings += faults
    return Inputs(block, _fixes(gnss, config.ins.gnss), wheels, tuple(warnings))


def _fixes(log: GnssLog, errors: GnssErrorConfig) -> tuple[GnssFix, ...]:
    """Fixes with what their σ leaves out."""
    weeks_s = (log.week - log.week[0]) * SECONDS_PER_WEEK
    steps_s = np.diff(weeks_s + log.tow_s)
    usual_s = float(np.median(steps_s)) if steps_s.size else 1.0
    found = []
    for k in range(len(log.week)):
        v_n, V = log.v_n_mps[k], log.velocity_covariance_n_m2ps2[k]
        known = errors.velocities and bool(np.isfinite(v_n).all())
        stated = GnssFix(
            log.time(k),
            log.r_e_m[k],
            log.covariance_n_m2[k],
            v_n if known else None,
            V if known else None,
        )
        found.append(
            with_lasting_errors(
                stated, errors.position, errors.velocity, errors.correlation, usual_s
            )
        )
    return tuple(found)


# --- the run -------------------------------------------------------------------------------------


def run_loose(config: Config, inputs: Inputs, outages: Sequence[Outage] = ()) -> LooseRun:
    """Align, filter, and smooth where the config asks for it.

    Raises
    ------
    ConfigError: an outage holds no fix.
    """
    imu = imu_section(config)
    withheld = tuple(_withheld(inputs.fixes, outage) for outage in outages)
    hidden = {id(fix) for held in withheld for fix in held}
    fixes = [fix for fix in inputs.fixes if id(fix) not in hidden]
    grade = imu.grade.build()
    layout = layout_of(config, inputs.wheels)
    settings = coupling_settings(config, inputs.block, inputs.wheels)
    settings = replace(settings, keep_trajectories=bool(outages))
    aligner = Alignment(
        inputs.block, fixes, grade, alignment_settings(config, layout), settings.standstill
    )
    noise = process_noise(grade)
    integration = integrate(inputs.block, fixes, aligner, noise, settings, inputs.wheels)
    forward = _epochs([e.estimate for e in integration.epochs], layout, inputs.block, settings)
    smooth = None
    if config.ins.smoother and integration.epochs:
        smooth = _epochs(smoothed(integration.epochs), layout, inputs.block, settings)
    return LooseRun(inputs, noise, settings, layout, integration, forward, smooth, withheld)


def through_outage(run: LooseRun, outage: Outage) -> LooseRun:
    """What an outage by itself would have done to a run that had all fixes: that stretch alone.

    Raises
    ------
    ConfigError: the outage holds no fix, or the run was not under way before it.
    """
    held, origin = _withheld(run.inputs.fixes, outage), run.inputs.block.origin
    first_s = held[0].time.since(origin)
    before = int(np.searchsorted(run.forward.time_s, first_s - SAME_EPOCH_S)) - 1
    if before < 0:
        raise ConfigError(f"an outage at {outage.from_s:g} s: the navigation starts later")
    starts = [run.integration.epochs[before].estimate]
    last_s = held[-1].time.since(origin) + 2.0 * run.settings.epoch_s  # an epoch beyond its end
    integration = integrate(
        between(run.inputs.block, float(run.forward.time_s[before]), last_s),
        [],
        lambda _: starts.pop() if starts else "the outage alone is asked for",
        run.noise,
        replace(run.settings, keep_trajectories=True),
        run.inputs.wheels,
    )
    return replace(run, integration=integration, withheld=(held,))


def _withheld(fixes: Sequence[GnssFix], outage: Outage) -> tuple[GnssFix, ...]:
    since_s = [fix.time.since(fixes[0].time) - outage.from_s for fix in fixes]
    held = [fix for fix, s in zip(fixes, since_s, strict=True) if 0.0 < s <= outage.length_s]
    if not held:
        raise ConfigError(
            f"--withhold {outage.from_s:g}:{outage.length_s:g}: no fix there; the solution has"
            f" them up to {fixes[-1].time.since(fixes[0].time):.1f} s after its first"
        )
    return tuple(held)


def _epochs(
    estimates: Iterable[Estimate], layout: Layout, block: ImuBlock, settings: Settings
) -> Epochs:
    rows: list[tuple[FloatArray | float, ...]] = []
    inertial, sensors = layout.inertial, slice(NAVIGATION, layout.inertial + int(layout.odometer))
    for estimate in estimates:
        ins, P = estimate.ins, estimate.P
        time_s = ins.time.since(block.origin)
        row = int(np.searchsorted(block.time_s, time_s - SAME_INSTANT_S))
        row = min(row, block.time_s.size - 1)
        rate = block.dtheta_b_rad[row] / block.dt_s[row]
        omega = (rate - ins.gyro_bias_radps) / (1.0 + ins.gyro_scale)
        antenna = body_point(ins, omega, settings.lever_b_m, layout)
        H = np.vstack([antenna.H_position, antenna.H_velocity])
        values = np.concatenate(
            [ins.gyro_bias_radps, ins.accel_bias_mps2, ins.gyro_scale, ins.accel_scale]
        )
        odometer = estimate.extras[: int(layout.odometer)]
        rows.append(
            (
                time_s,
                np.array([ins.lat_rad, ins.lon_rad, ins.height_m]),
                ins.v_n_mps,
                ins.q_nb,
                P[:NAVIGATION, :NAVIGATION],
                antenna.r_e_m,
                antenna.v_n_mps,
                H @ P @ H.T,
                np.concatenate([values[: inertial - NAVIGATION], odometer]),
                np.sqrt(np.diagonal(P)[sensors]),
            )
        )
    if not rows:
        empty = (np.zeros((0, *shape)) for shape in _SHAPES)
        return Epochs(block.origin, *empty)
    columns = (np.array(column, dtype=np.float64) for column in zip(*rows, strict=True))
    return Epochs(block.origin, *columns)


_SHAPES: tuple[tuple[int, ...], ...] = (
    *((), (3,), (3,), (4,), (NAVIGATION, NAVIGATION)),
    *((3,), (3,), (6, 6), (6,), (6,)),
)
