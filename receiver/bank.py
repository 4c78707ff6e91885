"""A bank: the channels of one signal on one stream, with their search, messages and memories.

A receiver is several banks that share time, place and navigation data. A bank counts samples of
its own stream; its clock is the receiver's, seen at that rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from fractions import Fraction
from typing import NamedTuple

from deepgnss.core.records import (
    ChannelReport,
    Correlations,
    Event,
    NavData,
    Observation,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver import framing, messages
from deepgnss.receiver.accounts import Accounts
from deepgnss.receiver.acquisition import Acquisition, AcquisitionSettings
from deepgnss.receiver.carrier_tracking import CarrierTracking
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.clock import NS, ReceiverClock
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.known_symbols import KnownSymbols, Sent, foretold, remembered, signs
from deepgnss.receiver.messages import Frame, Subframe
from deepgnss.receiver.modes import Mode, TrackingSettings
from deepgnss.receiver.observables import PhaseMemory, observe, tag_of
from deepgnss.receiver.search import (
    Assistance,
    Place,
    Searcher,
    SearchSettings,
    Sight,
    predict_sights,
)
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.smoothing import HatchState, smooth

_FITS = 0.05  # code periods, 15 km: a channel on another signal fits one time in ten
_FORETOLD_S = 0.7  # that must be known ahead: a window and more
_FORETOLD_SYMBOLS = 32  # that settle a half cycle: more than a word, whose sign may be another


class Head(NamedTuple):
    """A frame head not yet believed."""

    channel: Channel
    stretch: int  # the channel's `symbols_first` it counts from
    frame: Frame


class News(NamedTuple):
    """What a channel's symbols told since the last epoch."""

    channel: Channel
    subframes: tuple[Subframe, ...]
    items: tuple[messages.News, ...]


class Tagged(NamedTuple):
    """Observations of a tag: of signals received, and of those in open loop."""

    received: list[Observation]
    coasting: list[Observation]


