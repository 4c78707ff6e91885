"""Symbols of a channel: code periods put together, decided, and freed of what lies over them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.hearing import LookBack
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import Accumulated, accumulate


class SymbolStream:
    """Hard decisions of a phase lock, and symbols made whole for the lock detectors.

    `end`: the code period of the channel's count that an interval ends before; `edge`: one at which
    a symbol begins.
    """

    def __init__(self, signal: Signal, longest: int) -> None:
        """longest: code periods of an interval."""
        self.decided = bytearray()  # since the last phase lock, 1: negative
        self.first = 0  # code period at which the first one starts
        self._size = signal.symbol_periods
        self._coded = bool(signal.secondary_code)
        symbols = 1 + longest // self._size
        self._secondary = np.tile(signal.secondary, symbols)[:, np.newaxis]
        self._pieces: list[ComplexArray] = []  # of a symbol the lock detectors wait for
        self._sum = 0j  # of a symbol under way …
        self._periods = 0  # … so far

    def stripped(
        self,
        taps: ComplexArray,
        first: int,
        edge: int,
        decide: Callable[[ComplexArray], FloatArray],
    ) -> ComplexArray:
        """Correlations (n, taps) without the secondary code, and without symbols if there are more.

        first: code period they begin at; decide: makes signs of symbol sums.
        """
        count, size = taps.shape[0], self._size
        if not self._coded and count <= size:
            return taps
        skip = (first - edge) % size
        signs = self._secondary[skip : skip + count]
        if count > size:
            symbols = (taps[:, 1] * signs[:, 0]).reshape(-1, size).sum(axis=1)
            signs = signs * np.repeat(decide(symbols), size)[:, np.newaxis]
        return np.asarray(taps * signs)

    def whole(self, seen: Accumulated, end: int, edge: int | None) -> Accumulated | None:
        """Intervals put together to a symbol; None while it is not full."""
        if edge is None or seen.periods.shape[0] >= self._size:
            return seen
        self._pieces.append(seen.periods)
        if (end - edge) % self._size:
            return None
        taps, self._pieces = np.concatenate(self._pieces), []
        return accumulate(taps, seen.period_s, seen.coherent)

    def decide(self, taps: ComplexArray, seen: Accumulated, end: int, edge: int) -> None:
        """Take an interval of a phase lock; taps: its correlations as they came."""
        size = self._size
        if seen.periods.shape[0] > size:  # as decided when they were stripped
            alike = (taps[:, 1].conj() * seen.periods[:, 1]).real * self._secondary[: len(taps), 0]
            self.decided.extend((alike.reshape(-1, size).sum(axis=1) < 0.0).astype(np.uint8))
            return
        self._sum += seen.prompt
        self._periods += seen.periods.shape[0]
        if (end - edge) % size == 0:
            if self._periods == size:
                self.decided.append(int(self._sum.real < 0.0))
            self._sum, self._periods = 0j, 0

    @property
    def even(self) -> bool:
        """Whether no part of a symbol waits for its rest."""
        return self._periods == 0 and not self._pieces

    def over(self, symbols: int) -> FloatArray:
        """Signs of the secondary code by code period of so many symbols."""
        return np.ascontiguousarray(self._secondary[: symbols * self._size, 0])

    def restart(self, end: int, edge: int) -> None:
        """Begin a new stretch at the next edge."""
        self.resume(bytearray(), end + (edge - end) % self._size)

    def look_back(self, seen: LookBack) -> None:
        """Go on from what was heard without phase lock."""
        self.resume(seen.symbols, seen.first)

    def resume(self, decided: bytearray, first: int) -> None:
        """Go on from a stretch that begins at a code period."""
        self.decided, self.first = decided, first
        self._sum, self._periods = 0j, 0
