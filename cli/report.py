"""`deepgnss report`: the page of finished runs, made again from their folders."""

from __future__ import annotations

from pathlib import Path

import click

from deepgnss.evaluate.report.run import write_run_report


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
def report(runs: tuple[Path, ...]) -> None:
    """Write report.html of finished RUNS (output folders of `process`) again."""
    for folder in runs:
        click.echo(f"written: {write_run_report(folder)}")
