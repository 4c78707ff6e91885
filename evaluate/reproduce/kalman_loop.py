"""KF-STAT, KF-DYN: a Kalman carrier loop against PLLs on the same recordings, K 3.1, 3.2.

K holds largest errors of position and speed against each other: 8 → 5 m and 0.1 → 0.05 m/s at
rest, 60 → 40 m and 6 → 5 m/s with accelerations to 20 g. The latter are a delay: 60 m at some
2000 m/s and 6 m/s at 196 m/s² are both 30 ms, whatever the noise. Positions by ranges say nothing
of a carrier loop here, since the code loop takes only its mean frequency: they are shown. What it
makes is held to those ratios: positions by phases (ambiguities as at rest) and speeds by Doppler,
north and east by least squares over the same satellites.

All loops have the same coherent time, and the PLLs order 3: one of order 2 and 20 Hz would be 0.7
cycle behind at 20 g.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray
from deepgnss.evaluate.reproduce.sampled_truth import SampledTruth
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started

PLLS_HZ: Final = (10.0, 20.0)
_COMMON: Final = ("output.interval=0.1", "oscillator=OCXO")
_WAVELENGTH_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
_FEWEST: Final = 5
_SETTLED_S: Final = 6.0


class Scene(NamedTuple):
    """A recording, from when on it counts, and how it moves."""

    scenario: str
    rest_s: float  # until which it stands: phases there tell their ambiguities
    counts_s: float
    quick_s: float
    dynamics_mps2: float
    position: float  # the Kalman loop's largest error against the PLL's, as published …
    speed: float  # … of speed


STATIC: Final = Scene("kalman_static", np.inf, 6.0, 12.0, 0.003, 5.0 / 8.0, 0.05 / 0.1)
DYNAMIC: Final = Scene("kalman_dynamic", 10.0, 11.0, 18.0, 3.0, 40.0 / 60.0, 5.0 / 6.0)


class Errors(NamedTuple):
    """Root mean squares over epochs, north and east together."""

    phase_m: float
    speed_mps: float
    range_m: float
    held: float  # share of phases that are there and of one arc

    def lost(self) -> bool:
        """Whether the loop did not hold."""
        return not self.held >= 0.99


def pll(bandwidth_hz: float, coherent_s: float = 0.020) -> tuple[str, ...]:
    """Settings of a PLL."""
    loop = f"loop: pll3, bandwidth: {bandwidth_hz:g}, coherent: {coherent_s:g}"
    return f"tracking.carrier={{{loop}}}", f"tracking.code.coherent={coherent_s:g}"


def kalman(dynamics_mps2: float) -> tuple[str, ...]:
    """Settings of the Kalman loop."""
    return (f"tracking.carrier={{loop: kalman, kalman: {{dynamics: {dynamics_mps2:g}}}}}",)


def tracked(recording: Recording, *settings: str) -> pd.DataFrame:
    """All observations less the truth, by time_s and satellite: range_m, phase_m, speed_mps; arc.

    Receiver clock and ambiguities are still in them.
    """
    truth, rows = SampledTruth(recording), []
    with started(recording, *_COMMON, *settings) as run:
        for result in run.engine.steps():
            for epoch in (fix.epoch for fix in result.fixes if fix.output):
                time_s = round(epoch.time.since(truth.start), 3)
                for seen in epoch.observations:
                    perfect = truth.perfect(seen.satellite, epoch.instant)
                    if perfect is not None:
                        rows.append(
                            {
                                "time_s": time_s,
                                "satellite": seen.satellite,
                                "range_m": seen.pseudorange_m - perfect.range_m,
                                "phase_m": seen.carrier_cycles * _WAVELENGTH_M - perfect.range_m
                                if seen.carrier_valid
                                else np.nan,
                                "speed_mps": _WAVELENGTH_M * (perfect.doppler_hz - seen.doppler_hz),
                                "arc": seen.arc,
                            }
                        )
    return pd.DataFrame(rows)


def errors_of(table: pd.DataFrame, sights: pd.DataFrame, scene: Scene) -> Errors:
    """What the observations make of position and speed."""
    table = table[table["time_s"] >= _SETTLED_S]
    longest = table.groupby("satellite")["arc"].agg(lambda arc: arc.mode().iloc[0])
    phases = table["phase_m"].where(table["arc"] == table["satellite"].map(longest))
    held = phases.notna().sum() / (table["time_s"].nunique() * len(sights))
    # The clock first: ambiguities are taken of what is left.
    phases -= phases.groupby(table["time_s"]).transform("median")
    at_rest = phases.where(table["time_s"] <= scene.rest_s)
    ambiguities = at_rest.groupby(table["satellite"]).transform("mean")
    table = table.assign(phase_m=phases - ambiguities)
    table = table[table["time_s"] >= scene.counts_s]
    phase_m, speed_mps, range_m = (
        _solved(table.pivot(index="time_s", columns="satellite", values=name), sights)
        for name in ("phase_m", "speed_mps", "range_m")
    )
    return Errors(phase_m, speed_mps, range_m, float(held))


def sights_of(recording: Recording) -> pd.DataFrame:
    """Direction and one by satellite, (north, east, down, 1), in the middle of the recording."""
    ranges = pd.read_csv(recording.folder / "ranges.csv")
    middle = ranges.groupby("satellite").nth(ranges["satellite"].value_counts().min() // 2)
    az, el = np.radians(middle["az_deg"]), np.radians(middle["el_deg"])
    sights = np.column_stack(
        [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el), np.ones(len(middle))]
    )
    return pd.DataFrame(sights, index=middle["satellite"])


def _solved(errors: pd.DataFrame, sights: pd.DataFrame) -> float:
    """Root mean square of the horizontal error that errors of ranges or rates make."""
    squares = []
    for row in errors.to_numpy(np.float64):
        there = np.isfinite(row)
        if there.sum() >= _FEWEST:
            G: FloatArray = sights.loc[errors.columns[there]].to_numpy(np.float64)
            solution = np.linalg.lstsq(G, row[there], rcond=None)[0]
            squares.append(float(solution[:2] @ solution[:2]))
    return float(np.sqrt(np.mean(squares))) if squares else np.inf


def measure(scene: Scene, quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Kalman loop and PLLs over all seeds; quick: one seed, part of the recording."""
    loops = {
        "Kalman": kalman(scene.dynamics_mps2),
        **{f"PLL {bandwidth_hz:g} Hz": pll(bandwidth_hz) for bandwidth_hz in PLLS_HZ},
    }
    found: dict[str, list[Errors]] = {name: [] for name in loops}
    for seed in seeds[:1] if quick else seeds:
        short = (f"seconds={scene.quick_s}",) if quick else ()
        with recorded(scene.scenario, seed, *short) as recording:
            for name, settings in loops.items():
                table = tracked(recording, *settings)
                found[name].append(errors_of(table, sights_of(recording), scene))
    ours = _together(found.pop("Kalman"))
    against = [_against(scene, ours, name, _together(runs)) for name, runs in found.items()]
    compared = any(figure.met is not None for figure in against)
    return [
        Figure(
            f"Kalman, {scene.dynamics_mps2:g} m/s² in 1 s",
            _told(ours),
            compared and not ours.lost(),
        ),
        *against,
    ]


