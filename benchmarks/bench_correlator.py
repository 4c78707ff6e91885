"""The baseband core alone: cost of the shared running sum, and of a channel's correlations."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.table import Table

from deepgnss.evaluate.reproduce.speed import correlator_cost

RATES_HZ = (4e6, 16e6, 25e6, 62e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15, help="runs whose median is printed")
    runs = parser.parse_args().runs
    table = Table(title="Baseband core, one thread, CPU time", title_justify="left")
    sums = ("sum, 2 bits, zero IF", "sum, 8 bits, zero IF", "sum, 8 bits, real with IF")
    for name in ("Msps", *sums, "channel, 3 taps", "real time"):
        table.add_column(name, justify="right")
    for rate_hz in RATES_HZ:
        packed = correlator_cost(rate_hz, True, runs, packed=True)
        zero, real = (correlator_cost(rate_hz, form, runs) for form in (True, False))
        table.add_row(
            f"{rate_hz / 1e6:.0f}",
            f"{packed.sum_ns:.2f} ns/sample",
            f"{zero.sum_ns:.2f} ns/sample",
            f"{real.sum_ns:.2f} ns/sample",
            f"{zero.channel_us:.2f} µs/ms",
            f"{1e3 / zero.channel_us:.0f} channels per core",
        )
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
