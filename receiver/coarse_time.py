"""Position from milliseconds of signal: code phases without their whole milliseconds, and Dopplers.

Nine unknowns: position, common code bias, coarse-time correction, velocity, clock drift (van
Diggelen, A-GPS, ch. 4, extended by the Doppler equations, so that the Dopplers help to find the
whole milliseconds, and the codes help the velocity):
    c·N_i·T − c·s_i = ρ_i(r, t₀ + τ) − c·δ_si + I + T + β       s_i: code phase, T: code period
    −λD_i = [ρ̇_i + ḋ − (c − ρ̇_i)·δ̇_si] / (1 + ḋ/c)

Three steps: a fix from Dopplers and prior alone, good to some ten kilometres; a search over the
whole periods N_i, satellite by satellite, each of which may also be an outlier; the exact
adjustment of the best few candidates, of which one must win clearly and fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import EARTH_RATE_RADPS, GM_GPS_M3PS2, SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.core.linear import inverse
from deepgnss.core.records import (
    SIGNAL_IDS,
    Ephemeris,
    FloatArray,
    NavData,
    NavSolution,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.pvt import dilutions, unsolved
from deepgnss.receiver.raim import RaimResult, check_residuals
from deepgnss.receiver.weights import PvtParameters, delays

R: Final = slice(0, 3)  # position, ECEF, m
BIAS: Final = 3  # common code bias, m
TAU: Final = 4  # correction of the rough time, s
V: Final = slice(5, 8)  # velocity, ECEF, m/s
DRIFT: Final = 8  # c · clock drift, m/s
_UNIT: Final = np.array([1e4, 1e4, 1e4, 1e4, 1.0, 1.0, 1.0, 1.0, 10.0])  # of the states, for lstsq

_BIAS_SIGMA_M: Final = 1e6  # larger than any bias within one period
_ANYWHERE_M: Final = 1e7
_NEARBY_M: Final = 5e3  # a prior that by itself tells right whole periods from wrong ones
_ANNEALING_MPS: Final = (1000.0, 300.0, 100.0, 30.0)
_BEAM: Final = 400  # candidates kept during the search
_HOPELESS: Final = 60.0  # cost over the best at which a candidate is dropped
_FINALISTS: Final = 10
_OUTLIER_ODDS: Final = 19.0  # right to wrong code peaks among what acquisition hands on
_CLEAR_WIN: Final = 12.0  # difference of −2 ln(likelihood) to the next other solution


class CodePhase(NamedTuple):
    """One satellite of a snapshot, at the snapshot's instant."""

    satellite: str
    signal: str  # SignalId.name
    code_s: float  # satellite clock reading modulo the code period: code phase / chip rate
    doppler_hz: float
    cn0_dbhz: float
    code_sigma_m: float = 30.0
    doppler_sigma_hz: float = 5.0


@dataclass(frozen=True, slots=True)
class Rough:
    """What is known before: means and standard deviations of loose normal priors."""

    time: GpsTime
    time_sigma_s: float = 30.0
    r_e_m: FloatArray | None = None  # None: anywhere on earth
    position_sigma_m: float = 50e3
    height_m: float = 0.0
    height_sigma_m: float = 10e3  # a small one lets four satellites do
    velocity_sigma_mps: float = 50.0
    drift_sps: float = 0.0
    drift_sigma_sps: float = 10e-6


@dataclass(frozen=True, slots=True)
class SnapshotFix:
    """A position from a snapshot.

    solution: its time is the corrected one, its clock_s the common bias modulo the code period.
    time_sigma_s: of that time. cost, limit: weighted squares of the residuals and their bound.
    margin: how much worse the next other solution fits (−2 ln likelihood ratio).
    """

    solution: NavSolution
    time_sigma_s: float
    cost: float
    limit: float
    margin: float


class _Problem(NamedTuple):
    """Everything that stays fixed during the adjustment."""

    satellites: tuple[str, ...]
    ephemerides: tuple[Ephemeris, ...]
    nav: NavData
    parameters: PvtParameters
    rough: Rough
    start: FloatArray  # (9,) prior mean; position meaningless when anywhere
    codes_m: FloatArray  # −c·s_i
    periods_m: FloatArray  # c·T
    rates_mps: FloatArray  # −λD
    carriers_hz: FloatArray
    code_sigma_m: FloatArray
    rate_sigma_mps: FloatArray


