"""The inertial navigation beside the receiver: fixes in, predictions out, epoch by epoch.

It stands at the last tag that was corrected. Before an epoch it looks ahead through the epoch's
increments, which gives the loops their aiding; after it, it goes on to the epoch's tags and takes
their fixes. It starts once the fixes show an attitude, stops when its filter fails, and starts
anew by itself; meanwhile the receiver runs unaided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.errors import NumericalError
from deepgnss.core.frames import C_ne
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.core.time import GpsTime
from deepgnss.deep.tight import CounterLine, range_epoch
from deepgnss.ins import (
    Alignment,
    AlignmentSettings,
    Estimate,
    GnssFix,
    Settings,
    Trajectory,
    WheelSpeeds,
    fix_of,
    process_noise,
)
from deepgnss.ins.error_state import difference, side_by_side
from deepgnss.ins.fixes import lasting_together, with_lasting_errors
from deepgnss.ins.increments import SAME_INSTANT_S, between
from deepgnss.ins.integration import Coupling, InsEvent, Instant
from deepgnss.ins.measurements import ROLLING, Measurement, Point, body_point
from deepgnss.ins.ranging import RangeEpoch
from deepgnss.ins.updates import Innovation
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.receiver import Fix

_REMEMBERED_S = 60.0  # fixes kept for an alignment
# What a position's own σ leaves out: atmosphere and reflections last for seconds.
LASTING_M = 1.0
LASTING_S = 10.0
_USELESS_M = 300.0  # 1σ of a position …
_USELESS_MPS = 10.0  # … and of a velocity that say nothing
_TRY_EVERY_S = 1.0  # between alignments tried


@dataclass(frozen=True, slots=True)
class InertialInputs:
    """What the navigation is made from."""

    block: ImuBlock  # the whole log: some 60 bytes per increment
    grade: ImuGrade
    alignment: AlignmentSettings
    settings: Settings
    wheels: WheelSpeeds | None = None
    ranging: PvtParameters | None = None  # of tight coupling; None: loose, fixes are taken
    systems: tuple[str, ...] = ()


class Antenna(NamedTuple):
    """Position and velocity (ECEF) of the antenna, and their covariance."""

    r_e_m: FloatArray  # (3,)
    v_e_mps: FloatArray  # (3,)
    covariance: FloatArray  # (6, 6), NED


@dataclass(frozen=True, slots=True)
class Leg:
    """The way from the tag before to a tag by the increments alone, and its correction there."""

    begin_s: float  # since `origin`
    end_s: float
    origin: GpsTime
    moved_e_m: FloatArray  # (3,) antenna
    gained_e_mps: FloatArray  # (3,) in velocity
    H_begin: FloatArray  # (3, n) slope of the antenna's position (NED) in the vehicle's errors
    H_end: FloatArray  # (3, n)
    Phi: FloatArray  # (n, n) of the errors, from begin to end
    Q: FloatArray
    correction: FloatArray  # (n,) by which what was measured at the tag changed the errors
    at_rest: bool
    rolled: tuple[Measurement, ...] = ()  # by wheels and road there, before that; H (k, n)


@dataclass(frozen=True, slots=True)
class NavigationState:
    """The navigation at a tag, for files and for whoever predicts from it."""

    time: GpsTime
    estimate: Estimate
    antenna: Antenna
    expected: Antenna | None  # the same by all tags before; None without increments
    leg: Leg | None  # that led here; None without increments
    together: float  # so many tags of ranges count as one, by their errors that last


class Navigation:
    """A causal inertial navigation: nothing in it knows more than the tags it has been given."""

    def __init__(self, inputs: InertialInputs) -> None:
        self._inputs = inputs
        self._noise = process_noise(inputs.grade)
        self._fixes: list[GnssFix] = []
        self._placed: GpsTime | None = None  # last tag with a position, or ranges for the filter
        self._coupling: Coupling | None = None
        self._line: CounterLine | None = None  # from the first tag with ranges after a start on
        self._not_before_s = -np.inf  # of an alignment, since the block's origin
        self._next_try_s = -np.inf
        self._reason = ""
        self.events: list[InsEvent] = []
        self.innovations: list[Innovation] = []

    @property
    def running(self) -> bool:
        """Whether there is a navigation now."""
        return self._coupling is not None

    @property
    def block(self) -> ImuBlock:
        """The log as it is used."""
        return self._inputs.block

    def shift(self, seconds: float) -> None:
        """Move the log in time; the navigation starts anew with the fixes it remembers."""
        block = self._inputs.block
        origin = block.origin.plus(seconds)
        self._inputs = replace(self._inputs, block=replace(block, origin=origin))
        self._coupling = None
        self._not_before_s = self._fixes[0].time.since(origin) if self._fixes else -np.inf
        self._next_try_s = -np.inf

    def stop(self, time: GpsTime, reason: str) -> None:
        """Give it up; it starts anew from fixes to come."""
        if self._coupling is not None:
            self._stop(time.since(self._inputs.block.origin), reason)

    # --- before an epoch ---------------------------------------------------------------------

    def ahead(self, until: GpsTime) -> Trajectory | None:
        """The way from the last tag to an instant by the increments alone."""
        if self._coupling is None:
            return None
        until_s = until.since(self._inputs.block.origin)
        try:
            trajectory = self._coupling.look_ahead(until_s)
        except NumericalError as error:
            self._stop(until_s, str(error))
            return None
        short_s = until_s - float(trajectory.time_s[-1])
        if trajectory.time_s.size < 3 or short_s > 1.0:
            return None  # within a gap, or past the log's end: unaided until it is over
        return trajectory

    # --- after it ----------------------------------------------------------------------------

    def take(self, fixes: Sequence[Fix]) -> list[NavigationState]:
        """Go on to the tags of an epoch with what they hold; the states there."""
        states = []
        for fix in fixes:
            apart_s = self._apart_s(fix.epoch.time)
            gnss = fix_of(fix.solution) if fix.solution.valid else None
            if gnss is not None:
                gnss = _weighed(gnss, apart_s, lasting_doppler_s(fix))
            if gnss is not None:
                self._remember(gnss)
            time_s = fix.epoch.time.since(self._inputs.block.origin)
            if self._coupling is None:
                self._align(time_s)
                continue
            start = self._coupling.antenna()
            ranges = self._ranges(fix, start.r_e_m, apart_s)
            taken = Instant(time_s, gnss if ranges is None else None, ranges)
            self._go_on(self._coupling, taken)
            if self._coupling is not None:
                end = self._expected(self._coupling)
                leg = None if end is None else self._leg(self._coupling, start, end)
                together = lasting_together(LASTING_S, apart_s)
                states.append(self._state(self._coupling, end, leg, together))
        return states

    def _apart_s(self, time: GpsTime) -> float:
        """Time since the last tag that said where the antenna is."""
        apart_s = time.since(self._placed) if self._placed is not None else LASTING_S
        return max(apart_s, 1e-3)

    def _ranges(self, fix: Fix, r_e_m: FloatArray, apart_s: float) -> RangeEpoch | None:
        """A tag's ranges for tight coupling."""
        inputs = self._inputs
        if inputs.ranging is None or not fix.epoch.observations:
            return None
        self._line = self._line or CounterLine(fix.epoch.time, fix.epoch.counter)
        together = lasting_together(LASTING_S, apart_s)
        found = range_epoch(
            fix, inputs.ranging, r_e_m, inputs.systems, self._line, LASTING_M, together
        )
        self._placed = self._placed if found is None else fix.epoch.time
        return found

    def _go_on(self, coupling: Coupling, taken: Instant) -> None:
        time_s, epoch_s = taken.time_s, self._inputs.settings.epoch_s
        constrained = round(time_s / epoch_s, 6) % 1.0 == 0.0
        speed = self._speed(coupling.time_s, time_s)
        instant = taken._replace(speed_mps=speed, constrained=constrained)
        failed_s = coupling.through([instant])
        self._hand_on(coupling)
        if failed_s is not None:
            self._coupling = None
            self._not_before_s = max(failed_s, time_s)

    def _speed(self, after_s: float, until_s: float) -> float | None:
        """Wheel speed at the end of an epoch, by the last two, whose own instants lie before."""
        wheels = self._inputs.wheels
        if wheels is None or wheels.time_s.size == 0:
            return None
        shift_s = wheels.origin.since(self._inputs.block.origin)
        k = int(np.searchsorted(wheels.time_s + shift_s, until_s + SAME_INSTANT_S)) - 1
        if k < 1 or wheels.time_s[k] + shift_s <= after_s:
            return None
        (before, last), (slower, speed) = (
            wheels.time_s[k - 1 : k + 1],
            wheels.speed_mps[k - 1 : k + 1],
        )
        ahead = (until_s - shift_s - last) / (last - before)
        return float(speed + ahead * (speed - slower)) if speed != 0.0 else 0.0

    def _expected(self, coupling: Coupling) -> Point | None:
        """The antenna where the increments alone have led; None without any."""
        before, omega_ib_b_radps = coupling.expected, coupling.carried.omega_ib_b_radps
        if omega_ib_b_radps.size == 0:
            return None
        lever_b_m = self._inputs.settings.lever_b_m
        return body_point(before.ins, omega_ib_b_radps[-1], lever_b_m, before.layout)

    def _leg(self, coupling: Coupling, start: Point, end: Point) -> Leg:
        way, before, after = coupling.carried, coupling.expected, coupling.estimate
        layout = before.layout
        inertial, vehicle = layout.inertial, layout.vehicle
        there = way.antenna(way.time_s[[0, -1]], self._inputs.settings.lever_b_m)
        wheels = vehicle - inertial
        walked = self._inputs.settings.odometer_walk_rts**2 * float(way.time_s[-1] - way.time_s[0])
        turned = (after.extras - before.extras)[:wheels]
        return Leg(
            float(way.time_s[0]),
            float(way.time_s[-1]),
            way.origin,
            there.r_e_m[1] - there.r_e_m[0],
            there.v_e_mps[1] - there.v_e_mps[0],
            start.H_position[:, :vehicle],
            end.H_position[:, :vehicle],
            side_by_side(way.Phi, np.eye(wheels)) if wheels else way.Phi,
            side_by_side(way.Q, walked * np.eye(wheels)) if wheels else way.Q,
            np.concatenate([difference(after.ins, before.ins)[:inertial], turned]),
            coupling.at_rest(float(way.time_s[-1])),
            tuple(m._replace(H=m.H[:, :vehicle]) for m in coupling.measured if m.kind in ROLLING),
        )

    def _state(
        self, coupling: Coupling, end: Point | None, leg: Leg | None, together: float
    ) -> NavigationState:
        estimate = coupling.estimate
        expected = None if end is None else _antenna(coupling.expected, end)
        antenna = _antenna(estimate, coupling.antenna())
        return NavigationState(estimate.ins.time, estimate, antenna, expected, leg, together)

    # --- start and stop ----------------------------------------------------------------------

    def _remember(self, fix: GnssFix) -> None:
        self._placed = fix.time
        self._fixes.append(fix)
        while fix.time.since(self._fixes[0].time) > _REMEMBERED_S:
            self._fixes.pop(0)

    def _align(self, now_s: float) -> None:
        """Try to find an attitude from the fixes so far and the increments that go with them."""
        if now_s < self._next_try_s or len(self._fixes) < 3:
            return
        self._next_try_s = now_s + _TRY_EVERY_S
        inputs = self._inputs
        origin = inputs.block.origin
        fixes = [f for f in self._fixes if f.time.since(origin) >= self._not_before_s]
        if len(fixes) < 3:
            return
        first_s = fixes[0].time.since(origin)
        piece = between(inputs.block, first_s - 1.0, fixes[-1].time.since(origin))
        align = Alignment(piece, fixes, inputs.grade, inputs.alignment, inputs.settings.standstill)
        begin_s = float(piece.time_s[0] - piece.dt_s[0]) if piece.time_s.size else first_s
        anew = np.isfinite(self._not_before_s)
        found = align(first_s if anew else begin_s)
        if isinstance(found, str):
            if found != self._reason:
                self.events.append(InsEvent(now_s, "not aligned", found))
            self._reason = found
            return
        self._coupling = Coupling(inputs.block, self._noise, inputs.settings)
        self._coupling.begin(found)
        self._line = None
        self._reason = ""
        started_s = found.ins.time.since(origin)
        later = [f for f in fixes if f.time.since(origin) > started_s + SAME_INSTANT_S]
        failed_s = self._coupling.through(
            [Instant(f.time.since(origin), f, None, None, False) for f in later]
        )
        self._hand_on(self._coupling)
        if failed_s is not None:
            self._coupling = None
            self._not_before_s = now_s

    def _stop(self, at_s: float, reason: str) -> None:
        self.events.append(InsEvent(at_s, "stopped", reason))
        self._coupling = None
        self._not_before_s = at_s

    def _hand_on(self, coupling: Coupling) -> None:
        """Take over what the coupling has noted: it keeps nothing, memory stays flat."""
        self.events.extend(coupling.events)
        self.innovations.extend(coupling.innovations)
        coupling.events.clear()
        coupling.innovations.clear()

    def news(self) -> tuple[list[InsEvent], list[Innovation]]:
        """Events and innovations since the last call."""
        told = (self.events, self.innovations)
        self.events, self.innovations = [], []
        return told

    def instant(self, time_s: float) -> GpsTime:
        """GPST of an event."""
        return self._inputs.block.origin.plus(time_s)


