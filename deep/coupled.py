"""The circle of the deep integration, closed once per epoch.

navigation.ahead ──▶ Aider.profiles ──▶ receiver.step ──▶ navigation.take
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne
from deepgnss.core.records import Event, FloatArray, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.deep.aiding import AHEAD_S, Aider, Listener
from deepgnss.deep.bridging import Bridge, Bridged, Loop, Tag
from deepgnss.deep.guard import Guard, Unit
from deepgnss.deep.inertial import (
    alignment_settings,
    coupling_settings,
    imu_section,
    layout_of,
    wheel_speeds,
)
from deepgnss.deep.navigation import InertialInputs, Navigation, NavigationState
from deepgnss.deep.placing import Placing
from deepgnss.deep.screening import Screening, ScreenSettings
from deepgnss.deep.setup import RunPlan
from deepgnss.deep.straying import Straying, Unheard
from deepgnss.deep.tight import CLOCK_NOISE
from deepgnss.deep.time_offset import CarrierLoop
from deepgnss.ins import WheelSpeeds
from deepgnss.ins.increments import joined
from deepgnss.ins.integration import SAME_EPOCH_S
from deepgnss.ins.sanity import findings
from deepgnss.ins.updates import Innovation
from deepgnss.io.config import Config
from deepgnss.io.imu import ImuLog, read_odometer
from deepgnss.receiver.carrier_loops import carrier_loop
from deepgnss.receiver.clock import NS, ReceiverClock, to_ns
from deepgnss.receiver.leading import Profile
from deepgnss.receiver.modes import Coast
from deepgnss.receiver.receiver import Fix, Receiver, Screen, StepResult


class Aids(NamedTuple):
    """What an epoch of the receiver is given."""

    profiles: Mapping[str, Profile]
    place: tuple[FloatArray, FloatArray] | None
    screen: Screen | None = None


NO_AIDS = Aids({}, None)


class Navigated(NamedTuple):
    """What an epoch gave the navigation."""

    states: tuple[NavigationState, ...] = ()  # at the epoch's tags
    events: tuple[Event, ...] = ()
    innovations: tuple[Innovation, ...] = ()
    moves: Mapping[str, Coast] = {}  # of channels in open loop at the last tag
    P: FloatArray | None = None  # of the navigation's errors but position, by the carrier phases
    placed: Mapping[GpsTime, NavSolution] = {}  # at tags where it knew where the antenna is
    outside: Mapping[GpsTime, frozenset[str]] = {}  # satellites whose phases all others contradict

    def told(self, fix: Fix) -> Fix:
        """A fix as it is put out: with the navigation, and without phases that are wrong."""
        time = fix.epoch.time
        fix = fix._replace(solution=self.placed.get(time, fix.solution))
        if not (wrong := self.outside.get(time)):
            return fix
        kept = tuple(
            one._replace(carrier_valid=False) if one.satellite in wrong else one
            for one in fix.epoch.observations
        )
        epoch = replace(fix.epoch, observations=kept)
        return fix._replace(measured=fix.measured._replace(epoch=epoch))


class CoupledNavigation:
    """Joins a receiver and an inertial navigation, an epoch at a time."""

    def __init__(
        self,
        navigation: Navigation,
        aider: Aider,
        bridge: Bridge,
        straying: Straying,
        guard: Guard,
        screening: Screening | None = None,
        placing: Placing | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        """`notes`: what is odd about the inertial log."""
        self.navigation = navigation
        self.guard = guard
        self.screening = screening
        self.notes = notes
        self._placing = placing
        self._aider = aider
        self._bridge = bridge
        self._straying = straying
        self._aided = False  # in the last step
        self._drift_sps = 0.0  # of its oscillator, as the last solution had it
        self._velocity_error_e_mps = np.zeros(3)  # of the navigation, as the phases had it

    def before(self, receiver: Receiver, first: int, end: int) -> Aids:
        """Aiding for samples [first, end) of the receiver's first stream."""
        clock = receiver.clock
        self._aided = False
        if clock is None:
            return NO_AIDS
        if not (self.navigation.running and self.guard.trusted):
            return self._unaided()
        # The last command of the epoch goes beyond it: an update of increments must be waited for.
        span = (clock.time(first), clock.time(end).plus(AHEAD_S))
        trajectory = self.navigation.ahead(span[1])
        if trajectory is None:
            return self._unaided()
        listeners = [
            Listener(channel.satellite, channel.signal.id, rate_hz)
            for bank, rate_hz in [(bank, float(bank.rate_hz)) for bank in receiver.banks]
            for channel in bank.tracked()
        ]
        known_sps = self._bridge.drift_sps
        drift_sps = self._drift_sps if known_sps is None else known_sps
        profiles = self._aider.profiles(
            trajectory,
            span,
            listeners,
            receiver.nav,
            clock,
            drift_sps,
            self._velocity_error_e_mps,
        )
        antenna = trajectory.antenna(trajectory.time_s[-1:], self._aider.lever_b_m)
        screen = None
        if self.screening is not None:
            screen = self.screening.along(trajectory, self._aider.lever_b_m, self._bridge.drift_mps)
        self._aided = bool(profiles)
        return Aids(profiles, (antenna.r_e_m[0], antenna.v_e_mps[0]), screen)

    def _unaided(self) -> Aids:
        """Nothing to aid with, nor to hold ranges against."""
        if self.screening is not None:
            self.screening.forget()
        return NO_AIDS

    def after(self, receiver: Receiver, result: StepResult) -> Navigated:
        """Take an epoch's fixes; the navigation at their tags, and what it has to tell."""
        states: list[NavigationState] = []
        found_at: list[tuple[Fix, NavigationState]] = []
        events: list[Event] = []
        moves: Mapping[str, Coast] = {}
        outside: dict[GpsTime, frozenset[str]] = {}
        joined_m: dict[str, float] = {}
        bent_m: Mapping[str, float] = {}
        for fix in result.fixes:
            found = self.navigation.take([fix])
            states += found
            found_at += [(fix, state) for state in found]
            bridged = self._bridged(fix, found[0] if found else None)
            for slip in bridged.slips:
                missing = None if slip.cycles is None else -slip.cycles
                receiver.mend(slip.satellite, missing, slip.reason)
            receiver.rejoin({one: 0.5 * (number % 2) for one, number in bridged.halves.items()})
            joined_m |= bridged.joined_m
            bent_m = bridged.bent_m
            if bridged.clock_jump_m is not None:
                jump_ns = bridged.clock_jump_m / SPEED_OF_LIGHT_MPS * NS
                detail = f"all phases moved together by {jump_ns:+.2f} ns"
                events.append(Event(fix.epoch.instant.sample, "RX", "clock jump", detail))
            moves = bridged.moves
            outside[fix.epoch.time] = bridged.outside
        receiver.coast(moves)  # of the last tag: it saw the generators as they stand
        left_m = {one: off_m for one, off_m in bent_m.items() if one not in joined_m}
        receiver.put_codes_right(left_m, reflected=True)
        receiver.put_codes_right(joined_m)
        if found_at:
            receiver.let_go(self._strayed(receiver, found_at[-1][1]))
        told, innovations = self.navigation.news()
        block = self.navigation.block
        turns = self.guard.take(block, result.fixes, states, told, innovations, aided=self._aided)
        for event in told:
            time = self.navigation.instant(event.time_s)
            sample = clock.instant(to_ns(time)).sample if (clock := receiver.clock) else result.end
            events.append(Event(sample, "INS", event.what, event.reason))
        for turn in turns:
            sample = clock.instant(to_ns(turn.time)).sample if (clock := receiver.clock) else 0
            what = "trusted" if turn.trusted else "distrusted"
            events.append(Event(sample, "INS", what, turn.reason))
            if not turn.trusted:  # what misled it is in its state
                self.navigation.stop(turn.time, turn.reason)
        if (moved_s := self.guard.correction_s()) is not None:
            detail = f"log was {self.guard.offset}: {moved_s:+.4f} s"
            events.append(Event(result.end, "INS", "time offset", detail))
            self.navigation.shift(moved_s)
            self.guard.corrected(moved_s)
        for flag in self.screening.news() if self.screening is not None else ():
            sample = clock.instant(to_ns(flag.time)).sample if (clock := receiver.clock) else 0
            what = "range refused" if flag.refused else "range accepted"
            events.append(Event(sample, flag.satellite, what, flag.reason))
        placed: Mapping[GpsTime, NavSolution] = {}
        if self._placing is not None and self._aided and self.guard.trusted:
            take = self._placing.take
            placed = {fix.epoch.time: take(fix, state) for fix, state in found_at}
        return Navigated(
            tuple(states),
            tuple(events),
            tuple(innovations),
            moves,
            self._bridge.errors_covariance,
            placed,
            outside,
        )

    def _bridged(self, fix: Fix, state: NavigationState | None) -> Bridged:
        """Hold a tag's phases against the way that led to it."""
        solution = fix.solution
        drift, drift_sigma = math.nan, math.nan
        if solution.valid and math.isfinite(solution.drift_sps):
            self._drift_sps = drift = fix.epoch.counter.drift_sps + solution.drift_sps
            drift_sigma = float(np.sqrt(solution.velocity_covariance_m2ps2[3, 3]))
            drift_sigma /= SPEED_OF_LIGHT_MPS
        if state is None or not self.guard.trusted:
            self._velocity_error_e_mps = np.zeros(3)
            return self._bridge.stop(fix.coasting)
        if state.leg is None:
            return Bridged()
        leg, estimate = state.leg, state.estimate
        there = abs(fix.epoch.time.since(leg.origin) - leg.end_s) < SAME_EPOCH_S
        vehicle = slice(0, estimate.layout.vehicle)
        tag = Tag(
            fix.epoch.observations if there else (),
            fix.coasting if there else (),
            fix.epoch.counter.ahead_s,
            (drift, drift_sigma),
            leg,
            estimate.P[vehicle, vehicle],
            C_ne(estimate.ins.lat_rad, estimate.ins.lon_rad),
            solution.rejected,
        )
        bridged = self._bridge.take(tag, self._aider.skyline)
        wrong_n_mps = self._bridge.velocity_error_n_mps
        self._velocity_error_e_mps = (
            np.zeros(3) if wrong_n_mps is None else tag.C_ne.T @ wrong_n_mps
        )
        return bridged

    def _strayed(self, receiver: Receiver, state: NavigationState) -> Mapping[str, str]:
        """Channels in open loop that may be too far off by now, and why."""
        skyline, ins = self._aider.skyline, state.estimate.ins
        coasting = [
            Unheard(channel.satellite, channel.signal)
            for channel in receiver.channels
            if channel.coasting and channel.satellite in skyline.row
        ]
        if state.leg is None or not coasting:
            return {}
        names = [one.satellite for one in coasting]
        sigma_mps = self._bridge.rate_sigma_mps(names, skyline, C_ne(ins.lat_rad, ins.lon_rad))
        if sigma_mps is None:
            return {}
        return self._straying.take(state.leg.end_s, coasting, sigma_mps)