class _Linear(NamedTuple):
    """Predictions at a state and their derivatives."""

    codes_m: FloatArray  # (k,)
    rates_mps: FloatArray
    H_code: FloatArray  # (k, 9)
    H_rate: FloatArray
    azimuth_rad: FloatArray
    elevation_rad: FloatArray


class _Adjusted(NamedTuple):
    x: FloatArray
    cost: float
    linear: _Linear
    A: FloatArray  # whitened design, rows: codes, rates, prior
    b: FloatArray  # whitened residuals


class _Candidate(NamedTuple):
    x: FloatArray
    periods: NDArray[np.int64]  # (k,) whole code periods
    inside: NDArray[np.bool_]  # (k,) False: outlier
    evidence: float  # the part of −2 ln(likelihood) that is not squares of residuals


def solve(
    snapshot: Sequence[CodePhase], nav: NavData, rough: Rough, parameters: PvtParameters
) -> SnapshotFix:
    """Position, velocity, time and clock of a snapshot.

    Five satellites are needed; four if the height is known to 500 m (`height_sigma_m`).
    Satellites whose Doppler or code does not fit are left out. Where nothing fits, or two
    different solutions fit alike, the solution is invalid and says so.
    """
    problem, rejected = _problem(snapshot, nav, rough, parameters)
    needed = 4 if rough.height_sigma_m <= 500.0 else 5
    count = len(problem.satellites)
    if count < needed:
        return _failed(rough, f"{count} of {needed} satellites needed", rejected)
    coarse = _doppler_fix(problem, needed)
    if isinstance(coarse, str):
        return _failed(rough, coarse, rejected)
    keep, coarse_x = coarse
    reasons = {
        name: "Doppler does not fit"
        for name, kept in zip(problem.satellites, keep, strict=True)
        if not kept
    }
    low = _linearize(problem, coarse_x).elevation_rad < parameters.elevation_mask_rad
    reasons |= {
        problem.satellites[row]: "below the elevation mask" for row in np.flatnonzero(low & keep)
    }
    rejected |= reasons
    problem = _subset(problem, keep & ~low)
    if len(problem.satellites) < needed:
        return _failed(rough, f"{len(problem.satellites)} of {needed} satellites needed", rejected)
    finalists = [
        (candidate, _adjust(problem, candidate.x, candidate.periods, candidate.inside))
        for candidate in _search(problem, coarse_x, needed)
    ]
    if not finalists:
        return _failed(rough, f"no {needed} code phases fit each other", rejected)
    finalists.sort(key=lambda f: f[0].evidence + f[1].cost)
    candidate, best = finalists[0]
    total = candidate.evidence + best.cost
    others = [
        other.evidence + fit.cost - total
        for other, fit in finalists[1:]
        if np.linalg.norm(fit.x[R] - best.x[R]) > 3000.0
    ]
    margin = min(others, default=np.inf)
    inside = candidate.inside
    if margin < _CLEAR_WIN:
        return _failed(
            rough, f"whole milliseconds ambiguous: next fits {margin:.1f} worse", rejected
        )
    rows = np.flatnonzero(inside)
    verdict = _check(best, len(rows), parameters)
    if verdict.excluded:
        inside = inside.copy()
        inside[rows[[row % len(rows) for row in verdict.excluded]]] = False
        best = _adjust(problem, best.x, candidate.periods, inside)
        rows = np.flatnonzero(inside)
        verdict = _check(best, len(rows), parameters)
    rejected |= {
        problem.satellites[row]: "code phase does not fit" for row in np.flatnonzero(~inside)
    }
    near = rough.r_e_m is not None and rough.position_sigma_m <= _NEARBY_M
    if not near and any("not fit" in reason for reason in rejected.values()):
        needed += 1  # without redundancy nothing tells that the right ones were left out
    if len(rows) < needed:
        return _failed(rough, f"only {len(rows)} satellites fit, {needed} needed", rejected)
    if not verdict.passed:
        return _failed(
            rough,
            f"residuals disagree: chi-square {verdict.statistic:.1f} > {verdict.limit:.1f} over "
            f"{len(rows)} satellites",
            rejected,
        )
    return _fix(problem, best, rows, rejected, verdict.limit, margin)