class Bank:
    """Channels of one signal on one stream."""

    def __init__(
        self,
        signal: Signal,
        sample_rate_hz: float,
        tracking: TrackingSettings,
        acquisition: AcquisitionSettings,
        searching: SearchSettings,
        known: Mapping[str, KnownSymbols],
    ) -> None:
        """`known`: symbols of satellites that an earlier pass has decoded."""
        self.signal = signal
        self.rate_hz = Fraction(sample_rate_hz)
        self.longest_s = CarrierTracking(signal, tracking).longest * signal.period_s
        self.channels: dict[int, Channel] = {}  # in the order of PRNs
        self.heads: dict[int, Head] = {}
        self._tracking = tracking
        self._known = known
        self._frames: dict[int, framing.FrameState] = {}
        self._sent: dict[int, Sent] = {}
        self._memory: dict[int, PhaseMemory] = {}
        self._hatch: dict[int, HatchState] = {}
        self._slips: dict[int, int] = {}  # of satellites that were tracked before
        self._searcher = Searcher(signal, acquisition, searching, sample_rate_hz)

    def tracked(self) -> list[Channel]:
        """Channels in the order of PRNs."""
        return list(self.channels.values())

    # --- search ------------------------------------------------------------------------------

    def search(
        self,
        feed: SumFeed,
        window: tuple[int, int],
        known: Assistance,
        clock: ReceiverClock | None,
        accounts: Accounts,
        elsewhere: int,
        executor: Executor | None,
    ) -> list[Event]:
        """Look for satellites that are not tracked, on the samples that begin an epoch.

        `elsewhere`: satellites that other banks track.
        """
        first, end = window
        events = []
        tracked = frozenset(self.channels)

        def strong() -> list[Acquisition]:
            return [self._as_seen(channel, prn, first) for prn, channel in self.channels.items()]

        outcomes = self._searcher.look(
            feed, first, end, known, tracked, elsewhere, executor, strong
        )
        for seen, sight in outcomes:
            accounts.searched(seen)
            if seen.found:
                events += self._take(seen, first, sight, clock)
        return events

    def _as_seen(self, channel: Channel, prn: int, sample: int) -> Acquisition:
        """A tracked satellite as a search of one code period would see it at a sample."""
        command = channel.command
        chips = (
            command.code_chips + float((sample - command.sample) / self.rate_hz) * command.code_hz
        )
        return Acquisition(
            satellite=channel.satellite,
            prn=prn,
            first=sample,
            doppler_hz=command.carrier_hz,
            code_chips=chips % self.signal.id.code_chips,
            peak_ratio=10.0 ** (0.1 * channel.cn0_dbhz) * self.signal.period_s,
            threshold=0.0,
            cn0_dbhz=channel.cn0_dbhz,
            found=True,
        )

    def _take(
        self, seen: Acquisition, first: int, sight: Sight | None, clock: ReceiverClock | None
    ) -> list[Event]:
        """Give a found satellite a channel."""
        channel = Channel(
            self.signal,
            seen.prn,
            self._tracking,
            sample_rate_hz=float(self.rate_hz),
            sample=first,
            code_chips=seen.code_chips,
            doppler_hz=seen.doppler_hz,
            slips=self._slips.get(seen.prn, 0),
        )
        channel.known = self._known.get(channel.satellite)
        self.channels = dict(sorted({**self.channels, seen.prn: channel}.items()))
        frames = self._frames.get(seen.prn)
        self._frames[seen.prn] = (
            framing.start(channel.satellite) if frames is None else framing.resume(frames)
        )
        self._memory[seen.prn] = PhaseMemory()
        if sight is not None and clock is not None:
            self._anchor_by_prediction(channel, sight, first, clock)
            if seen.cn0_dbhz < self._tracking.phase_threshold_dbhz:
                channel.begin_weak(seen.cn0_dbhz)
        detail = (
            f"peak {seen.peak_ratio:.1f} of {seen.threshold:.1f} needed, "
            f"{seen.cn0_dbhz:.1f} dB-Hz at {seen.doppler_hz:+.0f} Hz"
        )
        told, channel.events = channel.events, []
        return [Event(first, seen.satellite, "acquired", detail), *told]

    def _anchor_by_prediction(
        self, channel: Channel, sight: Sight, first: int, clock: ReceiverClock
    ) -> None:
        """Transmit time and symbol edges from the predicted travel time (known to ≪ 0.5 ms)."""
        channel.anchor, _ = self._predicted_anchor(channel, sight, first, clock)
        channel.set_edge(-channel.anchor, "predicted travel time")

    def _predicted_anchor(
        self, channel: Channel, sight: Sight, first: int, clock: ReceiverClock
    ) -> tuple[int, float]:
        """A channel's anchor by a prediction at a sample, and the code periods it misses by."""
        command, period_ns = channel.command, self.signal.period_s * NS
        wait_s = float((command.sample - first) / self.rate_hz)
        into_s = command.code_chips / self.signal.id.chip_rate_hz
        ahead_ns = round(clock.gpst_ns(first) + (sight.transmit_s + wait_s - into_s) * NS)
        sent_ns = clock.origin_ns + ahead_ns
        begun = round(sent_ns / period_ns)
        return begun - channel.periods, (sent_ns - begun * round(period_ns)) / period_ns

    def anchor_faint(
        self, place: Place, nav: NavData, clock: ReceiverClock, first: int
    ) -> list[Event]:
        """Give channels too weak to be read their transmit time, where code and symbols fit it."""
        told = []
        for channel in self.tracked():
            if channel.mode is not Mode.WEAK or channel.anchor is not None or channel.edge is None:
                continue
            for sight in predict_sights(place, nav, self.signal, [channel.satellite]):
                anchor, off = self._predicted_anchor(channel, sight, first, clock)
                if abs(off) < _FITS and (anchor + channel.edge) % self.signal.symbol_periods == 0:
                    channel.anchor = anchor
                    detail = "predicted travel time"
                    told.append(Event(first, channel.satellite, "frame sync", detail))
        return told

    def retire(self) -> list[Channel]:
        """Take lost channels out and return them."""
        gone = [channel for channel in self.tracked() if channel.mode is Mode.LOST]
        for prn in [prn for prn, channel in self.channels.items() if channel.mode is Mode.LOST]:
            self._slips[prn] = self.channels.pop(prn).slips + 1
            self.heads.pop(prn, None)
            self._memory.pop(prn, None)
            self._hatch.pop(prn, None)
            self._searcher.lost(prn)
        return gone

    # --- messages ----------------------------------------------------------------------------

    def read_messages(self, date: GpsTime | None) -> list[News]:
        """What the channels in phase lock have decoded; new frame heads join `heads`."""
        news = []
        for prn, channel in self.channels.items():
            if channel.mode is not Mode.PHASE or not framing.due(self._frames[prn], channel):
                continue
            found = framing.read_symbols(self._frames[prn], channel, date)
            self._frames[prn] = found.state
            for subframe in found.subframes:
                before = self._sent.get(prn, {})
                self._sent[prn] = remembered(before, subframe, self.signal.message)
            for frame in found.heads:
                self.heads[prn] = Head(channel, channel.symbols_first, frame)
            if found.subframes or found.news:
                news.append(News(channel, found.subframes, found.news))
        return news

    def present_heads(self) -> dict[int, Head]:
        """Frame heads of stretches of symbols that are still going on."""
        self.heads = {
            prn: head
            for prn, head in self.heads.items()
            if head.channel.symbols_first == head.stretch
        }
        return self.heads

    def take_known_polarities(self) -> None:
        """Settle half cycles by symbols that an earlier pass has decoded, or that were foretold.

        What was foretold may have been replaced by the satellite: the next head of a subframe has
        the last word.
        """
        for channel in self.channels.values():
            if channel.half_cycle is not None and not channel.unproven:
                continue
            decoded = self._known.get(channel.satellite)
            half_cycle = framing.polarity(channel, decoded) if decoded is not None else None
            if half_cycle is not None:
                channel.set_polarity(half_cycle)
            elif channel.known is not None and channel.mode is Mode.PHASE:
                half_cycle = framing.polarity(channel, channel.known, _FORETOLD_SYMBOLS)
                if half_cycle is not None and half_cycle != channel.half_cycle:
                    channel.set_polarity(half_cycle)
                    channel.unproven = True

    def foretell_symbols(self) -> None:
        """Tell channels which symbols come, as far as known: those without a phase, or a polarity.

        A polarity needs the symbols since the subframe's beginning.
        """
        for prn, channel in self.channels.items():
            if channel.anchor is None or not self._needs_symbols(channel):
                continue
            now = channel.anchor + channel.periods
            ahead = round(_FORETOLD_S / self.signal.period_s)
            known = channel.known
            if (
                known is not None
                and signs(
                    known, now, ahead // self.signal.symbol_periods, self.signal.symbol_periods
                )
                is not None
            ):
                continue
            told = foretold(
                self._sent.get(prn, {}),
                self.signal.message,
                now,
                round(1.0 / self.signal.period_s),
                self.signal.symbol_periods,
            )
            channel.known = told or known

    @staticmethod
    def _needs_symbols(channel: Channel) -> bool:
        if channel.mode is Mode.PHASE:
            return channel.half_cycle is None or channel.unproven
        return channel.mode in (Mode.WEAK, Mode.HOLD)

    # --- observables ---------------------------------------------------------------------------

    def observe(
        self, clock: ReceiverClock, tag_ns: int, time: GpsTime, *, output: bool, smoothing: bool
    ) -> Tagged:
        """Observations at a tag; slips are counted from the last one put out."""
        tag = tag_of(clock.at_rate(self.rate_hz), tag_ns)
        tagged = Tagged([], [])
        for prn, channel in self.channels.items():
            if channel.mode is Mode.LOST:  # dropped since it ran
                continue
            memory = self._memory[prn]
            seen = observe(channel, tag, memory)
            if seen is None:
                continue
            told = output and not seen.coasting
            self._memory[prn] = (
                seen.memory if told else PhaseMemory(seen.memory.ambiguity, memory.slips)
            )
            observation = seen.observation
            if seen.coasting:
                tagged.coasting.append(observation)
                continue
            if smoothing:
                state = self._hatch.get(prn, HatchState())
                self._hatch[prn], observation = smooth(
                    state, observation, time, aided=channel.aided
                )
            tagged.received.append(observation)
        return tagged

    # --- accounts ------------------------------------------------------------------------------

    def events(self) -> list[Event]:
        """What the channels noted in the epoch just run."""
        return [event for channel in self.tracked() for event in channel.events]

    def reports(self, accounts: Accounts) -> list[ChannelReport]:
        """State of every channel."""
        return [channel.report(accounts.stage(channel.satellite)) for channel in self.tracked()]

    def correlations(self) -> dict[str, tuple[Correlations, ...]]:
        """Recorded correlations by satellite."""
        return {
            channel.satellite: tuple(channel.recorded)
            for channel in self.tracked()
            if channel.recorded
        }