def _together(runs: Sequence[Errors]) -> Errors:
    """Root mean squares over recordings; the least share held."""
    columns = np.array(runs)
    rms = np.sqrt((columns[:, :3] ** 2).mean(axis=0))
    return Errors(float(rms[0]), float(rms[1]), float(rms[2]), float(columns[:, 3].min()))


def _told(errors: Errors) -> str:
    return (
        f"position by phases {1e3 * errors.phase_m:.2f} mm, by ranges {errors.range_m:.2f} m;"
        f" speed {1e3 * errors.speed_mps:.1f} mm/s; held {100.0 * errors.held:.1f} %"
    )


def _against(scene: Scene, ours: Errors, name: str, other: Errors) -> Figure:
    if other.lost():
        return Figure(f"{name}: lost its phases", _told(other), None)
    phase, speed = ours.phase_m / other.phase_m, ours.speed_mps / other.speed_mps
    return Figure(
        f"{name}: of its errors {phase:.2f} (position) and {speed:.2f} (speed) are left",
        _told(other),
        phase <= scene.position and speed <= scene.speed,
    )


def measure_static(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """KF-STAT."""
    return measure(STATIC, quick, seeds)


def measure_dynamic(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """KF-DYN."""
    return measure(DYNAMIC, quick, seeds)
