"""The baseband core alone: cost of the shared running sum, and of a channel's correlations."""

from __future__ import annotations

import argparse
from statistics import median
from time import thread_time
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.core.records import (
    GPS_L1CA,
    FloatArray,
    NcoCommand,
    RunningSums,
    SampleBlock,
    StreamInfo,
)
from deepgnss.receiver.baseband import correlate
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, code_runs

RATES_HZ = (4e6, 16e6, 25e6, 62e6)
SECONDS = 0.1
CHANNELS = 8
SIGNAL = GPS_L1CA_SIGNAL
TAPS: FloatArray = np.array([0.125, 0.0, -0.125])


class Cost(NamedTuple):
    sum_ns: float  # per sample
    channel_us: float  # per channel and ms of signal


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15, help="runs whose median is printed")
    runs = parser.parse_args().runs
    table = Table(title="Baseband core, one thread, CPU time", title_justify="left")
    for name in ("Msps", "sum, zero IF", "sum, real with IF", "channel, 3 taps", "real time"):
        table.add_column(name, justify="right")
    for rate_hz in RATES_HZ:
        zero, real = cost(rate_hz, True, runs), cost(rate_hz, False, runs)
        table.add_row(
            f"{rate_hz / 1e6:.0f}",
            f"{zero.sum_ns:.2f} ns/sample",
            f"{real.sum_ns:.2f} ns/sample",
            f"{zero.channel_us:.2f} µs/ms",
            f"{1e3 / zero.channel_us:.0f} channels per core",
        )
    Console(width=100).print(table)


def cost(rate_hz: float, is_complex: bool, runs: int) -> Cost:
    """Median cost of a stretch of noise, block by block as the receiver goes through it."""
    count = round(SECONDS * rate_hz)
    intermediate_hz = 0.0 if is_complex else rate_hz / 4.1
    stream = StreamInfo("L1", rate_hz, GPS_L1CA.carrier_hz, intermediate_hz, is_complex, count)
    shape = (count, 2) if is_complex else (count,)
    samples = np.random.default_rng(1).integers(-60, 60, shape, dtype=np.int8)

    def read(first: int, length: int) -> SampleBlock:
        return SampleBlock(stream, first, samples[first : first + length])

    costs = [_pass(SumFeed(read, stream, GPS_L1CA.carrier_hz, 0), count) for _ in range(runs + 1)]
    timed = costs[1:]  # the first one compiles
    return Cost(median(c.sum_ns for c in timed), median(c.channel_us for c in timed))


def _pass(feed: SumFeed, count: int) -> Cost:
    began, correlating_s, correlated = thread_time(), 0.0, 0
    for sums in feed.advance(count):
        before = thread_time()
        correlated += sum(_correlated(sums, prn) for prn in SIGNAL.prns[:CHANNELS])
        correlating_s += thread_time() - before
    summing_s = thread_time() - began - correlating_s
    return Cost(summing_s / count * 1e9, correlating_s / correlated * 1e6)


def _correlated(sums: RunningSums, prn: int) -> int:
    """Correlate all whole code periods of a block in one channel; their number."""
    period = sums.sample_rate_hz * SIGNAL.period_s
    start = sums.first + 100 + round(period * prn / 40.0)
    periods = int((sums.first + sums.packed.size * sums.step - start - 100) / period)
    command = NcoCommand(start, 0.3, 500.0 * prn, 0.1, 0.4, 1.023e6 + prn / 3.0, 0.0)
    if periods > 0:
        correlate(sums, command, code_runs(SIGNAL.id.name, prn), TAPS, periods)
    return max(periods, 0)


if __name__ == "__main__":
    main()
