"""A channel's code loop: the schedule of its bandwidths, and when its ranges count, T 5.5.2."""

from __future__ import annotations

import math

from deepgnss.core.loops import settling_time_s
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.trackers import DelayLock, scheduled_bandwidth_hz

_SETTLING_WINDOWS = 3  # after which a loop on windows is believed
_LOOP_PRODUCT = 0.4  # bandwidth × window: a wider loop does not settle


class CodeLoop:
    """A delay lock that begins wide and becomes narrow."""

    def __init__(
        self,
        settings: TrackingSettings,
        sample_chips: float,
        neighbour: float,
        rate_hz: float,
        window_s: float,
    ) -> None:
        """neighbour: the code's correlation a chip off; window_s: of frequency tracking."""
        self._settings = settings
        self._sample_chips = sample_chips
        self._neighbour = neighbour
        self._rate = rate_hz
        self._window_s = window_s
        self._schedule = settings.code_bandwidths_hz
        self.restart(0, 0.0)

    def restart(self, sample: int, settled_s: float) -> None:
        """Begin the bandwidth schedule anew; ranges count once the loop has settled."""
        self._since = sample
        self._settled_s = settled_s
        self.tracker = self._delay_lock(self._schedule[0])

    def widen(self, sample: int) -> None:
        """Begin the schedule anew in the midst of tracking: the code is known to be far off.

        Ranges count as they did.
        """
        self._settled_s -= self._seconds_to(sample)
        self._since = sample
        self.tracker = self._delay_lock(self._schedule[0])

    def settle(self) -> None:
        """Be at the schedule's end: the code is known as well as by a loop that came so far."""
        self._settled_s = -math.inf
        self.tracker = self._delay_lock(self._schedule[-1])

    def settling_s(self, *, windows: bool) -> float:
        """Time the loop takes that starts some way off, on intervals or on windows."""
        if windows:
            return _SETTLING_WINDOWS * self._window_s
        return settling_time_s(self._schedule[0])

    def settled(self, sample: int) -> bool:
        """Whether ranges count at a sample."""
        return self._seconds_to(sample) > self._settled_s

    @property
    def narrowest(self) -> bool:
        """Whether the schedule is over."""
        return self.tracker.bandwidth_hz == self._schedule[-1]

    def narrow(self, sample: int) -> bool:
        """Follow the bandwidth schedule; True when the loop just became narrower."""
        if self.narrowest:
            return False
        due = scheduled_bandwidth_hz(self._schedule, self._seconds_to(sample))
        if due == self.tracker.bandwidth_hz:
            return False
        self.tracker = self._delay_lock(due)
        return True

    def over(self, seconds: float) -> DelayLock:
        """The loop on intervals of that length: one too wide for them does not settle."""
        widest_hz = _LOOP_PRODUCT / seconds
        return (
            self.tracker if self.tracker.bandwidth_hz <= widest_hz else self._delay_lock(widest_hz)
        )

    @property
    def on_windows(self) -> DelayLock:
        """The loop on windows of frequency tracking."""
        return self.over(self._window_s)

    def _delay_lock(self, bandwidth_hz: float) -> DelayLock:
        settings = self._settings
        return DelayLock(
            settings.code_order,
            bandwidth_hz,
            settings.spacing_chips,
            self._sample_chips,
            self._neighbour,
        )

    def _seconds_to(self, sample: int) -> float:
        return (sample - self._since) / self._rate
