"""`deepgnss simulate`: a scenario in; samples, IMU log and truth out."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from deepgnss.cli.screen import nearby
from deepgnss.io.config import json_schema, reference_markdown, resolved_yaml
from deepgnss.sim.output import Written, write_simulation
from deepgnss.sim.schema import (
    PUBLISHED,
    REFERENCE_HEAD,
    ScenarioConfig,
    Simulation,
    build,
    load_scenario,
    ready_scenarios,
)

_PLAIN_EVERY_S = 5.0


@click.command()
@click.argument("scenario", required=False)
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), help="Folder to fill.")
@click.option("--seconds", type=click.FloatRange(min=0.0, min_open=True), help="Length.")
@click.option("--seed", type=click.IntRange(min=0), help="Of everything random.")
@click.option("--threads", type=click.IntRange(min=1), help="Default: one per core.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Change a key (repeatable)."
)
@click.option("--list", "action", flag_value="list", help="Name the ready scenarios.")
@click.option("--show", "action", flag_value="show", help="Print it, defaults filled in.")
@click.option("--schema", "action", flag_value="schema", help="Print the JSON schema.")
@click.option(
    "--reference", "action", flag_value="reference", help="Print all keys explained, as Markdown."
)
def simulate(
    scenario: str | None,
    folder: Path | None,
    seconds: float | None,
    seed: int | None,
    threads: int | None,
    settings: tuple[str, ...],
    action: str | None,
) -> None:
    """Make a recording with known truth by SCENARIO: a YAML file, or a ready one by its name."""
    if action == "list":
        _print_ready()
    elif action == "schema":
        click.echo(json_schema(ScenarioConfig), nl=False)
    elif action == "reference":
        click.echo(reference_markdown(ScenarioConfig, REFERENCE_HEAD), nl=False)
    else:
        if scenario is None:
            raise click.UsageError("Missing argument 'SCENARIO' (--list names the ready ones).")
        given = {"seconds": seconds, "seed": seed}
        own = tuple(f"{key}={value}" for key, value in given.items() if value is not None)
        config = load_scenario(scenario, (*settings, *own))
        if action == "show":
            click.echo(resolved_yaml(config), nl=False)
        elif folder is None:
            raise click.UsageError("Missing option '-o' / '--output'.")
        else:
            _make(config, folder, threads or os.cpu_count() or 1)


def _make(config: ScenarioConfig, folder: Path, threads: int) -> None:
    simulation = build(config)
    began = time.monotonic()
    with _Bar(config.seconds) as bar:
        written = write_simulation(simulation, folder, threads, bar.update)
    took_s = time.monotonic() - began
    _print_result(simulation, written, took_s)


def _print_ready() -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    for ready in (*ready_scenarios(), *ready_scenarios(PUBLISHED)):
        table.add_row(ready.name, ready.about)
    Console(highlight=False).print(table)


class _Bar:
    """Progress: a bar on a terminal, elsewhere a plain line every few seconds."""

    def __init__(self, total_s: float) -> None:
        self._total_s = total_s
        self._console = Console(stderr=True, highlight=False)
        columns = (
            TextColumn("simulate"),
            BarColumn(),
            TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=self._console, transient=True)
        self._task = self._bar.add_task("simulate", total=total_s)
        self._began = self._told = time.monotonic()

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._console.is_terminal:
            self._bar.stop()

    def update(self, done_s: float) -> None:
        """Show how many seconds of recording are written."""
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done_s)
            return
        now = time.monotonic()
        if now - self._told >= _PLAIN_EVERY_S:
            self._told = now
            self._console.print(
                f"simulate: {done_s:.1f} of {self._total_s:.1f} s,"
                f" {done_s / (now - self._began):.1f} × real time",
                soft_wrap=True,
            )


def _print_result(simulation: Simulation, written: Written, took_s: float) -> None:
    console = Console(highlight=False)
    table = Table(box=None, pad_edge=False)
    table.add_column("file", no_wrap=True)
    table.add_column("size", justify="right", no_wrap=True)
    table.add_column("holds")
    for file in written.files:
        table.add_row(file.path.name, _size(file.path.stat().st_size), file.holds)
    console.print(table)
    seconds = simulation.scenario.seconds
    console.print(
        f"\n{seconds:g} s in {took_s:.1f} s, {seconds / took_s:.1f} × real time, written to"
        f" {nearby(written.config.parent)}; next:\n"
        f"deepgnss process {nearby(written.recording)} --config {nearby(written.config)}",
        soft_wrap=True,
    )


def _size(size: float) -> str:
    power = min(int(math.log(max(size, 1), 1000)), 3)
    return f"{size / 1000**power:.3g} {('B', 'kB', 'MB', 'GB')[power]}"
