"""The circle of the deep integration, closed once per epoch.

navigation.ahead ──▶ Aider.profiles ──▶ receiver.step ──▶ navigation.take
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from deepgnss.core.records import Event, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.aiding import AHEAD_S, Aider, Listener, Profile
from deepgnss.deep.inertial import (
    alignment_settings,
    coupling_settings,
    imu_section,
    layout_of,
    wheel_speeds,
)
from deepgnss.deep.navigation import InertialInputs, Navigation, NavigationState
from deepgnss.deep.setup import RunPlan
from deepgnss.ins import WheelSpeeds
from deepgnss.ins.increments import joined
from deepgnss.ins.sanity import findings
from deepgnss.ins.updates import Innovation
from deepgnss.io.config import Config
from deepgnss.io.imu import ImuLog, read_odometer
from deepgnss.receiver.clock import ReceiverClock, to_ns
from deepgnss.receiver.receiver import Receiver, StepResult

_DRIFT_REMEMBERED_S = 3.0  # of clock drift, taken when no solution tells it


class Aids(NamedTuple):
    """What an epoch of the receiver is given."""

    profiles: Mapping[str, Profile]
    place: tuple[FloatArray, FloatArray] | None


NO_AIDS = Aids({}, None)


class Navigated(NamedTuple):
    """What an epoch gave the navigation."""

    states: tuple[NavigationState, ...] = ()  # at the epoch's tags
    events: tuple[Event, ...] = ()
    innovations: tuple[Innovation, ...] = ()


@dataclass(slots=True)
class ClockMemory:
    """Mean clock drift of the last seconds, for the time in which nothing shows it."""

    time: GpsTime | None = None
    drift_sps: float = math.nan

    def take(self, time: GpsTime, drift_sps: float) -> None:
        """Take the drift of a solution in."""
        if not math.isfinite(drift_sps):
            return
        passed_s = time.since(self.time) if self.time is not None else math.inf
        share = -math.expm1(-passed_s / _DRIFT_REMEMBERED_S)
        before = self.drift_sps if math.isfinite(self.drift_sps) else drift_sps
        self.time, self.drift_sps = time, before + share * (drift_sps - before)


class CoupledNavigation:
    """Joins a receiver and an inertial navigation, an epoch at a time."""

    def __init__(self, navigation: Navigation, aider: Aider, notes: tuple[str, ...] = ()) -> None:
        """`notes`: what is odd about the inertial log."""
        self.navigation = navigation
        self.notes = notes
        self._aider = aider
        self._clock = ClockMemory()

    def before(self, receiver: Receiver, first: int, end: int) -> Aids:
        """Aiding for samples [first, end) of the receiver's first stream."""
        clock = receiver.clock
        if clock is None or not self.navigation.running:
            return NO_AIDS
        # The last command of the epoch goes beyond it: an update of increments must be waited for.
        span = (clock.time(first), clock.time(end).plus(AHEAD_S))
        trajectory = self.navigation.ahead(span[1])
        if trajectory is None:
            return NO_AIDS
        listeners = [
            Listener(channel.satellite, channel.signal.id, float(bank.rate_hz))
            for bank in receiver.banks
            for channel in bank.tracked()
        ]
        drift_sps = self._clock.drift_sps if math.isfinite(self._clock.drift_sps) else 0.0
        profiles = self._aider.profiles(trajectory, span, listeners, receiver.nav, clock, drift_sps)
        antenna = trajectory.antenna(trajectory.time_s[-1:], self._aider.lever_b_m)
        return Aids(profiles, (antenna.r_e_m[0], antenna.v_e_mps[0]))

    def after(self, receiver: Receiver, result: StepResult) -> Navigated:
        """Take an epoch's fixes; the navigation at their tags, and what it has to tell."""
        if receiver.clock is not None:
            for fix in result.fixes:
                if fix.solution.valid:
                    drift_sps = receiver.clock.drift_sps + fix.solution.drift_sps
                    self._clock.take(fix.epoch.time, drift_sps)
        states = self.navigation.take(result.fixes)
        told, innovations = self.navigation.news()
        events = []
        for event in told:
            time = self.navigation.instant(event.time_s)
            sample = clock.instant(to_ns(time)).sample if (clock := receiver.clock) else result.end
            events.append(Event(sample, "INS", event.what, event.reason))
        return Navigated(tuple(states), tuple(events), tuple(innovations))


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
    layout = layout_of(config, wheels)
    settings = replace(coupling_settings(config, block, wheels), keep_epochs=False)
    inputs = InertialInputs(
        block, imu.grade.build(), alignment_settings(config, layout), settings, wheels
    )
    notes = (*log.faults, *(f"{log.path}: {line}" for line in found), *faults)
    aider = Aider(plan.settings.pvt, settings.lever_b_m)
    return CoupledNavigation(Navigation(inputs), aider, notes)
