"""CP-S48, CP-S33, CP-D47, CP-D35, CP-D26: double differences of carrier phase, T 6.3.

Against the true ranges; at rest, and aided on a drive with turns and braking to 2 g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.evaluate.observables import single_differences, wide
from deepgnss.evaluate.observations import wavelength_m
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, observed, recorded, with_unit
from deepgnss.sim.scenario import Emitter
from deepgnss.sim.schema import PUBLISHED, build, load_scenario
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles

BANDWIDTH_HZ: Final = 7.0
COHERENT_S: Final = 0.020
LIMIT: Final = 1.15  # of √2·σ_th
UNITS: Final = ("FSAS", "MTi-G")
_SETTINGS: Final = (
    f"tracking.carrier={{loop: pll3, bandwidth: {BANDWIDTH_HZ}, coherent: {COHERENT_S}}}",
    "output.interval=0.1",
)
_AT_REST: Final = "acquisition.doppler_max=4.0e+3"  # no satellite has more
_WEAK: Final = "acquisition.noncoherent=5"  # 33 dB-Hz found at once
_SETTLED_S: Final = 1.0  # after a satellite's first observation
_QUICK: Final = (
    *("seconds=14", "satellites.systems=[GPS]"),
    "streams=[{name: L1, format: bits2, sample_rate: 4.13e+6, bandwidth: 3.9e+6}]",
)
_ALIGNED_S: Final = 30.0  # of a drive, before it counts: gentle, and strong until
_STRONG_S: Final = 28.0
_STRONG_DBHZ: Final = 47.0
_QUICK_DRIVE_S: Final = 46.0
_SLIP_CYCLES: Final = 0.25  # by which means of neighbouring seconds differ after one


class Differences(NamedTuple):
    """Double differences of one recording."""

    sigma: pd.DataFrame  # index satellite: epochs, measured_m, largest_m, thermal_m
    cn0_dbhz: float  # mean of what the receiver reports
    lost: list[str]  # satellites with a gap, a slip or none at all


def differences(
    recording: Recording, errors: pd.DataFrame, settled_s: float = _SETTLED_S
) -> Differences:
    """σ of each satellite's phase against the highest of its system, true geometry taken off.

    Thermal σ is that of the C/N0 behind the converter: the other satellites, which the receiver
    also takes for noise, are not in it.
    """
    parts, lost = [], []
    last_ms = int(errors["time_ms"].max())
    systems: dict[str, list[Emitter]] = {}
    for emitter in recording.scenario.emitters:
        systems.setdefault(emitter.satellite[0], []).append(emitter)
    for emitters in systems.values():
        names = [emitter.satellite for emitter in emitters]
        phases = errors[errors["satellite"].isin(names)].dropna(subset=["phase_m"])
        own = _settled(phases, settled_s)
        kept = {name: rows for name, rows in own.groupby("satellite") if _unbroken(rows, last_ms)}
        lost += [name for name in names if name not in kept]
        own = own[own["satellite"].isin(list(kept))]
        reference = str(own.groupby("satellite")["elevation_deg"].mean().idxmax())
        sigma = single_differences(own, reference)[["epochs", "phase_sigma_m"]]
        off_m = _about_mean(own, reference)[sigma.index]
        slipped = [str(name) for name in sigma.index if _slips(off_m[name], str(name))]
        lost += slipped if len(slipped) < len(sigma) else [*slipped, reference]
        sigmas_m = {emitter.satellite: _thermal_m(recording, emitter) for emitter in emitters}
        thermal_m = [math.hypot(sigmas_m[str(name)], sigmas_m[reference]) for name in sigma.index]
        parts.append(sigma.assign(thermal_m=thermal_m, largest_m=off_m.abs().max()))
    table = pd.concat(parts).rename(columns={"phase_sigma_m": "measured_m"})
    return Differences(table, float(errors["cn0_dbhz"].mean()), lost)


def _settled(errors: pd.DataFrame, settled_s: float) -> pd.DataFrame:
    first = errors.groupby("satellite")["time_ms"].transform("min")
    return errors[errors["time_ms"] >= first + round(1e3 * settled_s)]


def _about_mean(errors: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Differences of unbroken phases against the reference's, less their means."""
    phase_m = wide(errors, "phase_m", sorted(set(errors["satellite"])))
    against_m = phase_m.sub(phase_m[reference], axis=0)
    return against_m - against_m.mean()


