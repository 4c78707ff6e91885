"""`deepgnss reproduce`: the published figures beside ours."""

from __future__ import annotations

import os
from collections.abc import Sequence

import click
from rich.console import Console
from rich.table import Table

from deepgnss.evaluate.reproduce import ROWS, Figure, measured, rows_named, verdict

_MISSED = 1


@click.command()
@click.option("--only", multiple=True, metavar="ID", help="Only this row (repeatable).")
@click.option("--quick", is_flag=True, help="Fewer trials: minutes become seconds.")
@click.option(
    "--seeds",
    type=click.IntRange(1, 1000),
    default=3,
    show_default=True,
    help="Independent repetitions, seeds 1 to this.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1),
    default=os.cpu_count() or 1,
    show_default="number of cores",
    help="Processes side by side; the figures do not depend on it.",
)
def reproduce(only: tuple[str, ...], quick: bool, seeds: int, jobs: int) -> None:
    """Measure the figures of the publications again; exit code 1 when one misses its target."""
    console = Console(highlight=False)
    rows = rows_named(only)
    missed = []
    waiting = [row.id for row in rows if row.measure is None]
    with console.status("measuring"):
        for row, figures, cpu_s in measured(rows, quick, range(1, seeds + 1), jobs):
            took = f"{cpu_s:.0f}" + (f" of {row.quick_s:.0f}" if quick else "") + " CPU s"
            console.print(f"[bold]{row.id}[/]  {row.scenario}  [dim]({took})[/]")
            console.print(f"  published {row.published}; target {row.target}")
            console.print(_table(figures))
            if not verdict(figures):
                missed.append(row.id)
    if waiting:
        console.print(f"not yet ({len(waiting)} of {len(ROWS)}): {', '.join(waiting)}", style="dim")
    if missed:
        console.print(f"missed: {', '.join(missed)}", style="red")
        raise click.exceptions.Exit(_MISSED)


def _table(figures: Sequence[Figure]) -> Table:
    table = Table.grid(padding=(0, 2), pad_edge=True)
    for figure in figures:
        judged = {True: "[green]met[/]", False: "[red]missed[/]", None: ""}[figure.met]
        table.add_row(figure.what, figure.ours, judged)
    return table
