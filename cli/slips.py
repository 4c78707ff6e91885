"""`deepgnss slips`: cycle slips between two antennas of one vehicle, found and repaired."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import NavData
from deepgnss.deep.slips import BoolArray, State, sure
from deepgnss.evaluate.antenna_pair import AntennaPair, Places, antenna_pair
from deepgnss.evaluate.observations import read_observations
from deepgnss.evaluate.simulated_pair import FILES as SIMULATED
from deepgnss.evaluate.simulated_pair import PairFiles, simulate_pair
from deepgnss.evaluate.single_point import at_rest as at_rest_at
from deepgnss.evaluate.single_point import single_point
from deepgnss.evaluate.slip_outputs import FILES, write_repaired, write_slips
from deepgnss.evaluate.slip_trials import (
    BY_CODE,
    BY_RESIDUAL,
    OURS,
    Inserted,
    Score,
    method_scores,
    random_slips,
    with_slips,
)
from deepgnss.evaluate.slips import Expected, Slips, find_slips
from deepgnss.io.folder import prepare_folder
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import ObsFile, read_obs
from deepgnss.io.truth import read_truth
from deepgnss.sim.schema import load_scenario

_NARROWEST = 100  # columns of the tables where there is no terminal
_Vector = tuple[float, float, float]


@click.command()
@click.option("--rover", type=click.Path(path_type=Path), help="RINEX of the first antenna.")
@click.option("--second", type=click.Path(path_type=Path), help="RINEX of the second antenna.")
@click.option(
    "--nav", type=click.Path(path_type=Path), help="Broadcast RINEX NAV; default: beside the rover."
)
@click.option(
    "--attitude",
    type=click.Path(path_type=Path),
    help="Trajectory with attitude: trajectory.csv of a run, truth CSV, KF-GINS .nav.",
)
@click.option(
    "--baseline",
    nargs=3,
    type=float,
    help="m from the first antenna to the second: forward, right, down (at rest: north, east,"
    " down).",
)
@click.option(
    "--lever-arm",
    nargs=3,
    type=float,
    default=(0.0, 0.0, 0.0),
    show_default=True,
    help="m from the trajectory's point to the first antenna: forward, right, down.",
)
@click.option("--at-rest", is_flag=True, help="Antennas stand where the headers say: no attitude.")
@click.option("--week", type=click.IntRange(1, 5000), help="GPS week, for a .nav that has none.")
@click.option(
    "--mask", type=click.FloatRange(0.0, 90.0), default=10.0, show_default=True, help="deg."
)
@click.option(
    "--phase-noise",
    type=click.FloatRange(0.0, 0.1, min_open=True),
    default=Expected().phase_m,
    show_default=True,
    help="1σ of one phase with its multipath, m.",
)
@click.option(
    "--attitude-change",
    type=click.FloatRange(0.0, 45.0),
    default=round(math.degrees(Expected().attitude_radps), 2),
    show_default=True,
    help="1σ of the change of the attitude's error over 1 s, by axis, deg.",
)
@click.option(
    "--longest-gap",
    type=click.FloatRange(0.0),
    default=Expected().longest_s,
    show_default=True,
    help="s without phase across which it is still repaired.",
)
@click.option("--insert", type=click.IntRange(0), default=0, help="Put in this many random slips.")
@click.option("--hard", is_flag=True, help="Simultaneous ones, pairs and both antennas among them.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option(
    "--simulate",
    metavar="SCENARIO",
    help="Simulate both antennas of a scenario (reproduce/slips) instead of reading files.",
)
@click.option("--no-figures", is_flag=True, help="Tables only.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("slips"), show_default=True
)
def slips(
    rover: Path | None,
    second: Path | None,
    nav: Path | None,
    attitude: Path | None,
    baseline: _Vector | None,
    lever_arm: _Vector,
    at_rest: bool,
    week: int | None,
    mask: float,
    phase_noise: float,
    attitude_change: float,
    longest_gap: float,
    insert: int,
    hard: bool,
    seed: int,
    simulate: str | None,
    no_figures: bool,
    output: Path,
) -> None:
    """Find and repair cycle slips between two antennas whose baseline an INS knows.

    Writes slips.csv, both RINEX files with phases repaired, summary.json and figures. With
    --insert random slips are put into the phases first, as in a test drive, and what was found is
    held against them; no RINEX is written then. Exit code 0: phases could be tested; 1: none
    could; 2: an input cannot be used.
    """
    prepare_folder(output, (*FILES, *(SIMULATED if simulate else ())))
    if simulate is not None:
        made = simulate_pair(load_scenario(simulate, (f"seed={seed}",)), output)
        rover, second, nav, attitude = made.first, made.second, made.nav, made.attitude
        baseline = _vector(made)
    paths = _required(rover, "--rover"), _required(second, "--second")
    files = read_obs(paths[0]), read_obs(paths[1])
    known = read_nav(nav or _beside(paths[0]))
    if at_rest == (attitude is not None):
        raise InputFileError("--attitude, --at-rest: expected one of them")
    if attitude is None:
        places = _standing(paths, files, baseline, known)
    else:
        places = _moving(attitude, baseline, lever_arm, week)
    pair = antenna_pair(*files, places, known, mask)
    expected = Expected(
        phase_m=phase_noise,
        attitude_radps=0.0 if at_rest else math.radians(attitude_change),
        longest_s=longest_gap,
    )
    inserted = None
    if insert:
        inserted = random_slips(pair, insert, np.random.default_rng(seed), hard)
        pair = with_slips(pair, inserted)
    found = find_slips(pair, expected)
    counts = _methods(found, inserted)
    write_slips(output, found, _summary(found, counts, inserted), not no_figures)
    written = ["slips.csv", "summary.json"]
    if inserted is None:
        both = (paths[0], files[0]), (paths[1], files[1])
        written += [path.name for path in write_repaired(output, found, both)]
    _print(found, counts, inserted, output, written)
    if not sure(found.between).any():
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _vector(made: PairFiles) -> _Vector:
    x, y, z = made.baseline_b_m.tolist()
    return x, y, z


def _required(path: Path | None, option: str) -> Path:
    if path is None:
        raise InputFileError(f"{option}: found nothing; the RINEX of both antennas is needed")
    return path


def _beside(rover: Path) -> Path:
    """The NAV file a run of ours leaves beside its observations."""
    found = sorted(rover.parent.glob("*_MN.rnx")) + sorted(rover.parent.glob("*_[GC]N.rnx"))
    if not found:
        raise InputFileError(f"--nav: found nothing, and no *N.rnx beside {rover}")
    return found[0]


# --- where the antennas are ----------------------------------------------------------------------


def _moving(
    attitude: Path, baseline: _Vector | None, lever_arm: _Vector, week: int | None
) -> Places:
    if baseline is None:
        raise InputFileError("--baseline: found nothing; forward, right, down in m is needed")
    is_nav = attitude.suffix.lower() == ".nav"
    way = read_truth(attitude, "kfgins_nav" if is_nav else "csv", week=week)
    if way.attitude_rad is None:
        raise InputFileError(f"{attitude}: no roll_deg, pitch_deg, heading_deg: no attitude in it")
    return way.of_point(lever_arm), way.of_point(np.add(lever_arm, baseline).tolist())


def _standing(
    paths: tuple[Path, Path],
    files: tuple[ObsFile, ObsFile],
    baseline: _Vector | None,
    nav: NavData,
) -> Places:
    """Antennas at rest: the second where its header says, or at a baseline in NED."""
    first = files[0].position_e_m
    if first is None:
        first = at_rest_at(single_point(read_observations(paths[0]), nav))
    if first is None:
        raise InputFileError(f"{paths[0]}: no APPROX POSITION XYZ, and no position found")
    if baseline is None:
        if files[1].position_e_m is None:
            raise InputFileError(
                f"{paths[1]}: no APPROX POSITION XYZ in its header: give the --baseline"
            )
        return first, files[1].position_e_m
    lat_rad, lon_rad, _ = geodetic(first)
    return first, first + C_ne(lat_rad, lon_rad).T @ np.asarray(baseline)


# --- what comes out ------------------------------------------------------------------------------


class _Method(NamedTuple):
    """Slips told by one method, by band (S table 1), and its score where some were put in."""

    told: dict[str, int]
    score: Score | None


def _methods(found: Slips, inserted: Inserted | None) -> dict[str, _Method]:
    told = {
        OURS: found.between.cycles != 0.0,
        BY_CODE: found.classical.told_by_code != 0.0,
        BY_RESIDUAL: found.classical.told_by_residual,
    }
    if not np.isfinite(found.classical.residual_m).any():
        del told[BY_RESIDUAL]
    scores = method_scores(found, inserted) if inserted is not None else {}
    return {
        name: _Method(_by_band(found.pair, where), scores.get(name)) for name, where in told.items()
    }


def _by_band(pair: AntennaPair, told: BoolArray) -> dict[str, int]:
    total = {f"{signal.satellite[0]} L{signal.band}": 0 for signal in pair.signals}
    for k, signal in enumerate(pair.signals):
        total[f"{signal.satellite[0]} L{signal.band}"] += int(told[:, k].sum())
    return total


def _largest_mm(found: Slips) -> float:
    check_m = found.between.check_m[sure(found.between)]
    return 1e3 * float(np.abs(check_m[np.isfinite(check_m)]).max(initial=0.0))


def _summary(found: Slips, counts: dict[str, _Method], inserted: Inserted | None) -> dict[str, Any]:
    state = found.between.state
    told = found.shares
    return {
        "epochs": len(found.pair.time_s),
        "signals": [signal.name for signal in found.pair.signals],
        "phases": {one.name.lower(): int((state == one).sum()) for one in State},
        "slips": int((found.between.cycles != 0.0).sum()),
        "slips_on_both_antennas_alike": int(
            ((found.between.cycles == 0.0) & (told.second != 0.0)).sum()
        ),
        "scatter_beyond_expectation": found.between.scale,
        "largest_check_m": 1e-3 * _largest_mm(found),
        "methods": counts,
        "inserted": None if inserted is None else int(np.count_nonzero(inserted.between)),
    }


def _print(
    found: Slips,
    counts: dict[str, _Method],
    inserted: Inserted | None,
    output: Path,
    written: list[str],
) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _NARROWEST)
    state = found.between.state
    tested = sure(found.between) | (state == State.UNDECIDED)
    table = Table(title="Slips told", title_justify="left")
    table.add_column("method")
    bands = list(next(iter(counts.values())).told)
    scored = ("found", "false") if inserted is not None else ()
    for name in (*bands, *scored):
        table.add_column(name, justify="right")
    for method, one in counts.items():
        cells = [str(one.told[band]) for band in bands]
        if one.score is not None:
            cells += [f"{one.score.found} of {one.score.inserted}", str(one.score.false)]
        table.add_row(method, *cells)
    console.print(table)
    undecided, untested = int((state == State.UNDECIDED).sum()), int((state == State.NEW).sum())
    console.print(
        f"{int(tested.sum())} phases tested over {len(found.pair.time_s)} epochs,"
        f" {undecided} undecided, {untested} first of their arc; σ"
        f" {np.nanmedian(found.between.sigma_cycles):.3f} cycle,"
        f" scatter {found.between.scale:.2f} times what is expected"
        if tested.any()
        else "no phase could be tested: no two epochs with orbits, places and both antennas"
    )
    if np.isfinite(found.between.check_m).any():
        console.print(f"largest four-difference check: {_largest_mm(found):.1f} mm")
    console.print(f"written to {output}: {', '.join(written)}")
