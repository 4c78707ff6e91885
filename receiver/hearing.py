"""What a channel hears without phase lock: where its symbols begin, and what they were."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, NcoCommand
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.sync import (
    BitSync,
    Edge,
    add_prompts,
    demodulate,
    start_bit_sync,
    symbol_edge,
)
from deepgnss.receiver.trackers import NcoState

_REMEMBERED_S = 4.0  # prompts kept


class LookBack(NamedTuple):
    """Symbols of a stretch without phase lock, and the carrier at its end."""

    symbols: bytearray
    first: int  # code period they begin at
    carrier: NcoState


class Hearing:
    """Prompts of a frequency-locked stretch."""

    def __init__(self, signal: Signal, remembered_s: float | None = None) -> None:
        """remembered_s: of prompts, as far back as the carrier's frequency and rate reach."""
        self._signal = signal
        self._remembered = (remembered_s or _REMEMBERED_S) / signal.period_s
        self._prompts: list[tuple[NcoCommand, ComplexArray]] = []
        self._first = 0  # code period of the first one kept
        self._sync: BitSync = self._fresh()
        self._sync_first = 0

    def _fresh(self) -> BitSync:
        return start_bit_sync(self._signal.secondary, coded=bool(self._signal.secondary_code))

    def forget(self) -> None:
        """A new stretch begins."""
        self._prompts = []

    def restart_sync(self) -> None:
        """Look for the symbol edges anew."""
        self._sync = self._fresh()

    def add(self, command: NcoCommand, prompts: ComplexArray, first: int) -> None:
        """Take the prompts (n,) of a command, which begin at a code period."""
        if not self._prompts:
            self._first = first
        self._prompts.append((command, prompts))
        kept = first + prompts.size - self._first
        if kept > self._remembered and len(self._prompts) > 1:
            self._first += self._prompts.pop(0)[1].size

    def edge(self, prompts: ComplexArray, signal: float, noise: float) -> Edge | None:
        """The symbol edge once it stands out, as a period of the channel's count.

        Parameters: prompts just added; power of signal and noise in one code period.
        """
        if self._sync.symbols == 0:
            self._sync_first = self._first
        self._sync = add_prompts(self._sync, prompts, signal, noise)
        edge = symbol_edge(self._sync)
        return edge._replace(period=self._sync_first + edge.period) if edge is not None else None

    @property
    def synced_by(self) -> int:
        """Symbols that have told the edge."""
        return self._sync.symbols

    def look_back(self, edge: int, carrier: NcoState, rate_hzps: float) -> LookBack:
        """Demodulate what was heard; at a symbol edge, so the last symbol ends at the command.

        rate_hzps: at which the carrier's frequency is known to have changed.
        """
        signal, size = self._signal, self._signal.symbol_periods
        prompts: ComplexArray = np.concatenate(
            [prompts * self._turns(at, prompts.size) for at, prompts in self._prompts]
        )
        # The generator followed the loop; seen from here the carrier runs as it was bound to.
        back_s = signal.period_s * (np.arange(prompts.size) + 0.5 - prompts.size)
        cycles = carrier.phase + back_s * (carrier.frequency + 0.5 * back_s * rate_hzps)
        prompts *= np.exp(-2j * np.pi * cycles)
        skip = (edge - self._first) % size
        seen = demodulate(prompts[skip:].reshape(-1, size) @ signal.secondary, signal.symbol_s)
        return LookBack(
            seen.symbols,
            self._first + skip,
            carrier._replace(
                phase=carrier.phase + seen.phase_cycles + 0.5 * seen.step_cycles,
                frequency=carrier.frequency + seen.step_cycles / signal.symbol_s,
            ),
        )

    def _turns(self, command: NcoCommand, periods: int) -> ComplexArray:
        """Carrier the generator ran on a command in the middles of its code periods."""
        t = self._signal.period_s * (np.arange(periods) + 0.5)
        t -= command.code_chips / command.code_hz
        cycles = command.carrier_cycles + t * (command.carrier_hz + 0.5 * t * command.carrier_hzps)
        return np.asarray(np.exp(2j * np.pi * np.mod(cycles, 1.0)))
