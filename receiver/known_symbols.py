"""Symbols known before they are received: from an earlier pass, or sent before.

Subframes 1 to 3 come again in every frame of 30 s, the others with the almanac; only the time in
them changes, and the parities with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import FloatArray
from deepgnss.receiver.messages import MessageFormat, Subframe


class KnownSymbols(NamedTuple):
    """Symbols decoded before, upright: what a satellite sent from a code period on."""

    first: int  # code periods since the GPS epoch
    symbols: bytes  # 0/1


def signs(known: KnownSymbols, first: int, count: int, symbol_periods: int) -> FloatArray | None:
    """Signs ±1 of `count` symbols from a code period on; None where not all are known."""
    skip = (first - known.first) // symbol_periods
    if skip < 0 or skip + count > len(known.symbols):
        return None
    bits = np.frombuffer(known.symbols, dtype=np.int8, count=count, offset=skip)
    return np.asarray(1.0 - 2.0 * bits.astype(np.float64))


Sent = Mapping[int, Any]
"""Subframes a satellite has sent, by the second of the cycle in which each comes again."""

_AHEAD = 3  # subframes foretold at a time


def remembered(sent: Sent, subframe: Subframe, message: MessageFormat) -> Sent:
    """What a satellite has sent, and this subframe."""
    return {**sent, _slot(int(subframe.start_tow_s), subframe.subframe_id, message): subframe}


def foretold(
    sent: Sent, message: MessageFormat, period: int, periods_per_second: int, symbol_periods: int
) -> KnownSymbols | None:
    """Symbols from the subframe that is on the air at a code period (since the GPS epoch) on.

    None where the subframe of that place in the cycle has not been heard.
    """
    if message.again is None:
        return None
    length_s = message.subframe_symbols * symbol_periods // periods_per_second
    second = period // periods_per_second
    phase_s = min((int(one.start_tow_s) % length_s for one in sent.values()), default=None)
    if phase_s is None:
        return None
    start_s = second - (second - phase_s) % length_s
    pieces = []
    for k in range(_AHEAD):
        tow_s = (start_s + k * length_s) % SECONDS_PER_WEEK
        subframe = sent.get(tow_s % message.frame_s) or sent.get(
            message.frame_s + tow_s % message.almanac_s
        )
        if subframe is None:
            break
        pieces.append(message.again(subframe, tow_s))
    if not pieces:
        return None
    return KnownSymbols(start_s * periods_per_second, np.concatenate(pieces).tobytes())


def _slot(tow_s: int, subframe_id: int, message: MessageFormat) -> int:
    """Seconds within the frame; behind them, seconds within the almanac's cycle."""
    if subframe_id <= 3:
        return tow_s % message.frame_s
    return message.frame_s + tow_s % message.almanac_s
