"""Coupling over whole files: increments, fixes or ranges, wheel speeds, what a car cannot do.

Between instants the navigator carries the estimate; at each instant the fixes, speeds and
constraints that belong to it correct it. Increments are cut at the instants, so that a fix between
two samples is taken at its own time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.errors import NumericalError
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.ins import measurements as models
from deepgnss.ins import ranging
from deepgnss.ins.error_model import VELOCITY, ProcessNoise
from deepgnss.ins.error_state import Estimate, side_by_side
from deepgnss.ins.fixes import GnssFix, WheelSpeeds
from deepgnss.ins.increments import SAME_INSTANT_S
from deepgnss.ins.measurements import Measurement
from deepgnss.ins.navigator import InsNavigator
from deepgnss.ins.past import Past
from deepgnss.ins.ranging import ClockNoise, RangeEpoch, extra_transition
from deepgnss.ins.standstill import StandstillLimits, standing
from deepgnss.ins.trajectory import Trajectory
from deepgnss.ins.updates import Innovation, updated

Aligner = Callable[[float], Estimate | str]
"""Seconds since the block's origin → estimate at its first chance from then on, or why none."""

SAME_EPOCH_S = 1e-6
"""What lies closer is corrected together: float64 seconds of a week resolve 1e-10 s."""

PLACING = ("position", "pseudorange")
"""Kinds that say where the vehicle is: refused again and again, the filter is lost."""

FASTEST_STANDSTILL_MPS = 1.0
"""Speed above which the filter does not believe that it stands, unless that is within its 2σ …"""

SLOW_MPS = 3.0
"""… and above which it does not in any case: on a smooth road all speeds are quiet."""

TURNING_RADPS = 0.01
"""Rate above which a vehicle turns, whatever is quiet: far above the Earth's and any bias."""


class Vehicle(NamedTuple):
    """A car: where its rear axle and driven wheel are, and how strictly it follows them."""

    axle_b_m: FloatArray  # (3,) IMU → middle of the rear axle
    C_vb: FloatArray  # (3, 3) body → forward, right, down of the vehicle
    sigma_mps: tuple[float, float] = (0.1, 0.1)  # lateral and vertical, per epoch


@dataclass(frozen=True, slots=True)
class Settings:
    """How the integration is run; what is None is not used."""

    lever_b_m: FloatArray  # (3,) IMU → antenna phase centre
    vehicle: Vehicle | None = None  # non-holonomic constraint
    odometer_sigma_mps: float | None = None  # needs vehicle, and the layout's odometer scale
    odometer_walk_rts: float = 1e-5  # of the scale
    standstill: StandstillLimits | None = None
    standing_sigma_mps: float = 0.03
    standing_sigma_radps: float = 0.001  # on top of the gyros' white noise
    epoch_s: float = 0.5  # of constraints, and longest time between stored epochs
    false_alarm: float = 1e-3  # of every innovation test
    restart_after: int = 10  # epochs in a row whose positions (ranges: most of them) are refused
    clock: ClockNoise = field(default_factory=ClockNoise)
    keep_trajectories: bool = False  # at IMU rate: some 0.2 kB per increment
    keep_epochs: bool = True  # for the smoother; without, memory stays flat


@dataclass(frozen=True, slots=True)
class FilterEpoch:
    """The filter at an instant: what the smoother needs to come back through it.

    Some 3·size² numbers (5 kB with 15 states, 11 kB with 21): an hour at 2 Hz takes 40 or 80 MB.
    """

    estimate: Estimate  # after the corrections
    x: FloatArray  # (size,) error taken off the prediction
    x_turning_mps: FloatArray  # (3,) see `Updated`
    P_predicted: FloatArray  # (size, size)
    Phi: FloatArray  # (size, size) from the epoch before
    continues: bool  # False: first after a start, Phi means nothing


@dataclass(frozen=True, slots=True)
class InsEvent:
    """Something worth a line in the log."""

    time_s: float  # since the block's origin
    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class Integration:
    """Outcome of a run; without a single alignment it has no epochs and says why."""

    origin: GpsTime
    epochs: tuple[FilterEpoch, ...]
    innovations: tuple[Innovation, ...]
    events: tuple[InsEvent, ...]
    trajectories: tuple[Trajectory, ...]
    reason: str  # why there is nothing, or nothing more; empty after a whole run


