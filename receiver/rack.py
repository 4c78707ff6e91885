"""Channels side by side: what all of them are due from a block is correlated in one call.

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
from deepgnss.receiver.modes import AidingSource, Mode, unaided
from deepgnss.receiver.signals import SIGNALS, code_runs


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
