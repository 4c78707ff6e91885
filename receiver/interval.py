"""Intervals of a channel: what the observables read, and how it is put right afterwards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from deepgnss.core.records import NcoCommand
from deepgnss.receiver.open_loop import Led
from deepgnss.receiver.trackers import NO_CORRECTION, Correction


class Heard(NamedTuple):
    """What a window of symbols said of the frequency."""

    unfollowed_hz: float = 0.0  # by how much the generator, as corrected by it, still misses it
    sigma_hz: float = math.nan  # 1σ of what it said
    seconds: float = 0.0  # its length, and how long nothing newer is heard


NOTHING_HEARD = Heard()


class Interval(NamedTuple):
    """A command with what was known when it was given, and what it was found to lack.

    The observables read these: generators' state plus correction is the loop's estimate with the
    interval's own correlations taken in, so it is less noisy and lags less than the generators.
    """

    command: NcoCommand
    periods: int  # code periods since the channel started
    code_valid: bool
    phase_valid: bool
    slips: int  # possible cycle slips so far, of the satellite: the number of the arc
    phase_since: int  # sample of phase lock
    cn0_dbhz: float
    half_cycle: float | None  # 0 or ½ cycle once the polarity is known
    correction: Correction = NO_CORRECTION  # what the interval's correlations said of it …
    middle_s: float = 0.0  # … at its middle, s after the command
    coasting: bool = False  # in open loop, by aiding
    frequency_valid: bool = True  # the loop's own, no longer the prediction's
    window: Heard = NOTHING_HEARD  # the last one, in frequency tracking by windows


def turned(command: NcoCommand, cycles: float, chips: float) -> NcoCommand:
    """A command with carrier and code moved."""
    return command._replace(
        carrier_cycles=command.carrier_cycles + cycles, code_chips=command.code_chips + chips
    )


def of_arc(
    history: Sequence[Interval], before: int, slips: int, half_cycle: float | None
) -> list[Interval]:
    """Intervals of whose arc more is known now."""
    return [
        i._replace(slips=slips, half_cycle=half_cycle) if i.slips == before else i for i in history
    ]


def led_on(
    history: Sequence[Interval], led: Sequence[Led], length: float, *, phase: bool
) -> list[Interval]:
    """Intervals since a signal fell: what loops did was noise, and nobody shall observe it.

    length: chips of a code period; phase: it is carried on.
    """
    generators = {one.sample: one for one in led}
    return [
        i
        if (one := generators.get(i.command.sample)) is None
        else i._replace(
            command=i.command._replace(
                carrier_cycles=one.carrier.phase,
                carrier_hz=one.carrier.frequency,
                carrier_hzps=one.carrier.rate,
                code_chips=one.chips - i.periods * length,
            ),
            correction=NO_CORRECTION,
            code_valid=False,
            phase_valid=phase,
            coasting=True,
        )
        for i in history
    ]
