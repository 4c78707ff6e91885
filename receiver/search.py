"""Which satellites to search, when, and where: bounded in cost for the whole run.

Weak ones take longer sums than an epoch holds: those searches go back over samples that went by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, FloatArray, NavData, RunningSums
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    changes_often,
    cold_search,
    search,
    search_windows,
)
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.weak_search import Aim, WeakSettings, needed_samples, weak_search

_HIDDEN_RAD = math.radians(-10.0)  # so far below a satellite does not rise within minutes
_BLIND_CHANGING = 3.0  # times the sums and the pause where signs change from period to period


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How often satellites that are not tracked are looked for."""

    predicted_every_s: float = 1.0  # risen or lost ones, in a narrow window
    patience_s: float = 8.0  # the longest pause between searches for one that stays away
    blind_every_s: float = 10.0  # one of those nothing is known of
    blind_unplaced_s: float = 2.0  # the same while the receiver does not know where it is
    below_mask_rad: float = float(np.radians(3.0))  # predicted ones are sought above this
    code_half_m: float = 3000.0  # half width of a predicted window
    doppler_half_hz: float = 120.0
    moved_m: float = 10_000.0  # more of both where only a place of another time is known
    speed_mps: float = 300.0
    weak: WeakSettings | None = field(default_factory=WeakSettings)
    weak_every_s: float = 5.0  # one predicted satellite that a usual search did not find
    weak_blind_sums: int = 8  # coherent sums to look blindly for weak ones with …
    few: int = 4  # … while fewer satellites than these are tracked


class Sight(NamedTuple):
    """What is predicted of one satellite at a sample."""

    satellite: str
    elevation_rad: float
    doppler_hz: float  # on the recording's own frequency scale
    transmit_s: float  # satellite clock reading, s after the given time
    healthy: bool


class Place(NamedTuple):
    """Where and when the receiver is believed to be."""

    time: GpsTime
    r_e_m: FloatArray
    v_e_mps: FloatArray
    drift_sps: float  # of the sample counter
    moving: bool = False  # it may be on the move, so that position and velocity are rough


class Assistance(NamedTuple):
    """What searches can go by."""

    nav: NavData
    place: Place | None = None  # known well enough to predict signals
    rough: Place | None = None  # its time good to minutes: tells who is in sight


def predict_sights(
    place: Place, nav: NavData, signal: Signal, satellites: Sequence[str] | None = None
) -> list[Sight]:
    """Satellites (default: all) that send a signal, with a usable ephemeris, from a place."""
    chosen: list[Ephemeris] = []
    for satellite in sorted(nav.ephemerides) if satellites is None else satellites:
        if satellite[0] == signal.id.system and int(satellite[1:]) in signal.prns:
            ephemeris = orbits.select(nav, satellite, place.time)
            if ephemeris is not None:
                chosen.append(ephemeris)
    if not chosen:
        return []
    v_e_mps = np.nan_to_num(place.v_e_mps)  # a position may lack its velocity
    seen = orbits.predict(chosen, place.time, place.r_e_m, v_e_mps)
    received_hz = -seen.pseudorange_rate_mps / SPEED_OF_LIGHT_MPS * signal.id.carrier_hz
    doppler_hz = (received_hz - place.drift_sps * signal.id.carrier_hz) / (1.0 + place.drift_sps)
    return [
        Sight(
            ephemeris.satellite,
            float(seen.elevation_rad[k]),
            float(doppler_hz[k]),
            -float(seen.pseudorange_m[k]) / SPEED_OF_LIGHT_MPS,
            ephemeris.health == 0,
        )
        for k, ephemeris in enumerate(chosen)
    ]


def hidden_prns(known: Assistance, signal: Signal) -> frozenset[int]:
    """Satellites far below the horizon where and when a receiver is said to be."""
    if known.rough is None:
        return frozenset()
    sights = predict_sights(known.rough, known.nav, signal)
    return frozenset(int(s.satellite[1:]) for s in sights if s.elevation_rad < _HIDDEN_RAD)


def window_of(sight: Sight, place: Place, signal: Signal, settings: SearchSettings) -> SearchWindow:
    """Window of code phase and Doppler around a prediction, wider for a rough place."""
    sent_s = place.time.tow_s % 1.0 + sight.transmit_s
    chips = (sent_s / signal.period_s % 1.0) * signal.id.code_chips
    half_s, half_hz = settings.code_half_m / SPEED_OF_LIGHT_MPS, settings.doppler_half_hz
    if place.moving:
        half_s += settings.moved_m / SPEED_OF_LIGHT_MPS
        half_hz += settings.speed_mps / SPEED_OF_LIGHT_MPS * signal.id.carrier_hz
    return SearchWindow(sight.doppler_hz, half_hz, chips, half_s * signal.id.chip_rate_hz)


