"""An inertial navigation against truth, and through outages, in units of its own σ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepgnss.core.attitude import attitude_error_n, quaternion_from_euler, slerp
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.loose import Epochs, LooseRun, Outage, through_outage
from deepgnss.io.output import write_whole
from deepgnss.io.tables import number
from deepgnss.io.truth import Trajectory


@dataclass(frozen=True, slots=True)
class InertialErrors:
    """Errors in NED at n epochs that truth covers, with their covariances; NaN: not known.

    Position and velocity are the antenna's.
    """

    time_s: FloatArray  # (n,) since the epochs' origin
    time: tuple[GpsTime, ...]
    position_m: FloatArray  # (n, 3)
    velocity_mps: FloatArray  # (n, 3)
    attitude_rad: FloatArray  # (n, 3) phi-angle
    covariance: FloatArray  # (n, 6, 6) of position and velocity
    attitude_covariance: FloatArray  # (n, 3, 3)


class Consistency(NamedTuple):
    """Of three components over all epochs: RMS per axis, mean NEES over 3, share within 3σ."""

    quantity: str
    rms: FloatArray  # (3,)
    nees: float  # 1 while errors are what the covariance says
    within: float


class OutageError(NamedTuple):
    """Error of the antenna at the last withheld fix, or against truth there."""

    start: GpsTime
    end: GpsTime
    length_s: float
    error_n_m: FloatArray  # (3,)
    sigma_n_m: FloatArray  # (3,) of the filter, and of the fix it is held against
    nees: float  # over 3

    @property
    def horizontal_m(self) -> float:
        """Size of the horizontal error."""
        return float(np.hypot(*self.error_n_m[:2]))

    @property
    def horizontal_sigma_m(self) -> float:
        """1σ of that, both axes together."""
        return float(np.hypot(*self.sigma_n_m[:2]))


def inertial_errors(epochs: Epochs, truth: Trajectory) -> InertialErrors:
    """Errors of forward or smoothed epochs."""
    times = [epochs.time(k) for k in range(epochs.time_s.size)]
    week = np.array([time.week for time in times], dtype=np.int64)
    tow_s = np.array([time.tow_s for time in times])
    r_e_m, v_e_mps = truth.at(week, tow_s)
    covered = np.isfinite(r_e_m).all(axis=1)
    places = np.array([geodetic(r)[:2] for r in r_e_m[covered]]).reshape(-1, 2)
    to_n = C_ne(*places.T)
    d_r = epochs.antenna_r_e_m[covered] - r_e_m[covered]
    v_n = np.einsum("kij,kj->ki", to_n, v_e_mps[covered])
    attitude = np.full((int(covered.sum()), 3), np.nan)
    if truth.attitude_rad is not None:
        q_nb = _attitude_at(truth, truth.seconds(week[covered], tow_s[covered]))
        attitude = attitude_error_n(epochs.q_nb[covered], q_nb)
    return InertialErrors(
        epochs.time_s[covered],
        tuple(times[k] for k in np.flatnonzero(covered)),
        np.einsum("kij,kj->ki", to_n, d_r),
        epochs.antenna_v_n_mps[covered] - v_n,
        attitude,
        epochs.antenna_covariance[covered],
        epochs.covariance[covered, 6:9, 6:9],
    )


def _attitude_at(truth: Trajectory, wanted_s: FloatArray) -> FloatArray:
    known_s = truth.seconds(truth.week, truth.tow_s)
    after = np.clip(np.searchsorted(known_s, wanted_s), 1, known_s.size - 1)
    share = (wanted_s - known_s[after - 1]) / (known_s[after] - known_s[after - 1])
    q_nb = quaternion_from_euler(np.asarray(truth.attitude_rad))
    return slerp(q_nb[after - 1], q_nb[after], share)


def consistency(errors: InertialErrors) -> tuple[Consistency, ...]:
    """Position, velocity and, where truth has it, attitude."""
    parts = [
        ("position", errors.position_m, errors.covariance[:, :3, :3]),
        ("velocity", errors.velocity_mps, errors.covariance[:, 3:, 3:]),
        ("attitude", errors.attitude_rad, errors.attitude_covariance),
    ]
    found = []
    for name, values, covariance in parts:
        known = np.isfinite(values).all(axis=1)
        if not known.any():
            continue
        e, P = values[known], covariance[known]
        nees = np.einsum("ki,kij,kj->k", e, np.linalg.inv(P), e)
        ratios = np.abs(e) / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        rms = np.sqrt(np.mean(e**2, axis=0))
        found.append(Consistency(name, rms, float(nees.mean() / 3.0), float(np.mean(ratios < 3.0))))
    return tuple(found)


def outage_errors(run: LooseRun, truth: Trajectory | None = None) -> tuple[OutageError | None, ...]:
    """Errors at the end of every outage of a run; None where the filter did not run there."""
    return tuple(_outage_error(run, k, truth) for k in range(len(run.withheld)))


def outages_along(
    run: LooseRun, length_s: float, from_s: FloatArray, truth: Trajectory | None = None
) -> list[OutageError]:
    """Errors of outages of one length at places (s since the first fix), each by itself."""
    found = []
    for at_s in from_s.tolist():
        (error,) = outage_errors(through_outage(run, Outage(at_s, length_s)), truth)
        if error is not None:
            found.append(error)
    return found


class OutageStatistics(NamedTuple):
    """Of many outages: horizontal errors against the filter's own σ."""

    places: int
    rms_m: float
    largest_m: float
    sigma_m: float  # RMS of what the filter says
    ratio: float  # RMS of error over σ, component by component, north and east
    worst_ratio: float  # largest of those
    nees: float  # mean over the outages, over 3


