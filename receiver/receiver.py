"""The receiver: a complete unaided one by itself, driven epoch by epoch.

One step: search, run every channel through the epoch, read messages, observe, position. What it
knows after a step it uses in the next; nothing looks ahead of the epoch's samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import (
    ChannelReport,
    Correlations,
    Ephemeris,
    Epoch,
    Event,
    FloatArray,
    NavData,
    NavSolution,
    Observation,
    RunningSums,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver import framing, lnav, pvt
from deepgnss.receiver.accounts import Accounts
from deepgnss.receiver.acquisition import Acquisition, AcquisitionSettings
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.clock import NS, ReceiverClock, from_ns
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.modes import AidingSource, Mode, TrackingSettings, unaided
from deepgnss.receiver.observables import PhaseMemory, observe
from deepgnss.receiver.search import Place, Searcher, SearchSettings, Sight
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.smoothing import HatchState, smooth

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
    symbols: Mapping[str, framing.KnownSymbols] = field(default_factory=dict)


class _Head(NamedTuple):
    """A frame head not yet believed."""

    channel: Channel
    stretch: int  # the channel's `symbols_first` it counts from
    frame: lnav.Frame


class Fix(NamedTuple):
    """Observations and solution of one tag."""

    epoch: Epoch
    solution: NavSolution
    output: bool  # falls on the output interval


@dataclass(frozen=True, slots=True)
class StepResult:
    """Everything an epoch gave."""

    first: int
    end: int
    fixes: tuple[Fix, ...]
    reports: tuple[ChannelReport, ...]
    events: tuple[Event, ...]
    subframes: tuple[tuple[str, lnav.Subframe], ...]
    correlations: Mapping[str, tuple[Correlations, ...]]


class Receiver:
    """One signal's receiver on one stream, unaided unless aiding sources are given."""

    def __init__(
        self,
        signal: Signal,
        sample_rate_hz: float,
        settings: ReceiverSettings,
        knowledge: Knowledge,
        executor: Executor | None = None,
        workers: int = 1,
    ) -> None:
        """Workers: number of tasks the channels of an epoch are dealt to."""
        self.signal = signal
        self.settings = settings
        self.nav = knowledge.nav
        self.clock = knowledge.clock
        self.solution: NavSolution | None = None
        self.channels: dict[int, Channel] = {}
        self.accounts = Accounts(signal)
        self._rate = Fraction(sample_rate_hz)
        self._near = knowledge.near
        self._start = knowledge
        self._executor = executor
        self._workers = workers
        self._frames: dict[int, framing.FrameState] = {}
        self._heads: dict[int, _Head] = {}
        self._memory: dict[int, PhaseMemory] = {}
        self._hatch: dict[int, HatchState] = {}
        self._searcher = Searcher(signal, settings.acquisition, settings.searching, sample_rate_hz)
        self._steered = knowledge.clock is not None  # tags mean GPST, to what is known of it
        self._last_tag_ns: int | None = None
        self._last_place: tuple[FloatArray, FloatArray] | None = None
        self._events: list[Event] = []

    # --- the epoch ---------------------------------------------------------------------------

    def step(
        self,
        feed: SumFeed,
        first: int,
        end: int,
        aiding: Mapping[str, AidingSource] | None = None,
    ) -> StepResult:
        """Run through samples [first, end), where the feed stands at `first`."""
        self._events = []
        self._search(feed, first, end)
        self._track(feed, end, aiding or {})
        subframes = self._read_messages()
        fixes = self._observe(first, end)
        reports = tuple(
            channel.report(self.accounts.stage(channel.satellite)) for channel in self._tracked()
        )
        for report in reports:
            self.accounts.tracked(report)
        correlations = {
            channel.satellite: tuple(channel.recorded)
            for channel in self._tracked()
            if channel.recorded
        }
        self._retire()
        events = tuple(sorted(self._events, key=lambda event: (event.sample, event.satellite)))
        return StepResult(first, end, fixes, reports, events, subframes, correlations)

    def _tracked(self) -> list[Channel]:
        return [self.channels[prn] for prn in sorted(self.channels)]

    def _track(self, feed: SumFeed, end: int, aiding: Mapping[str, AidingSource]) -> None:
        """Run all channels to the end, block by block: its sums are still in the cache."""
        channels = self._tracked()
        for channel in channels:
            channel.begin_epoch()
        shares = [channels[k :: self._workers] for k in range(self._workers)]

        def run(share: list[Channel], sums: RunningSums) -> None:
            for channel in share:
                channel.run(sums, aiding.get(channel.satellite, unaided))

        for sums in feed.advance(end):
            if self._executor is None:
                run(channels, sums)
            else:
                for task in [self._executor.submit(run, share, sums) for share in shares]:
                    task.result()
        for channel in channels:
            self._events.extend(channel.events)
            if channel.mode is not Mode.PULL_IN:
                self.accounts.advance(channel.satellite, "pulled in")
            if channel.edge is not None:
                self.accounts.advance(channel.satellite, "bit sync")

    def _retire(self) -> None:
        for prn, channel in list(self.channels.items()):
            if channel.mode is Mode.LOST:
                del self.channels[prn]
                self._heads.pop(prn, None)
                self._memory.pop(prn, None)
                self._hatch.pop(prn, None)
                self._searcher.lost(prn)
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

    def _search(self, feed: SumFeed, first: int, end: int) -> None:
        """Look for satellites that are not tracked, on the samples that begin this epoch."""
        tracked = frozenset(self.channels)
        place = self._place(first)
        for seen, sight in self._searcher.look(
            feed, first, end, place, self.nav, tracked, self._executor
        ):
            self._take(seen, first, sight)

    def _take(self, seen: Acquisition, first: int, sight: Sight | None) -> None:
        """Give a found satellite a channel."""
        self.accounts.searched(seen)
        if not seen.found:
            return
        detail = (
            f"peak {seen.peak_ratio:.1f} of {seen.threshold:.1f} needed, "
            f"{seen.cn0_dbhz:.1f} dB-Hz at {seen.doppler_hz:+.0f} Hz"
        )
        self._events.append(Event(first, seen.satellite, "acquired", detail))
        channel = Channel(
            self.signal,
            seen.prn,
            self.settings.tracking,
            sample_rate_hz=float(self._rate),
            sample=first,
            code_chips=seen.code_chips,
            doppler_hz=seen.doppler_hz,
        )
        self.channels[seen.prn] = channel
        known = self._frames.get(seen.prn)
        self._frames[seen.prn] = (
            framing.start(channel.satellite) if known is None else framing.resume(known)
        )
        self._memory[seen.prn] = PhaseMemory()
        if sight is not None and self.clock is not None:
            self._anchor_by_prediction(channel, sight, first)

    def _anchor_by_prediction(self, channel: Channel, sight: Sight, first: int) -> None:
        """Transmit time and symbol edges from the predicted travel time (known to ≪ 0.5 ms)."""
        if self.clock is None:
            return
        period_ns = self.signal.period_s * NS
        command = channel.command
        wait_ns = (command.sample - first) / float(self._rate) * NS
        sent_ns = self.clock.origin_ns + round(
            self.clock.gpst_ns(first) + sight.transmit_s * NS + wait_ns
        )
        channel.anchor = round(sent_ns / period_ns)
        channel.set_edge(-channel.anchor, "predicted travel time")

    # --- messages and time ---------------------------------------------------------------------

    def _read_messages(self) -> tuple[tuple[str, lnav.Subframe], ...]:
        subframes: list[tuple[str, lnav.Subframe]] = []
        for prn, channel in sorted(self.channels.items()):
            if channel.mode is not Mode.PHASE or not channel.symbols:
                continue
            found = framing.read_symbols(self._frames[prn], channel, self._date())
            self._frames[prn] = found.state
            subframes.extend((channel.satellite, subframe) for subframe in found.subframes)
            for frame in found.heads:
                self._heads[prn] = _Head(channel, channel.symbols_first, frame)
            fresh = tuple(item for item in found.news if not self._is_copy(channel, item))
            self.nav = framing.take_news(self.nav, fresh)
            for item in fresh:
                if isinstance(item, Ephemeris):
                    self._events.append(
                        Event(
                            channel.command.sample,
                            channel.satellite,
                            "ephemeris",
                            f"IODE {item.iode}, health {item.health}",
                        )
                    )
        self._take_heads()
        for channel in self.channels.values():
            known = self._start.symbols.get(channel.satellite)
            if known is not None and channel.half_cycle is None:
                half_cycle = framing.polarity(channel, known)
                if half_cycle is not None:
                    channel.set_polarity(half_cycle)
        for channel in self.channels.values():
            if channel.anchor is not None:
                satellite = channel.satellite
                self.accounts.advance(satellite, "frame sync")
                if satellite in self.nav.ephemerides:
                    self.accounts.advance(satellite, "ephemeris")
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
        self._heads = {
            prn: head
            for prn, head in self._heads.items()
            if head.channel.symbols_first == head.stretch
        }
        half = SECONDS_PER_WEEK // 2
        origins: dict[int, int] = {}
        anchors: dict[int, int] = {}
        for prn, (channel, _, frame) in self._heads.items():
            offset_s = (frame.start_tow_s - date.tow_s + half) % SECONDS_PER_WEEK - half
            anchors[prn] = framing.anchor_of(channel, frame, date.plus(offset_s).week)
            origins[prn] = self._origin_ns(channel, anchors[prn])
        for prn, origin_ns in origins.items():
            channel, _, frame = self._heads[prn]
            agreeing = sum(abs(origin_ns - other) < 0.03 * NS for other in origins.values()) - 1
            fits = self.clock is not None and abs(origin_ns - self.clock.origin_ns) < 0.05 * NS
            if frame.confirmed or fits or agreeing >= 2:
                self._settle(channel, frame, anchors[prn])
                del self._heads[prn]

    def _origin_ns(self, channel: Channel, anchor: int) -> int:
        """GPST of sample 0, ns since the GPS epoch, by a channel's anchor and a guessed travel."""
        sent_ns = (anchor + channel.periods) * round(self.signal.period_s * NS)
        elapsed_ns = round(channel.command.sample / self._rate * NS)
        return sent_ns + round(_TRAVEL_S * NS) - elapsed_ns

    def _settle(self, channel: Channel, frame: lnav.Frame, anchor: int) -> None:
        if channel.anchor is not None and channel.anchor != anchor:
            detail = f"frame says {anchor - channel.anchor:+d} code periods"
            self._note(channel, "time corrected", detail)
        elif channel.anchor is None:
            self._note(
                channel, "frame sync", f"subframe {frame.subframe_id}, {frame.start_tow_s} s"
            )
        channel.anchor = anchor
        channel.set_polarity(0.5 if frame.polarity else 0.0)
        if self.clock is None:
            origin_ns = self._origin_ns(channel, anchor)
            self.clock = ReceiverClock(self._rate, origin_ns, uncertainty_s=_TIME_GUESS_S)

    def _is_copy(self, channel: Channel, item: Ephemeris | lnav.IonoUtc) -> bool:
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
            rival = self.channels.get(int(satellite[1:]))
            if rival is None or rival.cn0_dbhz >= channel.cn0_dbhz:
                self._drop(channel, f"cross-correlation: sends the orbit of {satellite}")
                return True
            self._drop(rival, f"cross-correlation: sends the orbit of {channel.satellite}")
            kept = tuple(e for e in others if e not in same)
            ephemerides = {**self.nav.ephemerides, satellite: kept}
            self.nav = replace(
                self.nav, ephemerides={name: sets for name, sets in ephemerides.items() if sets}
            )
            return False
        return False

    def _drop(self, channel: Channel, reason: str) -> None:
        channel.drop(reason)
        self._events.append(channel.events[-1])

    # --- observables and position --------------------------------------------------------------

    def _observe(self, first: int, end: int) -> tuple[Fix, ...]:
        """Observations and solutions of the tags in (first, end]."""
        fixes: list[Fix] = []
        for tag_ns in self._tags(first, end):
            fix = self._fix(tag_ns)
            if fix is not None:
                fixes.append(fix)
        return tuple(fixes)

    def _tags(self, first: int, end: int) -> list[int]:
        """GPST tags, ns since the GPS epoch, each once, as far as every channel's estimate goes.

        A channel's last whole interval ends up to a symbol before the epoch does.
        """
        if self.clock is None:
            return []
        lag = int(1.25 * self.signal.symbol_s * self._rate)
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

    def _fix(self, tag_ns: int) -> Fix | None:
        output = tag_ns % self.settings.output_ns == 0 and self._steered
        epoch = self._epoch(tag_ns, output)
        if not epoch.observations:
            return None
        solution = pvt.solve(epoch, self.nav, self.settings.pvt, self.solution)
        if solution.valid and self.clock is not None:
            first = not self._steered
            self.clock = self.clock.steered(
                tag_ns, solution.clock_s, solution.drift_sps, first=first
            )
            if first:  # observe again: the tag has moved by up to some ms
                self._steered = True
                output = tag_ns % self.settings.output_ns == 0
                epoch = self._epoch(tag_ns, output)
                solution = pvt.solve(epoch, self.nav, self.settings.pvt, solution)
        self._last_tag_ns = tag_ns
        self.solution = solution if solution.valid else self.solution
        if solution.valid:
            self._last_place = (solution.r_e_m, solution.v_e_mps)
        self.accounts.solved(solution)
        if not self._steered:
            return None  # tags are still some ms off
        return Fix(epoch, solution, output)

    def _epoch(self, tag_ns: int, output: bool) -> Epoch:
        """Observations at a tag; slips are counted from the last one put out."""
        if self.clock is None:
            raise ValueError("no receiver time")
        instant = self.clock.instant(tag_ns)
        epoch_time = from_ns(tag_ns)
        observations = []
        for prn, channel in sorted(self.channels.items()):
            if channel.mode is Mode.LOST:  # dropped since it ran
                continue
            memory = self._memory[prn]
            seen = observe(channel, self.clock, tag_ns, instant, memory)
            if seen is not None:
                observations.append(self._smoothed(prn, channel, seen.observation, epoch_time))
                self._memory[prn] = (
                    seen.memory if output else memory._replace(ambiguity=seen.memory.ambiguity)
                )
        return Epoch(epoch_time, instant, tuple(observations))

    def _smoothed(
        self, prn: int, channel: Channel, observation: Observation, time: GpsTime
    ) -> Observation:
        if not self.settings.smoothing:
            return observation
        state, smoothed = smooth(
            self._hatch.get(prn, HatchState()), observation, time, channel.slips
        )
        self._hatch[prn] = state
        return smoothed

    # --- accounts ------------------------------------------------------------------------------

    def _note(self, channel: Channel, what: str, reason: str) -> None:
        self._events.append(Event(channel.command.sample, channel.satellite, what, reason))