class Instant(NamedTuple):
    """What belongs to an instant, s since the block's origin."""

    time_s: float
    fix: GnssFix | None = None
    ranges: RangeEpoch | None = None
    speed_mps: float | None = None
    constrained: bool = False


def integrate(
    block: ImuBlock,
    fixes: Sequence[GnssFix],
    align: Aligner,
    noise: ProcessNoise,
    settings: Settings,
    wheels: WheelSpeeds | None = None,
    ranges: Sequence[RangeEpoch] = (),
) -> Integration:
    """Run the filter from the first alignment to the end of the increments.

    Loose coupling takes fixes, tight coupling ranges (with a layout that has the clock); nothing
    speaks against both, of different instants.

    It starts anew, and says so, after a gap too long to bridge, after `restart_after` epochs of
    refused positions in a row, and after a numerical failure.
    """
    run = Coupling(block, noise, settings)
    instants = _instants(block, fixes, ranges, wheels, settings.epoch_s)
    times_s = np.array([instant.time_s for instant in instants])
    from_s, reason = float(block.time_s[0] - block.dt_s[0]) if block.time_s.size else 0.0, ""
    while True:
        start = align(from_s) if block.time_s.size else "no increments"
        if isinstance(start, str):
            run.note(from_s, "not aligned", start)
            reason = start
            break
        run.begin(start)
        at_s = start.ins.time.since(block.origin)
        if at_s < from_s - SAME_EPOCH_S:
            raise NumericalError(f"aligned at {at_s:.3f} s, before {from_s:.3f} s as asked")
        ahead = instants[int(np.searchsorted(times_s, at_s + SAME_INSTANT_S)) :]
        failed_s = run.through(ahead)
        if failed_s is None:
            break
        from_s = failed_s
    return Integration(
        block.origin,
        tuple(run.epochs),
        tuple(run.innovations),
        tuple(run.events),
        tuple(run.trajectories),
        reason,
    )


