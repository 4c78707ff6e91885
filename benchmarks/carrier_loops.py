"""All carrier loops on one recording, unaided and aided: phase σ, slips, phases, CPU seconds."""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pandas as pd
from tables import markdown

from deepgnss.evaluate.observables import range_errors
from deepgnss.evaluate.observations import read_observations, read_ranges, wavelength_m

LOOPS = ("pll2", "pll3", "kalman", "long_update")
_SLIP_CYCLES = 0.25
_SHORTEST_S = 3.0  # of an arc whose mean says something
_SETTLED_M = 1e-6
_MOST_ROUNDS = 10_000  # it takes hundreds where arcs are short and overlap with few others


class Run(NamedTuple):
    """What a loop made of the recording."""

    loop: str
    aided: bool
    errors: pd.DataFrame  # as of `range_errors`
    cpu_s: float


class Phases(NamedTuple):
    """Phases of a run against the truth."""

    sigma_m: float  # about the means of arcs, what an epoch has in common taken off
    settled: bool  # whether means and common parts came to rest
    steps: int  # of more than a quarter cycle that no flag announces
    arcs: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("config", type=Path, help="with an inertial unit")
    parser.add_argument("ranges", type=Path, help="ranges.csv of the recording")
    parser.add_argument("--loop", action="append", choices=LOOPS, help="only this one (repeatable)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--since", type=float, default=8.0, help="s after the first observation")
    options = parser.parse_args()
    ranges = read_ranges(options.ranges)
    runs = []
    for loop in options.loop or LOOPS:
        for aided in (False, True):
            settings = [f"tracking.carrier.loop={loop}", *options.settings]
            settings += [] if aided else ["deep=false"]
            observed, cpu_s = process(options.recording, options.config, settings)
            table = range_errors(observed, ranges)
            since_ms = table["time_ms"].min() + 1e3 * options.since
            runs.append(Run(loop, aided, table[table["time_ms"] >= since_ms], cpu_s))
    heads = ("loop", "aiding", "phase σ, mm", "slips not told", "arcs", "phases, %", "CPU, s")
    print(markdown(heads, list(lines(runs))))


def process(recording: Path, config: Path, settings: Sequence[str]) -> tuple[pd.DataFrame, float]:
    """Observations of a run, phases of unknown polarity left out, and its CPU seconds."""
    with TemporaryDirectory() as out:
        program = Path(sys.executable).parent / "deepgnss"
        command = [str(program), "process", str(recording), "--config", str(config), "-o", out]
        command += ["--set", "output.interval=0.2"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        for setting in settings:
            command += ["--set", setting]
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        observed = read_observations(Path(out) / "observations.csv")
    whole = observed["carrier_cycles"].where(~observed["half_cycle"])
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return observed.assign(carrier_cycles=whole), cpu_s


def lines(runs: list[Run]) -> Iterator[list[str]]:
    """A row per run; shares are of what any run has a range of."""
    keys = ["time_ms", "satellite"]
    there = pd.concat([run.errors[keys] for run in runs]).drop_duplicates()
    for run in runs:
        found = phases(run.errors)
        yield [
            run.loop,
            "aided" if run.aided else "none",
            f"{1e3 * found.sigma_m:.2f}" + ("" if found.settled else " (not settled)"),
            f"{found.steps}",
            f"{found.arcs}",
            f"{100.0 * run.errors['phase_m'].notna().sum() / len(there):.1f}",
            f"{run.cpu_s:.0f}",
        ]


def phases(errors: pd.DataFrame) -> Phases:
    """Phases of all satellites, arc by arc."""
    own = errors.dropna(subset=["phase_m"])
    arc = own["satellite"] + own["arc"].astype(str)
    length_s = own.groupby(arc)["time_ms"].transform(np.ptp) / 1e3
    own, arc = own[length_s >= _SHORTEST_S], arc[length_s >= _SHORTEST_S]
    left, moved_m, rounds = own["phase_m"], np.inf, 0
    while moved_m > _SETTLED_M and rounds < _MOST_ROUNDS:
        before, left = left, left - left.groupby(arc).transform("mean")
        left = left - left.groupby(own["time_ms"]).transform("median")
        moved_m, rounds = float((left - before).abs().max()), rounds + 1
    steps = left.groupby(arc).diff().abs()
    limit_m = own["satellite"].map(wavelength_m) * _SLIP_CYCLES
    sigma_m = float((left**2).mean() ** 0.5)
    wrong = int((steps > limit_m).sum())
    return Phases(sigma_m, moved_m <= _SETTLED_M, wrong, arc.nunique())


if __name__ == "__main__":
    main()
