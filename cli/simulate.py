"""`deepgnss simulate`: a recording with known truth."""

from __future__ import annotations

import os
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from deepgnss.sim.output import write_scenario
from deepgnss.sim.presets import PRESETS, preset


@click.command()
@click.option(
    "--preset", "name", type=click.Choice(list(PRESETS)), default="demo", show_default=True
)
@click.option("--seconds", type=click.FloatRange(min=0.0, min_open=True), help="Length.")
@click.option("--rate", "rate_hz", type=float, help="Sampling rate, Hz.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--threads", type=click.IntRange(min=1), help="Default: one per core.")
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="Folder for rec.bin, config.yaml, truth.csv, ranges.csv, nav.rnx.",
)
def simulate(
    name: str,
    seconds: float | None,
    rate_hz: float | None,
    seed: int,
    threads: int | None,
    directory: Path,
) -> None:
    """Make a recording of GPS L1 C/A with its truth, by a ready scenario."""
    scenario = preset(name, seconds, rate_hz, seed)
    console = Console(stderr=True)
    columns = (TextColumn("simulate"), BarColumn(), TextColumn("{task.completed:.1f} s"))
    with Progress(*columns, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("simulate", total=scenario.seconds)
        write_scenario(
            scenario,
            directory,
            threads or os.cpu_count() or 1,
            lambda done_s: bar.update(task, completed=done_s),
        )
    click.echo(
        f"{directory / 'rec.bin'}: {scenario.seconds:g} s of {len(scenario.emitters)} satellites "
        f"at {scenario.streams[0].front_end.sample_rate_hz / 1e6:g} Msps; process it with "
        f"{directory / 'config.yaml'}"
    )
