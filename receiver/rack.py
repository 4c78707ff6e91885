"""Channels side by side, through an epoch: those that are steady in a kernel, and the others.

Steady ones go through an epoch in one call. Of the others all that is due from a block is
correlated in one; between two calls a channel does what it does alone (`Channel.run`). A call
holds no lock of the interpreter, so that the channels of two streams run at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import ComplexArray, FloatArray, NcoCommand, RunningSums
from deepgnss.receiver.baseband import NOTHING_SHARED, correlate_periods
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.feed import Stretch, SumFeed
from deepgnss.receiver.modes import AidingSource, Mode, unaided
from deepgnss.receiver.signals import Signal, code_table
from deepgnss.receiver.steady import NEAR_ENTRIES, run_stretch
from deepgnss.receiver.steady_group import SteadyGroup, steady


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
    steps = np.empty((4, edges.shape[1]))
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
            NOTHING_SHARED,
            steps,
            out[k, :periods],
        )


class Rack:
    """Channels of one signal's name and with equal taps, through an epoch.

    Each does what its `run` does; those with nothing to decide do it in a kernel.
    """

    def __init__(
        self, channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> None:
        """aiding: by satellite; end: sample at which the epoch ends."""
        self._aiding = aiding
        groups: dict[Signal, list[Channel]] = {}
        self._others: list[Channel] = []
        for channel in channels:
            if steady(channel, aiding.get(channel.satellite, unaided)):
                groups.setdefault(channel.signal, []).append(channel)
            else:
                self._others.append(channel)
        self._groups = [SteadyGroup(group, aiding, end) for group in groups.values()]
        self._gone_through = False  # whether the groups have reached the epoch's end

    def go_through(self, stretch: Stretch) -> None:
        """Track steady channels through the samples of an epoch, summed on the way."""
        self._gone_through = True
        if not self._groups:
            return
        room = np.empty(max(NEAR_ENTRIES, 3 * stretch.kept), dtype=np.int64)
        run_stretch(*stretch, room, tuple(group.side for group in self._groups))
        for group in self._groups:
            self._others += group.stopped()

    @property
    def has_steady(self) -> bool:
        """Whether there are channels that can go through the epoch by themselves."""
        return bool(self._groups)

    @property
    def wants_sums(self) -> bool:
        """Whether there are channels that can not, or have not."""
        return bool(self._others)

    def advance(self, sums: RunningSums) -> None:
        """Track as far as the running sums go."""
        if not self._gone_through:
            for group in self._groups:
                self._others += group.run(sums)
        run_together(self._others, sums, self._aiding)

    def finish(self) -> None:
        """The epoch is over."""
        for group in self._groups:
            group.hand_back()


def run_epoch(
    racks: Sequence[Rack], feed: SumFeed, end: int, executor: Executor | None = None
) -> None:
    """Track the channels of a stream up to sample `end`, at which the epoch is over.

    Steady ones come first, which sum what they go over; the others go block by block, so that the
    sums are still in the cache. executor: for the racks behind the first one.
    """
    has_steady = any(rack.has_steady for rack in racks)
    stretch = feed.stretch(end) if has_steady else None
    if stretch is not None:
        _each(partial(Rack.go_through, stretch=stretch), racks, executor)
    if (has_steady and stretch is None) or any(rack.wants_sums for rack in racks):
        for sums in feed.advance(end):
            _each(partial(Rack.advance, sums=sums), racks, executor)
    else:
        feed.pass_over(end)
    for rack in racks:
        rack.finish()


def _each(do: Callable[[Rack], None], racks: Sequence[Rack], executor: Executor | None) -> None:
    tasks = [executor.submit(do, rack) for rack in racks[1:] if executor]
    do(racks[0])
    for task in tasks:
        task.result()


def run_together(
    channels: Sequence[Channel], sums: RunningSums, aiding: Mapping[str, AidingSource]
) -> None:
    """Track channels of one signal's name and with equal taps as far as the running sums go.

    Each does what its `run` does. aiding: by satellite.
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