def _slips(off_m: pd.Series, satellite: str) -> int:
    """Steps against truth, whatever the receiver says of them."""
    means = off_m.groupby(off_m.index.to_numpy() // 1000).mean()
    return int((means.diff().abs() > _SLIP_CYCLES * wavelength_m(satellite)).sum())


def _unbroken(rows: pd.DataFrame, last_ms: int) -> bool:
    """Whether a satellite's phase goes on to the last epoch without gap or slip."""
    return rows["arc"].nunique() == 1 and int(rows["time_ms"].iloc[-1]) == last_ms


def behind_dbhz(recording: Recording, emitter: Emitter) -> float:
    """Last C/N0 of a satellite behind filter and converter of the stream that covers its signal."""
    offsets_hz = {
        abs(stream.front_end.centre_hz - emitter.signal.id.carrier_hz): stream.front_end
        for stream in recording.scenario.streams
    }
    return emitter.cn0_dbhz[-1][1] - loss_db(offsets_hz[min(offsets_hz)], emitter.signal.id)


def _thermal_m(recording: Recording, emitter: Emitter) -> float:
    cn0_dbhz = behind_dbhz(recording, emitter)
    cycles = pll_thermal_sigma_cycles(cn0_dbhz, BANDWIDTH_HZ, COHERENT_S)
    return cycles * wavelength_m(emitter.satellite)


def measure(scenario: str, quick: bool, seeds: Sequence[int], *settings: str) -> list[Figure]:
    """σ over all pairs and seeds, the worst pair, satellites lost; quick: 14 s of GPS, one seed."""
    runs = []
    for seed in seeds[:1] if quick else seeds:
        with recorded(scenario, seed, *(_QUICK if quick else ())) as recording:
            runs.append(
                differences(recording, observed(recording, *_SETTINGS, _AT_REST, *settings))
            )
            behind = [behind_dbhz(recording, emitter) for emitter in recording.scenario.emitters]
            tracked = len(behind)
    pairs = pd.concat([run.sigma for run in runs])
    ratio = pairs["measured_m"] / pairs["thermal_m"]
    together = float((ratio**2).mean() ** 0.5)
    # Of n nearly independent epochs; three pairs share a satellite, which costs half as much again.
    spread = math.sqrt(1.5 / (2.0 * float(pairs["epochs"].sum())))
    measured_cm, thermal_cm = (
        1e2 * float((pairs[name] ** 2).mean() ** 0.5) for name in ("measured_m", "thermal_m")
    )
    worst = ratio.groupby(level=0).apply(lambda own: float((own**2).mean() ** 0.5))
    lost = sorted({name for run in runs for name in run.lost})
    heard = sum(run.cn0_dbhz for run in runs) / len(runs)
    return [
        Figure(
            f"σ over {len(pairs)} pairs, {pairs['epochs'].sum()} epochs",
            f"{measured_cm:.4f} cm = {together:.3f} (± {spread:.3f}) · √2 σ_th"
            f" of {sum(behind) / len(behind):.1f} dB-Hz ({thermal_cm:.4f} cm)",
            together <= LIMIT,
        ),
        Figure(
            f"largest of a pair, {worst.idxmax()}",
            f"{worst.max():.3f} · √2 σ_th",
            None if quick else bool(worst.max() <= LIMIT),
        ),
        Figure("C/N0 the receiver reports", f"{heard:.1f} dB-Hz", None),
        Figure(
            "satellites lost",
            f"{len(lost)} of {tracked}" + (f": {', '.join(lost)}" if lost else ""),
            not lost,
        ),
    ]


def measure_strong(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CP-S48."""
    return measure("phase_48", quick, seeds)


def measure_weak(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CP-S33."""
    return measure("phase_33", quick, seeds, _WEAK)


class Drive(NamedTuple):
    """A row of the drive: its level, and what is asked of it."""

    dbhz: float  # behind the converter, from the time it counts
    seconds: float
    sigma_m: float = math.inf
    largest_m: float = math.inf
    ratio: float = math.inf  # to √2·σ_th
    settings: tuple[str, ...] = ()


D47: Final = Drive(47.0, 130.0, sigma_m=0.6e-3, largest_m=2.5e-3)
D35: Final = Drive(35.0, 130.0, ratio=1.2)
D26: Final = Drive(
    26.0,
    332.0,
    ratio=1.19,
    settings=("tracking.thresholds.phase=20", "tracking.thresholds.frequency=16"),
)


def measure_drive(row: Drive, quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """σ, largest and satellites lost with each unit; quick: 16 s of one seed, the lesser unit."""
    units = UNITS[-1:] if quick else UNITS
    seconds = _QUICK_DRIVE_S if quick else row.seconds
    runs: dict[str, list[Differences]] = {unit: [] for unit in units}
    for seed in seeds[:1] if quick else seeds:
        with recorded("drive", seed, f"seconds={seconds}", _levels(row.dbhz)) as recording:
            for unit in units:
                aided = (*_SETTINGS, *row.settings, *with_unit(recording, unit))
                errors = observed(recording, *aided)
                runs[unit].append(differences(recording, errors, _ALIGNED_S))
    return [figure for unit, own in runs.items() for figure in _drive_figures(row, unit, own)]


def _levels(dbhz: float) -> str:
    """A drive that begins strong: the scenario's own level, and the row's later."""
    front_end = build(load_scenario(PUBLISHED + "drive")).scenario.streams[0].front_end
    begin, later = (level + loss_db(front_end) for level in (_STRONG_DBHZ, dbhz))
    return f"satellites.schedule={{all: [[0, {begin:.3f}], [{_STRONG_S}, {later:.3f}]]}}"


def _drive_figures(row: Drive, unit: str, runs: Sequence[Differences]) -> list[Figure]:
    pairs = pd.concat([run.sigma for run in runs])
    measured_m, thermal_m = (
        float((pairs[name] ** 2).mean() ** 0.5) for name in ("measured_m", "thermal_m")
    )
    largest_m = float(pairs["largest_m"].max())
    lost = sorted({name for run in runs for name in run.lost})
    return [
        Figure(
            f"{unit}: σ over {len(pairs)} pairs, {pairs['epochs'].sum()} epochs",
            f"{1e2 * measured_m:.4f} cm = {measured_m / thermal_m:.3f} · √2 σ_th",
            measured_m <= min(row.sigma_m, row.ratio * thermal_m),
        ),
        Figure(
            f"{unit}: largest",
            f"{1e2 * largest_m:.3f} cm",
            largest_m <= row.largest_m if math.isfinite(row.largest_m) else None,
        ),
        Figure(
            f"{unit}: satellites lost or slipped",
            f"{len(lost)}" + (f": {', '.join(lost)}" if lost else ""),
            not lost,
        ),
    ]


def measure_drive_47(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CP-D47."""
    return measure_drive(D47, quick, seeds)


def measure_drive_35(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CP-D35."""
    return measure_drive(D35, quick, seeds)


def measure_drive_26(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """CP-D26."""
    return measure_drive(D26, quick, seeds)
