"""PR-MP: code errors by one reflected ray over its delay and phase, T 5.5.3."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray
from deepgnss.evaluate.reproduce.front_end import correlation
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, observed, recorded
from deepgnss.sim.scenario import FrontEnd
from deepgnss.theory.multipath import multipath_error_chips

CHIP_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.chip_rate_hz
WAVELENGTH_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
AMPLITUDE: Final = 0.5
SPACINGS: Final = (1.0, 0.1)
LIMIT: Final = 0.10  # of the largest error

_CLEAN: Final = "G30"  # a satellite without rays: the others are held against it
_REFLECTED: Final = ("G03", "G14", "G18", "G20")
_BEGIN_S: Final = 5.0  # of the first ray: time is known by then
_DWELL_S: Final = 2.0
_SETTLING_S: Final = 1.0
# Chips; those of the largest errors (against the phase (1 − α)·D/2, in phase (1 + α)·D/2), and some
# for the shape.
_QUICK_DELAYS: Final = (0.25, 0.75)
_DELAYS: Final = (
    *(0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85),
    *(0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.35, 1.5),
)


class Ray(NamedTuple):
    """A ray that stays for a while."""

    satellite: str
    delay_m: float
    in_phase: bool
    begin_s: float

    @property
    def end_s(self) -> float:
        """When it goes."""
        return self.begin_s + _DWELL_S


class Point(NamedTuple):
    """What a ray did to the code: chips, positive: measured too long."""

    delay_chips: float
    in_phase: bool
    measured_chips: float
    theory_chips: float


def rays(delays_chips: Sequence[float]) -> list[Ray]:
    """Both phases of each delay, one after the other on each of the satellites that have rays.

    A mirror turns the carrier by half a cycle: whole wavelengths arrive against the direct signal.
    """
    found = []
    cases = [(delay, phase) for delay in delays_chips for phase in (True, False)]
    for number, (delay_chips, in_phase) in enumerate(cases):
        place, satellite = divmod(number, len(_REFLECTED))
        whole = round(delay_chips * CHIP_M / WAVELENGTH_M)
        delay_m = (whole + (0.5 if in_phase else 0.0)) * WAVELENGTH_M
        begin_s = _BEGIN_S + place * _DWELL_S
        found.append(Ray(_REFLECTED[satellite], delay_m, in_phase, begin_s))
    return found


def points(recording: Recording, cast: Sequence[Ray], spacing_chips: float) -> list[Point]:
    """Mean code errors once the loop has settled on each ray, beside those of theory."""
    errors = observed(
        recording,
        f"tracking.code={{bandwidth: [3.0], spacing: {spacing_chips}}}",
        "acquisition.doppler_max=4.0e+3",
        "output.interval=0.1",
    )
    start = recording.scenario.start
    seconds = (errors["week"] - start.week) * 604_800.0 + errors["tow_s"] - start.tow_s
    table = errors.assign(_s=seconds.round(3)).pivot(
        index="_s", columns="satellite", values="code_m"
    )
    table = table.sub(table[_CLEAN], axis=0)
    front_end = recording.scenario.streams[0].front_end
    curves = {name: _curve(front_end, int(name[1:])) for name in _REFLECTED}
    return [_point(ray, table, curves[ray.satellite], spacing_chips) for ray in cast]


def _curve(front_end: FrontEnd, prn: int) -> Callable[[FloatArray], FloatArray]:
    chips, values = correlation(front_end, GPS_L1CA, prn)
    return lambda at: np.asarray(np.interp(at, chips, values))


def _point(
    ray: Ray,
    table: pd.DataFrame,
    curve: Callable[[FloatArray], FloatArray],
    spacing_chips: float,
) -> Point:
    settled = table.loc[ray.begin_s + _SETTLING_S : ray.end_s - 0.05, ray.satellite]
    delay_chips = ray.delay_m / CHIP_M
    phase = 0.0 if ray.in_phase else 0.5
    theory = multipath_error_chips(spacing_chips, AMPLITUDE, delay_chips, phase, curve)
    return Point(delay_chips, ray.in_phase, float(settled.mean()) / CHIP_M, theory)


def envelopes(quick: bool, seed: int) -> dict[float, list[Point]]:
    """Points of the envelope by spacing, from one recording."""
    cast = rays(_QUICK_DELAYS if quick else _DELAYS)
    given = ", ".join(
        f"{{ray: {{satellite: {ray.satellite}, amplitude: {AMPLITUDE}, delay: {ray.delay_m!r},"
        f" from: {ray.begin_s}, to: {ray.end_s}}}}}"
        for ray in cast
    )
    settings = (f"surroundings=[{given}]", f"seconds={cast[-1].end_s + 0.2}")
    with recorded("multipath", seed, *settings) as recording:
        return {spacing: points(recording, cast, spacing) for spacing in SPACINGS}


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Largest errors either way, and how far all points lie from theory; one seed when quick."""
    runs = [envelopes(quick, seed) for seed in (seeds[:1] if quick else seeds)]
    figures = []
    for spacing in SPACINGS:
        found = [point for run in runs for point in run[spacing]]
        published = 0.5 * AMPLITUDE * spacing
        measured = np.array([point.measured_chips for point in found])
        theory = np.array([point.theory_chips for point in found])
        in_phase = np.array([point.in_phase for point in found])
        for chosen, name, sign in ((in_phase, "in phase", 1), (~in_phase, "against it", -1)):
            # Of all rays by theory, the mean over those within 2 % of the largest.
            size = sign * theory[chosen]
            top = size >= 0.98 * size.max()
            ours = float((sign * measured[chosen])[top].mean())
            figures.append(
                Figure(
                    f"D {spacing:g}, {name}: largest",
                    f"{sign * ours:+.4f} chip ({sign * published:+.3f} unfiltered,"
                    f" {sign * size[top].mean():+.4f} through the front end)",
                    abs(ours / published - 1.0) <= LIMIT,
                )
            )
        off = float(np.sqrt(((measured - theory) ** 2).mean()))
        figures.append(
            Figure(
                f"D {spacing:g}: {len(found)} delays and phases against theory",
                f"{off:.4f} chip RMS, {np.abs(measured - theory).max():.4f} at most",
                off <= LIMIT * published,
            )
        )
    return figures


def draw(path: Path, points_by_spacing: dict[float, list[Point]]) -> None:
    """Picture of the envelopes, measured over theory, as T figure 5.27."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.0, 4.5), layout="constrained")
    for number, (spacing, found) in enumerate(points_by_spacing.items()):
        for in_phase in (True, False):
            own = sorted(point for point in found if point.in_phase is in_phase)
            delay, _, measured, theory = zip(*own, strict=True)
            label = f"D {spacing:g} chip" if in_phase else None
            axes.plot(delay, theory, f"C{number}-", linewidth=1.0)
            axes.plot(delay, measured, f"C{number}o", markersize=4.0, label=label)
    axes.set(xlabel="delay of the ray, chips", ylabel="code error, chips")
    axes.grid(alpha=0.3)
    axes.legend(title="measured; lines: theory", loc="lower right")
    figure.savefig(path, dpi=120)
    plt.close(figure)
