"""Published error budgets beside what their formulas, ours and a simulation give.

T 4.4–4.6 states figures read off pictures that are not in the text; which sum they are follows
from the formulas: docs/analyze.md has the derivations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray, ImuGrade
from deepgnss.evaluate.analysis.monte_carlo import (
    Motion,
    damped_loop_m,
    finer,
    open_loop_m,
    signed_mps,
    white_mps,
)
from deepgnss.evaluate.peak_probability import FEW_BINS, SUMS, SYMBOL_S
from deepgnss.io.config import imu_grade, oscillator_of
from deepgnss.theory.discriminator_range import aided_rise_hz, largest_rise_hz
from deepgnss.theory.inertial import Sums, error_sums
from deepgnss.theory.loop_response import OPEN, Loop, carrier_loop
from deepgnss.theory.oscillators import allan_phase_sigma_cycles
from deepgnss.theory.peak_probability import correct_peak_probability, sum_snr
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles
from deepgnss.theory.update_filter import oscillator_step_sigma

CARRIER_HZ: Final = GPS_L1CA.carrier_hz
WAVELENGTH_M: Final = SPEED_OF_LIGHT_MPS / CARRIER_HZ
AGREEMENT: Final = 0.03
"""How near the simulation has to come to the formulas."""
_NORTH: Final = np.array([1.0, 0.0, 0.0])
_WALKS_S: Final = 1e12  # T's drift never forgets
_CLOSED_RATE_HZ, _OPEN_RATE_HZ, _WINDOW_RATE_HZ = 200.0, 5.0, 20.0
_PARTS: Final = 40  # loop updates in an interval of the unit


class PublishedFigure(NamedTuple):
    """A figure in print and what becomes of it here."""

    source: str  # document and section
    what: str
    unit: str
    relation: str  # of the published one: "=", "<", ">" or "about", a whole number
    published: float
    formulas: float  # as printed, with its own table: drift that walks; NaN: the same as ours
    ours: float
    simulated: float  # NaN: nothing to simulate
    note: str = ""

    @property
    def follows(self) -> bool:
        """Whether ours is what the publication says: equal to 3 % or to the digits printed."""
        if self.relation == "<":
            return self.ours < self.published
        if self.relation == ">":
            return self.ours > self.published
        if self.relation == "about":
            return round(self.ours) == self.published
        _, _, decimals = f"{self.published:.10g}".partition(".")
        rounding = 0.5 * 10.0 ** -len(decimals) if decimals else 0.0
        return abs(self.ours - self.published) <= max(AGREEMENT * self.published, rounding)

    @property
    def confirmed(self) -> bool:
        """Whether the simulation agrees with ours to 3 %."""
        return math.isnan(self.simulated) or abs(self.simulated / self.ours - 1.0) <= AGREEMENT


def published_figures(runs: int, seed: int) -> list[PublishedFigure]:
    """All figures; runs: navigations simulated for each spread (1σ of which is 1/√(2·runs))."""
    rng = np.random.default_rng(seed)
    fsas, mti_g = imu_grade("FSAS"), imu_grade("MTi-G")
    return [
        *_closed(fsas, {15.0: 0.25, 3.0: 2.0}),
        *_closed(mti_g, {15.0: 1.5, 3.0: 10.0}),
        *_open_fsas(fsas, runs, rng),
        *_after_20_s(fsas, 1.1, None, runs, rng),
        _first_second(mti_g),
        *_after_20_s(mti_g, 16.0, (7.5, 14.7), runs, rng),
        *_regions(fsas, {0.04: "<", 0.08: ">", 0.16: ">"}, runs, rng),
        *_regions(mti_g, {0.02: ">", 0.04: ">"}, runs, rng),
        _peaks(),
        *_jitter(),
    ]


# --- T 4.4–4.6 ------------------------------------------------------------------------------------


class _Case(NamedTuple):
    """A unit under a motion; sums along north."""

    grade: ImuGrade
    motion: Motion

    def sums(
        self, at_s: FloatArray, loop: Loop = OPEN, *, walks: bool = False
    ) -> tuple[Sums, Sums]:
        """Velocity and position by theory."""
        grade = self.grade
        if walks:
            grade = grade._replace(gyro_drift_time_s=_WALKS_S, accel_drift_time_s=_WALKS_S)
        return error_sums(grade, self.motion.force_n_mps2, at_s, _NORTH, loop)

    def both(self, value: Callable[[Sums, Sums], float], scale: float = 1.0) -> tuple[float, float]:
        """By T's formulas and by ours, at the end of the motion."""
        at_s: FloatArray = np.array([self.motion.seconds])
        printed, ours = (scale * value(*self.sums(at_s, walks=walks)) for walks in (True, False))
        return printed, ours

    def signed(self) -> FloatArray:
        """Velocity by the strapdown mechanization."""
        return signed_mps(self.grade, self.motion)

    def white(self, runs: int, rng: np.random.Generator) -> FloatArray:
        """Velocities by the strapdown mechanization."""
        return white_mps(self.grade, self.motion, runs, rng)


