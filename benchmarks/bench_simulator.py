"""The simulator: CPU time per satellite and sample, per noise value, and against real time."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import process_time

from rich.console import Console
from rich.table import Table

from deepgnss.core.records import GPS_L1CA
from deepgnss.sim.converter import convert
from deepgnss.sim.delays import node_source
from deepgnss.sim.generator import input_sigma, sample_source
from deepgnss.sim.noise import normal_pairs
from deepgnss.sim.scenario import FrontEnd, Scenario, Stream
from deepgnss.sim.schema import build, load_scenario

SATELLITES = 20
COUNT = 1 << 17  # samples timed at a time
RATES_HZ = (4e6, 16e6, 62e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=9, help="runs whose median is printed")
    runs = parser.parse_args().runs
    console = Console(width=100)
    nodes = node_source(crowd(FrontEnd(4e6)))
    seconds = iter(range(1, 1000))
    node_s = cost(lambda _: nodes(1000 * next(seconds), 1000 * next(seconds) + 1), runs)
    node_s /= 2 * SATELLITES
    noise_s = cost(lambda k: normal_pairs(1, k * COUNT, COUNT), runs)
    console.print(f"noise: {noise_s / (2 * COUNT) * 1e9:.2f} ns per value")
    console.print(f"delays: {node_s * 1e3:.2f} ms per satellite and second")
    table = Table(
        title=f"{SATELLITES} satellites, complex 2-bit samples, one thread, CPU time",
        title_justify="left",
    )
    for name in ("Msps", "filter", "signals", "with noise", "with converter", "2 cores"):
        table.add_column(name, justify="right")
    for rate_hz in RATES_HZ:
        for bandwidth_hz in (None, 0.8 * rate_hz):
            table.add_row(
                *_row(FrontEnd(rate_hz, "bits2", bandwidth_hz=bandwidth_hz), node_s, runs)
            )
    console.print(table)


def _row(front_end: FrontEnd, node_s: float, runs: int) -> list[str]:
    """Costs of a front end as text; node_s: delays of a satellite and second."""
    scenario = crowd(front_end)
    silent, noisy = sample_source(replace(scenario, noise=False)), sample_source(scenario)
    sigma = input_sigma(scenario, front_end)
    signal_s = cost(lambda k: silent(k * COUNT, COUNT), runs)
    sample_s = cost(lambda k: noisy(k * COUNT, COUNT), runs)
    all_s = cost(lambda k: convert(noisy(k * COUNT, COUNT), sigma, front_end), runs)
    ns = 1e9 / COUNT
    return [
        f"{front_end.sample_rate_hz / 1e6:.0f}",
        f"{front_end.filter_taps} taps" if front_end.bandwidth_hz else "off",
        f"{signal_s * ns / SATELLITES:.2f} ns/satellite",
        f"{sample_s * ns:.1f} ns/sample",
        f"{all_s * ns:.1f} ns/sample",
        f"{2.0 / (front_end.sample_rate_hz * all_s / COUNT + SATELLITES * node_s):.1f} × real time",
    ]


def crowd(front_end: FrontEnd) -> Scenario:
    """Ten satellites twice over: twenty signals that nobody would tell apart."""
    scenario = build(load_scenario("static48")).scenario
    return replace(
        scenario, emitters=scenario.emitters * 2, streams=(Stream(GPS_L1CA.name, front_end),)
    )


def cost(make: Callable[[int], object], runs: int) -> float:
    """Median CPU seconds of a piece; kernels and the first second of delays are made before."""
    make(0)
    spent = []
    for k in range(runs):
        began = process_time()
        make(k % 2)
        spent.append(process_time() - began)
    return median(spent)


if __name__ == "__main__":
    main()
