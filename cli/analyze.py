"""`deepgnss analyze`: error budgets of loops, open loop and discriminators from theory."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click
import pandas as pd
from rich.console import Console
from rich.table import Table

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import SIGNAL_IDS
from deepgnss.evaluate.analysis.budgets import (
    Budget,
    closed_loop,
    discriminator,
    jitter,
    open_loop,
    peaks,
)
from deepgnss.evaluate.analysis.figures import draw
from deepgnss.evaluate.analysis.published import AGREEMENT, PublishedFigure, published_figures
from deepgnss.evaluate.analysis.subject import Subject, subject_of
from deepgnss.io.config import grade_of, load_config, oscillator_of
from deepgnss.io.config.receiver import MAX_LOOP_PRODUCT
from deepgnss.io.folder import prepare_folder
from deepgnss.io.output import write_whole

_MISSED = 1
_NARROWEST = 118  # columns of the tables where there is no terminal
_WIDE = 200
_LEVELS_DBHZ = tuple(float(x) for x in range(20, 51, 5))
_PEAKS_DBHZ = tuple(float(x) for x in range(10, 27))
_CLOSED_S, _OPEN_S, _WINDOWS_S = 1.0, 20.0, 1.0
_TRIALS = 3000
_ENDINGS = (".csv", "_table.csv", ".png")  # curves, what the screen shows, picture
_Command = TypeVar("_Command", bound=Callable[..., Any])
_ABOVE = click.FloatRange(0.0, min_open=True)
_OPTIONS = {
    "imu": click.option(
        "--imu", "grade", help="Inertial unit: a name in configs/imu, or a YAML file."
    ),
    "oscillator": click.option(
        "--oscillator", help="A name in configs/oscillators, or a YAML file."
    ),
    "signal": click.option("--signal", type=click.Choice(list(SIGNAL_IDS))),
    "order": click.option("--order", type=click.IntRange(2, 3), help="Order of the carrier loop."),
    "bandwidth": click.option(
        "--bandwidth", "bandwidth_hz", type=_ABOVE, help="Of the carrier loop, one-sided, Hz."
    ),
    "damping": click.option("--damping", type=_ABOVE, help="Of order 2; T 4.4.3 takes 1."),
    "coherent": click.option(
        "--coherent", "coherent_s", type=_ABOVE, help="Coherent time of the carrier loop, s."
    ),
    "cn0": click.option("--cn0", "cn0_dbhz", type=float, help="Signal, dB-Hz."),
    "acceleration": click.option(
        "--acceleration", "across_mps2", type=float, help="Level, across the line of sight, m/s²."
    ),
    "along": click.option(
        "--along", "along_mps2", type=float, help="Level acceleration along the sight, m/s²."
    ),
    "jerk": click.option(
        "--jerk", "jerk_mps3", type=float, help="Towards the satellite, of unaided loops, m/s³."
    ),
    "elevation": click.option(
        "--elevation", type=click.FloatRange(0.0, 90.0), help="Of the satellite, deg."
    ),
    "satellites": click.option(
        "--satellites", type=click.IntRange(1), help="Whose phases told the clock before."
    ),
    "interval": click.option(
        "--interval", "interval_s", type=_ABOVE, help="One sum of the discriminator, s."
    ),
    "window": click.option(
        "--window", "window_s", type=_ABOVE, help="Window of the discriminator, s."
    ),
    "lines": click.option("--lines", type=click.IntRange(1), help="Lines searched; default all."),
    "vibration": click.option(
        "--vibration",
        "vibration_g2phz",
        type=click.FloatRange(0.0),
        help="One-sided density, g²/Hz; needs the oscillator's g_sensitivity.",
    ),
    "spacing": click.option(
        "--spacing", "spacing_chips", type=click.FloatRange(0.01, 1.9), help="Early to late, chips."
    ),
    "front-end": click.option(
        "--front-end", "front_end_hz", type=_ABOVE, help="Two-sided bandwidth, Hz."
    ),
}
_MOTION = ("imu", "signal", "acceleration", "along", "elevation")
_LOOP = ("order", "bandwidth")
_DISCRIMINATOR = ("interval", "window", "lines")


def _options(*names: str) -> Callable[[_Command], _Command]:
    """The options of these names, and --config, --set, -o."""
    whole = (
        click.option(
            "--config",
            "config_file",
            type=click.Path(path_type=Path),
            help="Unit, oscillator and loops of a run; options go before it.",
        ),
        click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE"),
        click.option(
            "-o", "--output", type=click.Path(path_type=Path), help="Folder for CSV and PNG."
        ),
    )

    def decorate(command: _Command) -> _Command:
        for option in reversed((*(_OPTIONS[name] for name in names), *whole)):
            command = option(command)
        return command

    return decorate


@click.group()
def analyze() -> None:
    """Error budgets: what theory says of loops, open loop and discriminators.

    The unit, the oscillator and the loops come from options, or from the configuration of a run
    (--config). Each command prints a table and, with -o, writes CSV and PNG.
    """


@analyze.command("closed-loop")
@_options(*_MOTION, *_LOOP, "damping", "jerk")
@click.option("--seconds", type=_ABOVE, default=_CLOSED_S, show_default=True)
def closed_loop_command(seconds: float, **told: Any) -> None:
    """Phase error that a wrong aiding leaves in a closed carrier loop, T 4.4."""
    subject, output = _subject(told)
    _finish([closed_loop(subject, seconds)], output)


@analyze.command("open-loop")
@_options(*_MOTION, "oscillator", "cn0", "satellites", *_LOOP, "coherent", *_DISCRIMINATOR)
@click.option("--seconds", type=_ABOVE, default=_OPEN_S, show_default=True)
def open_loop_command(seconds: float, **told: Any) -> None:
    """Phase, frequency and code with nothing received, and how long to trust them, T 4.5."""
    subject, output = _subject(told)
    _finish([open_loop(subject, seconds)], output)


@analyze.command("discriminator")
@_options(*_MOTION, *_DISCRIMINATOR)
@click.option("--seconds", type=_ABOVE, default=_WINDOWS_S, show_default=True)
def discriminator_command(seconds: float, **told: Any) -> None:
    """Motion that the FFT discriminator bears, alone and aided, T 4.6."""
    subject, output = _subject(told)
    _finish([discriminator(subject, seconds)], output)


@analyze.command("jitter")
@_options("oscillator", "signal", *_LOOP, "coherent", "cn0", "along", "jerk", "elevation",
          "vibration", "spacing", "front-end")  # fmt: skip
def jitter_command(**told: Any) -> None:
    """Thermal noise, vibration, oscillator and lag of the loops, T 2.2.5, K 1, L 1.3."""
    subject, output = _subject(told)
    _finish([jitter(subject, _LEVELS_DBHZ)], output)


@analyze.command("peaks")
@click.option("--trials", type=click.IntRange(1), default=_TRIALS, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder for CSV and PNG.")
def peaks_command(trials: int, seed: int, output: Path | None) -> None:
    """How often the largest line of a spectrum is the right one, T figure 3.4."""
    _finish([peaks(_PEAKS_DBHZ, trials, seed)], output)


@analyze.command("all")
@_options(*_OPTIONS)
def all_command(**told: Any) -> None:
    """Every budget of a run's configuration."""
    subject, output = _subject(told)
    budgets = [
        closed_loop(subject, _CLOSED_S),
        open_loop(subject, _OPEN_S),
        discriminator(subject, _WINDOWS_S),
        jitter(subject, _LEVELS_DBHZ),
        peaks(_PEAKS_DBHZ, _TRIALS, 1),
    ]
    _finish(budgets, output)


