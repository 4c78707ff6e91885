"""`deepgnss regress`: a suite of runs held against limits."""

from __future__ import annotations

from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from deepgnss.evaluate.regress import read_summary, write_report
from deepgnss.evaluate.regress import regress as run_suite
from deepgnss.evaluate.suite import load_suite
from deepgnss.io.folder import prepare_folder

_MISSED = 1
_NARROWEST = 100  # columns of the table where there is no terminal


@click.command()
@click.argument("suite", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("regress"), show_default=True
)
@click.option("--baseline", type=click.Path(path_type=Path), help="An earlier summary.json.")
def regress(suite: Path, output: Path, baseline: Path | None) -> None:
    """Run the recordings and scenarios of SUITE (YAML) and check their metrics.

    Writes junit.xml, summary.md and summary.json. Exit code 0: everything holds; 1: something
    does not; 2: the suite or the baseline cannot be used.
    """
    config = load_suite(suite)
    before = read_summary(baseline) if baseline is not None else None
    prepare_folder(output, ("junit.xml", "summary.md", "summary.json"))
    console = Console(stderr=True, highlight=False)
    report = run_suite(config, output, before, lambda name: console.print(f"running {name}"))
    write_report(report, output)
    table = Table(title=config.name, title_justify="left")
    for name in ("run", "expected", "found", ""):
        table.add_column(name)
    for check in report.checks:
        verdict = "[green]holds[/]" if check.holds else "[red]failed[/]"
        table.add_row(check.run, check.what, check.found, verdict)
    screen = Console()
    if not screen.is_terminal:
        screen.width = max(screen.width, _NARROWEST)
    screen.print(table)
    screen.print(f"written: {output / 'junit.xml'}, summary.md, summary.json")
    if not report.passed:
        raise click.exceptions.Exit(_MISSED)
