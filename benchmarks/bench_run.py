"""The whole program on eight satellites at 16 Msps: CPU time by channel and by stage, memory."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from deepgnss.evaluate.child import DEEPGNSS, Ran, run

CHANNELS = 8  # of the scenario
ALLOWED_S = 0.012  # CPU time per channel and second of signal


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", type=float, default=10.0, help="length of the short runs, s")
    parser.add_argument("--long", type=float, default=30.0, help="length of the long runs, s")
    parser.add_argument("--runs", type=int, default=3, help="runs whose median is printed")
    options = parser.parse_args()
    console = Console(width=100)
    with tempfile.TemporaryDirectory(prefix="deepgnss-bench-") as folder:
        place = Path(folder)
        run([*DEEPGNSS, *_simulate(options.long, place)])
        run(_process(place, options.short))  # compiles the kernels
        short, long = (
            [run(_process(place, seconds)) for _ in range(options.runs)]
            for seconds in (options.short, options.long)
        )
        console.print(_totals(options.short, short, options.long, long))
        console.print(_by_stage(place, options.long))


def _simulate(seconds: float, place: Path) -> list[str]:
    return ["simulate", "bench", "--seconds", str(seconds), "-o", str(place)]


def _arguments(place: Path, seconds: float, start: str) -> list[str]:
    settings = [
        f"recording.duration={seconds}",
        f"start={start}",
        f"nav={place / 'nav.rnx'}",
        "output.interval=1.0",
        "threads=1",
    ]
    chosen = [part for setting in settings for part in ("--set", setting)]
    where = [str(place / "rec.bin"), "--config", str(place / "config.yaml")]
    return [*where, *chosen, "-o", str(place / "out")]


def _process(place: Path, seconds: float) -> list[str]:
    return [*DEEPGNSS, "process", *_arguments(place, seconds, "causal")]


def _totals(short_s: float, short: list[Ran], long_s: float, long: list[Ran]) -> Table:
    table = Table(title="Whole program, one thread, all outputs at 1 Hz", title_justify="left")
    for name in ("recording", "CPU", "× real time", "peak memory"):
        table.add_column(name, justify="right")
    for seconds, costs in ((short_s, short), (long_s, long)):
        cpu_s = median(cost.cpu_s for cost in costs)
        table.add_row(
            f"{seconds:g} s",
            f"{cpu_s:.2f} s",
            f"{seconds / cpu_s:.1f}",
            f"{max(cost.resident_mb for cost in costs):.0f} MB",
        )
    slope_s = (median(cost.cpu_s for cost in long) - median(cost.cpu_s for cost in short)) / (
        CHANNELS * (long_s - short_s)
    )
    growth = (max(cost.resident_mb for cost in long) - max(cost.resident_mb for cost in short)) / (
        long_s - short_s
    )
    table.caption = (
        f"CPU per channel and second of signal (slope): {slope_s:.4f} s, allowed {ALLOWED_S:.3f}\n"
        f"memory per second of recording: {growth:+.2f} MB"
    )
    table.caption_justify = "left"
    return table


def _by_stage(place: Path, seconds: float) -> Table:
    from stages import stages_s  # after the children: those start with this process's memory

    table = Table(title="By stage, scout pass included", title_justify="left")
    table.add_column("stage")
    for name in ("CPU", "× real time", "per channel and second"):
        table.add_column(name, justify="right")
    for name, spent_s in stages_s(_arguments(place, seconds, "scout")).items():
        table.add_row(
            name,
            f"{spent_s:.2f} s",
            f"{seconds / spent_s:.1f}",
            f"{spent_s / (CHANNELS * seconds) * 1e3:.2f} ms",
        )
    return table


if __name__ == "__main__":
    main()
