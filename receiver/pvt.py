"""Single-point position, velocity and time by weighted least squares.

Observation equations (ECEF at reception, signs as SPEC 1):
    P  = ρ + c·δ_r + ISB − c·(δ_s − TGD) + I + T
    −λD = [ρ̇ + c·δ̇_r − (c − ρ̇)·δ̇_s] / (1 + δ̇_r)
with ρ from the satellite at its time of transmission to the antenna at reception, Earth turned by
the travel time. The transmission time is the satellite clock's reading, so the receiver clock does
not enter the orbit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.jit import brief_kernel
from deepgnss.core.linear import inverse, least_squares, whitening
from deepgnss.core.records import Epoch, FloatArray, NavData, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.beside import (
    Beside,
    Place,
    Rows,
    between_systems,
    rows_beside,
)
from deepgnss.receiver.measured import NOBODY_REFUSED, Measured, measure
from deepgnss.receiver.raim import GROSS_M, check_residuals, gross_errors
from deepgnss.receiver.weights import (
    ErrorModel,
    PvtParameters,
    range_sigma,
    rate_sigma,
)

__all__ = [
    "NOBODY_REFUSED",
    "ErrorModel",
    "PvtParameters",
    "dilutions",
    "solve",
    "solve_measured",
    "unsolved",
]

_MAX_ITERATIONS = 20
_CONVERGED_M = 1.0  # the step after this one would be its square over the range: 1e-7 m
_ATMOSPHERE_STEP_M = 10.0  # its delays change by 3 mm at zenith over this height
_DILUTIONS = ("gdop", "pdop", "hdop", "vdop", "tdop")
_KINDS = ("elevation", "residual", "range")
_PLAUSIBLE_HEIGHT_M = (-20e3, 2000e3)


class _Fix(NamedTuple):
    """Result of the adjustment of one set of satellites."""

    r_e_m: FloatArray
    biases_m: Mapping[str, float]  # receiver clock in metres, by system
    H: FloatArray  # of all rows: satellites used, then those beside …
    sigma: FloatArray  # … and their σ
    beside_left: FloatArray  # of those beside after the adjustment, in their units
    sigma_m: FloatArray  # of all measured
    residuals_m: FloatArray  # of all measured; NaN for systems that are not in the solution
    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    used: NDArray[np.bool_]
    sight: orbits.LineOfSight
    low: Mapping[str, str]  # satellite → how far it is below the mask


class _Failure(NamedTuple):
    """Why there is none."""

    reason: str
    low: Mapping[str, str]
    diverged: bool = False


def solve(
    epoch: Epoch,
    nav: NavData,
    parameters: PvtParameters,
    previous: NavSolution | None = None,
    refused: Mapping[str, str] = NOBODY_REFUSED,
    place: Place | None = None,
) -> NavSolution:
    """Position, velocity and clock from the observations of one epoch.

    Parameters
    ----------
    epoch: one observation per satellite; `transmit` is the satellite clock's reading.
    previous: a solution to start from; without one the iteration starts at the geocentre.
    refused: satellites that somebody else found wrong, and why: they stay out.
    place: the antenna as somebody predicts it, taken as a measurement: one satellite is enough
        then, and RAIM holds the ranges against it, too.

    Returns a solution with `valid` False and a reason where there is none. `rejected` also names
    satellites of the position whose Doppler was left out of the velocity ("Doppler: …").
    """
    return solve_measured(measure(epoch, nav), parameters, previous, refused, place)


def solve_measured(
    measured: Measured,
    parameters: PvtParameters,
    previous: NavSolution | None = None,
    refused: Mapping[str, str] = NOBODY_REFUSED,
    place: Place | None = None,
) -> NavSolution:
    """As `solve`, of observations that others look at, too."""
    time = measured.epoch.time
    active, rejected = measured.without(refused)
    start_e_m = previous.r_e_m if previous is not None and previous.valid else np.zeros(3)
    start_e_m = start_e_m if place is None else place.r_e_m
    known = Beside(between_systems(time, previous), place)
    screened = not parameters.raim
    while True:
        fix = _adjust(parameters, measured, active, start_e_m, known)
        if not screened and _is_gross(fix):
            screened = True
            for row, error_m in gross_errors(
                measured.states, measured.ranges_m, active, start_e_m
            ).items():
                active[row] = False
                rejected[measured.satellites[row]] = f"range off by {error_m / 1e3:.0f} km"
            continue
        rejected |= fix.low
        if isinstance(fix, _Failure):
            return unsolved(time, fix.reason + _tally(rejected), rejected)
        if not parameters.raim:
            break
        rows = np.flatnonzero(fix.used)
        verdict = check_residuals(
            fix.H,
            np.concatenate([fix.residuals_m[rows], fix.beside_left]),
            fix.sigma,
            parameters.false_alarm,
            excludable=len(rows),
        )
        if not verdict.passed and known.between_m:
            known = known._replace(
                between_m={}
            )  # what was known of the systems may be what is wrong
            continue
        if not verdict.passed:
            return unsolved(
                time,
                f"residuals disagree: chi-square {verdict.statistic:.1f} > {verdict.limit:.1f} "
                f"over {len(rows)} satellites, too few to tell which is wrong",
                rejected,
            )
        if not verdict.excluded:
            break
        for row in rows[list(verdict.excluded)]:
            active[row] = False
            rejected[measured.satellites[row]] = (
                f"residual {fix.residuals_m[row]:.1f} m at σ {fix.sigma_m[row]:.1f} m"
            )
        start_e_m = fix.r_e_m
    height_m = geodetic(fix.r_e_m)[2]
    if not _PLAUSIBLE_HEIGHT_M[0] < height_m < _PLAUSIBLE_HEIGHT_M[1]:
        return unsolved(time, f"height of {height_m / 1e3:.0f} km is impossible", rejected)
    return _solution(parameters, measured, fix, rejected, place)


def _adjust(
    parameters: PvtParameters,
    measured: Measured,
    active: NDArray[np.bool_],
    start_e_m: FloatArray,
    known: Beside,
) -> _Fix | _Failure:
    """Gauss–Newton over the active satellites above the mask."""
    r_e_m = start_e_m
    delays_m, sigma_m = np.zeros(len(active)), np.ones(len(active))
    elevation = np.full(len(active), np.nan)
    azimuth = elevation
    used, modelled_at_e_m = active, None
    low: dict[str, str] = {}
    members = _members(measured.satellites)
    for _ in range(_MAX_ITERATIONS):
        sight = orbits.line_of_sight(r_e_m, np.zeros(3), measured.states)
        near_earth = math.hypot(*r_e_m) > 6.3e6
        if near_earth and (
            modelled_at_e_m is None or math.dist(r_e_m, modelled_at_e_m) > _ATMOSPHERE_STEP_M
        ):
            azimuth, elevation = orbits.directions(r_e_m, sight)
            used = active & (elevation >= parameters.elevation_mask_rad)
            low = _below_mask(parameters, measured, active, elevation)
            delays_m, variance_m2 = measured.delays(parameters, r_e_m, azimuth, elevation)
            sigma_m = range_sigma(
                parameters.errors, measured.ephemerides, elevation, measured.cn0_dbhz, variance_m2
            )
            modelled_at_e_m = r_e_m
        rows = np.flatnonzero(used)
        systems = [system for system, member in members.items() if member[rows].any()]
        beside = rows_beside(systems, known, r_e_m)
        unknowns = 3 + len(systems)
        needed = max(unknowns - len(beside.values), 1 if known.place is not None else 4)
        if len(rows) < needed:
            return _Failure(f"{len(rows)} of {needed} satellites needed", low, len(low) > 0)
        misfit = measured.ranges_m - delays_m - sight.range_m
        clocks = np.array([members[system] for system in systems])
        x, rank, H, sigma = _step(misfit, sight.unit_e, clocks, sigma_m, rows, *beside)
        if rank < unknowns:
            return _Failure(f"geometry of {len(rows)} satellites is singular", low)
        step_m = math.hypot(*x[:3])
        r_e_m = r_e_m + x[:3]
        if step_m < _CONVERGED_M:
            break
    else:
        return _Failure(
            f"no convergence: last of {_MAX_ITERATIONS} steps was {step_m:.0f} m", low, True
        )
    biases_m = dict(zip(systems, (float(b) for b in x[3:]), strict=True))
    own_m = np.array([biases_m.get(s[0], np.nan) for s in measured.satellites])
    moved_m = -sight.unit_e @ x[:3]
    return _Fix(
        r_e_m,
        biases_m,
        H,
        sigma,
        beside.values - beside.H @ x,
        sigma_m,
        misfit - moved_m - own_m,
        azimuth,
        elevation,
        used,
        sight,
        low,
    )


@brief_kernel
def _step(
    misfit_m: FloatArray,
    unit_e: FloatArray,
    clocks: FloatArray,
    sigma_m: FloatArray,
    rows: NDArray[np.intp],
    H_beside: FloatArray,
    values: FloatArray,
    sigma_beside: FloatArray,
) -> tuple[FloatArray, int, FloatArray, FloatArray]:
    """Step x (p,) by some rows and those beside, and their rank; H (n, p) and σ (n,) of all.

    −unit·δr + clock = misfit, weights σ⁻²; clocks (systems, k): 1 for a system's satellites.
    """
    count = rows.size
    H, sigma = np.empty((count + values.size, 3 + clocks.shape[0])), np.empty(count + values.size)
    H[count:], sigma[count:] = H_beside, sigma_beside
    for n in range(count):
        k = rows[n]
        H[n, :3], H[n, 3:], sigma[n] = -unit_e[k], clocks[:, k], sigma_m[k]
    weight = 1.0 / sigma
    asked = np.concatenate((misfit_m[rows], values))
    x, rank = least_squares(H * weight.reshape(-1, 1), asked * weight)
    return x, rank, H, sigma


def _is_gross(fix: _Fix | _Failure) -> bool:
    """Whether residuals are beyond what a linear test can judge."""
    if isinstance(fix, _Failure):
        return fix.diverged
    return bool(np.abs(fix.residuals_m[fix.used]).max() > GROSS_M)


def _members(satellites: Sequence[str]) -> dict[str, FloatArray]:
    """Whose satellites (k,) are a system's (1, else 0), by its letter.

    GPS comes first: the clock of the first is the receiver's.
    """
    letters = [satellite[0] for satellite in satellites]
    return {
        system: np.array([letter == system for letter in letters], dtype=np.float64)
        for system in sorted(set(letters), key=lambda s: (s != "G", s))
    }


def _below_mask(
    parameters: PvtParameters,
    measured: Measured,
    active: NDArray[np.bool_],
    elevation: FloatArray,
) -> dict[str, str]:
    mask_deg = math.degrees(parameters.elevation_mask_rad)
    return {
        measured.satellites[
            row
        ]: f"elevation {math.degrees(elevation[row]):.1f}° below {mask_deg:.1f}°"
        for row in np.flatnonzero(active & (elevation < parameters.elevation_mask_rad))
    }


def _tally(rejected: Mapping[str, str]) -> str:
    """How many satellites were left out for which kind of reason."""
    kinds = [
        next((kind for kind in _KINDS if reason.startswith(kind)), reason)
        for reason in rejected.values()
    ]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return f" (left out: {counts})" if counts else ""


class _Velocity(NamedTuple):
    v_e_mps: FloatArray
    drift_sps: float
    covariance_m2ps2: FloatArray


def _velocity(
    parameters: PvtParameters,
    measured: Measured,
    fix: _Fix,
    rejected: dict[str, str],
    place: Place | None,
) -> _Velocity:
    """Velocity and clock drift from the Dopplers of the satellites used for the position."""
    H, misfit = _rate_equations(*fix.sight[1:], measured.rates_mps, measured.states.drift_sps)
    sigma = rate_sigma(parameters.errors, measured.cn0_dbhz, measured.rate_sigmas_mps)
    rows = np.flatnonzero(fix.used & np.isfinite(misfit))
    told = Rows(np.zeros((0, 4)), np.zeros(0), np.zeros(0))
    if place is not None:
        white = whitening(place.velocity_covariance_m2ps2)
        told = Rows(np.zeros((3, 4)), white @ place.v_e_mps, np.ones(3))
        told.H[:, :3] = white
    while len(rows) >= max(4 - len(told.values), 1):
        x, rank, A, design, residuals, sigmas = _rate_step(H, misfit, sigma, rows, *told)
        if rank < 4:
            break
        excluded: tuple[int, ...] = ()
        if parameters.raim:
            verdict = check_residuals(
                design, residuals, sigmas, parameters.false_alarm, excludable=len(rows)
            )
            if not verdict.passed:
                break
            excluded = verdict.excluded
        if not excluded:
            drift_sps = float(x[3]) / SPEED_OF_LIGHT_MPS
            return _Velocity(np.asarray(x[:3]), drift_sps, inverse(A.T @ A))
        for row in excluded:
            satellite = measured.satellites[rows[row]]
            rejected[satellite] = f"Doppler: residual {residuals[row]:.2f} m/s"
        rows = np.delete(rows, excluded)
    return _Velocity(np.full(3, np.nan), np.nan, np.full((4, 4), np.nan))


@brief_kernel
def _rate_equations(
    still_mps: FloatArray,
    unit_e: FloatArray,
    rate_scale: FloatArray,
    rates_mps: FloatArray,
    drift_sps: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """H (k, 4) and misfits (k,) of range rates, m/s: H·(velocity, drift·c) = misfit.

    still_mps: of an antenna at rest; drift_sps: of the satellites' clocks.
    """
    misfit = rates_mps - still_mps + (SPEED_OF_LIGHT_MPS - still_mps) * drift_sps
    H = np.empty((rates_mps.size, 4))
    H[:, :3] = -unit_e * rate_scale.reshape(-1, 1)
    H[:, 3] = 1.0 - rates_mps / SPEED_OF_LIGHT_MPS
    return H, misfit


@brief_kernel
def _rate_step(
    H: FloatArray,
    misfit: FloatArray,
    sigma: FloatArray,
    rows: NDArray[np.intp],
    told_H: FloatArray,
    told: FloatArray,
    told_sigma: FloatArray,
) -> tuple[FloatArray, int, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Velocity and drift·c (4,) by some rows and what is told, and their rank.

    Then of all these equations (n): weighted design matrix (n, 4), the plain one, what is left of
    them, and their σ.
    """
    design = np.concatenate((H[rows], told_H))
    values = np.concatenate((misfit[rows], told))
    sigmas = np.concatenate((sigma[rows], told_sigma))
    A = design / sigmas.reshape(-1, 1)
    x, rank = least_squares(A, values / sigmas)
    return x, rank, A, design, values - design @ x, sigmas