def couple(config: Config, plan: RunPlan, clock: ReceiverClock) -> CoupledNavigation:
    """Read the inertial log (and the odometer's) onto the receiver's time.

    Raises InputFileError or ConfigError when they cannot be used.
    """
    imu = imu_section(config)
    start, end = clock.time(plan.first), clock.time(plan.end)
    log = ImuLog(
        imu,
        near=start,
        sample_zero=clock.time(0),
        sample_rate_hz=plan.stream.sample_rate_hz,
    )
    block = joined(*log)
    wheels: WheelSpeeds | None = None
    faults: Sequence[str] = ()
    if config.odometer is not None and config.ins.vehicle is not None:
        speeds, faults = read_odometer(config.odometer, start)
        wheels = wheel_speeds(speeds)
    last = block.origin.plus(float(block.time_s[-1]))
    found = findings(block, stated_rate_hz=imu.rate, recording=(start, end), last=last)
    tight = config.deep.coupling == "tight"
    systems = tuple(sorted({covered.id.system for covered in plan.covered}, key="GC".index))
    layout = layout_of(config, wheels)._replace(systems=systems if tight else ())
    settings = replace(
        coupling_settings(config, block, wheels),
        keep_epochs=False,
        restart_after=round(config.ins.restart_after / config.deep.epoch),
        clock=CLOCK_NOISE,
    )
    inputs = InertialInputs(
        block,
        imu.grade.build(),
        alignment_settings(config, layout),
        settings,
        wheels,
        plan.settings.pvt if tight else None,
        systems,
    )
    notes = (*log.faults, *(f"{log.path}: {line}" for line in found), *faults)
    aider = Aider(plan.settings.pvt, settings.lever_b_m)
    carrier = carrier_loop(plan.settings.tracking.carrier).settled
    loop = Loop(carrier.bandwidth_hz, carrier.interval_s, config.deep.phase_floor)
    bridge = Bridge(config.oscillator.oscillator(), loop)
    outliers, screening = config.positioning.outliers, None
    if outliers.enabled:
        own = ScreenSettings(outliers.alpha, outliers.threshold)
        screening = Screening(plan.settings.pvt, own)
    unit = Unit(
        inputs.grade,
        settings.lever_b_m,
        inputs.alignment.mounting_yaw_rad,
        None if imu.time_offset == "auto" else imu.time_offset,
    )
    guard = Guard(unit, CarrierLoop(*carrier))
    placing = Placing(plan.settings.pvt) if config.positioning.inertial else None
    straying = Straying(plan.settings.tracking.spacing_chips)
    return CoupledNavigation(
        Navigation(inputs), aider, bridge, straying, guard, screening, placing, notes
    )