class Coupling:
    """The navigator on its way through the increments of a block, and what it leaves behind."""

    def __init__(self, block: ImuBlock, noise: ProcessNoise, settings: Settings) -> None:
        self.block, self.noise, self.settings = block, noise, settings
        self.stood = None if settings.standstill is None else standing(block, settings.standstill)
        self.epochs: list[FilterEpoch] = []
        self.innovations: list[Innovation] = []
        self.events: list[InsEvent] = []
        self.trajectories: list[Trajectory] = []
        self._navigator: InsNavigator
        self._Phi: FloatArray
        self._omega_ib_b = np.zeros(3)
        self._refused = 0
        self._past = Past()
        self.carried: Trajectory  # the way to the last instant …
        self.expected: Estimate  # … the estimate there before its corrections …
        self.measured: tuple[Measurement, ...] = ()  # … and what spoke of it, believed or not

    @property
    def estimate(self) -> Estimate:
        """As it stands."""
        return self._navigator.estimate

    @property
    def time_s(self) -> float:
        """Instant at which it stands, s since the block's origin."""
        return self.estimate.ins.time.since(self.block.origin)

    def look_ahead(self, until_s: float) -> Trajectory:
        """The way on to an instant by the increments alone; nothing moves."""
        _, trajectory = self._navigator.advance(self.block, until_s)
        return trajectory

    def antenna(self) -> models.Point:
        """The antenna as it stands."""
        omega_ib_b = self._omega_ib_b
        return models.body_point(
            self.estimate.ins, omega_ib_b, self.settings.lever_b_m, self.estimate.layout
        )

    def note(self, time_s: float, what: str, reason: str) -> None:
        """Keep a line for the log."""
        self.events.append(InsEvent(time_s, what, reason))

    def begin(self, estimate: Estimate) -> None:
        """Start from an estimate."""
        size = estimate.layout.size
        self._navigator = InsNavigator(estimate, self.noise, None, self.settings.epoch_s)
        self._Phi, self._refused = np.eye(size), 0
        self._past = Past()
        self.epochs.append(
            FilterEpoch(estimate, np.zeros(size), np.zeros(3), estimate.P, np.eye(size), False)
        )
        self.note(estimate.ins.time.since(self.block.origin), "started", "aligned")

    def through(self, instants: Sequence[Instant]) -> float | None:
        """Run through instants; the time to start anew from, or None at the end."""
        for instant in instants:
            try:
                trajectory = self._carry(instant.time_s)
                if trajectory.outage is not None:
                    gap = trajectory.outage
                    self.note(gap.start_s, "stopped", f"no increments for {gap.length_s:.1f} s")
                    return gap.end_s
                if instant.time_s - trajectory.time_s[-1] > SAME_EPOCH_S:
                    continue  # within a gap: the way over it is found at the next instant
                self._correct(instant, trajectory)
            except NumericalError as error:
                self.note(instant.time_s, "stopped", str(error))
                return instant.time_s
            if self._refused >= self.settings.restart_after:
                self.note(
                    instant.time_s,
                    "stopped",
                    f"positions of {self._refused} epochs in a row failed the innovation test",
                )
                return instant.time_s
        return None

    def _carry(self, time_s: float) -> Trajectory:
        """Advance the navigator and the parameters behind the inertial errors."""
        start_s, self.measured = self.time_s, ()
        self._navigator, trajectory = self._navigator.advance(self.block, time_s)
        if trajectory.omega_ib_b_radps.size:
            self._omega_ib_b = trajectory.omega_ib_b_radps[-1]
        for gap in trajectory.bridged:
            self.note(gap.start_s, "bridged", f"no increments for {gap.length_s:.3f} s")
        estimate = self._navigator.estimate
        layout = estimate.layout
        passed_s = float(trajectory.time_s[-1]) - start_s
        Phi_extra, Q_extra = extra_transition(
            layout, passed_s, self.settings.clock, self.settings.odometer_walk_rts
        )
        if layout.extras:
            stay = side_by_side(np.eye(layout.inertial), Phi_extra)
            added = side_by_side(np.zeros((layout.inertial, layout.inertial)), Q_extra)
            estimate = replace(
                estimate,
                extras=Phi_extra @ estimate.extras,
                P=stay @ estimate.P @ stay.T + added,
            )
            self._navigator = replace(self._navigator, estimate=estimate)
        self._Phi = side_by_side(trajectory.Phi, Phi_extra) @ self._Phi
        self.carried, self.expected = trajectory, self._navigator.estimate
        if self.settings.keep_trajectories:
            self.trajectories.append(trajectory)
        return trajectory

    def _correct(self, instant: Instant, trajectory: Trajectory) -> None:
        estimate = self._navigator.estimate
        self.measured = tuple(self._measured(instant, trajectory))
        after = updated(estimate, self.measured, self.settings.false_alarm)
        if self.settings.keep_epochs:
            self.epochs.append(
                FilterEpoch(
                    after.estimate, after.x, after.x_turning_mps, estimate.P, self._Phi, True
                )
            )
        self.innovations.extend(after.innovations)
        believed = [i.accepted for i in after.innovations if i.kind in PLACING]
        if believed:
            self._refused = 0 if 2 * sum(believed) >= len(believed) else self._refused + 1
        self._navigator = replace(self._navigator, estimate=after.estimate)
        self._Phi = np.eye(estimate.layout.size)
        self._past.note(trajectory, after.x)

    def _measured(self, instant: Instant, trajectory: Trajectory) -> list[Measurement]:
        estimate, settings = self._navigator.estimate, self.settings
        ins, layout = estimate.ins, estimate.layout
        if not trajectory.omega_ib_b_radps.size:
            return []
        omega_ib_b = trajectory.omega_ib_b_radps[-1]
        found: list[Measurement] = []
        antenna = models.body_point(ins, omega_ib_b, settings.lever_b_m, layout)
        if instant.ranges is not None:
            found += ranging.ranges(estimate, antenna, instant.ranges.observations)
        if instant.fix is not None:
            fix = instant.fix
            found.append(
                models.position(ins, antenna, fix.r_e_m, fix.covariance_n_m2, fix.together)
            )
            if fix.v_n_mps is not None and fix.velocity_covariance_n_m2ps2 is not None:
                v = models.velocity(antenna, fix.v_n_mps, fix.velocity_covariance_n_m2ps2)
                found.append(self._past.aged(v, fix.velocity_age_s, trajectory, estimate.P))
        if self._stands(instant):
            lengths_s = np.diff(trajectory.time_s)
            rate = lengths_s @ trajectory.omega_ib_b_radps / lengths_s.sum()
            white = self.noise.gyro_rad_rts / np.sqrt(lengths_s.sum())
            sigma_radps = float(np.hypot(settings.standing_sigma_radps, white))
            found.append(models.zero_velocity(ins, settings.standing_sigma_mps, layout))
            found.append(models.zero_rotation(ins, rate, sigma_radps, layout))
            return found
        if settings.vehicle is None:
            return found
        axle_b_m, C_vb, sigma_mps = settings.vehicle
        if instant.constrained:
            found.append(
                models.nonholonomic(ins, omega_ib_b, axle_b_m, C_vb, np.array(sigma_mps), layout)
            )
        if instant.speed_mps is not None and settings.odometer_sigma_mps is not None:
            found.append(
                models.odometer(
                    estimate,
                    omega_ib_b,
                    axle_b_m,
                    C_vb,
                    instant.speed_mps,
                    settings.odometer_sigma_mps,
                )
            )
        return found

    def at_rest(self, time_s: float) -> bool:
        """Quiet sensors up to an instant, and a speed that agrees."""
        row = int(np.searchsorted(self.block.time_s, time_s - SAME_INSTANT_S))
        quiet = self.stood is not None and row < self.stood.size and bool(self.stood[row])
        return quiet and self._slow() and not self._turns(row)

    def _stands(self, instant: Instant) -> bool:
        """Quiet sensors, or wheels at rest, and a speed that agrees."""
        wheels = instant.speed_mps == 0.0 and self._slow()
        return wheels or (instant.constrained and self.at_rest(instant.time_s))

    def _slow(self) -> bool:
        estimate = self._navigator.estimate
        sigma2 = np.trace(estimate.P[VELOCITY, VELOCITY])
        limit_mps = min(max(FASTEST_STANDSTILL_MPS, 2.0 * np.sqrt(sigma2)), SLOW_MPS)
        return bool(np.linalg.norm(estimate.ins.v_n_mps) < limit_mps)

    def _turns(self, row: int) -> bool:
        """Whether the gyros show a turn in the second up to an increment: a steady one is quiet."""
        block = self.block
        first = int(np.searchsorted(block.time_s, block.time_s[row] - 1.0))
        passed_s = float(block.dt_s[first : row + 1].sum())
        rate = block.dtheta_b_rad[first : row + 1].sum(axis=0) / passed_s
        turning = rate - self._navigator.estimate.ins.gyro_bias_radps
        return bool(np.linalg.norm(turning) > TURNING_RADPS)