def aim_of(sight: Sight, place: Place, signal: Signal, settings: SearchSettings) -> Aim:
    """The window, and the code period in it: time is known far better than to a period."""
    window = window_of(sight, place, signal, settings)
    sent_s = place.time.tow_s % 1.0 + sight.transmit_s
    return Aim(window, math.floor(sent_s / signal.period_s) % signal.symbol_periods)


class Outcome(NamedTuple):
    """A search done, and the prediction it went by."""

    seen: Acquisition
    sight: Sight | None


class Searcher:
    """Decides at each epoch whom to look for; the cost per second of signal is bounded.

    The first epoch searches all satellites: those predicted, once time and place are known, and
    not those far below the horizon where these are known roughly. Later on predicted ones that
    stay away are tried ever less often, and of those nothing is known of, one after the other.
    """

    def __init__(
        self,
        signal: Signal,
        acquisition: AcquisitionSettings,
        settings: SearchSettings,
        sample_rate_hz: float,
    ) -> None:
        self._signal = signal
        self._acquisition = acquisition
        self._settings = settings
        self._rate = sample_rate_hz
        self._began = False
        self._next_predicted = 0
        self._next_blind = 0
        self._due: dict[int, int] = {}  # PRN → sample of its next predicted search
        self._pause_s: dict[int, float] = {}
        self._tried: dict[int, int] = {}
        self._predicted: frozenset[int] = frozenset()
        self._risen: frozenset[int] = frozenset()  # of those predicted: healthy, above the mask
        self._start: int | None = None  # the first sample there is to look back on
        self._next_weak = 0
        self._tried_long: dict[int, int] = {}

    @property
    def length_s(self) -> float:
        """Samples a search needs, s."""
        acquisition = self._acquisition
        return acquisition.coherent_s * acquisition.noncoherent + 2.0 * self._signal.period_s

    def lost(self, prn: int) -> None:
        """A satellite's channel ended: look for it soon again."""
        self._due.pop(prn, None)
        self._pause_s.pop(prn, None)

    def look(
        self,
        feed: SumFeed,
        first: int,
        end: int,
        known: Assistance,
        tracked: frozenset[int],
        elsewhere: int,
        executor: Executor | None,
        strong: Callable[[], Sequence[Acquisition]] = tuple,
    ) -> list[Outcome]:
        """Search on the samples from `first` on, at most to `end`, or on those before `first`.

        `elsewhere`: satellites tracked on other signals. `strong`: what the tracked ones are at
        `first`, for what they leave in others' codes.
        """
        outcomes: list[Outcome] = []
        nav, place = known.nav, known.place
        if self._start is None:
            self._start = first
        count = round(self.length_s * self._rate)
        if first + count > end:  # the recording ends
            return outcomes

        @cache
        def sums() -> RunningSums:
            return feed.over(first, count)

        if place is not None and first >= self._next_predicted:
            self._next_predicted = first + round(self._settings.predicted_every_s * self._rate)
            sights = predict_sights(place, nav, self._signal)
            self._predicted = frozenset(int(sight.satellite[1:]) for sight in sights)
            self._risen = frozenset(
                int(sight.satellite[1:])
                for sight in sights
                if sight.elevation_rad >= self._settings.below_mask_rad and sight.healthy
            )
            wanted = [sight for sight in sights if self._wanted(sight, first, tracked)]
            if wanted:
                outcomes += self._in_windows(sums(), first, place, wanted, executor)
        if not self._began or first >= self._next_blind:
            outcomes += self._blind(feed, sums, first, known, tracked, elsewhere, executor)
        taken = tracked | {outcome.seen.prn for outcome in outcomes if outcome.seen.found}
        if place is not None:
            return outcomes + self._look_back(feed, first, place, nav, taken, strong, executor)
        return outcomes

    def _blind(
        self,
        feed: SumFeed,
        sums: Callable[[], RunningSums],
        first: int,
        known: Assistance,
        tracked: frozenset[int],
        elsewhere: int,
        executor: Executor | None,
    ) -> list[Outcome]:
        """Search those nothing is known of: all at first, one of them from time to time then."""
        settings, outcomes = self._settings, []
        unknown = [p for p in self._signal.prns if p not in tracked and p not in self._predicted]
        if not self._began:
            if known.place is None or not self._predicted:
                hidden = hidden_prns(known, self._signal)
                found = self._cold_search(sums(), first, unknown, hidden, elsewhere, executor)
                outcomes = [Outcome(seen, None) for seen in found]
        elif unknown:
            prn = min(unknown, key=lambda p: (self._tried.get(p, -1), p))
            self._tried[prn] = first
            few = len(tracked) + elsewhere < settings.few
            outcomes = [self._blind_search(feed, first, prn, few, executor)]
        pause_s = settings.blind_unplaced_s if known.place is None else settings.blind_every_s
        if changes_often(self._signal):  # such a search costs several times as much
            pause_s *= _BLIND_CHANGING
        self._next_blind = first + round(pause_s * self._rate)
        self._began = True
        return outcomes

    def _cold_search(
        self,
        sums: RunningSums,
        first: int,
        prns: Sequence[int],
        hidden: frozenset[int],
        elsewhere: int,
        executor: Executor | None,
    ) -> list[Acquisition]:
        """Search satellites; hidden ones only where few others are found, since time may be wrong.

        All are searched anew then, since strong ones may leave something in any other's code.
        """

        def found(chosen: Sequence[int]) -> list[Acquisition]:
            return cold_search(sums, first, self._signal, self._acquisition, chosen, executor)

        if hidden and (shown := [prn for prn in prns if prn not in hidden]):
            seen = found(shown)
            if elsewhere + sum(one.found for one in seen) >= self._settings.few:
                return seen
        return found(prns)

    def _look_back(
        self,
        feed: SumFeed,
        first: int,
        place: Place,
        nav: NavData,
        taken: frozenset[int],
        strong: Callable[[], Sequence[Acquisition]],
        executor: Executor | None,
    ) -> list[Outcome]:
        """The long search of one predicted satellite that a usual search has missed."""
        weak = self._settings.weak
        if weak is None or self._start is None or first < self._next_weak:
            return []
        if first - needed_samples(self._signal, weak, self._rate) < self._start:
            return []
        missed = (self._risen & self._pause_s.keys()) - taken
        if not missed:
            return []
        prn = min(missed, key=lambda p: (self._tried_long.get(p, -1), p))
        satellite = self._signal.satellite(prn)
        sights = predict_sights(place, nav, self._signal, (satellite,))
        if not sights:  # its ephemeris has aged since
            return []
        (sight,) = sights
        self._next_weak = first + round(self._settings.weak_every_s * self._rate)
        self._tried_long[prn] = first
        aim = aim_of(sight, place, self._signal, self._settings)
        seen = weak_search(
            feed.over, first, self._signal, prn, aim, weak, self._rate, strong(), executor
        )
        return [Outcome(seen, sight)]

    def _blind_search(
        self, feed: SumFeed, first: int, prn: int, few: bool, executor: Executor | None
    ) -> Outcome:
        """Search a satellite of which nothing is known: with longer sums while there are few."""
        signal, long = self._signal, self._blind_settings(few)
        length_s = long.coherent_s * long.noncoherent + 2.0 * signal.period_s
        count = round(length_s * self._rate)
        if self._start is None or first - count < self._start:
            long, count = self._acquisition, round(self.length_s * self._rate)
            seen = search(feed.over(first, count), first, signal, prn, long, executor=executor)
            return Outcome(seen, None)
        begin = first - count
        seen = search(feed.over(begin, count), begin, signal, prn, long, executor=executor)
        stretch = 1.0 + seen.doppler_hz / signal.id.carrier_hz
        chips = seen.code_chips + count / self._rate * signal.id.chip_rate_hz * stretch
        return Outcome(replace(seen, first=first, code_chips=chips % signal.id.code_chips), None)

    def _blind_settings(self, few: bool) -> AcquisitionSettings:
        settings, usual = self._settings, self._acquisition
        if settings.weak is None or not few:
            return usual
        more = _BLIND_CHANGING if changes_often(self._signal) else 1.0
        sums = round(more * settings.weak_blind_sums)
        return replace(usual, noncoherent=max(usual.noncoherent, sums))

    def _wanted(self, sight: Sight, first: int, tracked: frozenset[int]) -> bool:
        prn = int(sight.satellite[1:])
        return (
            prn not in tracked
            and sight.elevation_rad >= self._settings.below_mask_rad
            and first >= self._due.get(prn, first)
        )

    def _in_windows(
        self,
        sums: RunningSums,
        first: int,
        place: Place,
        sights: Sequence[Sight],
        executor: Executor | None,
    ) -> list[Outcome]:
        windows = {}
        for sight in sights:
            prn = int(sight.satellite[1:])
            pause_s = self._pause_s.get(prn, self._settings.predicted_every_s)
            self._due[prn] = first + round(pause_s * self._rate)
            self._pause_s[prn] = min(2.0 * pause_s, self._settings.patience_s)
            windows[prn] = window_of(sight, place, self._signal, self._settings)
        found = search_windows(sums, first, self._signal, windows, self._acquisition, executor)
        return [Outcome(seen, sight) for seen, sight in zip(found, sights, strict=True)]