def _solution(
    parameters: PvtParameters,
    measured: Measured,
    fix: _Fix,
    rejected: dict[str, str],
    place: Place | None,
) -> NavSolution:
    velocity = _velocity(parameters, measured, fix, rejected, place)
    rows = np.flatnonzero(fix.used)
    reference, *others = fix.biases_m
    lat, lon, _ = geodetic(fix.r_e_m)
    # Columns as receiver clock and biases against it instead of one clock per system.
    H = fix.H.copy()
    H[: len(rows), 3] = 1.0
    H[len(rows) :, 3] = 0.0
    weighted = H / fix.sigma[:, np.newaxis]
    covariance_m2 = inverse(weighted.T @ weighted)
    between_m = np.sqrt(np.diagonal(covariance_m2)[4:])
    placed = 0 if place is None else 3  # rows that are no satellites: they dilute nothing
    return NavSolution(
        time=measured.epoch.time,
        valid=True,
        reason="",
        r_e_m=fix.r_e_m,
        v_e_mps=velocity.v_e_mps,
        clock_s=fix.biases_m[reference] / SPEED_OF_LIGHT_MPS,
        drift_sps=velocity.drift_sps,
        isb_s={
            system: (fix.biases_m[system] - fix.biases_m[reference]) / SPEED_OF_LIGHT_MPS
            for system in others
        },
        isb_sigma_s={
            system: float(sigma_m) / SPEED_OF_LIGHT_MPS
            for system, sigma_m in zip(others, between_m, strict=True)
            if reference == "G"
        },
        covariance_m2=covariance_m2[:4, :4],
        velocity_covariance_m2ps2=velocity.covariance_m2ps2,
        dops=dilutions(H[: len(H) - placed], C_ne(lat, lon)),
        used=tuple(measured.satellites[row] for row in rows),
        rejected=rejected,
        residuals_m={
            satellite: residual_m
            for satellite, residual_m in zip(
                measured.satellites, fix.residuals_m.tolist(), strict=True
            )
            if math.isfinite(residual_m)
        },
        azimuth_elevation_rad=dict(
            zip(
                measured.satellites,
                zip(fix.azimuth_rad.tolist(), fix.elevation_rad.tolist(), strict=True),
                strict=True,
            )
        ),
        differential=measured.nav.corrections is not None,
    )


