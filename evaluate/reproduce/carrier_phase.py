"""CP-S48, CP-S33: double differences of carrier phase at rest against the true ranges, T 6.3."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.evaluate.observables import single_differences
from deepgnss.evaluate.observations import wavelength_m
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, observed, recorded
from deepgnss.sim.scenario import Emitter
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles

BANDWIDTH_HZ: Final = 7.0
COHERENT_S: Final = 0.020
LIMIT: Final = 1.15  # of √2·σ_th
_SETTINGS: Final = (
    f"tracking.carrier={{loop: pll3, bandwidth: {BANDWIDTH_HZ}, coherent: {COHERENT_S}}}",
    "output.interval=0.1",
    "acquisition.doppler_max=4.0e+3",  # at rest no satellite has more
)
_WEAK: Final = "acquisition.noncoherent=5"  # 33 dB-Hz found at once
_SETTLED_S: Final = 1.0  # after a satellite's first observation
_QUICK_S: Final = 14.0


class Differences(NamedTuple):
    """Double differences of one recording."""

    sigma: pd.DataFrame  # index satellite: epochs, measured_m, thermal_m
    cn0_dbhz: float  # mean of what the receiver reports
    lost: list[str]  # satellites with a gap, a slip or none at all


def differences(recording: Recording, errors: pd.DataFrame) -> Differences:
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
        own = _settled(errors[errors["satellite"].isin(names)].dropna(subset=["phase_m"]))
        kept = {name: rows for name, rows in own.groupby("satellite") if _unbroken(rows, last_ms)}
        lost += [name for name in names if name not in kept]
        own = own[own["satellite"].isin(list(kept))]
        reference = str(own.groupby("satellite")["elevation_deg"].mean().idxmax())
        sigma = single_differences(own, reference)[["epochs", "phase_sigma_m"]]
        sigmas_m = {emitter.satellite: _thermal_m(recording, emitter) for emitter in emitters}
        thermal_m = [math.hypot(sigmas_m[str(name)], sigmas_m[reference]) for name in sigma.index]
        parts.append(sigma.assign(thermal_m=thermal_m))
    table = pd.concat(parts).rename(columns={"phase_sigma_m": "measured_m"})
    return Differences(table, float(errors["cn0_dbhz"].mean()), lost)


def _settled(errors: pd.DataFrame) -> pd.DataFrame:
    first = errors.groupby("satellite")["time_ms"].transform("min")
    return errors[errors["time_ms"] >= first + round(1e3 * _SETTLED_S)]


def _unbroken(rows: pd.DataFrame, last_ms: int) -> bool:
    """Whether a satellite's phase goes on to the last epoch without gap or slip."""
    return rows["arc"].nunique() == 1 and int(rows["time_ms"].iloc[-1]) == last_ms


def behind_dbhz(recording: Recording, emitter: Emitter) -> float:
    """C/N0 of a satellite behind filter and converter of the stream that covers its signal."""
    offsets_hz = {
        abs(stream.front_end.centre_hz - emitter.signal.id.carrier_hz): stream.front_end
        for stream in recording.scenario.streams
    }
    return emitter.cn0_dbhz[0][1] - loss_db(offsets_hz[min(offsets_hz)], emitter.signal.id)


def _thermal_m(recording: Recording, emitter: Emitter) -> float:
    cn0_dbhz = behind_dbhz(recording, emitter)
    cycles = pll_thermal_sigma_cycles(cn0_dbhz, BANDWIDTH_HZ, COHERENT_S)
    return cycles * wavelength_m(emitter.satellite)


def measure(scenario: str, quick: bool, seeds: Sequence[int], *settings: str) -> list[Figure]:
    """σ over all pairs and seeds, the worst pair, satellites lost; quick: 14 s of one seed."""
    runs = []
    for seed in seeds[:1] if quick else seeds:
        short = (f"seconds={_QUICK_S}",) if quick else ()
        with recorded(scenario, seed, *short) as recording:
            runs.append(differences(recording, observed(recording, *_SETTINGS, *settings)))
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
