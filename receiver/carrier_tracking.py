"""A channel's carrier loops: one for every mode, and what each needs and leaves to the rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deepgnss.receiver.carrier_loops import carrier_loop
from deepgnss.receiver.frequency_tracking import (
    always_squares,
    noise_bandwidth_hz,
    spectral_lock,
)
from deepgnss.receiver.modes import Mode, TrackingSettings
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import Accumulated, Correction, FrequencyLock, Tracker


def _interval_periods(signal: Signal, interval_s: float) -> int:
    """Periods of an interval of a phase loop: a part of a symbol, or whole ones."""
    symbol = signal.symbol_periods
    periods = round(interval_s / signal.period_s)
    return periods if periods < symbol else periods // symbol * symbol


class CarrierTracking:
    """The loop at work and its memory."""

    def __init__(self, signal: Signal, settings: TrackingSettings) -> None:
        self.windowed = spectral_lock(settings.frequency)  # on windows, without phase lock
        self.always_squares = always_squares(settings.frequency.discriminator)
        self._signal = signal
        self._settings = settings
        coded = bool(signal.secondary_code)
        blind = FrequencyLock(settings.frequency_bandwidth_hz, squared=True)
        seeing = FrequencyLock(settings.frequency_bandwidth_hz, signal.symbol_periods // 4)
        self._pull_in = FrequencyLock(settings.pull_in_bandwidth_hz, squared=coded)
        self._frequency: Mapping[bool, Tracker] = {True: seeing, False: blind if coded else seeing}
        self._loop = carrier_loop(settings.carrier)
        self._periods = _interval_periods(signal, self._loop.interval_s)
        self.settled = self._loop.settled
        self._memory: Any = self._loop.start()

    @property
    def longest(self) -> int:
        """Code periods of the longest interval there will be."""
        return max(self._signal.update_periods, self._periods)

    def periods(self, mode: Mode) -> int:
        """Code periods of an undivided interval; frequency is seen best over whole symbols."""
        return self._periods if mode is Mode.PHASE else self._signal.update_periods

    def has_own_rate(self, mode: Mode) -> bool:
        """Whether the loop follows a steady change of frequency by itself."""
        return (mode is Mode.PHASE and self.settled.order >= 3) or (
            mode is Mode.WEAK and self._settings.frequency.order == 2
        )

    def correct(self, mode: Mode, seen: Accumulated, *, edge_known: bool) -> Correction:
        """Correction at the middle of an interval."""
        if mode is Mode.PHASE:
            self._memory, correction = self._loop.step(self._memory, seen)
            return correction
        if mode is Mode.PULL_IN:
            return self._pull_in.correct(seen)
        return self._frequency[edge_known].correct(seen)

    def restart(self) -> None:
        """A phase lock begins."""
        self._memory = self._loop.start()

    def turn(self, cycles: float) -> None:
        """The generator was put forward by a phase."""
        self._memory = self._loop.turned(self._memory, cycles)

    def bandwidth_hz(self, mode: Mode) -> float:
        """One-sided noise bandwidth of the loop at work."""
        if mode is Mode.PHASE:
            return self._loop.bandwidth_hz(self._memory)
        if mode is Mode.WEAK:
            return noise_bandwidth_hz(self._settings.frequency)
        return self._settings.frequency_bandwidth_hz
