"""Windows of frequency tracking as they fill up, and whether the frequency they hold is right."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.frequency_tracking import LockWatch, window_of
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import Accumulated

_DOUBTED_DB = 3.0  # below the threshold of frequency tracking: a window with nothing to follow

Signs = Callable[[int, int], FloatArray | None]
"""Signs of symbols from a code period on, how many; None where they are not all known."""


class Windows:
    """Collects the updates of a channel into windows of whole symbols."""

    def __init__(self, signal: Signal, settings: TrackingSettings) -> None:
        self._signal = signal
        self._updates = int(settings.frequency.window_s / signal.update_s + 1e-9)
        self.seconds = self._updates * signal.update_s
        self._lowest = 10.0 ** (0.1 * (settings.frequency_threshold_dbhz - _DOUBTED_DB))
        self._watch = LockWatch(signal.symbol_s, self.seconds, settings.frequency.bins)
        self._taps: list[ComplexArray] = []
        self.off_hz = 0.0  # by which the frequency is off
        self.coherent_s = signal.symbol_s  # over which the last one was added up
        self.empty = False  # whether the last one had nothing to follow

    def restart(self) -> None:
        """Forget what was collected: the generator was moved."""
        self._taps = []
        self._watch.clear()
        self.off_hz = 0.0
        self.empty = False

    @property
    def under_way(self) -> bool:
        """Whether one is being filled."""
        return bool(self._taps)

    @property
    def suspicious(self) -> bool:
        """Whether the frequency may be off: the signal's power is not to be believed."""
        return self._watch.suspicious

    def add(
        self, taps: ComplexArray, end: int, noise: float, unaided_hz: float, signs: Signs
    ) -> Accumulated | None:
        """Take an update; the window it completes, None where that has no signal to follow.

        Parameters: correlations (n, taps) of whole symbols without a secondary code, n code
        periods up to the period `end`; power of noise in one of them; the generator's frequency
        less its aiding.
        """
        self._taps.append(taps)
        if len(self._taps) < self._updates:
            return None
        taps, self._taps = np.concatenate(self._taps), []
        signal, size = self._signal, self._signal.symbol_periods
        symbols = taps.reshape(-1, size, taps.shape[1])
        sums = symbols.sum(axis=1)
        self.off_hz = self._watch.off_hz(symbols[:, :, 1], unaided_hz)
        power = float(np.vdot(sums[:, 1], sums[:, 1]).real) / sums.shape[0]
        self.empty = (power / size - noise) / size < self._lowest * signal.period_s * noise
        if self.empty:
            return None
        known = signs(end - taps.shape[0], sums.shape[0])
        window = window_of(sums, signal.symbol_s, known, size * noise)
        self.coherent_s = window.seconds if window.coherent else signal.symbol_s
        return window
