"""Channels side by side: in an epoch, those that are steady in a kernel (`steady`), and the others,
of which all that is due from a block is correlated in one call.

Between two calls a channel does what it does alone (`Channel.run`); a call holds no lock of the
interpreter, so that the channels of two streams run at the same time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import ComplexArray, FloatArray, NcoCommand, RunningSums
from deepgnss.receiver.baseband import correlate_periods
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.leading import Profile
from deepgnss.receiver.locks import RECENT_KEPT, half_shifts
from deepgnss.receiver.modes import AidingSource, Mode, unaided
from deepgnss.receiver.signals import SIGNALS, Signal, code_runs
from deepgnss.receiver.steady import State, Update, records, run_steady


class CodeTable(NamedTuple):
    """The codes of a signal's satellites as runs (`CodeRuns`), row by row."""

    rows: Mapping[int, int]  # by PRN
    edges: FloatArray  # (rows, most runs + 1)
    signs: FloatArray  # (rows, most runs)
    runs: NDArray[np.int64]  # (rows,): how many of them count


@cache
def code_table(signal_name: str) -> CodeTable:
    """All codes of a signal."""
    prns = [prn for signal in SIGNALS[signal_name] for prn in signal.prns]
    codes = [code_runs(signal_name, prn) for prn in prns]
    most = max(code.signs.size for code in codes)
    edges, signs = np.zeros((len(codes), most + 1)), np.zeros((len(codes), most))
    for row, code in enumerate(codes):
        edges[row, : code.edges.size], signs[row, : code.signs.size] = code
    runs = np.array([code.signs.size for code in codes])
    return CodeTable({prn: row for row, prn in enumerate(prns)}, edges, signs, runs)


@kernel
def correlate_all(
    packed: NDArray[np.int64],
    first: int,
    step: int,
    sample_rate_hz: float,
    due: FloatArray,
    edges: FloatArray,
    signs: FloatArray,
    runs: NDArray[np.int64],
    taps_chips: FloatArray,
    out: ComplexArray,
) -> None:
    """`correlate_periods` of many channels: out (channels, most periods, taps).

    due: (channels, 10): NcoCommand; row of the code in edges, signs and runs, periods to skip,
    periods to correlate.
    """
    for k in range(due.shape[0]):
        c = due[k]
        row, skip, periods = int(c[7]), int(c[8]), int(c[9])
        correlate_periods(
            packed,
            first,
            step,
            sample_rate_hz,
            NcoCommand(int(c[0]), c[1], c[2], c[3], c[4], c[5], c[6]),
            edges[row, : runs[row] + 1],
            signs[row, : runs[row]],
            taps_chips,
            skip,
            out[k, :periods],
        )


