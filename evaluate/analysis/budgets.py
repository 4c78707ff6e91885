"""Budgets as tables: what `deepgnss analyze` shows, writes and draws. All figures are theory's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.carrier_model import carrier_covariance
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.analysis.subject import Subject
from deepgnss.evaluate.peak_probability import SUMS, SYMBOL_S, peak_shares
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.signals import BDS_B1I_D1, GPS_L1CA_SIGNAL
from deepgnss.theory.discriminator_range import (
    aided_rise_hz,
    largest_acceleration_mps2,
    largest_rate_hzps,
    largest_rise_hz,
)
from deepgnss.theory.inertial import Sums, error_growth, error_sums
from deepgnss.theory.loop_response import drawn_response
from deepgnss.theory.open_loop import Growth, best_fit, clock_growth, entry_growth, together
from deepgnss.theory.phase_budget import THRESHOLD_CYCLES, best_bandwidth_hz, phase_budget
from deepgnss.theory.reach import reach
from deepgnss.theory.tracking_error import (
    dll_thermal_sigma_chips,
    pll_thermal_sigma_cycles,
    reported_share,
)
from deepgnss.theory.update_filter import (
    oscillator_step_sigma,
    steady_phase_sigma_cycles,
)

_POINTS: Final = 400
_HALF_CYCLE: Final = 0.5
_CODE_CHIPS: Final = 0.1  # T 4.5.3
_INTERVALS_S: Final = (0.010, 0.020, 0.040, 0.080, 0.160)  # T figure 4.12
_UPDATE_S: Final = (0.05, 0.1, 0.2, 0.4)  # L 1.3
_STATES: Final = 4
_LAST_HZPS3_RTHZ: Final = 64.0  # drives the last one, Hz/s²: as far in 1 s as L 2.2 goes


class Budget(NamedTuple):
    """One analysis."""

    name: str  # of its files
    title: str
    facts: tuple[tuple[str, str], ...]
    table: pd.DataFrame  # for the screen
    curves: pd.DataFrame  # for CSV and the picture


def _times(seconds: float) -> FloatArray:
    return np.asarray(np.linspace(0.0, seconds, _POINTS + 1)[1:])


def _named(name: str) -> str:
    return name.replace(" ", "_")


def _sums_columns(sums: Sums, scale: float, unit: str) -> dict[str, FloatArray]:
    return {
        f"sum_{unit}": scale * sums.signed,
        f"largest_sum_{unit}": scale * sums.largest,
        f"drawn_1sigma_{unit}": scale * sums.drawn,
        f"noise_1sigma_{unit}": scale * sums.white,
        f"all_1sigma_{unit}": scale * sums.sigma,
    }


# --- closed loop, T 4.4 ---------------------------------------------------------------------------


def closed_loop(subject: Subject, seconds: float) -> Budget:
    """Phase error that aiding errors leave in a closed loop, source by source, and the unaided."""
    at_s, to_deg = _times(seconds), 360.0 / subject.wavelength_m
    told = (subject.grade, subject.force_n_mps2, at_s)
    terms = error_growth(*told, subject.sight_n[np.newaxis], subject.loop)
    _, phase = error_sums(*told, subject.sight_n, subject.loop)
    rate, jerk = (drawn_response(subject.loop, k, at_s).phase for k in (1, 2))
    unaided_deg = 360.0 * (
        rate * subject.rate_hzps + jerk * subject.jerk_mps3 / subject.wavelength_m
    )
    curves = pd.DataFrame(
        {"time_s": at_s}
        | {f"{_named(term.name)}_deg": to_deg * term.position_m[:, 0] for term in terms}
        | _sums_columns(phase, to_deg, "deg")
        | {"unaided_deg": unaided_deg}
    )
    kinds = {term.name: "noise" if term.white else "drawn once" for term in terms}
    rows = [
        _end_and_largest(name, kind, curves[f"{_named(name)}_deg"]) for name, kind in kinds.items()
    ]
    rows += [
        _end_and_largest(name, "", curves[column])
        for name, column in (
            ("sum of what is drawn once", "sum_deg"),
            ("the same, worst signs", "largest_sum_deg"),
            ("the same, 1σ", "drawn_1sigma_deg"),
            ("noise, 1σ", "noise_1sigma_deg"),
            ("all, 1σ", "all_1sigma_deg"),
            ("unaided loop, by the motion", "unaided_deg"),
        )
    ]
    table = pd.DataFrame(
        rows, columns=["source", "kind", f"at {seconds:g} s, deg", "largest, deg", "at, s"]
    )
    table["at, s"] = [f"{at_s[k]:.3g}" for k in table["at, s"]]
    title = f"Closed loop: phase error by {subject.grade.name}"
    return Budget("closed_loop", title, _loop_facts(subject), table, curves)


def _end_and_largest(name: str, kind: str, curve: pd.Series[float]) -> tuple[Any, ...]:
    size = curve.abs().to_numpy()
    return name, kind, float(curve.iloc[-1]), float(size.max()), int(size.argmax())


def _loop_facts(subject: Subject) -> tuple[tuple[str, str], ...]:
    damping = math.sqrt(0.5) if subject.damping is None else subject.damping
    damped = f", damping {damping:.3g}" if subject.order == 2 else ""
    return (
        ("loop", f"order {subject.order}{damped}, {subject.bandwidth_hz:g} Hz"),
        *_motion_facts(subject),
    )


def _motion_facts(subject: Subject) -> tuple[tuple[str, str], ...]:
    return (
        ("unit", subject.grade.name),
        (
            "motion",
            f"{subject.across_mps2:g} m/s² across, {subject.along_mps2:g} m/s² along the sight"
            f" at {math.degrees(subject.elevation_rad):g}° elevation",
        ),
        ("signal", subject.signal.name),
    )


# --- open loop, T 4.5 -----------------------------------------------------------------------------


def open_loop(subject: Subject, seconds: float) -> Budget:
    """Phase, frequency and code over time with nothing received, and how long they may be trusted.

    Navigation just left alone with the unit's initial errors, clock carried on by the fit that
    suits its oscillator best at the end.
    """
    at_s, wavelength_m = _times(seconds), subject.wavelength_m
    velocity, way = error_sums(subject.grade, subject.force_n_mps2, at_s, subject.sight_n)
    thermal = pll_thermal_sigma_cycles(subject.cn0_dbhz, subject.bandwidth_hz, subject.coherent_s)
    carrier_hz, known = subject.signal.carrier_hz, thermal / math.sqrt(subject.satellites)
    clock = clock_growth(
        subject.oscillator,
        carrier_hz,
        best_fit(subject.oscillator, carrier_hz, seconds, known),
        at_s,
    )
    chance = Growth("unit", way.sigma / wavelength_m, velocity.sigma / wavelength_m)
    noise = Growth("noise", way.white / wavelength_m, velocity.white / wavelength_m)
    entry = entry_growth(thermal, at_s)
    sigma = together([chance, clock, entry])
    random = together([noise, clock, entry])
    worst = Growth(
        "sum and 1σ",
        np.abs(way.signed) / wavelength_m + random.phase_cycles,
        np.abs(velocity.signed) / wavelength_m + random.frequency_hz,
    )
    curves = pd.DataFrame(
        {"time_s": at_s}
        | _sums_columns(way, 360.0 / wavelength_m, "phase_deg")
        | _sums_columns(velocity, 1.0 / wavelength_m, "frequency_hz")
        | _sums_columns(way, 1.0, "code_m")
        | {
            "clock_1sigma_phase_deg": 360.0 * clock.phase_cycles,
            "clock_1sigma_frequency_hz": clock.frequency_hz,
            "total_1sigma_phase_deg": 360.0 * sigma.phase_cycles,
            "total_1sigma_frequency_hz": sigma.frequency_hz,
            "total_1sigma_code_m": wavelength_m * sigma.phase_cycles,
            "sum_and_1sigma_phase_deg": 360.0 * worst.phase_cycles,
            "sum_and_1sigma_frequency_hz": worst.frequency_hz,
            "sum_and_1sigma_code_m": wavelength_m * worst.phase_cycles,
        }
    )
    moments_s = [t for t in (1.0, 2.0, 5.0, 10.0, 20.0, 60.0) if t <= seconds]
    rows = [_moment(curves, t) for t in moments_s or [seconds]]
    facts = (
        *_motion_facts(subject),
        ("oscillator", f"{subject.oscillator.name}, after phases of {known:.4f} cycle"),
        *_trusted(subject, at_s, sigma, worst),
    )
    title = f"Open loop: {subject.grade.name} and {subject.oscillator.name} left alone"
    return Budget("open_loop", title, facts, pd.DataFrame(rows), curves)


def _moment(curves: pd.DataFrame, at_s: float) -> dict[str, float]:
    def at(column: str) -> float:
        return float(np.interp(at_s, curves["time_s"], curves[column]))

    return {
        "after, s": at_s,
        "phase sum, deg": at("sum_phase_deg"),
        "unit 1σ, deg": at("all_1sigma_phase_deg"),
        "noise 1σ, deg": at("noise_1sigma_phase_deg"),
        "clock 1σ, deg": at("clock_1sigma_phase_deg"),
        "frequency sum, Hz": at("sum_frequency_hz"),
        "noise 1σ, Hz": at("noise_1sigma_frequency_hz"),
        "clock 1σ, Hz": at("clock_1sigma_frequency_hz"),
        "code sum, m": at("sum_code_m"),
        "noise 1σ, m": at("noise_1sigma_code_m"),
    }


def _trusted(
    subject: Subject, at_s: FloatArray, sigma: Growth, worst: Growth
) -> tuple[tuple[str, str], ...]:
    """How long each may be used: T's limits on sum + 1σ, the receiver's on 1σ."""
    own = TrackingSettings().open_loop_phase_sigma_cycles
    rise_hz = largest_rise_hz(subject.interval_s, subject.lines, subject.window_s)
    limits = [
        ("phase, sum + 1σ within half a cycle", worst.phase_cycles, _HALF_CYCLE),
        (f"phase, 1σ within {own:g} cycle, the receiver's", sigma.phase_cycles, own),
        (f"the same, {2.0 * own:g} with known symbols", sigma.phase_cycles, 2.0 * own),
        (f"frequency, sum + 1σ within {rise_hz:.3g} Hz", worst.frequency_hz, rise_hz),
    ]
    code_m, worst_m = (one.phase_cycles * subject.wavelength_m for one in (sigma, worst))
    for signal in (GPS_L1CA_SIGNAL, BDS_B1I_D1):
        name, chip_m = signal.id.name, SPEED_OF_LIGHT_MPS / signal.id.chip_rate_hz
        limits.append(
            (f"code, sum + 1σ within {_CODE_CHIPS:g} chip of {name}", worst_m, _CODE_CHIPS * chip_m)
        )
        hz, chips = reach(signal.part_s, subject.spacing_chips)
        if signal.id == subject.signal:
            frequency = f"frequency, 1σ within {hz:.3g} Hz, the receiver's"
            limits.append((frequency, sigma.frequency_hz, hz))
        limits.append(
            (f"code, 1σ within {chips:.3g} chip of {name}, the receiver's", code_m, chips * chip_m)
        )
    return tuple((what, _until(at_s, curve, limit)) for what, curve, limit in limits)


def _until(at_s: FloatArray, curve: FloatArray, limit: float) -> str:
    above = np.flatnonzero(curve > limit)
    if not above.size:
        return f"{at_s[-1]:g} s and longer"
    k = int(above[0])
    if k == 0:
        return f"not for {at_s[0]:.2g} s"
    return f"{np.interp(limit, curve[k - 1 : k + 1], at_s[k - 1 : k + 1]):.2f} s"


# --- FFT discriminator, T 4.6 ---------------------------------------------------------------------


def discriminator(subject: Subject, seconds: float) -> Budget:
    """Acceleration that the FFT discriminator bears over windows and intervals: T figure 4.12."""
    windows_s = np.linspace(0.02, max(seconds, 0.1), 50)
    intervals_s = sorted({*_INTERVALS_S, subject.interval_s})
    curves = pd.DataFrame({"window_s": windows_s})
    for interval_s in intervals_s:
        limit_hz = largest_rise_hz(interval_s)
        curves[f"aided_{1e3 * interval_s:g}ms_mps2"] = [
            largest_acceleration_mps2(subject.grade, limit_hz, float(w), subject.wavelength_m)
            for w in windows_s
        ]
        curves[f"alone_{1e3 * interval_s:g}ms_mps2"] = [
            largest_rate_hzps(interval_s, float(w)) * subject.wavelength_m for w in windows_s
        ]
    at_s = sorted({0.1, 0.2, subject.window_s, 0.512, 1.0})
    rows = []
    for interval_s in intervals_s:
        limit_hz = largest_rise_hz(interval_s)
        aided = [
            largest_acceleration_mps2(subject.grade, limit_hz, w, subject.wavelength_m)
            for w in at_s
        ]
        row: dict[str, Any] = {"sum, ms": 1e3 * interval_s, "range, Hz": limit_hz}
        rows.append(row | {f"{w:g} s, m/s²": a for w, a in zip(at_s, aided, strict=True)})
    own = aided_rise_hz(
        subject.grade, subject.across_mps2, np.array([subject.window_s]), subject.wavelength_m
    )
    limit = largest_rise_hz(subject.interval_s, subject.lines, subject.window_s)
    lines = "all lines" if subject.lines is None else f"{subject.lines} lines"
    facts = (
        ("unit", subject.grade.name),
        (
            f"window {subject.window_s:g} s of {1e3 * subject.interval_s:g} ms, {lines}",
            f"aided at {subject.across_mps2:g} m/s² off by {own[0]:.3f} Hz of {limit:.3f};"
            f" alone {largest_rate_hzps(subject.interval_s, subject.window_s, subject.lines):.3g}"
            " Hz/s",
        ),
    )
    title = f"FFT discriminator: largest acceleration across, aided by {subject.grade.name}"
    return Budget("discriminator", title, facts, pd.DataFrame(rows), curves)


# --- jitter, T 2.2.5, K 1, L 1.3 ------------------------------------------------------------------


def jitter(subject: Subject, cn0s_dbhz: Sequence[float]) -> Budget:
    """Thermal noise, vibration, oscillator and lag over C/N0, and over bandwidth at one of them."""
    code = [
        dll_thermal_sigma_chips(
            cn0,
            subject.code_bandwidth_hz,
            subject.code_coherent_s,
            subject.spacing_chips,
            subject.front_end_hz,
            subject.signal.chip_rate_hz,
        )
        for cn0 in cn0s_dbhz
    ]
    chip_m = SPEED_OF_LIGHT_MPS / subject.signal.chip_rate_hz
    rows = []
    for cn0, chips in zip(cn0s_dbhz, code, strict=True):
        stress = subject.stress(cn0)
        budget = phase_budget(subject.order, subject.bandwidth_hz, stress)
        rows.append(
            {
                "C/N0, dB-Hz": cn0,
                "thermal, deg": 360.0 * budget.thermal,
                "vibration, deg": 360.0 * budget.vibration,
                "oscillator, deg": 360.0 * budget.oscillator,
                "lag, deg": 360.0 * budget.dynamic,
                "K(1) of 15, deg": 360.0 * budget.total,
                "best, Hz": best_bandwidth_hz(subject.order, stress),
                "code, m": chips * chip_m,
            }
        )
    bandwidths_hz = np.geomspace(0.1, 100.0, 121)
    budgets = [phase_budget(subject.order, float(b), subject.stress()) for b in bandwidths_hz]
    curves = pd.DataFrame(
        {
            "bandwidth_hz": bandwidths_hz,
            "thermal_deg": [360.0 * b.thermal for b in budgets],
            "vibration_deg": [360.0 * b.vibration for b in budgets],
            "oscillator_deg": [360.0 * b.oscillator for b in budgets],
            "lag_deg": [360.0 * b.dynamic for b in budgets],
            "total_deg": [360.0 * b.total for b in budgets],
        }
    )
    told = reported_share(subject.order, subject.bandwidth_hz, subject.coherent_s)
    facts = (
        ("carrier loop", f"order {subject.order}, {subject.bandwidth_hz:g} Hz,"
         f" {1e3 * subject.coherent_s:g} ms"),
        ("code loop", f"{subject.code_bandwidth_hz:g} Hz, D {subject.spacing_chips:g} chip,"
         f" {1e3 * subject.code_coherent_s:g} ms"),
        ("oscillator", subject.oscillator.name),
        ("a phase as told", f"{told:.3f} of the thermal noise: its own symbol counts"),
        ("limit", f"{360.0 * THRESHOLD_CYCLES:g}°, K(1)"),
        *_updates(subject),
    )  # fmt: skip
    title = f"Jitter of loops with {subject.oscillator.name}"
    return Budget("jitter", title, facts, pd.DataFrame(rows), curves)


def _updates(subject: Subject) -> list[tuple[str, str]]:
    """A Kalman loop with long updates, L 1.3: what the oscillator adds, where the phase settles."""
    carrier_hz, lines = subject.signal.carrier_hz, []
    for update_s in _UPDATE_S:
        phase, frequency = oscillator_step_sigma(subject.oscillator, carrier_hz, update_s)
        Q = carrier_covariance(
            _STATES, update_s, subject.oscillator, carrier_hz, _LAST_HZPS3_RTHZ**2
        )
        settled = steady_phase_sigma_cycles(subject.cn0_dbhz, update_s, Q)
        lines.append(
            (
                f"update every {1e3 * update_s:g} ms",
                f"oscillator {phase:.2g} cycle, {frequency:.2g} Hz; phase settles at"
                f" {360.0 * settled:.2f}° at {subject.cn0_dbhz:g} dB-Hz",
            )
        )
    return lines


# --- correct peaks, T 3.3 -------------------------------------------------------------------------


def peaks(cn0s_dbhz: Sequence[float], trials: int, seed: int) -> Budget:
    """How often the largest line is the right one: T figure 3.4."""
    points = peak_shares(cn0s_dbhz, trials, seed)
    curves = pd.DataFrame({"cn0_dbhz": list(cn0s_dbhz)})
    table = pd.DataFrame({"C/N0, dB-Hz": list(cn0s_dbhz)})
    for name in dict.fromkeys(point.discriminator for point in points):
        own = [point for point in points if point.discriminator == name]
        curves[f"{name.lower()}_share"] = [point.share for point in own]
        curves[f"{name.lower()}_1sigma"] = [point.sigma for point in own]
        table[f"{name}, %"] = [100.0 * point.share for point in own]
        if own[0].theory is not None:
            theory = np.array([point.theory for point in own], dtype=np.float64)
            curves[f"{name.lower()}_integral"] = theory
            table[f"{name} integral, %"] = 100.0 * theory
    facts = (
        ("window", f"{SUMS} sums of {1e3 * SYMBOL_S:g} ms, 3 lines searched by PFFT and PSFFT"),
        ("simulated", f"{trials} windows a point by the receiver's discriminators, seed {seed}"),
        ("squares", "SFFT, PSFFT: no integral, T 3.3.1"),
    )
    return Budget("peaks", "Correct peaks, T figure 3.4", facts, table, curves)
