"""`deepgnss reproduce`: the published figures beside ours."""

from __future__ import annotations

import time
from collections.abc import Sequence

import click
from rich.console import Console
from rich.table import Table

from deepgnss.evaluate.reproduce import ROWS, Figure, rows_named, verdict

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
def reproduce(only: tuple[str, ...], quick: bool, seeds: int) -> None:
    """Measure the figures of the publications again; exit code 1 when one misses its target."""
    console = Console(highlight=False)
    rows = rows_named(only)
    missed = []
    waiting = [row.id for row in rows if row.measure is None]
    for row in rows:
        if row.measure is None:
            continue
        with console.status(row.id):
            began = time.perf_counter()
            figures = row.measure(quick, range(1, seeds + 1))
            took_s = time.perf_counter() - began
        console.print(f"[bold]{row.id}[/]  {row.scenario}  [dim]({took_s:.0f} s)[/]")
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