def following(previous: SnapshotFix, seconds: float, velocity_sigma_mps: float = 10.0) -> Rough:
    """Prior for a snapshot `seconds` after one that was solved."""
    solution = previous.solution
    height_m = geodetic(solution.r_e_m)[2]
    return Rough(
        time=solution.time.plus(seconds),
        time_sigma_s=float(np.hypot(previous.time_sigma_s, 1.0)),
        r_e_m=solution.r_e_m,
        position_sigma_m=1000.0 + 100.0 * abs(seconds),
        height_m=height_m,
        height_sigma_m=1000.0,
        velocity_sigma_mps=velocity_sigma_mps,
        drift_sps=solution.drift_sps,
        drift_sigma_sps=1e-6,
    )


# --- setting up ----------------------------------------------------------------------------------


def _problem(
    snapshot: Sequence[CodePhase], nav: NavData, rough: Rough, parameters: PvtParameters
) -> tuple[_Problem, dict[str, str]]:
    rejected: dict[str, str] = {}
    chosen: list[tuple[CodePhase, Ephemeris]] = []
    for entry in snapshot:
        ephemeris = orbits.select(nav, entry.satellite, rough.time)
        if ephemeris is None:
            rejected[entry.satellite] = "no ephemeris"
        elif ephemeris.health != 0:
            rejected[entry.satellite] = "unhealthy"
        else:
            chosen.append((entry, ephemeris))
    entries = [entry for entry, _ in chosen]
    signals = [SIGNAL_IDS[entry.signal] for entry in entries]
    carriers_hz = np.array([signal.carrier_hz for signal in signals])
    wavelengths_m = SPEED_OF_LIGHT_MPS / carriers_hz
    start = np.zeros(9)
    start[DRIFT] = SPEED_OF_LIGHT_MPS * rough.drift_sps
    if rough.r_e_m is not None:
        start[R] = rough.r_e_m
    return _Problem(
        satellites=tuple(entry.satellite for entry in entries),
        ephemerides=tuple(ephemeris for _, ephemeris in chosen),
        nav=nav,
        parameters=parameters,
        rough=rough,
        start=start,
        codes_m=-SPEED_OF_LIGHT_MPS * np.array([entry.code_s for entry in entries]),
        periods_m=SPEED_OF_LIGHT_MPS * np.array([s.code_chips / s.chip_rate_hz for s in signals]),
        rates_mps=-wavelengths_m * np.array([entry.doppler_hz for entry in entries]),
        carriers_hz=carriers_hz,
        code_sigma_m=np.array([entry.code_sigma_m for entry in entries]),
        rate_sigma_mps=wavelengths_m * np.array([entry.doppler_sigma_hz for entry in entries]),
    ), rejected


def _subset(problem: _Problem, keep: NDArray[np.bool_]) -> _Problem:
    rows = np.flatnonzero(keep)
    return problem._replace(
        satellites=tuple(problem.satellites[row] for row in rows),
        ephemerides=tuple(problem.ephemerides[row] for row in rows),
        codes_m=problem.codes_m[rows],
        periods_m=problem.periods_m[rows],
        rates_mps=problem.rates_mps[rows],
        carriers_hz=problem.carriers_hz[rows],
        code_sigma_m=problem.code_sigma_m[rows],
        rate_sigma_mps=problem.rate_sigma_mps[rows],
    )


# --- equations -----------------------------------------------------------------------------------