class Rack:
    """Channels of one signal's name and with equal taps, through an epoch.

    Each does exactly what its `run` does; those with nothing to decide do it in a kernel.
    """

    def __init__(
        self, channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> None:
        """aiding: by satellite; end: sample at which the epoch ends."""
        self._aiding = aiding
        steady: dict[Signal, list[Channel]] = {}
        self._others: list[Channel] = []
        for channel in channels:
            if channel.steady(aiding.get(channel.satellite, unaided)):
                steady.setdefault(channel.signal, []).append(channel)
            else:
                self._others.append(channel)
        self._groups = [_Group(group, aiding, end) for group in steady.values()]

    def advance(self, sums: RunningSums) -> None:
        """Track as far as the running sums go."""
        for group in self._groups:
            self._others += group.run(sums)
        run_together(self._others, sums, self._aiding)

    def finish(self) -> None:
        """The epoch is over."""
        for group in self._groups:
            group.hand_back()


class _Group:
    """Steady channels of a signal."""

    def __init__(
        self, channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> None:
        one = channels[0]
        self._channels = dict(enumerate(channels))
        self._loops = one.loops
        self._taps_chips = one.taps_chips
        self._table = code_table(one.signal.id.name)
        count, periods = len(channels), self._loops.periods
        of_update = periods // self._loops.symbol_periods
        self._secondary = one.secondary_over(of_update)
        self._shifts = half_shifts(self._loops.symbol_periods)
        update_samples = periods * self._loops.period_s * self._loops.rates.sample_hz
        updates = 2 + int((end - min(c.command.sample for c in channels)) / update_samples)
        self._recent = np.zeros((count, RECENT_KEPT))
        self._taken = np.zeros((count, periods, one.taps_chips.size), dtype=np.complex128)
        self._states = np.zeros(count, records(State))
        self._told = np.zeros((count, updates), records(Update))
        self._symbols = np.zeros((count, updates, of_update), dtype=np.uint8)
        self._sources = [aiding.get(channel.satellite, unaided) for channel in channels]
        most = max(s.cycles.size if isinstance(s, Profile) else 0 for s in self._sources)
        self._cycles = np.zeros((count, most))
        for k, (channel, source) in enumerate(zip(channels, self._sources, strict=True)):
            if isinstance(source, Profile):
                self._cycles[k, : source.cycles.size] = source.cycles
            row = self._table.rows[channel.prn]
            self._states[k] = channel.hand_over(self._recent[k], self._taken[k], source, row)

    def run(self, sums: RunningSums) -> list[Channel]:
        """Track as far as the running sums go; channels that have to go on by themselves."""
        run_steady(
            sums.packed,
            sums.first,
            sums.step,
            sums.scale,
            self._loops,
            self._table.edges,
            self._table.signs,
            self._table.runs,
            self._taps_chips,
            self._secondary,
            self._shifts,
            self._states.view(np.recarray),  # whose records have attributes in plain Python, too
            self._recent,
            self._taken,
            self._cycles,
            self._told.view(np.recarray),
            self._symbols,
        )
        stopped = np.flatnonzero(self._states["stopped"]).tolist()
        return [self._back(k) for k in stopped if k in self._channels]

    def hand_back(self) -> None:
        """Let all channels go on by themselves."""
        for k in [*self._channels]:
            self._back(k)

    def _back(self, k: int) -> Channel:
        channel, state = self._channels.pop(k), State(*self._states[k].item())
        updates = [Update(*one) for one in self._told[k, : state.updates].tolist()]
        channel.take_back(
            state,
            self._recent[k],
            self._taken[k],
            updates,
            self._symbols[k, : state.updates],
            self._sources[k],
        )
        return channel


def run_together(
    channels: Sequence[Channel], sums: RunningSums, aiding: Mapping[str, AidingSource]
) -> None:
    """Track channels of one signal's name and with equal taps as far as the running sums go.

    Each does exactly what its `run` does. aiding: by satellite.
    """
    going = [channel for channel in channels if channel.mode is not Mode.LOST]
    while going:
        _take_due(going, sums)
        going = [channel for channel in going if channel.complete]
        for channel in going:
            channel.conclude(aiding.get(channel.satellite, unaided))
        going = [channel for channel in going if channel.mode is not Mode.LOST]


def _take_due(channels: Sequence[Channel], sums: RunningSums) -> None:
    """Give each channel the correlations of the code periods at hand."""
    end = sums.end
    wanting = [(channel, count) for channel in channels if (count := channel.due(end)) > 0]
    if not wanting:
        return
    one = wanting[0][0]
    table = code_table(one.signal.id.name)
    told = ((*c.command, table.rows[c.prn], c.skip, count) for c, count in wanting)
    due = np.array([*chain.from_iterable(told)], dtype=np.float64).reshape(len(wanting), -1)
    most = max(count for _, count in wanting)
    out = np.empty((len(wanting), most, one.taps_chips.size), dtype=np.complex128)
    correlate_all(
        sums.packed,
        sums.first,
        sums.step,
        sums.sample_rate_hz,
        due,
        table.edges,
        table.signs,
        table.runs,
        one.taps_chips,
        out,
    )
    if sums.scale != 1.0:
        out *= sums.scale
    for (channel, count), taken in zip(wanting, out, strict=True):
        channel.take(taken[:count])
