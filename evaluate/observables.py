"""Code and carrier phase against true ranges: errors, σ per satellite, theory beside them.

One receiver clock error δ stands in time tag, range and phase: an observation tagged t was taken
at t − δ, and its range is c·δ too long. Truth is therefore taken at t − δ, and what the satellites
of an epoch have in common is removed, either as their mean or by differences against one of them.
Error = observation − truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.constants import SECONDS_PER_WEEK, SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray
from deepgnss.evaluate.observations import SIGNAL_OF_SYSTEM, wavelength_m, wavelengths_m
from deepgnss.theory.tracking_error import (
    dll_thermal_sigma_chips,
    loop_states,
    pll_thermal_sigma_cycles,
)

_SLIP_CYCLES: Final = 0.25  # a step of the phase error from epoch to epoch that is no noise
_GAP: Final = 1.5  # times the usual interval
_ROUNDS: Final = 3  # of clock error: each is 1e-5 (range rate over c) of the one before

_SETTLED_S: Final = 1.0  # a loop's own start
_BLOCK_S: Final = 5.0  # means of code errors over this are nearly independent at 0.1 Hz

_Truth = dict[str, tuple[FloatArray, pd.DataFrame]]  # seconds and rows by satellite


def range_errors(observed: pd.DataFrame, ranges: pd.DataFrame) -> pd.DataFrame:
    """Errors of every observation that truth covers, the epoch's clock error (a median) taken off.

    Truth is interpolated linearly between its rows: within 0.3 mm at 0.1 s for satellites, exact
    for receivers steered to those instants.

    Parameters: tables as of `read_observations`, `read_ranges`.

    Returns: week, tow_s, time_ms (whole ms since the week of the first range), satellite,
    elevation_deg, cn0_dbhz, code_m, phase_m (arbitrary offset per arc; NaN without phase), arc
    (number of the phase's unbroken stretch, by flags and gaps), clock_s.
    """
    week = int(ranges["week"].iloc[0])
    frame = observed.assign(_s=week_seconds(observed, week)).sort_values(
        ["satellite", "_s"], kind="stable"
    )
    truth = _by_satellite(ranges, week)
    frame = frame[frame["satellite"].isin(list(truth))]
    clock_s = np.zeros(len(frame))
    for _ in range(_ROUNDS):
        late_m = frame["pseudorange_m"] - _true(frame, truth, "range_m", clock_s)
        clock_s = late_m.groupby(frame["_s"]).transform("median").to_numpy() / SPEED_OF_LIGHT_MPS
    return error_table(
        frame,
        _true(frame, truth, "range_m", clock_s),
        _true(frame, truth, "phase_m", clock_s),
        _true(frame, truth, "elevation_deg", clock_s),
        clock_s,
    )


def error_table(
    frame: pd.DataFrame,
    range_m: FloatArray,
    phase_m: FloatArray,
    elevation_deg: FloatArray,
    clock_s: FloatArray,
) -> pd.DataFrame:
    """Observations less what they should be, the clock's error taken off, as of `range_errors`.

    frame: observations by satellite and time, with their `week_seconds` as `_s`.
    """
    clock_m = clock_s * SPEED_OF_LIGHT_MPS
    carrier_m = frame["carrier_cycles"] * wavelengths_m(frame["satellite"])
    errors = pd.DataFrame(
        {
            "week": frame["week"],
            "tow_s": frame["tow_s"],
            "time_ms": (frame["_s"] * 1e3).round().astype(np.int64),
            "satellite": frame["satellite"],
            "elevation_deg": elevation_deg,
            "cn0_dbhz": frame["cn0_dbhz"],
            "code_m": frame["pseudorange_m"] - range_m - clock_m,
            "phase_m": carrier_m - phase_m - clock_m,
            "arc": phase_arcs(frame, frame["carrier_cycles"].notna()),
            "clock_s": clock_s,
        }
    )
    return errors.dropna(subset=["code_m"]).sort_values(
        ["time_ms", "satellite"], kind="stable", ignore_index=True
    )


def _by_satellite(ranges: pd.DataFrame, week: int) -> _Truth:
    return {
        str(name): (week_seconds(rows, week), rows)
        for name, rows in ranges.groupby("satellite", sort=False)
    }


def week_seconds(frame: pd.DataFrame, week: int) -> FloatArray:
    """Seconds of the rows' time tags since the start of a GPS week."""
    weeks = frame["week"].to_numpy(dtype=np.int64) - week
    seconds: FloatArray = weeks * float(SECONDS_PER_WEEK) + frame["tow_s"].to_numpy(np.float64)
    return seconds


def _true(
    frame: pd.DataFrame,
    truth: _Truth,
    column: str,
    clock_s: FloatArray,
) -> FloatArray:
    """A column of truth at the true instants, NaN where truth has no rows."""
    at_s = frame["_s"].to_numpy() - clock_s
    satellites = frame["satellite"].to_numpy()
    values = np.full(len(frame), np.nan)
    for name, (known_s, rows) in truth.items():
        mine = satellites == name
        known = rows[column].to_numpy(np.float64)
        step_s = np.median(np.diff(known_s)) if len(known_s) > 1 else math.inf
        after = np.clip(np.searchsorted(known_s, at_s[mine]), 1, max(len(known_s) - 1, 1))
        found = np.interp(at_s[mine], known_s, known, left=np.nan, right=np.nan)
        if len(known_s) > 1:
            found[known_s[after] - known_s[after - 1] > _GAP * step_s] = np.nan
        values[mine] = found
    return values


def phase_arcs(frame: pd.DataFrame, has_phase: pd.Series) -> pd.Series:
    """Number of the phase arc, row by row of a frame sorted by satellite and time."""
    times = frame["_s"].where(has_phase)
    by_satellite = frame["satellite"]
    before = times.groupby(by_satellite).ffill().groupby(by_satellite).shift()
    gaps = times - before
    interval_s = gaps[gaps > 0.0].median()
    starts = has_phase & (frame["slip"] | gaps.isna() | (gaps > _GAP * interval_s))
    return starts.groupby(by_satellite).cumsum().astype(np.int64)


def same_epochs(errors: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """Only the satellites and epochs (by time tag, to the ms) that all receivers have with phase.

    Parameters, returns: tables as of `range_errors`.
    """
    keys = [
        pd.MultiIndex.from_frame(e.dropna(subset=["phase_m"])[["time_ms", "satellite"]])
        for e in errors
    ]
    common = keys[0]
    for other in keys[1:]:
        common = common.intersection(other)
    return [
        e[pd.MultiIndex.from_frame(e[["time_ms", "satellite"]]).isin(common)].reset_index(drop=True)
        for e in errors
    ]


def wide(errors: pd.DataFrame, column: str, satellites: Iterable[str]) -> pd.DataFrame:
    """One row per epoch (time_ms) that has every satellite, one column per satellite."""
    table = errors.pivot(index="time_ms", columns="satellite", values=column)
    return table.reindex(columns=list(satellites)).dropna()


def clock_free(errors: pd.DataFrame, column: str, satellites: Sequence[str]) -> pd.DataFrame:
    """`wide`, less what the satellites of an epoch have in common; phase also less each arc's mean.

    A mean over an arc takes its whole (and half) cycles with it.
    """
    table = wide(errors, column, satellites)
    if column != "phase_m":
        return table.sub(table.mean(axis=1), axis=0)
    arcs = errors.pivot(index="time_ms", columns="satellite", values="arc").loc[table.index]
    many = arcs[list(satellites)].nunique().max() > 1
    for _ in range(20 if many else 1):  # two-way means: exact at once where arcs span everything
        for name in satellites:
            table[name] -= table[name].groupby(arcs[name]).transform("mean")
        table = table.sub(table.mean(axis=1), axis=0)
    return table


def satellite_sigmas(residuals: pd.DataFrame, about_zero: bool = False) -> pd.Series:
    """σ of each satellite's own error from residuals against their mean.

    With independent errors, Var(eᵢ − ē) = σᵢ²(1 − 2/N) + Σσ²/N², solved for σᵢ² (N ≥ 3).

    Parameters: residuals as of `clock_free`; `about_zero`: a mean error counts as error (RMS).
    """
    n = residuals.shape[1]
    if n < 3:
        return pd.Series(np.nan, residuals.columns)
    spread = (residuals**2).mean() if about_zero else residuals.var(ddof=1)
    total = spread.sum() * n / (n - 1)
    own = (spread - total / n**2) / (1.0 - 2.0 / n)
    return own.clip(lower=0.0) ** 0.5


def satellite_accuracy(
    errors: pd.DataFrame, satellites: Sequence[str] | None = None
) -> pd.DataFrame:
    """Errors of one receiver by satellite, what the epoch's satellites have in common removed.

    Parameters: errors as of `range_errors`; satellites: those compared, over the epochs that have
    all of them (default: all that have phase in nine tenths of the epochs).

    Returns: index satellite; elevation_deg, cn0_dbhz (means), epochs, code_rms_m, code_mean_m,
    phase_sigma_m, arcs, slips (steps of more than a quarter cycle that no flag announces),
    code_minus_phase_mmps and its σ code_minus_phase_sigma_mmps (from means over 5 s).
    """
    names = list(satellites) if satellites is not None else usual_satellites(errors)
    code, phase = clock_free(errors, "code_m", names), clock_free(errors, "phase_m", names)
    kept = errors[errors["time_ms"].isin(phase.index)].set_index("satellite").loc[names]
    groups = kept.groupby(level=0)
    slopes = pd.DataFrame(
        [_code_minus_phase(rows) for _, rows in groups],
        index=[str(name) for name, _ in groups],
        columns=["code_minus_phase_mmps", "code_minus_phase_sigma_mmps"],
    )
    return pd.DataFrame(
        {
            "elevation_deg": groups["elevation_deg"].mean(),
            "cn0_dbhz": groups["cn0_dbhz"].mean(),
            "epochs": groups.size(),
            "code_rms_m": satellite_sigmas(code, about_zero=True),
            "code_mean_m": code.mean(),
            "phase_sigma_m": satellite_sigmas(phase),
            "arcs": groups["arc"].nunique(),
            "slips": pd.Series({name: _steps(phase, kept, name) for name in names}),
        }
    ).join(slopes)


def usual_satellites(errors: pd.DataFrame, share: float = 0.9) -> list[str]:
    """Satellites with phase in at least a share of the epochs that have any, by name."""
    with_phase = errors.dropna(subset=["phase_m"])
    counts = with_phase.groupby("satellite").size()
    return [str(name) for name in counts.index[counts >= share * with_phase["time_ms"].nunique()]]


def _steps(phase: pd.DataFrame, kept: pd.DataFrame, name: str) -> int:
    """Steps within arcs of one satellite against the median of all."""
    steps = phase.diff().sub(phase.diff().median(axis=1), axis=0)[name].to_numpy()
    arc = kept.loc[[name], "arc"].to_numpy()
    within = np.concatenate(([False], np.diff(arc) == 0))
    return int((np.abs(steps[within]) > _SLIP_CYCLES * wavelength_m(name)).sum())


def _code_minus_phase(rows: pd.DataFrame) -> tuple[float, float]:
    """Slope of code minus phase over time and its σ, mm/s; each arc has an offset of its own."""
    t_s = rows["time_ms"] * 1e-3
    lines = pd.DataFrame({"t_s": t_s, "m": rows["code_m"] - rows["phase_m"], "arc": rows["arc"]})
    lines = lines.groupby(["arc", (t_s - t_s.iloc[0]) // _BLOCK_S]).mean()
    lines -= lines.groupby(level=0).transform("mean")
    t, difference = lines["t_s"].to_numpy(), lines["m"].to_numpy()
    power = float(t @ t)
    freedom = len(t) - lines.index.get_level_values(0).nunique() - 1
    if power == 0.0 or freedom < 1:
        return math.nan, math.nan
    slope = float(t @ difference) / power
    rest = difference - slope * t
    return slope * 1e3, math.sqrt(float(rest @ rest) / freedom / power) * 1e3


def single_differences(errors: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Differences of each satellite against the reference, over all epochs that have both.

    Clock and tag cancel. Phase has each arc's mean (of either satellite) removed.

    Returns: index satellite; epochs, code_sigma_m, code_rms_m, phase_sigma_m.
    """
    found = {}
    for name in sorted(set(errors["satellite"]) - {reference}):
        pair = [name, reference]
        code = wide(errors, "code_m", pair)
        both = wide(errors.dropna(subset=["phase_m"]), "phase_m", pair)
        arcs = wide(errors, "arc", pair).loc[both.index]
        if len(both) < 2:
            continue
        difference = code[name] - code[reference]
        phase = both[name] - both[reference]
        phase -= phase.groupby([arcs[name], arcs[reference]]).transform("mean")
        found[name] = {
            "epochs": len(both),
            "code_sigma_m": difference.std(),
            "code_rms_m": float(np.sqrt((difference**2).mean())),
            "phase_sigma_m": phase.std(),
        }
    return pd.DataFrame.from_dict(found, orient="index")


def thermal_sigmas(
    errors: pd.DataFrame, channels: pd.DataFrame, spacing_chips: float, front_end_hz: float
) -> pd.DataFrame:
    """What T(2.20) and T(2.25) expect of each observation, by the loop's settings at that time.

    The C/N0 is the satellite's mean over the table (a single estimate is noise itself).

    Parameters
    ----------
    errors: as of `range_errors`. channels: as of `read_channels`. spacing_chips: early to late.
    front_end_hz: two-sided bandwidth; at most the sampling rate of complex samples.

    Returns: errors with the columns phase_thermal_m, code_thermal_m (NaN before the loops' time).
    """
    week = int(errors["week"].iloc[0])
    settings = channels.assign(
        time_ms=(week_seconds(channels, week) * 1e3).round().astype(np.int64)
    )
    columns = ["coherent_s", "carrier_bandwidth_hz", "code_bandwidth_hz"]
    merged = pd.merge_asof(
        errors.sort_values("time_ms", kind="stable"),
        settings.sort_values("time_ms", kind="stable")[["time_ms", "satellite", *columns]],
        on="time_ms",
        by="satellite",
        direction="forward",
    )
    cn0 = merged.groupby("satellite")["cn0_dbhz"].transform("mean")
    known = merged[columns].notna().all(axis=1)
    phase_m, code_m = np.full(len(merged), np.nan), np.full(len(merged), np.nan)
    rows = zip(merged["satellite"], cn0, *(merged[name] for name in columns), strict=True)
    for k, (satellite, cn0_dbhz, coherent_s, carrier_hz, code_hz) in enumerate(rows):
        if known.iloc[k]:
            chip_rate_hz = SIGNAL_OF_SYSTEM[satellite[0]].chip_rate_hz
            phase_m[k] = wavelength_m(satellite) * pll_thermal_sigma_cycles(
                cn0_dbhz, carrier_hz, coherent_s
            )
            code_m[k] = (SPEED_OF_LIGHT_MPS / chip_rate_hz) * dll_thermal_sigma_chips(
                cn0_dbhz, code_hz, coherent_s, spacing_chips, front_end_hz, chip_rate_hz
            )
    return merged.assign(phase_thermal_m=phase_m, code_thermal_m=code_m)


def dynamic_errors(
    ranges: pd.DataFrame, order: int, bandwidth_hz: float, coherent_s: float
) -> pd.DataFrame:
    """Phase error of an unaided carrier loop that follows the true ranges without noise.

    The loop runs on intervals of the satellite's own time (symbol edges), truth linear between
    its rows; a phase is the estimate of the interval that holds the instant, as observables are.

    Returns: time_ms, satellite, phase_m, arc (always 1), for every row of ranges but the first s.
    """
    week = int(ranges["week"].iloc[0])
    parts = []
    for name, (t_s, rows) in _by_satellite(ranges, week).items():
        cycles = rows["phase_m"].to_numpy(np.float64) / wavelength_m(name)
        edge_s = (t_s[0] - rows["range_m"].iloc[0] / SPEED_OF_LIGHT_MPS) % coherent_s
        edges_s = np.arange(t_s[0] - edge_s + coherent_s, t_s[-1], coherent_s)
        points_s = edges_s[:-1, None] + coherent_s * (np.arange(20) + 0.5) / 20
        means = np.interp(points_s, t_s, cycles - cycles[0]).mean(axis=1)
        states = loop_states(means, order, bandwidth_hz, coherent_s)
        place = np.searchsorted(edges_s, t_s, side="right") - 1
        held = (place >= 0) & (place < len(states)) & (t_s >= t_s[0] + _SETTLED_S)
        since_s = t_s[held] - edges_s[place[held]] - 0.5 * coherent_s
        phase, frequency, rate = states[place[held]].T
        estimate = phase + since_s * (frequency + 0.5 * since_s * rate)
        error_m = (estimate - (cycles - cycles[0])[held]) * wavelength_m(name)
        time_ms = np.round(t_s[held] * 1e3).astype(np.int64)
        parts.append(
            pd.DataFrame({"time_ms": time_ms, "satellite": name, "phase_m": error_m, "arc": 1})
        )
    return pd.concat(parts, ignore_index=True)


def with_theory(accuracy: pd.DataFrame, thermal: pd.DataFrame) -> pd.DataFrame:
    """`satellite_accuracy` with code_thermal_m, phase_thermal_m: root mean squares of theory."""
    columns = ["phase_thermal_m", "code_thermal_m"]
    squares = (thermal.set_index("satellite")[columns] ** 2).groupby(level=0).mean()
    return accuracy.join(squares**0.5)