def _closed(grade: ImuGrade, published_deg: dict[float, float]) -> list[PublishedFigure]:
    """T 4.4.4: 20 m/s² east, 12 north; a loop of order 2 with damping 1."""
    case = _Case(grade, Motion(12.0, 20.0, 1.0, _CLOSED_RATE_HZ))
    step_s = 1.0 / (_CLOSED_RATE_HZ * _PARTS)
    at_s: FloatArray = np.asarray(np.arange(1, round(1.0 / step_s) + 1) * step_s)
    fed_mps = finer(case.signed(), _PARTS)
    to_deg = 360.0 / WAVELENGTH_M
    figures = []
    for bandwidth_hz, published in published_deg.items():
        loop = carrier_loop(2, bandwidth_hz, damping=1.0)
        _, ours = case.sums(at_s, loop)
        stepped = damped_loop_m(fed_mps, step_s, loop.omega_radps, damping=1.0)
        largest, last = np.abs(ours.signed).max() * to_deg, abs(ours.signed[-1]) * to_deg
        figures.append(
            PublishedFigure(
                "T 4.4.4, 4.7",
                f"{grade.name}, closed loop {bandwidth_hz:g} Hz, 20/12 m/s²: phase within 1 s",
                "deg",
                "=",
                published,
                math.nan,
                float(largest),
                float(np.abs(stepped).max() * to_deg),
                f"the largest sum of what is drawn once; at 1 s {last:.2f}",
            )
        )
    return figures


def _open_fsas(grade: ImuGrade, runs: int, rng: np.random.Generator) -> list[PublishedFigure]:
    to_deg = 360.0 / WAVELENGTH_M
    figures = []
    for what, motion, relation, published in (
        ("4/3 m/s²", Motion(3.0, 4.0, 5.0, _OPEN_RATE_HZ), ">", 180.0),
        ("steady", Motion(0.0, 0.0, 5.0, _OPEN_RATE_HZ), "<", 130.0),
    ):
        case = _Case(grade, motion)
        way_m = open_loop_m(case.signed(), 1.0 / _OPEN_RATE_HZ)
        figures.append(
            PublishedFigure(
                "T 4.5.3",
                f"{grade.name}, open loop, {what}: phase at 5 s, sum",
                "deg",
                relation,
                published,
                *case.both(_sum, to_deg),
                to_deg * abs(float(way_m[-1])),
            )
        )
    ways_m = open_loop_m(case.white(runs, rng), 1.0 / _OPEN_RATE_HZ)
    figures.append(
        PublishedFigure(
            "T 4.5.3",
            f"{grade.name}, open loop, steady: phase at 5 s, noise 1σ",
            "deg",
            "=",
            27.0,
            *case.both(_noise, to_deg),
            to_deg * float(ways_m[:, -1].std()),
            "27 with g = 10 m/s², or at 4/3 m/s²",
        )
    )
    return figures


def _first_second(grade: ImuGrade) -> PublishedFigure:
    to_deg = 360.0 / WAVELENGTH_M
    case = _Case(_only_velocity(grade), Motion(3.0, 4.0, 1.0, _OPEN_RATE_HZ))
    whole, _ = _Case(grade, case.motion).both(_sum, to_deg)
    way_m = open_loop_m(case.signed(), 1.0 / _OPEN_RATE_HZ)
    return PublishedFigure(
        "T 4.5.3",
        f"{grade.name}, open loop: phase at 1 s by the initial velocity",
        "deg",
        "=",
        94.0,
        *case.both(_sum, to_deg),
        to_deg * float(way_m[-1]),
        f"that term alone; the sum is {whole:.0f}",
    )


def _after_20_s(
    grade: ImuGrade,
    limit_hz: float,
    code_m: tuple[float, float] | None,
    runs: int,
    rng: np.random.Generator,
) -> list[PublishedFigure]:
    """Code (sum, noise) and frequency at 4/3 m/s²."""
    case, step_s = _Case(grade, Motion(3.0, 4.0, 20.0, _OPEN_RATE_HZ)), 1.0 / _OPEN_RATE_HZ
    signed_v, white_v = case.signed(), case.white(runs, rng)
    figures = []
    if code_m is not None:
        what = f"{grade.name}, open loop, 4/3 m/s²: code at 20 s"
        figures = [
            PublishedFigure(
                "T 4.5.3",
                f"{what}, sum",
                "m",
                "=",
                code_m[0],
                *case.both(_sum),
                abs(float(open_loop_m(signed_v, step_s)[-1])),
                "7.43 with g = 10 m/s²",
            ),
            PublishedFigure(
                "T 4.5.3",
                f"{what}, noise 1σ",
                "m",
                "=",
                code_m[1],
                *case.both(_noise),
                float(open_loop_m(white_v, step_s)[:, -1].std()),
                "14.72 with g = 10 m/s² and a drift that walks",
            ),
        ]
    simulated_mps = abs(float(signed_v[-1])) + float(white_v[:, -1].std())
    return [
        *figures,
        PublishedFigure(
            "T 4.5.5",
            f"{grade.name}, open loop, 4/3 m/s²: frequency at 20 s, sum + 1σ",
            "Hz",
            "<",
            limit_hz,
            *case.both(_sum_and_sigma, 1.0 / WAVELENGTH_M),
            simulated_mps / WAVELENGTH_M,
        ),
    ]


