"""`deepgnss compare`: our runs and other receivers' logs side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import NavData
from deepgnss.evaluate.comparison import (
    Comparison,
    Yardstick,
)
from deepgnss.evaluate.comparison import (
    compare as held_against,
)
from deepgnss.evaluate.comparison_outputs import FILES, write_comparison
from deepgnss.evaluate.comparison_tables import Sheet, sheets
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.evaluate.observations import read_observations
from deepgnss.evaluate.outages import read_gaps
from deepgnss.evaluate.positions import read_sections
from deepgnss.evaluate.rtk import MODES, RIGHT_M
from deepgnss.evaluate.sources import Source, read_reference, read_source
from deepgnss.io.folder import prepare_folder
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs

_NARROWEST = 110  # columns of the tables where there is no terminal
_TruthKind = Literal["csv", "rtklib_pos", "kfgins_nav"]


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--log",
    "logs",
    multiple=True,
    type=click.Path(path_type=Path),
    help="UBX, NMEA, RINEX, .pos, .nav of another receiver (repeatable).",
)
@click.option("--truth", type=click.Path(path_type=Path), help="The way the antenna went.")
@click.option(
    "--truth-format",
    type=click.Choice(["csv", "rtklib_pos", "kfgins_nav"]),
    help="Default: by its ending; the positions of a .ubx or .nmea log serve too.",
)
@click.option(
    "--lever-arm",
    type=float,
    nargs=3,
    help="IMU to antenna, m forward right down: takes a .nav, whose places are the IMU's, there.",
)
@click.option(
    "--base", type=click.Path(path_type=Path), help="RINEX observations of a base station."
)
@click.option(
    "--nav", type=click.Path(path_type=Path), help="Broadcast RINEX NAV; default: a run's own."
)
@click.option(
    "--interval",
    type=click.FloatRange(0.02),
    default=1.0,
    show_default=True,
    help="s between instants compared.",
)
@click.option(
    "--mask",
    type=click.FloatRange(0.0, 90.0),
    default=10.0,
    show_default=True,
    help="Elevation, deg, of differences.",
)
@click.option(
    "--gross",
    type=click.FloatRange(0.0),
    default=GROSS_M,
    show_default=True,
    help="m, horizontal error counted as gross.",
)
@click.option(
    "--sections", type=click.Path(path_type=Path), help="CSV: name, from_tow_s, to_tow_s."
)
@click.option("--rtk", is_flag=True, help="RTK through RTKLIB's rnx2rtkp: right and wrong fixes.")
@click.option(
    "--rtk-mode",
    type=click.Choice(MODES),
    default=MODES[0],
    show_default=True,
    help="How RTKLIB resolves ambiguities.",
)
@click.option(
    "--right",
    type=click.FloatRange(0.0),
    default=RIGHT_M,
    show_default=True,
    help="m, horizontal error up to which a fix is right.",
)
@click.option(
    "--gaps",
    type=click.Path(path_type=Path),
    help="Stretches without sky: CSV as --sections, or a simulation's ranges.csv;"
    " default: gaps that all receivers have.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("compare"), show_default=True
)
def compare(
    runs: tuple[Path, ...],
    logs: tuple[Path, ...],
    truth: Path | None,
    truth_format: _TruthKind | None,
    lever_arm: tuple[float, float, float] | None,
    base: Path | None,
    nav: Path | None,
    interval: float,
    mask: float,
    gross: float,
    sections: Path | None,
    rtk: bool,
    rtk_mode: str,
    right: float,
    gaps: Path | None,
    output: Path,
) -> None:
    """Compare RUNS (folders of `process`) and logs: positions, code, carrier.

    Positions need --truth; double differences of code and carrier need --base (with --truth, or
    at the same antenna); --rtk needs both. Everything is on GPST and counted over the instants and
    satellites that all receivers have. Exit code 0: something could be compared; 1: nothing in
    common; 2: an input cannot be used.
    """
    sources = _named([*runs, *logs], lever_arm)
    if not sources:
        raise InputFileError("RUN, --log: found none; there is nothing to compare")
    yardstick = Yardstick(
        truth=read_reference(truth, truth_format, lever_arm) if truth is not None else None,
        truth_path=truth,
        base=read_observations(base) if base is not None else None,
        base_r_e_m=read_obs(base).position_e_m if base is not None else None,
        nav=_nav(nav, runs),
        interval_s=interval,
        elevation_mask_deg=mask,
        gross_m=gross,
        sections=read_sections(sections) if sections is not None else (),
        rtk_mode=rtk_mode if rtk else None,
        right_m=right,
        gaps=read_gaps(gaps, mask) if gaps is not None else (),
    )
    found = held_against(sources, yardstick)
    prepare_folder(output, FILES)
    write_comparison(found, output)
    _print(found, output)
    if not any(one.compared for one in found.positions.values()) and not any(
        len(table) for table in found.observations.values()
    ):
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _named(paths: Iterable[Path], lever_arm_m: tuple[float, float, float] | None) -> list[Source]:
    """Sources with names that differ."""
    sources: list[Source] = []
    for path in paths:
        source = read_source(path, lever_arm_m=lever_arm_m)
        if any(source.name == other.name for other in sources):
            source = source._replace(name=f"{path.resolve().parent.name}/{source.name}")
        sources.append(source)
    return sources


def _nav(nav: Path | None, runs: Iterable[Path]) -> NavData:
    """The NAV file given, or what the first run that has one decoded."""
    if nav is not None:
        return read_nav(nav)
    for run in runs:
        for path in sorted(run.glob("*N.rnx")):
            return read_nav(path)
    return NavData()


def _print(found: Comparison, output: Path) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _NARROWEST)
    for note in found.notes:
        console.print(f"note: {note}", markup=False)
    for sheet in sheets(found):
        console.print(_table(sheet))
    console.print(f"written: {output}", markup=False)


def _table(sheet: Sheet) -> Table:
    table = Table(title=Text(sheet.title), title_justify="left", caption=Text(sheet.note) or None)
    for place, name in enumerate(sheet.head):
        table.add_column(Text(name), justify="left" if place < sheet.words else "right")
    for row in sheet.rows:
        table.add_row(*map(Text, row))
    return table
