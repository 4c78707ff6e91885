"""`deepgnss batch`: many drives, side by side."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.evaluate.batch import (
    Drive,
    Outcome,
    earlier,
    find_drives,
    run_here,
    run_on_cluster,
)

_NARROWEST = 100  # columns of the table where there is no terminal


@click.command()
@click.argument("drives", nargs=-1, required=True, metavar="CONFIG...")
@click.option("--jobs", type=click.IntRange(1), help="At a time.  [default: one per core]")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A folder for all outputs.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key.")
@click.option("--again", is_flag=True, help="Also what an earlier batch has done.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster, e.g. tcp://host:8786.")
def batch(
    drives: tuple[str, ...],
    jobs: int | None,
    output: Path | None,
    overrides: tuple[str, ...],
    again: bool,
    scheduler: str | None,
) -> None:
    """Process many drives: configurations (patterns, quoted) that name their recordings.

    What an earlier batch did with the same settings on the same files is kept, so that a batch
    that was stopped goes on where it stood. Exit code 0: every drive has positions. 1: some have
    none, or failed. 2: a configuration is faulty (nothing is run).
    """
    found = find_drives(drives, output, overrides)
    kept = {} if again else {d.folder: o for d in found if (o := earlier(d)) is not None}
    ahead = [drive for drive in found if drive.folder not in kept]
    console = Console(stderr=True)
    if kept:
        console.print(f"{len(kept)} of {len(found)} drives were done before")
    outcomes = dict(kept)
    run = run_on_cluster(ahead, scheduler) if scheduler else run_here(ahead, jobs or _cores())
    for outcome in run:
        outcomes[outcome.folder] = outcome
        told = "done" if outcome.done else outcome.reason
        console.print(f"{len(outcomes)}/{len(found)} {outcome.name}: {told}", highlight=False)
    _print(found, outcomes)
    if not all(outcome.done for outcome in outcomes.values()):
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _cores() -> int:
    return os.cpu_count() or 1


def _print(drives: Sequence[Drive], outcomes: dict[Path, Outcome]) -> None:
    """One row per drive, in their order."""
    table = Table(title="Batch", title_justify="left")
    for name in ("drive", "recording", "epochs fixed", "first fix", "took", "outputs, or why none"):
        table.add_column(name, justify="left" if name.startswith(("drive", "out")) else "right")
    for drive in drives:
        outcome = outcomes[drive.folder]
        table.add_row(drive.name, *_figures(outcome), _took(outcome), _place(outcome))
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, _NARROWEST)
    console.print(table)


def _figures(outcome: Outcome) -> tuple[str, str, str]:
    """Length, share fixed and first fix, as the run's summary has them."""
    path = outcome.folder / "summary.json"
    if outcome.code not in (0, 1) or not path.is_file():
        return "", "", ""
    summary = json.loads(path.read_text(encoding="utf-8"))
    first_s = summary["first_fix_s"]
    return (
        f"{summary['recording_s']:.1f} s",
        f"{summary['epochs_fixed']} of {summary['epochs']}",
        "" if first_s is None else f"{first_s:.1f} s",
    )


def _took(outcome: Outcome) -> str:
    return "before" if outcome.kept else f"{outcome.seconds:.1f} s"


def _place(outcome: Outcome) -> str:
    return str(outcome.folder) if outcome.done else outcome.reason