def _antenna(estimate: Estimate, point: Point) -> Antenna:
    to_n = C_ne(estimate.ins.lat_rad, estimate.ins.lon_rad)
    v_e_mps, covariance = _turned(
        to_n, point.v_n_mps, point.H_position, point.H_velocity, estimate.P
    )
    return Antenna(point.r_e_m, v_e_mps, covariance)


@brief_kernel
def _turned(
    to_n: FloatArray,
    v_n_mps: FloatArray,
    H_position: FloatArray,
    H_velocity: FloatArray,
    P: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,), ECEF, and covariance (6, 6), NED, of position and velocity, by that of errors.

    H (3, n) of both, P (n, n).
    """
    H = np.concatenate((H_position, H_velocity))
    return to_n.T @ v_n_mps, H @ P @ H.T


def lasting_doppler_s(fix: Fix) -> float:
    """For how long a tag's Dopplers are the same measurements, carried on."""
    used = set(fix.solution.used)
    return max((o.doppler_s for o in fix.epoch.observations if o.satellite in used), default=0.0)


def _weighed(fix: GnssFix, apart_s: float, doppler_s: float) -> GnssFix | None:
    """A fix of the receiver's own: errors that last, and a velocity only where it has one.

    None: so far off, by its own word, that nothing of it is linear.
    """
    if np.trace(fix.covariance_n_m2) > _USELESS_M**2:
        return None
    V = fix.velocity_covariance_n_m2ps2
    if fix.v_n_mps is not None and V is not None:
        known = np.isfinite(fix.v_n_mps).all() and np.trace(V) < _USELESS_MPS**2
        same = max(1.0, doppler_s / apart_s)  # tags that count as one
        fix = replace(
            fix,
            v_n_mps=fix.v_n_mps if known else None,
            velocity_covariance_n_m2ps2=V * same if known else None,
            velocity_age_s=doppler_s,  # half of it since its middle, the rest until the next one
        )
    return with_lasting_errors(fix, LASTING_M, 0.0, LASTING_S, apart_s)