def dilutions(H: FloatArray, C_ne: FloatArray) -> dict[str, float]:
    """Dilutions of precision of a design matrix (n, ≥ 4): position (ECEF), clock, biases.

    Empty where the satellites alone make no position.
    """
    return dict(zip(_DILUTIONS, _dilutions(H, C_ne).tolist(), strict=False))


@brief_kernel
def _dilutions(H: FloatArray, C_ne: FloatArray) -> FloatArray:
    """Values of `_DILUTIONS`, or none."""
    if np.linalg.matrix_rank(H) < H.shape[1]:
        return np.zeros(0)
    Q = np.linalg.inv(H.T @ H)
    n, e, d = 0.0, 0.0, 0.0
    for i in range(3):
        for j in range(3):
            n += C_ne[0, i] * Q[i, j] * C_ne[0, j]
            e += C_ne[1, i] * Q[i, j] * C_ne[1, j]
            d += C_ne[2, i] * Q[i, j] * C_ne[2, j]
    return np.sqrt(np.array([np.trace(Q), n + e + d, n + e, d, Q[3, 3]]))  # type: ignore[no-any-return]


def unsolved(time: GpsTime, reason: str, rejected: Mapping[str, str]) -> NavSolution:
    """A solution that is none, and why."""
    unknown, matrix = np.full(3, np.nan), np.full((4, 4), np.nan)
    return NavSolution(
        time=time,
        valid=False,
        reason=reason,
        r_e_m=unknown,
        v_e_mps=unknown,
        clock_s=np.nan,
        drift_sps=np.nan,
        isb_s={},
        covariance_m2=matrix,
        velocity_covariance_m2ps2=matrix,
        dops={},
        used=(),
        rejected=dict(rejected),
        residuals_m={},
        azimuth_elevation_rad={},
    )