def _only_velocity(grade: ImuGrade) -> ImuGrade:
    return ImuGrade(
        grade.name,
        gyro_bias_radps=0.0,
        gyro_drift_radps2_rthz=0.0,
        gyro_drift_time_s=grade.gyro_drift_time_s,
        gyro_noise_rad_rts=0.0,
        gyro_scale=0.0,
        accel_bias_mps2=0.0,
        accel_drift_mps3_rthz=0.0,
        accel_drift_time_s=grade.accel_drift_time_s,
        accel_noise_mps_rts=0.0,
        accel_scale=0.0,
        velocity_mps=grade.velocity_mps,
        tilt_rad=0.0,
        heading_rad=0.0,
    )


def _sum(_: Sums, phase: Sums) -> float:
    return abs(float(phase.signed[0]))


def _noise(_: Sums, phase: Sums) -> float:
    return float(phase.white[0])


def _sum_and_sigma(velocity: Sums, _: Sums) -> float:
    return abs(float(velocity.signed[0])) + float(velocity.white[0])


def _regions(
    grade: ImuGrade, relations: dict[float, str], runs: int, rng: np.random.Generator
) -> list[PublishedFigure]:
    """T figure 4.12: its upper right corner, 1 s and 1000 m/s² east."""
    case = _Case(grade, Motion(0.0, 1000.0, 1.0, _WINDOW_RATE_HZ))
    printed, _ = case.both(_sum_and_sigma)
    ours_hz = float(aided_rise_hz(grade, 1000.0, np.array([1.0]), WAVELENGTH_M)[0])
    simulated_mps = abs(float(case.signed()[-1])) + float(case.white(runs, rng)[:, -1].std())
    return [
        PublishedFigure(
            "T figure 4.12",
            f"{grade.name}, 1000 m/s², 1 s: frequency against 1/(4·{1e3 * interval_s:.0f} ms)",
            "Hz",
            relation,
            largest_rise_hz(interval_s),
            printed / WAVELENGTH_M,
            ours_hz,
            simulated_mps / WAVELENGTH_M,
            "tracked" if relation == "<" else "beyond the range",
        )
        for interval_s, relation in relations.items()
    ]


# --- T 3.3, 2.2.5, L 1.3 --------------------------------------------------------------------------


def _peaks() -> PublishedFigure:
    """Where 90 % of the peaks are right: what three lines gain over sixteen."""

    def needed_dbhz(searched: int) -> float:
        def lack(cn0_dbhz: float) -> float:
            snr = sum_snr(cn0_dbhz, SYMBOL_S)
            return correct_peak_probability(snr, SUMS, searched) - 0.9

        return float(brentq(lack, 5.0, 30.0))

    ours = needed_dbhz(SUMS) - needed_dbhz(FEW_BINS)
    return PublishedFigure(
        "T 3.3.1",
        "PFFT of 3 lines against FFT of 16, at 90 % right peaks",
        "dB",
        "about",
        2.0,
        math.nan,
        ours,
        math.nan,
        "simulated by `analyze peaks`",
    )


def _jitter() -> list[PublishedFigure]:
    figures = [
        PublishedFigure(
            "T 3.5",
            "thermal noise at 30 dB-Hz, 7 Hz, 20 ms",
            "deg",
            "<",
            6.0,
            math.nan,
            360.0 * pll_thermal_sigma_cycles(30.0, 7.0, 0.020),
            math.nan,
        ),
        PublishedFigure(
            "T 3.5",
            "oscillator with σ_y(1 s) = 6.8e-11, 1 ms",
            "deg",
            "=",
            0.039,
            math.nan,
            360.0 * allan_phase_sigma_cycles(CARRIER_HZ, 1e-3, 6.8e-11),
            math.nan,
        ),
    ]
    for name, phase, frequency in (("TCXO_L", 0.228, 0.086), ("OCXO", 0.0002, 0.0004)):
        ours = oscillator_step_sigma(oscillator_of(name), CARRIER_HZ, 0.1)
        for what, unit, published, value in zip(
            ("phase", "frequency"), ("cycle", "Hz"), (phase, frequency), ours, strict=True
        ):
            figures.append(
                PublishedFigure(
                    "L 1.3.1",
                    f"{name}: {what} in 100 ms",
                    unit,
                    "=",
                    published,
                    math.nan,
                    value,
                    math.nan,
                    "√(h0·T)·f0, its q_b is h0/2"
                    if what == "phase"
                    else "lacks the 2π² of its q_d",
                )
            )
    return figures
