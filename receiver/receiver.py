"""The receiver: a complete unaided one by itself, driven epoch by epoch.

One step: search, run every channel through the epoch, read messages, observe, position. What it
knows after a step it uses in the next; nothing looks ahead of the epoch's samples.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import (
    ChannelReport,
    Correlations,
    Counter,
    Ephemeris,
    Epoch,
    Event,
    FloatArray,
    NavData,
    NavSolution,
    Observation,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver import framing, pvt
from deepgnss.receiver.accounts import Accounts
from deepgnss.receiver.acquisition import AcquisitionSettings
from deepgnss.receiver.bank import Bank, Head
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.clock import NS, ReceiverClock, from_ns
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.known_symbols import KnownSymbols
from deepgnss.receiver.measured import Measured, measure
from deepgnss.receiver.messages import Frame, News, Subframe
from deepgnss.receiver.modes import AidingSource, Coast, Mode, TrackingSettings
from deepgnss.receiver.rack import Rack, run_epoch
from deepgnss.receiver.search import Assistance, Place, SearchSettings
from deepgnss.receiver.signals import Signal

_TRAVEL_S = 0.075  # of a signal, when nothing is known: right to 12 ms
_TIME_GUESS_S = 0.015


@dataclass(frozen=True, slots=True)
class ReceiverSettings:
    """Everything a receiver is told beforehand."""

    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    acquisition: AcquisitionSettings = field(default_factory=AcquisitionSettings)
    searching: SearchSettings = field(default_factory=SearchSettings)
    pvt: pvt.PvtParameters = field(default_factory=pvt.PvtParameters)
    output_ns: int = NS  # interval of output epochs
    solution_ns: int = NS // 10  # interval of positions until the first one, and for aiding
    solve_between_outputs: bool = False  # somebody (a filter) wants a position at that interval
    smoothing: bool = False


@dataclass(frozen=True, slots=True)
class Knowledge:
    """What is known before the first sample: from a NAV file, a hint, or a scout pass."""

    nav: NavData = field(default_factory=NavData)
    near: GpsTime | None = None  # rough date, for the week number
    clock: ReceiverClock | None = None
    position_e_m: FloatArray | None = None
    symbols: Mapping[str, KnownSymbols] = field(default_factory=dict)
    start: GpsTime | None = None  # of the recording, good to minutes: for who is in sight


Screen = Callable[[Measured], Mapping[str, str]]
"""Satellites of a tag whose range must leave the position, and why."""


class Fix(NamedTuple):
    """Observations and solution of one tag."""

    measured: Measured
    solution: NavSolution
    output: bool  # falls on the output interval
    coasting: tuple[Observation, ...] = ()  # of channels in open loop, by their generators alone

    @property
    def epoch(self) -> Epoch:
        """All observations."""
        return self.measured.epoch


@dataclass(frozen=True, slots=True)
class StepResult:
    """Everything an epoch gave."""

    first: int
    end: int
    fixes: tuple[Fix, ...]
    reports: tuple[ChannelReport, ...]
    events: tuple[Event, ...]
    subframes: tuple[tuple[str, Subframe], ...]
    correlations: Mapping[str, tuple[Correlations, ...]]


class Receiver:
    """Banks of channels that share time, place and navigation data; unaided unless aided.

    Its own time axis is the sample counter of the first bank's stream; all streams start at the
    same instant.
    """

    def __init__(
        self,
        signals: Sequence[tuple[Signal, float]],
        settings: ReceiverSettings,
        knowledge: Knowledge,
        executor: Executor | None = None,
        workers: int = 1,
    ) -> None:
        """Signals with the sampling rates of their streams, Hz.

        Workers: number of tasks the channels of an epoch are dealt to.
        """
        self.settings = settings
        self.nav = knowledge.nav
        self.clock = knowledge.clock
        self.solution: NavSolution | None = None
        self.banks = tuple(
            Bank(
                signal,
                rate_hz,
                settings.tracking,
                settings.acquisition,
                settings.searching,
                knowledge.symbols,
            )
            for signal, rate_hz in signals
        )
        self.accounts = Accounts([bank.signal for bank in self.banks])
        self._rate = self.banks[0].rate_hz
        self._near = knowledge.near
        self._start = knowledge
        self._executor = executor
        self._workers = workers
        self._steered = knowledge.clock is not None  # tags mean GPST, to what is known of it
        self._last_tag_ns: int | None = None
        self._last_place: tuple[FloatArray, FloatArray] | None = None
        self._events: list[Event] = []
        self._late: list[Event] = []  # noted after a step, told by the next
        self._told = False  # whether the last step's tags were put out

    @property
    def steered(self) -> bool:
        """Whether a solution has set the clock: tags then mean GPST."""
        return self._steered

    @property
    def channels(self) -> list[Channel]:
        """All channels, bank by bank in the order of PRNs."""
        return [channel for bank in self.banks for channel in bank.tracked()]

    # --- the epoch ---------------------------------------------------------------------------

    def step(
        self,
        feeds: Mapping[str, SumFeed],
        first: int,
        end: int,
        aiding: Mapping[str, AidingSource] | None = None,
        place: tuple[FloatArray, FloatArray] | None = None,
        screen: Screen | None = None,
    ) -> StepResult:
        """Run through samples [first, end) of the first stream; the feeds stand at `first`.

        feeds: running sums by signal name. aiding: by satellite, in samples of its own stream.
        place: position and velocity (ECEF) by somebody who knows better than the last solution.
        screen: asked at every tag before its position.
        """
        self._events, self._late = self._late, []
        self._last_place = place or self._last_place
        self._search(feeds, first, end)
        self._track(feeds, end, aiding or {})
        subframes = self._read_messages()
        fixes = self._observe(first, end, screen)
        reports = tuple(report for bank in self.banks for report in bank.reports(self.accounts))
        for report in reports:
            self.accounts.tracked(report)
        correlations = {
            satellite: taken
            for bank in self.banks
            for satellite, taken in bank.correlations().items()
        }
        self._retire()
        events = tuple(sorted(self._events, key=lambda event: (event.sample, event.satellite)))
        return StepResult(first, end, fixes, reports, events, subframes, correlations)

    def coast(self, moves: Mapping[str, Coast]) -> None:
        """Put right phases carried on in open loop, by satellite.

        To be called after every step, also with nothing to move: an open loop keeps its phase for
        as long as somebody looks after it. A channel whose signal has come back is left to itself.
        """
        for channel in self.channels:
            channel.coast(moves.get(channel.satellite))

    def let_go(self, gone: Mapping[str, str]) -> None:
        """Give up channels after a step, by satellite with the reason: they are searched anew."""
        self._act(gone, lambda channel: channel.drop(gone[channel.satellite]))
        self._retire()

    def mend(self, satellite: str, cycles: float | None, reason: str) -> None:
        """Take a cycle slip into account that was found after a step, in its last tags.

        cycles: missing in the phase as RINEX has it, a multiple of ½; they are put back, and where
        no phase without them was put out the arc goes on. None: not known, a new arc begins.
        """
        self._act([satellite], lambda channel: channel.mend(cycles, reason, told=self._told))

    def rejoin(self, half_cycles: Mapping[str, float]) -> None:
        """Tell channels that are back their polarity (0 or ½), by satellite, until symbols do."""
        self._act(half_cycles, lambda channel: channel.rejoin(half_cycles[channel.satellite]))

    def put_codes_right(self, off_m: Mapping[str, float], *, reflected: bool = False) -> None:
        """Take off codes, by satellite, what they are known to be too long, after a step.

        reflected: they follow reflections.
        """
        self._act(
            off_m,
            lambda channel: channel.put_code_right(off_m[channel.satellite], reflected=reflected),
        )

    def _act(self, satellites: Container[str], act: Callable[[Channel], None]) -> None:
        """Do something to channels after a step, and keep the events it makes for the next one."""
        for bank in self.banks:
            for channel in bank.tracked():
                if channel.satellite in satellites:
                    before = len(channel.events)
                    act(channel)
                    self._late.extend(self._counted(channel.events[before:], bank))

    def sample_in(self, rate_hz: Fraction | float, sample: int) -> int:
        """A sample of the first stream, counted in a stream of another rate."""
        if rate_hz == self._rate:
            return sample
        return round(sample * Fraction(rate_hz) / self._rate)

    def _log(self, events: Sequence[Event], bank: Bank) -> None:
        """Keep events, their samples counted in the first stream."""
        self._events.extend(self._counted(events, bank))

    def _counted(self, events: Sequence[Event], bank: Bank) -> list[Event]:
        if bank.rate_hz == self._rate:
            return list(events)
        scale = self._rate / bank.rate_hz
        return [replace(event, sample=round(event.sample * scale)) for event in events]

    def _track(
        self, feeds: Mapping[str, SumFeed], end: int, aiding: Mapping[str, AidingSource]
    ) -> None:
        """Run all channels to the end: streams at the same time, their workers share channels.

        The one that takes longest begins.
        """
        for channel in self.channels:
            channel.begin_epoch()
        names, executor = sorted(feeds, key=self._load, reverse=True), self._executor
        workers = max(1, self._workers // len(names)) if executor is not None else 1

        def through(name: str) -> None:
            self._run_stream(name, feeds[name], end, aiding, workers)

        if executor is None or len(names) == 1:
            for name in names:
                through(name)
        else:
            list(executor.map(through, names))
        for bank in self.banks:
            self._log(bank.events(), bank)
        for channel in self.channels:
            if channel.mode is not Mode.PULL_IN:
                self.accounts.advance(channel.satellite, "pulled in")
            if channel.edge is not None:
                self.accounts.advance(channel.satellite, "bit sync")

    def _load(self, name: str) -> float:
        """What the channels of a signal's name cost, about: chips a second."""
        banks = self._banks_of(name)
        return sum(len(bank.channels) * bank.signal.id.chip_rate_hz for bank in banks)

    def _banks_of(self, name: str) -> list[Bank]:
        """Banks of a signal's name, which have a stream in common."""
        return [bank for bank in self.banks if bank.signal.id.name == name]

    def _run_stream(
        self,
        name: str,
        feed: SumFeed,
        end: int,
        aiding: Mapping[str, AidingSource],
        workers: int,
    ) -> None:
        """Run the channels of a signal's name, dealt to so many workers."""
        banks = self._banks_of(name)
        channels = [channel for bank in banks for channel in bank.tracked()]
        end = self.sample_in(banks[0].rate_hz, end)
        racks = [Rack(channels[k::workers], aiding, end) for k in range(workers)]
        run_epoch(racks, feed, end, self._executor)

    def _retire(self) -> None:
        for bank in self.banks:
            for channel in bank.retire():
                reason = channel.events[-1].reason if channel.events else "lost"
                stage = self.accounts.stage(channel.satellite)
                self.accounts.advance(channel.satellite, stage, f"lost: {reason}")

    # --- search ------------------------------------------------------------------------------

    def _place(self, sample: int) -> Place | None:
        """Where and when the receiver is at a sample, if known well enough to predict signals."""
        if self.clock is None or not self._steered:
            return None
        time, drift_sps = self.clock.time(sample), self.clock.drift_sps
        if self._last_place is not None:
            return Place(time, *self._last_place, drift_sps)
        if self._start.position_e_m is None:
            return None
        return Place(time, self._start.position_e_m, np.zeros(3), drift_sps, moving=True)

    def _rough_place(self, sample: int) -> Place | None:
        """Where and when a sample was taken, as far as somebody has told beforehand."""
        start, r_e_m = self._start.start, self._start.position_e_m
        if start is None or r_e_m is None:
            return None
        return Place(start.plus(float(sample / self._rate)), r_e_m, np.zeros(3), 0.0, moving=True)

    def _search(self, feeds: Mapping[str, SumFeed], first: int, end: int) -> None:
        """Look for satellites that are not tracked, on the samples that begin this epoch."""
        place = self._place(first)
        rough = self._rough_place(first) if place is None else None
        known = Assistance(self.nav, place, rough)
        for bank in self.banks:
            elsewhere = sum(len(other.channels) for other in self.banks if other is not bank)
            window = (self.sample_in(bank.rate_hz, first), self.sample_in(bank.rate_hz, end))
            clock = self.clock.at_rate(bank.rate_hz) if self.clock is not None else None
            feed, executor = feeds[bank.signal.id.name], self._executor
            found = bank.search(feed, window, known, clock, self.accounts, elsewhere, executor)
            self._log(found, bank)
            if place is not None and clock is not None and not place.moving:
                self._log(bank.anchor_faint(place, self.nav, clock, window[0]), bank)

    # --- messages and time ---------------------------------------------------------------------

    def _read_messages(self) -> tuple[tuple[str, Subframe], ...]:
        subframes: list[tuple[str, Subframe]] = []
        for bank in self.banks:
            for news in bank.read_messages(self._date()):
                satellite = news.channel.satellite
                subframes.extend((satellite, subframe) for subframe in news.subframes)
                fresh = tuple(i for i in news.items if not self._is_copy(bank, news.channel, i))
                self.nav = framing.take_news(self.nav, fresh)
                for item in fresh:
                    if isinstance(item, Ephemeris):
                        detail = f"IODE {item.iode}, health {item.health}"
                        self._note(bank, news.channel, "ephemeris", detail)
        self._take_heads()
        for bank in self.banks:
            bank.take_known_polarities()
            bank.foretell_symbols()
        for channel in self.channels:
            if channel.anchor is not None:
                self.accounts.advance(channel.satellite, "frame sync")
                if channel.satellite in self.nav.ephemerides:
                    self.accounts.advance(channel.satellite, "ephemeris")
        return tuple(subframes)

    def _date(self) -> GpsTime | None:
        """Rough date: clock, hint, or any ephemeris."""
        if self.clock is not None:
            return self.clock.time(0)
        if self._near is not None:
            return self._near
        for ephemerides in self.nav.ephemerides.values():
            return ephemerides[-1].toe
        return None

    def _take_heads(self) -> None:
        """Frame heads set transmit time and polarity once they are beyond doubt.

        A head is believed when its subframe (or the next head) confirmed it, when it agrees with
        the receiver's time, or when two other satellites say the same.
        """
        date = self._date()
        if date is None:
            return
        heads: dict[tuple[Bank, int], Head] = {
            (bank, prn): head for bank in self.banks for prn, head in bank.present_heads().items()
        }
        anchors: dict[tuple[Bank, int], int] = {}
        origins: dict[tuple[Bank, int], int] = {}
        for key, (channel, _, frame) in heads.items():
            weeks = round((date.tow_s - frame.start_tow_s) / SECONDS_PER_WEEK)  # the nearest one
            anchors[key] = framing.anchor_of(channel, frame, date.week + weeks)
            origins[key] = self._origin_ns(key[0], channel, anchors[key])
        for key, origin_ns in origins.items():
            (bank, prn), (channel, _, frame) = key, heads[key]
            agreeing = sum(abs(origin_ns - other) < 0.03 * NS for other in origins.values()) - 1
            fits = self.clock is not None and abs(origin_ns - self.clock.origin_ns) < 0.05 * NS
            if frame.confirmed or fits or agreeing >= 2:
                self._settle(bank, channel, frame, anchors[key])
                del bank.heads[prn]

    def _origin_ns(self, bank: Bank, channel: Channel, anchor: int) -> int:
        """GPST of sample 0, ns since the GPS epoch, by a channel's anchor and a guessed travel."""
        sent_ns = (anchor + channel.periods) * round(bank.signal.period_s * NS)
        elapsed_ns = round(channel.command.sample / bank.rate_hz * NS)
        return sent_ns + round(_TRAVEL_S * NS) - elapsed_ns

    def _settle(self, bank: Bank, channel: Channel, frame: Frame, anchor: int) -> None:
        if channel.anchor is not None and channel.anchor != anchor:
            detail = f"frame says {anchor - channel.anchor:+d} code periods"
            self._note(bank, channel, "time corrected", detail)
        elif channel.anchor is None:
            detail = f"subframe {frame.subframe_id}, {frame.start_tow_s} s"
            self._note(bank, channel, "frame sync", detail)
        channel.anchor = anchor
        channel.set_polarity(0.5 if frame.polarity else 0.0)
        if self.clock is None:
            origin_ns = self._origin_ns(bank, channel, anchor)
            self.clock = ReceiverClock(self._rate, origin_ns, uncertainty_s=_TIME_GUESS_S)

    def _is_copy(self, bank: Bank, channel: Channel, item: News) -> bool:
        """True, and the channel dropped, when it reads another satellite's message.

        A channel locked to the cross-correlation of a strong satellite decodes that one's orbit;
        should it be the first to tell, the other, weaker one is dropped with what it told.
        """
        if not isinstance(item, Ephemeris):
            return False
        for satellite, others in self.nav.ephemerides.items():
            same = [e for e in others if (e.m0_rad, e.omega_rad) == (item.m0_rad, item.omega_rad)]
            if satellite == channel.satellite or not same:
                continue
            rival = bank.channels.get(int(satellite[1:]))
            if rival is None or rival.cn0_dbhz >= channel.cn0_dbhz:
                self._drop(bank, channel, f"cross-correlation: sends the orbit of {satellite}")
                return True
            self._drop(bank, rival, f"cross-correlation: sends the orbit of {channel.satellite}")
            kept = tuple(e for e in others if e not in same)
            ephemerides = {**self.nav.ephemerides, satellite: kept}
            self.nav = replace(
                self.nav, ephemerides={name: sets for name, sets in ephemerides.items() if sets}
            )
            return False
        return False

    def _drop(self, bank: Bank, channel: Channel, reason: str) -> None:
        channel.drop(reason)
        self._log(channel.events[-1:], bank)

    # --- observables and position --------------------------------------------------------------

    def _observe(self, first: int, end: int, screen: Screen | None) -> tuple[Fix, ...]:
        """Observations and solutions of the tags in (first, end]."""
        fixes: list[Fix] = []
        for tag_ns in self._tags(first, end):
            fix = self._fix(tag_ns, screen)
            if fix is not None:
                fixes.append(fix)
        self._told = any(fix.output for fix in fixes)
        return tuple(fixes)

    def _tags(self, first: int, end: int) -> list[int]:
        """GPST tags, ns since the GPS epoch, each once, as far as every channel's estimate goes.

        A channel's last whole interval ends up to its own length before the epoch does.
        """
        if self.clock is None:
            return []
        lag = int(1.25 * max(bank.longest_s for bank in self.banks) * self._rate)
        first, end = first - lag, end - lag
        begin_ns, end_ns = (
            self.clock.origin_ns + round(self.clock.gpst_ns(sample)) for sample in (first, end)
        )
        tags: set[int] = set()
        settings = self.settings
        needed = self.solution is None or settings.solve_between_outputs
        for interval in (settings.output_ns, *((settings.solution_ns,) if needed else ())):
            tags.update(range(-(-begin_ns // interval) * interval, end_ns + 1, interval))
        last = self._last_tag_ns
        return sorted(
            tag
            for tag in tags
            if first <= self.clock.instant(tag).sample < end and (last is None or tag > last)
        )

    def _fix(self, tag_ns: int, screen: Screen | None) -> Fix | None:
        output = tag_ns % self.settings.output_ns == 0 and self._steered
        measured, coasting = self._measured(tag_ns, output)
        if not measured.epoch.observations:
            return self._unseen(tag_ns, measured, coasting)
        refused = screen(measured) if screen is not None else pvt.NOBODY_REFUSED
        for channel in self.channels if refused else ():
            if channel.satellite in refused:
                channel.doubt_code()
        solution = pvt.solve_measured(measured, self.settings.pvt, self.solution, refused)
        if solution.valid and self.clock is not None:
            first = not self._steered
            self.clock = self.clock.steered(
                tag_ns, solution.clock_s, solution.drift_sps, first=first
            )
            if first:  # observe again: the tag has moved by up to some ms
                self._steered = True
                output = tag_ns % self.settings.output_ns == 0
                measured, coasting = self._measured(tag_ns, output)
                solution = pvt.solve_measured(measured, self.settings.pvt, solution)
        self._last_tag_ns = tag_ns
        self.solution = solution if solution.valid else self.solution
        if solution.valid:
            self._last_place = (solution.r_e_m, solution.v_e_mps)
        self.accounts.solved(solution)
        if not self._steered:
            return None  # tags are still some ms off
        return Fix(measured, solution, output, coasting)

    def _unseen(
        self, tag_ns: int, measured: Measured, coasting: tuple[Observation, ...]
    ) -> Fix | None:
        """A tag at which every channel is in open loop, for whoever puts them right."""
        if not coasting or not self._steered:
            return None
        self._last_tag_ns = tag_ns
        unsolved = pvt.unsolved(measured.epoch.time, "no signal", {})
        return Fix(measured, unsolved, False, coasting)

    def _measured(self, tag_ns: int, output: bool) -> tuple[Measured, tuple[Observation, ...]]:
        """Observations of all banks at a tag, and those of channels in open loop."""
        if self.clock is None:
            raise ValueError("no receiver time")
        time = from_ns(tag_ns)
        received: list[Observation] = []
        coasting: list[Observation] = []
        for bank in self.banks:
            tagged = bank.observe(
                self.clock, tag_ns, time, output=output, smoothing=self.settings.smoothing
            )
            received += tagged.received
            coasting += tagged.coasting
        instant = self.clock.instant(tag_ns)
        counter = Counter(-self.clock.lag_s(tag_ns, instant), self.clock.drift_sps)
        epoch = Epoch(time, instant, tuple(received), counter)
        return measure(epoch, self.nav), tuple(coasting)

    # --- accounts ------------------------------------------------------------------------------

    def _note(self, bank: Bank, channel: Channel, what: str, reason: str) -> None:
        self._log([Event(channel.command.sample, channel.satellite, what, reason)], bank)