@analyze.command("published")
@click.option("--runs", type=click.IntRange(2), default=10_000, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder for CSV.")
def published_command(runs: int, seed: int, output: Path | None) -> None:
    """Published values, ours, and a simulation side by side; exit code 1 when it disagrees.

    The simulation puts drawn errors on the readings of a unit, RUNS times, and runs strapdown
    navigation and loop step by step.
    """
    console = _console(_WIDE)
    with console.status("simulated"):
        figures = published_figures(runs, seed)
    console.print(_published_table(figures))
    if output is not None:
        prepare_folder(output, ["published.csv"])
        columns = [*PublishedFigure._fields, "follows", "confirmed"]
        rows = [[*figure, figure.follows, figure.confirmed] for figure in figures]
        _write_csv(output / "published.csv", pd.DataFrame(rows, columns=columns))
    apart = [figure.what for figure in figures if not figure.confirmed]
    for what in apart:
        console.print(f"simulation off by more than {100 * AGREEMENT:g} %: {what}", style="red")
    if apart:
        raise click.exceptions.Exit(_MISSED)


# --- what is asked, what is shown -----------------------------------------------------------------


def _subject(told: dict[str, Any]) -> tuple[Subject, Path | None]:
    """The config's, with what the options say instead."""
    output, config_file, overrides = (
        told.pop(name) for name in ("output", "config_file", "overrides")
    )
    subject = Subject()
    if config_file is not None or overrides:
        subject = subject_of(load_config(config_file, overrides, check_files=False))
    given = {name: value for name, value in told.items() if value is not None}
    if "grade" in given:
        given["grade"] = grade_of(given["grade"])
    if "oscillator" in given:
        given["oscillator"] = oscillator_of(given["oscillator"])
    if "signal" in given:
        given["signal"] = SIGNAL_IDS[given["signal"]]
    if "elevation" in given:
        given["elevation_rad"] = math.radians(given.pop("elevation"))
    subject = replace(subject, **given)
    if subject.damping is not None and subject.order != 2:
        raise ConfigError(f"--damping: order {subject.order} has none (--order 2)")
    product = subject.bandwidth_hz * subject.coherent_s
    if "coherent_s" in told and product > MAX_LOOP_PRODUCT:
        raise ConfigError(
            f"--bandwidth {subject.bandwidth_hz:g}: expected at most"
            f" {MAX_LOOP_PRODUCT / subject.coherent_s:g} Hz with updates every"
            f" {subject.coherent_s:g} s (--coherent)"
        )
    if subject.interval_s > subject.window_s:
        raise ConfigError(
            f"--interval {subject.interval_s:g}: longer than the window ({subject.window_s:g} s)"
        )
    return subject, output


def _finish(budgets: Sequence[Budget], output: Path | None) -> None:
    console = _console()
    if output is not None:
        names = [budget.name + ending for budget in budgets for ending in _ENDINGS]
        prepare_folder(output, names)
    for budget in budgets:
        console.print(f"[bold]{budget.title}[/]")
        console.print(_facts(budget))
        console.print(_table(budget.table))
        if output is not None:
            _write_csv(output / f"{budget.name}.csv", budget.curves)
            _write_csv(output / f"{budget.name}_table.csv", budget.table)
            draw(output / f"{budget.name}.png", budget)
    if output is not None:
        console.print(f"written to {output}", soft_wrap=True)


def _console(narrowest: int = _NARROWEST) -> Console:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, narrowest)
    return console