def outage_statistics(outages: Sequence[OutageError]) -> OutageStatistics:
    """Statistics of one length of outages."""
    size = np.array([outage.horizontal_m for outage in outages])
    sigma = np.array([outage.horizontal_sigma_m for outage in outages])
    ratios = np.array([outage.error_n_m[:2] / outage.sigma_n_m[:2] for outage in outages])
    return OutageStatistics(
        len(outages),
        float(np.sqrt(np.mean(size**2))),
        float(size.max()),
        float(np.sqrt(np.mean(sigma**2))),
        float(np.sqrt(np.mean(ratios**2))),
        float(np.abs(ratios).max()),
        float(np.mean([outage.nees for outage in outages])),
    )


def _outage_error(run: LooseRun, k: int, truth: Trajectory | None) -> OutageError | None:
    fixes, origin = run.withheld[k], run.inputs.block.origin
    last = fixes[-1]
    time_s = last.time.since(origin)
    stretch = next(
        (
            part
            for part in run.integration.trajectories
            if part.time_s.size > 1 and part.time_s[0] < time_s <= part.time_s[-1] + 1e-8
        ),
        None,
    )
    if stretch is None:
        return None
    at, lever = np.array([time_s]), run.settings.lever_b_m
    r_e_m, reference2 = last.r_e_m, last.covariance_n_m2
    if truth is not None:
        place, _ = truth.at(last.time.week, last.time.tow_s)
        if np.isfinite(place).all():
            r_e_m, reference2 = place[0], np.zeros((3, 3))
    to_n = C_ne(*geodetic(r_e_m)[:2])
    error = to_n @ (stretch.antenna(at, lever).r_e_m[0] - r_e_m)
    P = stretch.antenna_covariance(at, lever)[0, :3, :3] + reference2
    return OutageError(
        fixes[0].time,
        last.time,
        last.time.since(fixes[0].time),
        error,
        np.sqrt(np.diagonal(P)),
        float(error @ np.linalg.solve(P, error)) / 3.0,
    )


def write_inertial_errors(path: Path, errors: InertialErrors) -> None:
    """errors.csv: errors in NED and their σ, a row per epoch that truth covers."""
    names = ["week", "tow_s"]
    for prefix in ("", "sigma_"):
        names += [f"{prefix}{axis}_m" for axis in ("north", "east", "down")]
        names += [f"{prefix}v_{axis}_mps" for axis in ("north", "east", "down")]
        names += [f"{prefix}phi_{axis}_deg" for axis in ("north", "east", "down")]
    sigma = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2))
    angle = np.degrees(np.sqrt(np.diagonal(errors.attitude_covariance, axis1=1, axis2=2)))
    attitude = np.degrees(errors.attitude_rad)
    table = np.hstack([errors.position_m, errors.velocity_mps, attitude, sigma, angle])
    rows = [",".join(names)]
    for time, values in zip(errors.time, table, strict=True):
        cells = [number(float(value), 5) for value in values]
        rows.append(",".join([str(time.week), f"{time.tow_s:.6f}", *cells]))
    write_whole(path, "\n".join(rows) + "\n")


def write_outages(path: Path, outages: tuple[OutageError | None, ...]) -> None:
    """outages.csv: error and σ at the end of every outage."""
    rows = ["week,start_tow_s,end_tow_s,north_m,east_m,down_m,sigma_n_m,sigma_e_m,sigma_d_m,nees"]
    for outage in outages:
        if outage is None:
            continue
        cells = [number(x, 4) for x in (*outage.error_n_m, *outage.sigma_n_m, outage.nees)]
        times = (str(outage.end.week), f"{outage.start.tow_s:.3f}", f"{outage.end.tow_s:.3f}")
        rows.append(",".join([*times, *cells]))
    write_whole(path, "\n".join(rows) + "\n")
