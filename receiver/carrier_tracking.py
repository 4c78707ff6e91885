"""A channel's carrier loops: one for every mode, and what each needs and leaves to the rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deepgnss.core.loops import LoopGains
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.carrier_loops import carrier_loop, chirp_lock
from deepgnss.receiver.discriminators import costas_arctan
from deepgnss.receiver.frequency_tracking import (
    always_squares,
    noise_bandwidth_hz,
    spectral_lock,
)
from deepgnss.receiver.locks import FAST_S, PHASE_S
from deepgnss.receiver.modes import Mode, TrackingSettings
from deepgnss.receiver.phase_loops import CostasLoop
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.sync import decided_signs
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    FrequencyLock,
    Tracker,
)

_LOCKED_S = 0.2  # of a phase loop before it is believed …
_INDICATED, _NOTICED = 8, 2  # updates
_LONG_S = 0.1  # … but of one with longer updates a single one
_BEFORE_LOCK = (Mode.PULL_IN, Mode.FREQUENCY)


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
        self._pull_in: Tracker = FrequencyLock(settings.pull_in_bandwidth_hz, squared=coded)
        self._frequency: Mapping[bool, Tracker] = {True: seeing, False: blind if coded else seeing}
        self._loop = carrier_loop(settings.carrier)
        self._periods = _interval_periods(signal, self._loop.interval_s)
        self._chirps = chirp_lock(settings.carrier, blind if coded else seeing)
        if self._chirps is not None:
            self._pull_in, self._frequency = self._chirps, {True: self._chirps, False: self._chirps}
        self.settled = self._loop.settled
        self._memory: Any = self._loop.start()

    @property
    def longest(self) -> int:
        """Code periods of the longest interval there will be."""
        return max(self._signal.update_periods, self._periods)

    @property
    def remembered_s(self) -> float | None:
        """How far back frequency and rate reach at phase lock; None: no matter."""
        return None if self._chirps is None else 2.0 * self._chirps.interval_s

    @property
    def lock_s(self) -> float:
        """Time after which a phase lock is believed."""
        interval_s = self.settled.interval_s
        return _LOCKED_S if interval_s < _LONG_S else min(_LOCKED_S, 0.9 * interval_s)

    @property
    def indicator_s(self) -> float:
        """Averaging of the phase's indicator: of symbols too weak for their phase, some updates."""
        return max(PHASE_S, _INDICATED * self.settled.interval_s)

    @property
    def fast_s(self) -> float:
        """Averaging of what notices a blockage: whoever decides seldom need not see it sooner."""
        return max(FAST_S, _NOTICED * self.settled.interval_s)

    def periods(self, mode: Mode) -> int:
        """Code periods of an undivided interval; frequency is seen best over whole symbols."""
        if self._chirps is not None and mode in _BEFORE_LOCK:
            return _interval_periods(self._signal, self._chirps.interval_s)
        return self._periods if mode is Mode.PHASE else self._signal.update_periods

    def fixed_gains(self, seconds: float) -> LoopGains | None:
        """Gains of a phase loop that knows no more than the phase of the sum over an interval."""
        loop = self._loop
        if not isinstance(loop, CostasLoop) or loop.discriminator is not costas_arctan:
            return None
        return loop.gains(seconds)

    def has_own_rate(self, mode: Mode) -> bool:
        """Whether the loop follows a steady change of frequency by itself."""
        return (
            (mode is Mode.PHASE and self.settled.order >= 3)
            or (mode is Mode.WEAK and self._settings.frequency.order == 2)
            or self.finds_rate(mode)
        )

    def finds_rate(self, mode: Mode) -> bool:
        """Whether the frequency loop of a mode tells the rate as well, from nothing."""
        return self._chirps is not None and mode in _BEFORE_LOCK

    def correct(self, mode: Mode, seen: Accumulated, *, edge_known: bool) -> Correction:
        """Correction at the middle of an interval."""
        if mode is Mode.PHASE:
            self._memory, correction = self._loop.step(self._memory, seen)
            return correction
        if mode is Mode.PULL_IN:
            return self._pull_in.correct(seen)
        return self._frequency[edge_known].correct(seen)

    def signs(self, mode: Mode, sums: ComplexArray) -> FloatArray:
        """Signs of the symbols of an interval, up to a common one."""
        if mode is Mode.PHASE:
            return self._loop.signs(self._memory, sums, self._signal.symbol_s)
        return decided_signs(sums)

    def foreseen(self, mode: Mode, seconds: float) -> Correction:
        """Change of the generator at the end of an interval that the loop foresees."""
        if mode is Mode.PHASE:
            return self._loop.foreseen(self._memory, seconds)
        return NO_CORRECTION

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