def _linearize(problem: _Problem, x: FloatArray) -> _Linear:
    """Predicted pseudoranges and rates at a state, and their derivatives by it."""
    time = problem.rough.time.plus(float(x[TAU]))
    at = orbits.predict(problem.ephemerides, time, x[R], x[V])
    delay_m, _ = delays(
        problem.nav,
        problem.parameters,
        time,
        x[R],
        at.azimuth_rad,
        at.elevation_rad,
        problem.carriers_hz,
    )
    sight = at.sight
    u, k = sight.unit_e, len(problem.ephemerides)
    satellites_e_m = x[R] + u * sight.range_m[:, np.newaxis]
    relative = at.v_e_mps - x[V]
    across = relative - u * np.einsum("ij,ij->i", u, relative)[:, np.newaxis]
    stretch = 1.0 + x[DRIFT] / SPEED_OF_LIGHT_MPS

    H_code, H_rate = np.zeros((k, 9)), np.zeros((k, 9))
    H_code[:, R] = -u
    H_code[:, BIAS] = 1.0
    # The antenna is where it is: the satellites' and the earth's motion alone.
    H_code[:, TAU] = at.pseudorange_rate_mps + u @ x[V]
    H_rate[:, R] = -across / sight.range_m[:, np.newaxis]
    H_rate[:, TAU] = np.einsum("ij,ij->i", across, across) / sight.range_m + np.einsum(
        "ij,ij->i", u, _acceleration(satellites_e_m, at.v_e_mps)
    )
    H_rate[:, V] = -u * sight.rate_scale[:, np.newaxis]
    H_rate[:, DRIFT] = 1.0 / stretch
    return _Linear(
        codes_m=at.pseudorange_m + delay_m + x[BIAS],
        rates_mps=(at.pseudorange_rate_mps + x[DRIFT]) / stretch,
        H_code=H_code,
        H_rate=H_rate,
        azimuth_rad=at.azimuth_rad,
        elevation_rad=at.elevation_rad,
    )


def _acceleration(r_e_m: FloatArray, v_e_mps: FloatArray) -> FloatArray:
    """Acceleration of satellites in ECEF: central gravity, Coriolis, centrifugal."""
    gravity = -GM_GPS_M3PS2 * r_e_m / np.linalg.norm(r_e_m, axis=1)[:, np.newaxis] ** 3
    w = np.array([0.0, 0.0, EARTH_RATE_RADPS])
    return np.asarray(gravity - 2.0 * np.cross(w, v_e_mps) - np.cross(w, np.cross(w, r_e_m)))


