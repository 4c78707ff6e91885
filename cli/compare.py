"""`deepgnss compare`: our runs and other receivers' logs side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import click
import pandas as pd
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import NavData
from deepgnss.evaluate.comparison import (
    Comparison,
    Yardstick,
    read_sections,
)
from deepgnss.evaluate.comparison import (
    compare as held_against,
)
from deepgnss.evaluate.comparison_outputs import FILES, write_comparison
from deepgnss.evaluate.double_differences import usual_sigma
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.evaluate.observations import read_observations
from deepgnss.evaluate.rtk import MODES, RATIO, RIGHT_M, Fixes
from deepgnss.evaluate.sources import Source, read_source
from deepgnss.io.folder import prepare_folder
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import read_truth

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
    default="csv",
    show_default=True,
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
    "-o", "--output", type=click.Path(path_type=Path), default=Path("compare"), show_default=True
)
def compare(
    runs: tuple[Path, ...],
    logs: tuple[Path, ...],
    truth: Path | None,
    truth_format: _TruthKind,
    base: Path | None,
    nav: Path | None,
    interval: float,
    mask: float,
    gross: float,
    sections: Path | None,
    rtk: bool,
    rtk_mode: str,
    right: float,
    output: Path,
) -> None:
    """Compare RUNS (folders of `process`) and logs: positions, code, carrier.

    Positions need --truth; double differences of code and carrier need --base (with --truth, or
    at the same antenna); --rtk needs both. Everything is on GPST and counted over the instants and
    satellites that all receivers have. Exit code 0: something could be compared; 1: nothing in
    common; 2: an input cannot be used.
    """
    sources = _named([*runs, *logs])
    if not sources:
        raise InputFileError("RUN, --log: found none; there is nothing to compare")
    yardstick = Yardstick(
        truth=read_truth(truth, truth_format) if truth is not None else None,
        base=read_observations(base) if base is not None else None,
        base_r_e_m=read_obs(base).position_e_m if base is not None else None,
        nav=_nav(nav, runs),
        interval_s=interval,
        elevation_mask_deg=mask,
        gross_m=gross,
        sections=read_sections(sections) if sections is not None else (),
        rtk_mode=rtk_mode if rtk else None,
        right_m=right,
    )
    found = held_against(sources, yardstick)
    prepare_folder(output, FILES)
    write_comparison(found, output)
    _print(found, output)
    if not any(one.compared for one in found.positions.values()) and not any(
        len(table) for table in found.observations.values()
    ):
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _named(paths: Iterable[Path]) -> list[Source]:
    """Sources with names that differ."""
    sources: list[Source] = []
    for path in paths:
        source = read_source(path)
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
        console.print(f"note: {note}")
    if found.positions:
        console.print(_positions(found))
    if found.sections:
        console.print(_sections(found.sections))
    for name, table in found.observations.items():
        console.print(_observations(name, table))
    if found.clocks:
        console.print(_clocks(found))
    if found.rtk.shares:
        console.print(_fixes(found.rtk))
    console.print(f"written: {output}")


def _positions(found: Comparison) -> Table:
    table = Table(title="Positions against truth", title_justify="left")
    table.add_column("receiver")
    for name in ("fixed", "gap", "σ N", "σ E", "σ D", "RMS", "CEP50", "CEP95", "gross"):
        table.add_column(name, justify="right")
    for name, one in found.positions.items():
        metres = (one.north_std_m, one.east_std_m, one.down_std_m, one.horizontal_rms_m)
        table.add_row(
            name,
            f"{100.0 * one.fixed_share:.1f} % of {one.epochs}",
            f"{one.longest_gap_s:g} s",
            *(f"{x:.2f} m" for x in (*metres, one.cep50_m, one.cep95_m)),
            f"{100.0 * one.gross_share:.2f} %",
        )
    compared = next(iter(found.positions.values())).compared
    table.caption = f"errors over the {compared} instants at which all have one; gap: the longest"
    return table


def _sections(sections: Mapping[str, Mapping[str, float]]) -> Table:
    table = Table(title="Share of instants with a position", title_justify="left")
    table.add_column("section")
    for name in next(iter(sections.values())):
        table.add_column(name, justify="right")
    for section, shares in sections.items():
        table.add_row(section, *(f"{100.0 * share:.1f} %" for share in shares.values()))
    return table


def _observations(name: str, found: pd.DataFrame) -> Table:
    table = Table(title=f"{name}: double differences", title_justify="left")
    for column in ("satellite", "against"):
        table.add_column(column)
    for column in ("epochs", "code σ", "code mean", "phase σ", "phase max", "slips"):
        table.add_column(column, justify="right")
    for satellite, row in found.iterrows():
        table.add_row(
            str(satellite),
            str(row["reference"]),
            str(int(row["epochs"])),
            f"{row['code_sigma_m']:.3f} m",
            f"{row['code_mean_m']:+.3f} m",
            f"{100.0 * row['phase_sigma_m']:.3f} cm",
            f"{100.0 * row['phase_max_m']:.3f} cm",
            str(int(row["slips"])),
        )
    if len(found):
        code_m, phase_m = usual_sigma(found, "code_sigma_m"), usual_sigma(found, "phase_sigma_m")
        table.caption = f"together: code {code_m:.3f} m, phase {100.0 * phase_m:.3f} cm"
    return table


def _clocks(found: Comparison) -> Table:
    table = Table(title="Clock against the base (delays of cables in it)", title_justify="left")
    table.add_column("receiver")
    for name in ("median", "σ of one", "differences"):
        table.add_column(name, justify="right")
    for name, clock in found.clocks.items():
        table.add_row(
            name, f"{clock.median_m:+.3f} m", f"{clock.sigma_m:.3f} m", str(clock.differences)
        )
    return table


def _fixes(rtk: Fixes) -> Table:
    table = Table(title="RTK by RTKLIB", title_justify="left")
    table.add_column("receiver")
    for name in ("instants", "right", "wrong", "float", "without", "RMS of the right"):
        table.add_column(name, justify="right")
    for name, one in rtk.shares.items():
        counts = (one.right, one.wrong, one.floating, one.without)
        table.add_row(
            name,
            str(one.epochs),
            *(f"{count} ({100.0 * count / max(one.epochs, 1):.1f} %)" for count in counts),
            f"{100.0 * one.right_rms_m:.2f} cm",
        )
    table.caption = f"fixed: ratio above {RATIO:g}"
    return table
