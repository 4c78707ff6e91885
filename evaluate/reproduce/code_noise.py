"""PR-NOISE: σ of code at rest for spacings, coherent times and bandwidths, T 6.2.1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA
from deepgnss.evaluate.observables import clock_free, satellite_sigmas, usual_satellites
from deepgnss.evaluate.reproduce.front_end import code_noise_ratio, loss_db
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, observed, recorded, since
from deepgnss.sim.scenario import FrontEnd
from deepgnss.theory.tracking_error import dll_thermal_sigma_chips

CHIP_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.chip_rate_hz
LIMIT: Final = 0.10
_CORRELATION: Final = 0.458  # ∫ρ²dτ · B of a loop of order 2 with damping √½
_QUICK_S: Final = 11.0


class Loop(NamedTuple):
    """Settings of a code loop, and how much of a recording is spent on it."""

    spacing_chips: float
    coherent_s: float
    bandwidth_hz: float
    seconds: float

    def __str__(self) -> str:
        return (
            f"D {self.spacing_chips:g}, T {1e3 * self.coherent_s:g} ms, B {self.bandwidth_hz:g} Hz"
        )

    @property
    def settled_s(self) -> float:
        """From the first observation on, some 2 s after the loop was closed."""
        return 1.0 + 1.2 / self.bandwidth_hz


LOOPS: Final = (
    Loop(1.0, 0.001, 1.0, 80.0),  # T's loop 1
    Loop(1.0, 0.020, 1.0, 80.0),
    Loop(0.5, 0.020, 1.0, 80.0),
    Loop(0.25, 0.020, 1.0, 80.0),
    Loop(0.125, 0.020, 1.0, 80.0),
    Loop(1.0, 0.020, 0.1, 120.0),
    Loop(0.125, 0.001, 0.1, 120.0),  # T's loop 2
    Loop(0.125, 0.020, 0.1, 120.0),  # T's loop 3
)
# Wide ones: seconds then hold enough independent samples.
QUICK_LOOPS: Final = (Loop(1.0, 0.001, 8.0, _QUICK_S), Loop(0.125, 0.020, 8.0, _QUICK_S))


def settings(loop: Loop) -> tuple[str, ...]:
    """Of a run with this code loop and T's carrier loop."""
    schedule = [b for b in (3.0, 1.0) if b > loop.bandwidth_hz] + [loop.bandwidth_hz]
    coherent = f"coherent: {loop.coherent_s}"
    return (
        f"tracking.carrier={{loop: pll3, bandwidth: 7.0, {coherent}}}",
        f"tracking.code={{order: 2, bandwidth: {schedule}, {coherent},"
        f" spacing: {loop.spacing_chips}}}",
        f"recording.duration={loop.seconds}",
        "acquisition.doppler_max=4.0e+3",  # at rest no satellite has more
        "output.interval=0.05",
    )


class Spread(NamedTuple):
    """Mean variance of the satellites' ranges, and the seconds × satellites it comes from.

    One satellite is lost to what all have in common.
    """

    variance_m2: float
    seconds: float


def spread(recording: Recording, loop: Loop) -> Spread:
    """Variance of single satellites' code errors, what they have in common removed.

    A mean over τ takes 1/(2Bτ) of a loop's noise with it, which is given back.
    """
    errors = since(observed(recording, *settings(loop)), loop.settled_s)
    table = clock_free(errors, "code_m", usual_satellites(errors))
    tau_s = 1e-3 * float(table.index[-1] - table.index[0])
    variance_m2 = float((satellite_sigmas(table) ** 2).mean())
    kept = 1.0 - 1.0 / (2.0 * loop.bandwidth_hz * tau_s)
    return Spread(variance_m2 / kept, tau_s * (table.shape[1] - 1))


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """σ over T(2.25) of every loop; quick: two with 8 Hz, 11 s of one seed."""
    loops, chosen = (QUICK_LOOPS, seeds[:1]) if quick else (LOOPS, seeds)
    short = (f"seconds={_QUICK_S}",) if quick else ()
    found: dict[Loop, list[Spread]] = {loop: [] for loop in loops}
    for seed in chosen:
        with recorded("code_noise", seed, *short) as recording:
            for loop in loops:
                found[loop].append(spread(recording, loop))
            front_end = recording.scenario.streams[0].front_end
            cn0_dbhz = recording.scenario.emitters[0].cn0_dbhz[0][1] - loss_db(front_end)
    return [_figure(loop, found[loop], cn0_dbhz, front_end) for loop in loops]


def _figure(loop: Loop, spreads: Sequence[Spread], cn0_dbhz: float, front_end: FrontEnd) -> Figure:
    thermal_m = CHIP_M * dll_thermal_sigma_chips(
        cn0_dbhz,
        loop.bandwidth_hz,
        loop.coherent_s,
        loop.spacing_chips,
        front_end.bandwidth_hz or front_end.sample_rate_hz,
        GPS_L1CA.chip_rate_hz,
    )
    table = pd.DataFrame(spreads)
    seconds = float(table["seconds"].sum())
    variance_m2 = float((table["variance_m2"] * table["seconds"]).sum()) / seconds
    ratio = math.sqrt(variance_m2) / thermal_m
    error = math.sqrt(0.5 * _CORRELATION / (loop.bandwidth_hz * seconds))
    return Figure(
        str(loop),
        f"{100.0 * math.sqrt(variance_m2):.1f} cm = {ratio:.3f} (± {error:.3f}) ·"
        f" {100.0 * thermal_m:.1f} cm at {cn0_dbhz:.1f} dB-Hz;"
        f" {code_noise_ratio(front_end, loop.spacing_chips):.2f} by the integral",
        abs(ratio - 1.0) <= LIMIT,
    )
