"""What updates of a steady channel leave: as a kernel tells it, and as a channel takes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from deepgnss.core.records import NcoCommand
from deepgnss.receiver.modes import AidingRate
from deepgnss.receiver.trackers import Correction


class Update(NamedTuple):
    """One of them, as a record of a kernel."""

    # Of the interval that is over: its correction in the middle, and the power it had.
    phase: float
    frequency: float
    rate: float
    middle_s: float
    power: float
    # The command that follows, what it was predicted by, the mean offset and C/N0 then.
    sample: int
    carrier_cycles: float
    carrier_hz: float
    carrier_hzps: float
    code_chips: float
    code_hz: float
    code_hzps: float
    aid_hz: float
    aid_hzps: float
    clock_hz: float
    offset_hz: float
    cn0_dbhz: float


class Updates(NamedTuple):
    """Several in a row, each field a sequence over them."""

    # Of the intervals that are over.
    corrections: Sequence[Correction]
    middles_s: Sequence[float]
    powers: Sequence[float]
    # Of the commands that follow.
    commands: Sequence[NcoCommand]
    aids: Sequence[AidingRate]
    offsets_hz: Sequence[float]
    cn0s_dbhz: Sequence[float]


def in_a_row(updates: Sequence[tuple[Any, ...]]) -> Updates:
    """Updates of a channel, each with the fields of `Update`; at least one."""
    of: Any = Update._make(zip(*updates, strict=True))  # every field: a tuple over them
    return Updates(
        [*map(Correction, of.phase, of.frequency, of.rate)],
        of.middle_s,
        of.power,
        [
            *map(
                NcoCommand,
                of.sample,
                of.carrier_cycles,
                of.carrier_hz,
                of.carrier_hzps,
                of.code_chips,
                of.code_hz,
                of.code_hzps,
            )
        ],
        [*map(AidingRate, of.aid_hz, of.aid_hzps, of.clock_hz)],
        of.offset_hz,
        of.cn0_dbhz,
    )
