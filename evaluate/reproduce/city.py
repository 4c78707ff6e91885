"""CITY-PR, CITY-RTK, CITY-EXIT: a drive through a city, with and without aiding, T 6.6.

Positions are the receiver's own, differential by the ranges of a base station. Unaided they are
the adjustment of a tag's ranges; aided, of those and of the antenna as the inertial navigation
expects it. Fixed is, in every run, a tag with at least one satellite in its position and a
horizontal 1σ of at most 10 m: without aid that takes four satellites. Tags count from when the
last run has its first position: how long a start takes is another row's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.core.records import NavSolution
from deepgnss.deep.placing import horizontal_sigma_m
from deepgnss.evaluate.metrics import GROSS_M
from deepgnss.evaluate.reproduce.city_rtk import added, counted
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started
from deepgnss.evaluate.rtk import Shares
from deepgnss.receiver.receiver import Fix

RUNS: Final[Mapping[str, tuple[str, ...]]] = {
    "unaided, no RAIM": ("deep=false", "positioning.raim=false"),
    "unaided": ("deep=false",),
    "aided, loose": ("deep.coupling=loose",),
    "aided, tight": ("deep.coupling=tight",),
}
PLAIN, FULL, *AIDED = RUNS
RATIOS: Final = (3.61 / 0.80, 1.50 / 0.93, 0.89 / 0.69, 9.25 / 2.90)  # σ N, σ E, CEP, gross
FIXED: Final = 0.995
FIXED_SIGMA_M: Final = 10.0
EXIT_S: Final = 1.0
RTK_GAIN: Final = 1.3  # right fixes over those of the unaided run

_SETTINGS: Final = (
    "output.interval=0.1",
    "tracking.code.spacing=0.1",
    "positioning.outliers.threshold=3.0",
)
_TAGS_HZ: Final = 10
_QUICK: Final = (
    *("seconds=46", "satellites.systems=[GPS]", "satellites.limit=9"),
    "streams=[{name: L1, format: bits2, sample_rate: 5.23e6, centre_frequency: 1575.42e6}]",
)
_QUICK_RUNS: Final = (FULL, AIDED[-1])
_DARK_S: Final = 2.0  # without a single satellite: a tunnel
_NEEDED: Final = 4  # unblocked satellites with which a fix is due


class Drive(NamedTuple):
    """One recording: what was in sight at every tag, and the runs' tables by name."""

    unblocked: pd.Series  # satellites above the mask in sight, by tag
    runs: dict[str, pd.DataFrame]  # index tag: satellites used, errors north_m, east_m where fixed
    rtk: Mapping[str, Shares | None] = {}  # None: RTKLIB is not installed


@cache
def drive(seed: int, quick: bool) -> Drive:
    """All runs over one recording; every seed has a sky of its own."""
    settings = [f"start=2023-11-30T{(9 + 5 * seed) % 24:02d}:10:38Z"]
    settings += _QUICK if quick else ()
    with recorded("city", seed, *settings) as recording:
        truth = _truth(recording)
        mask_deg = 10.0
        seen = pd.read_csv(recording.folder / "ranges.csv")
        seen = seen[(seen["visible"] == 1) & (seen["el_deg"] >= mask_deg)]
        unblocked = seen.groupby(_tags(seen["tow"]))["satellite"].nunique()
        unblocked = unblocked.reindex(truth.index, fill_value=0)
        runs, rtk = {}, {}
        for name in _QUICK_RUNS if quick else RUNS:
            fixes = _fixes(recording, RUNS[name])
            runs[name] = _table(fixes, truth)
            rtk[name] = counted(recording.folder, fixes, 1.0 / _TAGS_HZ)
    return Drive(unblocked, runs, rtk)


def _tags(tow_s: pd.Series) -> pd.Series:
    return (tow_s * _TAGS_HZ).round().astype(int)


def _truth(recording: Recording) -> pd.DataFrame:
    """ECEF position of the antenna at the tags."""
    rows = pd.read_csv(recording.folder / "truth.csv")
    tags = rows["gps_tow_s"] * _TAGS_HZ
    rows = rows[(tags - tags.round()).abs() < 1e-6]
    angles = np.radians(rows[["lat_deg", "lon_deg"]].to_numpy())
    heights = rows["height_m"].to_numpy()
    places = [ecef(lat, lon, height) for (lat, lon), height in zip(angles, heights, strict=True)]
    return pd.DataFrame(places, index=_tags(rows["gps_tow_s"]).to_numpy())


def _fixes(recording: Recording, settings: Sequence[str]) -> list[Fix]:
    base = f"positioning.base={recording.folder / 'base.obs'}"
    with started(recording, base, *_SETTINGS, *settings) as (_, _, engine):
        return [fix for result in engine.steps() for fix in result.fixes if fix.output]


def _table(fixes: Sequence[Fix], truth: pd.DataFrame) -> pd.DataFrame:
    rows = {}
    for fix in fixes:
        tag, own = round(fix.epoch.time.tow_s * _TAGS_HZ), fix.solution
        if tag not in truth.index or not _is_fixed(own):
            continue
        r_e_m = truth.loc[tag].to_numpy()
        lat_rad, lon_rad, _ = geodetic(r_e_m)
        north_m, east_m, _ = C_ne(lat_rad, lon_rad) @ (own.r_e_m - r_e_m)
        rows[tag] = (len(own.used), north_m, east_m)
    columns = ["used", "north_m", "east_m"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns).reindex(truth.index)
    return table.assign(used=table["used"].fillna(0))