def _write_csv(path: Path, frame: pd.DataFrame) -> None:
    write_whole(path, frame.to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def _facts(budget: Budget) -> Table:
    grid = Table.grid(padding=(0, 2), pad_edge=True)
    for what, value in budget.facts:
        grid.add_row(what, value)
    return grid


def _table(frame: pd.DataFrame) -> Table:
    table = Table(box=None, padding=(0, 1))
    for name in frame.columns:
        text = frame[name].dtype == object
        table.add_column(str(name), justify="left" if text else "right")
    for row in frame.itertuples(index=False):
        table.add_row(*(_cell(value) for value in row))
    return table


def _cell(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "no limit"
    size = abs(value)
    return f"{value:.0f}" if size >= 1000.0 else f"{value:.4g}" if size >= 1e-3 else f"{value:.1e}"


def _published_table(figures: Sequence[PublishedFigure]) -> Table:
    table = Table(box=None, padding=(0, 1))
    for name in ("source", "what"):
        table.add_column(name)
    for name in ("published", "its formulas", "ours", "simulated", "unit"):
        table.add_column(name, justify="right" if name != "unit" else "left")
    table.add_column("")
    for one in figures:
        sign = "" if one.relation == "=" else f"{one.relation} "
        note = one.note if one.follows else f"does not follow: {one.note}"
        table.add_row(
            one.source,
            one.what,
            f"{sign}{one.published:g}",
            *(_cell(float(value)) for value in (one.formulas, one.ours, one.simulated)),
            one.unit,
            note,
        )
    return table