def _prior_rows(problem: _Problem, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Whitened rows of the prior: design (10, 9) and misfit (10,)."""
    rough = problem.rough
    lat, lon, height_m = geodetic(x[R])
    sigma = np.empty(9)
    sigma[R] = _ANYWHERE_M if rough.r_e_m is None else rough.position_sigma_m
    sigma[BIAS] = _BIAS_SIGMA_M
    sigma[TAU] = rough.time_sigma_s
    sigma[V] = rough.velocity_sigma_mps
    sigma[DRIFT] = SPEED_OF_LIGHT_MPS * rough.drift_sigma_sps
    misfit = (problem.start - x) / sigma
    if rough.r_e_m is None:
        misfit[R] = 0.0
    up = np.zeros((1, 9))
    up[0, R] = -C_ne(lat, lon)[2] / rough.height_sigma_m
    return (
        np.vstack([np.diag(1.0 / sigma), up]),
        np.append(misfit, (rough.height_m - height_m) / rough.height_sigma_m),
    )


def _adjust(
    problem: _Problem,
    x: FloatArray,
    periods: NDArray[np.int64] | None,
    inside: NDArray[np.bool_],
    iterations: int = 12,
    scale_mps: float | None = None,
) -> _Adjusted:
    """Gauss–Newton over the satellites inside, with codes of given whole periods or without.

    With `scale_mps` rates have that standard deviation, more where they misfit more (Cauchy).
    """
    rows = np.flatnonzero(inside)
    for _ in range(iterations):
        linear = _linearize(problem, x)
        prior, prior_misfit = _prior_rows(problem, x)
        misfit_mps = (problem.rates_mps - linear.rates_mps)[rows]
        sigma_mps = problem.rate_sigma_mps[rows]
        if scale_mps is not None:
            sigma_mps = np.hypot(scale_mps, misfit_mps)
        blocks = [linear.H_rate[rows] / sigma_mps[:, np.newaxis], prior]
        misfits = [misfit_mps / sigma_mps, prior_misfit]
        if periods is not None:
            measured_m = problem.codes_m + problem.periods_m * periods
            blocks.insert(0, linear.H_code[rows] / problem.code_sigma_m[rows, np.newaxis])
            misfits.insert(0, (measured_m - linear.codes_m)[rows] / problem.code_sigma_m[rows])
        A, b = np.vstack(blocks), np.concatenate(misfits)
        step = np.linalg.lstsq(A * _UNIT, b)[0] * _UNIT
        x = x + step
        b = b - A @ step
        if np.linalg.norm(step[R]) < 1.0 and abs(step[TAU]) < 1e-3:
            break
    return _Adjusted(x, float(b @ b), linear, A, b)


# --- from Dopplers -------------------------------------------------------------------------------


def _doppler_fix(problem: _Problem, needed: int) -> tuple[NDArray[np.bool_], FloatArray] | str:
    """Rough state from Dopplers and prior, and which Dopplers agree; or why there is none.

    A wrong peak's Doppler is wrong by up to a km/s and would drag the fix far away; it is found
    where the linearisation holds, at a fix in which large misfits weigh little.
    """
    keep = np.ones(len(problem.satellites), bool)
    x, best = problem.start, np.inf
    for start in _starting_points(problem):
        for scale_mps in _ANNEALING_MPS:
            start = _adjust(problem, start, None, keep, 2, scale_mps).x
        misfit_mps = problem.rates_mps - _linearize(problem, start).rates_mps
        loss = float(np.log1p((misfit_mps / _ANNEALING_MPS[-1]) ** 2).sum())
        if loss < best:
            x, best = start, loss
        if loss < 1.0:
            break
    while True:
        rows = np.flatnonzero(keep)
        fit = _adjust(problem, x, None, keep, 1)
        verdict = check_residuals(
            fit.A, fit.b, np.ones(len(fit.b)), 1e-6, at_once=3, excludable=len(rows)
        )
        if not verdict.passed or len(rows) - len(verdict.excluded) < needed:
            return f"Dopplers disagree: chi-square {fit.cost:.0f} over {len(rows)} satellites"
        if not verdict.excluded:
            return keep, _adjust(problem, x, None, keep).x
        keep[rows[list(verdict.excluded)]] = False


def _starting_points(problem: _Problem) -> list[FloatArray]:
    """The prior's mean; without a position the point below the satellites' middle and a ring."""
    if problem.rough.r_e_m is not None:
        return [problem.start]
    states = orbits.satellite_states(
        problem.ephemerides, problem.rough.time, np.zeros(len(problem.ephemerides))
    )
    middle = states.r_e_m.mean(axis=0)
    lat, lon, _ = geodetic(middle)
    axes = C_ne(lat, lon)
    points = [-axes[2]]
    for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 3.0):
        sideways = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
        points.append(np.cos(0.5) * -axes[2] + np.sin(0.5) * sideways)
    starts = []
    for point in points:
        start = problem.start.copy()
        start_lat, start_lon, _ = geodetic(6.371e6 * point)
        start[R] = ecef(start_lat, start_lon, problem.rough.height_m)
        starts.append(start)
    return starts


# --- whole periods -------------------------------------------------------------------------------


def _search(problem: _Problem, x: FloatArray, needed: int) -> list[_Candidate]:
    """Best assignments of whole periods, from a linearisation at the Doppler fix.

    Breadth-first over the satellites, the strongest first: each candidate is a Kalman filter that
    takes the satellite's code with every number of periods that is likely enough, or leaves it
    out as an outlier (code phase uniform over the period). −2 ln(likelihood) is what is compared.
    """
    count = len(problem.satellites)
    everything = np.ones(count, bool)
    fit = _adjust(problem, x, None, everything)
    linear = _linearize(problem, fit.x)
    P = inverse(fit.A.T @ fit.A)
    place_m, time_s = float(np.sqrt(np.trace(P[R, R]))), float(np.sqrt(P[TAU, TAU]))
    # What the linearisation leaves out: curvature of the range in place, in time, and mixed.
    curvature_m = place_m**2 / 4e7 + 0.08 * time_s**2 + 1.6e-4 * place_m * time_s

    mean, P = fit.x[np.newaxis], P[np.newaxis]
    whole = np.zeros((1, count), np.int64)
    inside = np.zeros((1, count), bool)
    cost = squares = np.zeros(1)
    for row in np.argsort(-linear.elevation_rad):
        h, period_m = linear.H_code[row], problem.periods_m[row]
        Ph = P @ h
        S = Ph @ h + problem.code_sigma_m[row] ** 2 + curvature_m**2
        first = np.logical_not(inside).all(axis=1).reshape(-1)
        innovation = problem.codes_m[row] - linear.codes_m[row] - (mean - fit.x) @ h
        nearest = -np.round(innovation / period_m).astype(np.int64)
        reach = np.where(first, 0, np.ceil(3.0 * np.sqrt(S) / period_m - 0.5)).astype(int)
        parents, numbers = [np.arange(len(cost))], [nearest]
        for offset in range(1, min(int(reach.max()), 4) + 1):
            wide = np.flatnonzero(reach >= offset)
            parents += [wide, wide]
            numbers += [nearest[wide] + offset, nearest[wide] - offset]
        parent, number = np.concatenate(parents), np.concatenate(numbers)
        left = innovation[parent] + number * period_m
        square = np.where(first[parent], 0.0, left**2 / S[parent])
        spread = np.where(first[parent], 2.0 * np.log(period_m), np.log(2.0 * np.pi * S[parent]))
        gain = Ph[parent] / S[parent, np.newaxis]
        new_whole, new_inside = whole[parent], inside[parent]
        new_whole[:, row], new_inside[:, row] = number, True
        outlier = cost + 2.0 * np.log(_OUTLIER_ODDS * period_m)
        mean = np.concatenate([mean[parent] + gain * left[:, np.newaxis], mean])
        P = np.concatenate([P[parent] - gain[:, :, np.newaxis] * Ph[parent, np.newaxis], P])
        whole = np.concatenate([new_whole, whole])
        inside = np.concatenate([new_inside, inside])
        squares = np.concatenate([squares[parent] + square, squares])
        cost = np.concatenate([cost[parent] + square + spread, outlier])
        order = np.argsort(cost, kind="stable")[:_BEAM]
        order = order[cost[order] <= cost[order[0]] + _HOPELESS]
        mean, P, whole, inside = mean[order], P[order], whole[order], inside[order]
        cost, squares = cost[order], squares[order]
    return [
        _Candidate(mean[n], whole[n], inside[n], float(cost[n] - squares[n]))
        for n in range(min(_FINALISTS, len(cost)))
        if np.count_nonzero(inside[n]) >= needed
    ]


# --- verdict and result --------------------------------------------------------------------------


def _check(fit: _Adjusted, satellites: int, parameters: PvtParameters) -> RaimResult:
    return check_residuals(
        fit.A,
        fit.b,
        np.ones(len(fit.b)),
        parameters.false_alarm,
        at_once=2,
        excludable=2 * satellites,
    )


def _fix(
    problem: _Problem,
    fit: _Adjusted,
    rows: NDArray[np.intp],
    rejected: Mapping[str, str],
    limit: float,
    margin: float,
) -> SnapshotFix:
    period_m = float(problem.periods_m[0])
    bias_m = (fit.x[BIAS] + period_m / 2) % period_m - period_m / 2
    P = inverse(fit.A.T @ fit.A)
    lat, lon, _ = geodetic(fit.x[R])
    H = fit.linear.H_code[rows][:, [0, 1, 2, BIAS, TAU]]
    position, velocity = [0, 1, 2, BIAS], [5, 6, 7, DRIFT]
    residuals_m = fit.b[: len(rows)] * problem.code_sigma_m[rows]
    solution = NavSolution(
        time=problem.rough.time.plus(float(fit.x[TAU])),
        valid=True,
        reason="",
        r_e_m=fit.x[R],
        v_e_mps=fit.x[V],
        clock_s=float(bias_m) / SPEED_OF_LIGHT_MPS,
        drift_sps=float(fit.x[DRIFT]) / SPEED_OF_LIGHT_MPS,
        isb_s={},
        covariance_m2=P[np.ix_(position, position)],
        velocity_covariance_m2ps2=P[np.ix_(velocity, velocity)],
        dops=dilutions(H, C_ne(lat, lon)) if len(rows) >= 5 else {},
        used=tuple(problem.satellites[row] for row in rows),
        rejected=dict(rejected),
        residuals_m={
            problem.satellites[row]: float(residual)
            for row, residual in zip(rows, residuals_m, strict=True)
        },
        azimuth_elevation_rad={
            satellite: (float(azimuth), float(elevation))
            for satellite, azimuth, elevation in zip(
                problem.satellites, fit.linear.azimuth_rad, fit.linear.elevation_rad, strict=True
            )
        },
    )
    return SnapshotFix(solution, float(np.sqrt(P[TAU, TAU])), fit.cost, limit, margin)


def _failed(rough: Rough, reason: str, rejected: Mapping[str, str]) -> SnapshotFix:
    return SnapshotFix(unsolved(rough.time, reason, rejected), np.nan, np.nan, np.nan, np.nan)