def _is_fixed(solution: NavSolution) -> bool:
    return (
        solution.valid
        and len(solution.used) > 0
        and horizontal_sigma_m(solution.covariance_m2, solution.r_e_m) <= FIXED_SIGMA_M
    )


# --- figures -------------------------------------------------------------------------------------


class Spread(NamedTuple):
    """Columns of T table 6.10."""

    north_m: float
    east_m: float
    cep_m: float
    gross: float
    fixed: float

    def __str__(self) -> str:
        shares = f"{100 * self.fixed:.1f} % fixed, {100 * self.gross:.2f} % gross"
        return f"{self.north_m:.2f} / {self.east_m:.2f} m, CEP {self.cep_m:.2f} m, {shares}"


def spreads(drives: Sequence[Drive]) -> dict[str, Spread]:
    """Errors over the epochs that all runs have, fixes over all with enough satellites in sight."""
    due = [_due(d) for d in drives]
    shared = [
        own & np.logical_and.reduce([run["north_m"].notna().to_numpy() for run in d.runs.values()])
        for own, d in zip(due, drives, strict=True)
    ]
    found = {}
    for name in drives[0].runs:
        parts = [d.runs[name] for d in drives]
        errors = pd.concat([part[rows] for part, rows in zip(parts, shared, strict=True)])
        have = pd.concat([part["north_m"][rows] for part, rows in zip(parts, due, strict=True)])
        off_m = np.hypot(errors["north_m"], errors["east_m"])
        found[name] = Spread(
            float(errors["north_m"].std()),
            float(errors["east_m"].std()),
            float(off_m.median()),
            float((off_m > GROSS_M).mean()),
            float(have.notna().mean()),
        )
    return found


def _due(seen: Drive) -> NDArray[np.bool_]:
    """Tags with enough satellites in sight, from when every run has begun."""
    begun = [run["north_m"].notna().cummax().to_numpy() for run in seen.runs.values()]
    return np.asarray(np.logical_and.reduce([(seen.unblocked >= _NEEDED).to_numpy(), *begun]))


def _judged(own: Spread, plain: Spread, full: Spread) -> tuple[str, bool]:
    ratios = [a / b if b else np.inf for a, b in zip(plain[:4], own[:4], strict=True)]
    better = all(a < b or a == b == 0.0 for a, b in zip(own[:4], full[:4], strict=True))
    met = (
        all(have >= asked for have, asked in zip(ratios, RATIOS, strict=True))
        and better
        and own.fixed >= max(FIXED, full.fixed)
    )
    return f"{own}; ratios {', '.join(f'{ratio:.2f}' for ratio in ratios)}", met


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CITY-PR; quick: GPS to the end of the first tunnel, one seed, tight coupling."""
    drives = [drive(seed, quick) for seed in (seeds[:1] if quick else seeds)]
    found = spreads(drives)
    others = [name for name in (PLAIN, FULL) if name in found]
    figures = [Figure(f"{name}: σ N / E", str(found[name]), None) for name in others]
    for name in [name for name in AIDED if name in found]:
        text, met = _judged(found[name], found[others[0]], found[FULL])
        figures.append(Figure(f"{name}: σ N / E", text, None if quick else met))
    return figures


def exits_s(seen: Drive, name: str) -> list[float]:
    """After every tunnel, time from enough satellites in sight to the first fix with as many."""
    tags, count = seen.unblocked.index.to_numpy(), seen.unblocked.to_numpy()
    fixed = (seen.runs[name]["used"] >= _NEEDED).to_numpy()
    waits, dark_since = [], None
    for k, number in enumerate(count):
        if number == 0:
            dark_since = k if dark_since is None else dark_since
        elif dark_since is not None and number >= _NEEDED:
            if k - dark_since >= _DARK_S * _TAGS_HZ:
                later = np.flatnonzero(fixed[k:])
                end = float(tags[k + later[0]]) if later.size else np.inf
                waits.append((end - float(tags[k])) / _TAGS_HZ)
            dark_since = None
    return waits


def measure_exit(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CITY-EXIT."""
    drives = [drive(seed, quick) for seed in (seeds[:1] if quick else seeds)]
    figures = []
    for name in [name for name in (FULL, *AIDED) if name in drives[0].runs]:
        waits_s = [wait for one in drives for wait in exits_s(one, name)]
        longest_s = max(waits_s, default=np.inf)
        met = None if name == FULL else longest_s <= EXIT_S
        figures.append(
            Figure(
                f"{name}, {len(waits_s)} tunnels",
                f"mean {np.mean(waits_s):.2f} s, longest {longest_s:.1f} s",
                met,
            )
        )
    return figures


def measure_rtk(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CITY-RTK; quick: as CITY-PR."""
    drives = [drive(seed, quick) for seed in (seeds[:1] if quick else seeds)]
    judged = [name for name in (FULL, *AIDED) if name in drives[0].rtk]
    parts = {name: [one.rtk[name] for one in drives] for name in judged}
    found = {
        name: added([one for one in own if one is not None])
        for name, own in parts.items()
        if None not in own
    }
    if not found:
        return [Figure("RTKLIB", "not installed (Debian, Ubuntu: apt install rtklib)", None)]
    alone = found[FULL].right
    figures = []
    for name, own in found.items():
        ratio = own.right / alone if alone else np.inf if own.right else 0.0
        of = f"right {own.right} of {own.right + own.wrong} fixes, {own.epochs} tags"
        met = None if name == FULL or quick else ratio >= RTK_GAIN
        figures.append(Figure(name, of if name == FULL else f"{of}; {ratio:.2f} × unaided", met))
    return figures