def _instants(
    block: ImuBlock,
    fixes: Sequence[GnssFix],
    ranges: Sequence[RangeEpoch],
    wheels: WheelSpeeds | None,
    epoch_s: float,
) -> list[Instant]:
    """Instants of fixes, wheel speeds and the constraints' own grid, in order of time."""
    found = [Instant(fix.time.since(block.origin), fix=fix) for fix in fixes]
    found += [Instant(epoch.time.since(block.origin), ranges=epoch) for epoch in ranges]
    if wheels is not None:
        shift_s = wheels.origin.since(block.origin)
        found += [
            Instant(float(time_s) + shift_s, speed_mps=float(speed_mps))
            for time_s, speed_mps in zip(wheels.time_s, wheels.speed_mps, strict=True)
        ]
    if block.time_s.size:
        first, last = block.time_s[[0, -1]] / epoch_s
        grid = np.arange(np.ceil(first), np.floor(last) + 1) * epoch_s
        found += [Instant(float(time_s), constrained=True) for time_s in grid]
    merged: list[Instant] = []
    for instant in sorted(found, key=lambda instant: instant.time_s):
        if merged and instant.time_s - merged[-1].time_s < SAME_EPOCH_S:
            before = merged[-1]
            merged[-1] = Instant(
                before.time_s,
                before.fix or instant.fix,
                before.ranges or instant.ranges,
                before.speed_mps if instant.speed_mps is None else instant.speed_mps,
                before.constrained or instant.constrained,
            )
        else:
            merged.append(instant)
    return merged
