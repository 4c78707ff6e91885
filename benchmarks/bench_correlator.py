"""The baseband core alone: cost of the shared running sum, and of a channel's correlations."""

from __future__ import annotations

import argparse
from statistics import median
from time import thread_time

import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.core.records import GPS_L1CA, FloatArray, NcoCommand, SampleBlock, StreamInfo
from deepgnss.receiver.baseband import RunningSumBuffer, correlate
from deepgnss.receiver.signals import SIGNALS, code_runs

RATES_HZ = (4e6, 16e6, 25e6, 62e6)
EPOCH_S = 0.1  # channels take turns over this length, as in the receiver
PIECE_S = 0.02  # samples are summed, and codes correlated, in pieces of this length
CHANNELS = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15, help="runs whose median is printed")
    runs = parser.parse_args().runs
    table = Table(title="Baseband core, one thread, CPU time", title_justify="left")
    for name in ("Msps", "sum, zero IF", "sum, real with IF", "channel, 3 taps", "real time"):
        table.add_column(name, justify="right")
    for rate_hz in RATES_HZ:
        zero_ns, _ = sum_cost(rate_hz, True, runs)
        real_ns, _ = sum_cost(rate_hz, False, runs)
        channel_us = channel_cost_us(rate_hz, runs)
        table.add_row(
            f"{rate_hz / 1e6:.0f}",
            f"{zero_ns:.2f} ns/sample",
            f"{real_ns:.2f} ns/sample",
            f"{channel_us:.2f} µs/ms",
            f"{1e3 / channel_us:.0f} channels per core",
        )
    Console(width=100).print(table)


def summed(rate_hz: float, is_complex: bool) -> tuple[RunningSumBuffer, list[SampleBlock]]:
    """A buffer for one epoch, and the blocks that fill it."""
    count = round(EPOCH_S * rate_hz)
    centre_hz = GPS_L1CA.carrier_hz
    stream = StreamInfo(
        "L1", rate_hz, centre_hz, 0.0 if is_complex else rate_hz / 4.1, is_complex, count
    )
    shape = (count, 2) if is_complex else (count,)
    samples = np.random.default_rng(1).integers(-60, 60, shape, dtype=np.int8)
    piece = round(PIECE_S * rate_hz)
    blocks = [SampleBlock(stream, k, samples[k : k + piece]) for k in range(0, count, piece)]
    return RunningSumBuffer(stream, centre_hz, count + 1), blocks


def sum_cost(rate_hz: float, is_complex: bool, runs: int) -> tuple[float, RunningSumBuffer]:
    """Time of the running sum, ns per sample, and the buffer it filled."""
    buffer, blocks = summed(rate_hz, is_complex)
    spent = []
    for _ in range(runs + 1):
        buffer.restart(0)
        began = thread_time()
        for block in blocks:
            buffer.append(block)
        spent.append(thread_time() - began)
    return median(spent[1:]) / (EPOCH_S * rate_hz) * 1e9, buffer  # the first run compiles


def channel_cost_us(rate_hz: float, runs: int) -> float:
    """Time of a channel's correlations with early, prompt and late, µs per ms of signal."""
    _, buffer = sum_cost(rate_hz, True, 1)
    sums, signal = buffer.sums, SIGNALS[GPS_L1CA.name]
    taps: FloatArray = np.array([0.125, 0.0, -0.125])
    periods = round(PIECE_S / signal.period_s)
    starts = range(100, round((EPOCH_S - PIECE_S) * rate_hz), round(PIECE_S * rate_hz))
    spent = []
    for _ in range(runs + 1):
        began = thread_time()
        for prn in signal.prns[:CHANNELS]:
            for start in starts:
                command = NcoCommand(start, 0.3, 500.0 * prn, 0.1, 0.4, 1.023e6 + prn / 3.0, 0.0)
                correlate(sums, command, code_runs(signal.id.name, prn), taps, periods)
        spent.append(thread_time() - began)
    return median(spent[1:]) / (CHANNELS * len(starts) * periods) * 1e6


if __name__ == "__main__":
    main()
