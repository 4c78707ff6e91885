"""Steady channels of a signal side by side: handed over to the kernel, and taken back.

Between two epochs a channel is itself, as everybody else knows it. In an epoch those with nothing
to decide are rows of arrays (`steady`), until one has to go on by itself or the epoch is over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepgnss.core.records import FloatArray, RunningSums
from deepgnss.receiver.baseband import NOTHING_SHARED
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.decisions import calm
from deepgnss.receiver.leading import NO_GRID, Profile
from deepgnss.receiver.locks import RECENT_KEPT, half_shifts
from deepgnss.receiver.modes import AidingSource, Mode, unaided
from deepgnss.receiver.signals import code_table
from deepgnss.receiver.steady import Loops, Side, State, records, run_steady
from deepgnss.receiver.updates import Update, in_a_row


def steady(channel: Channel, source: AidingSource) -> bool:
    """Whether a channel has nothing to decide, and is led by a source the kernel can ask."""
    if not (
        channel.settled
        and channel.code_loop.narrowest
        and channel.carriers.fixed_gains(channel.signal.update_s) is not None
        and len(channel.locks.recent) == RECENT_KEPT
    ):
        return False
    if isinstance(source, Profile):
        return channel.aided and channel.open_loop.loop.memory.knows_offset
    return source is unaided and not channel.aided


def loops_of(channel: Channel) -> Loops:
    """What a steady channel has in common with others of its signal."""
    signal, carriers = channel.signal, channel.carriers
    gains = carriers.fixed_gains(signal.update_s)
    if gains is None:
        raise ValueError(f"{channel.satellite}: its carrier loop is not one of fixed gains")
    return Loops(
        channel.nco.rates,
        signal.period_s,
        signal.update_periods,
        signal.symbol_periods,
        channel.margin,
        gains,
        channel.code_loop.over(signal.update_s).gains(signal.update_s),
        carriers.has_own_rate(Mode.PHASE),
        calm(channel.settings, aided=channel.aided),
        carriers.indicator_s,
        carriers.fast_s,
    )


def state_of(channel: Channel, source: AidingSource, row: int) -> State:
    """A channel as it is; row: of its code in the table."""
    locks, leading = channel.locks, channel.leading
    grid, points, clock_hz = NO_GRID, 0, 0.0
    if isinstance(source, Profile):
        grid, points, clock_hz = source.grid, source.cycles.size, source.clock_hz
    return State(
        *channel.command,
        channel.nco.code_offset_hz,
        channel.frequency_error_hz,
        channel.filled,
        locks.seconds,
        locks.signal,
        locks.fast_signal,
        locks.noise,
        locks.phase,
        locks.phase_seconds,
        *locks.shifted,
        *leading.now,
        leading.led_hz,
        leading.led_hzps,
        *channel.open_loop.loop.memory.mean,
        points,
        *grid,
        clock_hz,
        int(source is not leading.told_by),
        row,
        channel.code_loop.tracker.slope,
        0,
        0,
    )


class SteadyGroup:
    """Steady channels of a signal, through an epoch."""

    def __init__(
        self, channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> None:
        one = channels[0]
        self._channels = dict(enumerate(channels))
        self._sources = [aiding.get(channel.satellite, unaided) for channel in channels]
        loops, table = loops_of(one), code_table(one.signal.id.name)
        count, periods = len(channels), loops.periods
        of_update = periods // loops.symbol_periods
        update_samples = periods * loops.period_s * loops.rates.sample_hz
        updates = 2 + int((end - min(c.command.sample for c in channels)) / update_samples)
        most = max(s.cycles.size if isinstance(s, Profile) else 0 for s in self._sources)
        self._states = np.zeros(count, records(State))
        self._told = np.zeros((count, updates), records(Update))
        self.side = Side(
            loops,
            table.edges,
            table.signs,
            table.runs,
            one.taps_chips,
            one.stream.over(of_update),
            half_shifts(loops.symbol_periods),
            # Records have attributes in compiled code; in plain Python they have in these views.
            self._states.view(np.recarray),
            np.zeros((count, RECENT_KEPT)),
            np.zeros((count, periods, one.taps_chips.size), dtype=np.complex128),
            np.zeros((count, most)),
            np.empty((count, 4, table.edges.shape[1])),
            np.full(count, NOTHING_SHARED),
            self._told.view(np.recarray),
            np.zeros((count, updates, of_update), dtype=np.uint8),
        )
        for k, (channel, source) in enumerate(zip(channels, self._sources, strict=True)):
            if isinstance(source, Profile):
                self.side.cycles[k, : source.cycles.size] = source.cycles
            self.side.recent[k] = channel.locks.recent
            channel.intake.copy_to(self.side.taken[k])
            self._states[k] = state_of(channel, source, table.rows[channel.prn])

    def run(self, sums: RunningSums) -> list[Channel]:
        """Track as far as the running sums go; channels that have to go on by themselves."""
        run_steady(sums.packed, sums.first, sums.step, sums.scale, self.side)
        return self.stopped()

    def stopped(self) -> list[Channel]:
        """Channels that have to go on by themselves, let go."""
        stopped = np.flatnonzero(self._states["stopped"]).tolist()
        return [self._back(k) for k in stopped if k in self._channels]

    def hand_back(self) -> None:
        """Let all channels go on by themselves."""
        for k in [*self._channels]:
            self._back(k)

    def _back(self, k: int) -> Channel:
        channel, state = self._channels.pop(k), State(*self._states[k].item())
        if state.updates:
            updates = self._told[k, : state.updates].tolist()
            symbols = self.side.symbols[k, : state.updates].tobytes()
            take_back(channel, state, self.side.recent[k], updates, symbols, self._sources[k])
        channel.intake.refill(self.side.taken[k, : state.filled])
        return channel


def take_back(
    channel: Channel,
    state: State,
    recent: FloatArray,
    updates: Sequence[tuple[Any, ...]],
    symbols: bytes,
    source: AidingSource,
) -> None:
    """Let a channel go on from what became of it.

    recent: (RECENT_KEPT,) powers; updates (`Update`) and symbols since, by source.
    """
    told = in_a_row(updates)
    channel.open_loop.go_on(told, channel.signal.update_periods, state.offset_seconds)
    channel.pass_on(told, state.code_offset_hz)
    leading = channel.leading
    leading.now, leading.told_by = told.aids[-1], source
    leading.led_hz, leading.led_hzps = state.led_hz, state.led_hzps
    channel.resume(state.locks(recent), state.error_hz, symbols)
