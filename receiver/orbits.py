"""Satellite position, velocity and clock from broadcast ephemerides, and the line of sight to them.

Signs (SPEC 1): range rate is positive when range grows; Doppler is −range rate / wavelength.
Everything is ECEF; what a signal left at its transmission is turned into the frame of its
reception (Sagnac) by `line_of_sight` alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter, is_
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import (
    BDT_MINUS_GPST_S,
    EARTH_RATE_RADPS,
    GM_GPS_M3PS2,
    RELATIVITY_F_SPRM,
    SECONDS_PER_WEEK,
    SPEED_OF_LIGHT_MPS,
)
from deepgnss.core.frames import azimuth_elevation
from deepgnss.core.jit import kernel
from deepgnss.core.records import Ephemeris, FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.signals import BDS_B1I_D2


class SystemConstants(NamedTuple):
    """What a system's broadcast orbit was fitted with."""

    gm_m3ps2: float
    earth_rate_radps: float
    relativity_sprm: float  # F = −2 √GM / c²
    minus_gpst_s: float  # its time minus GPST: the node is counted from its own week


SYSTEMS: Final = {
    "G": SystemConstants(GM_GPS_M3PS2, EARTH_RATE_RADPS, RELATIVITY_F_SPRM, 0.0),
    "C": SystemConstants(  # BDS-SIS-ICD 2.1, 5.2.4.10 and 5.2.4.12
        3.986004418e14,
        7.2921150e-5,
        -2.0 * 3.986004418e14**0.5 / SPEED_OF_LIGHT_MPS**2,
        BDT_MINUS_GPST_S,
    ),
}

_GEOSTATIONARY: Final = frozenset(map(BDS_B1I_D2.satellite, BDS_B1I_D2.prns))
_GEO_TILT: Final = float(np.cos(np.radians(-5.0))), float(np.sin(np.radians(-5.0)))

MINIMUM_ELEVATION_KNOWN_M: Final = 1.0e6
"""Distance from the geocentre below which a position has no meaningful horizon."""

_TRAVEL_S: Final = 0.075  # of a signal, roughly


class SatelliteStates(NamedTuple):
    """State of satellites at their times of transmission, in the ECEF frame of that instant."""

    r_e_m: FloatArray  # (…, k, 3)
    v_e_mps: FloatArray  # (…, k, 3)
    clock_s: FloatArray  # (…, k) satellite clock − GPST, with relativity, without group delay
    drift_sps: FloatArray  # (…, k)
    group_delay_s: FloatArray  # (k,) a single-frequency user's clock is clock_s − group_delay_s


class LineOfSight(NamedTuple):
    """Geometry between an antenna at reception and satellites at transmission."""

    range_m: FloatArray  # (k,) with Sagnac
    range_rate_mps: FloatArray  # (k,) d(range)/d(time of reception)
    unit_e: FloatArray  # (k, 3) from antenna to satellite, frame of reception
    rate_scale: FloatArray  # (k,) d(range rate)/d(antenna velocity) is −unit_e · rate_scale


class Prediction(NamedTuple):
    """Everything about satellites seen from an antenna at an instant of GPST."""

    sight: LineOfSight
    v_e_mps: FloatArray  # (k, 3) of the satellites, in the frame of reception
    azimuth_rad: FloatArray  # (k,)
    elevation_rad: FloatArray  # (k,)
    clock_s: FloatArray  # (k,) satellite clock at transmission, group delay taken off
    drift_sps: FloatArray  # (k,)
    pseudorange_m: FloatArray  # (k,) range − c·clock: atmosphere and receiver clock are missing
    pseudorange_rate_mps: FloatArray  # (k,)


_ELEMENTS: Final = (
    "sqrt_a_rm",
    "eccentricity",
    "m0_rad",
    "delta_n_radps",
    "omega0_rad",
    "omega_rad",
    "omega_dot_radps",
    "i0_rad",
    "idot_radps",
    "cuc_rad",
    "cus_rad",
    "crc_m",
    "crs_m",
    "cic_rad",
    "cis_rad",
    "af0_s",
    "af1_sps",
    "af2_sps2",
    "group_delay_s",
    "toe.week",
    "toe.tow_s",
    "toc.week",
    "toc.tow_s",
)
_CONSTANTS: Final = (*SystemConstants._fields, "geostationary")

_elements = attrgetter(*_ELEMENTS)
_COLUMNS: Final = np.dtype([(name.replace(".", "_"), "f8") for name in (*_ELEMENTS, *_CONSTANTS)])


@lru_cache(maxsize=256)
def _constants(satellite: str) -> tuple[float, ...]:
    return (*SYSTEMS[satellite[0]], float(satellite in _GEOSTATIONARY))


class _Chosen:
    """Ephemerides as a key: the very same ones, since comparing their values takes as long as a
    table of them."""

    def __init__(self, ephemerides: Sequence[Ephemeris]) -> None:
        self.ephemerides = tuple(ephemerides)

    def __hash__(self) -> int:
        return hash(tuple(map(id, self.ephemerides)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Chosen) or len(self.ephemerides) != len(other.ephemerides):
            return False
        return all(map(is_, self.ephemerides, other.ephemerides))


@lru_cache(maxsize=16)  # a choice lasts for hours and is asked about several times an epoch
def _table_of(chosen: _Chosen) -> NDArray[np.void]:
    rows = [_elements(e) + _constants(e.satellite) for e in chosen.ephemerides]
    columns = np.array(rows, dtype=np.float64).reshape(-1).view(_COLUMNS)
    return columns.view(np.recarray)  # whose fields are attributes without a compiler as well


def _table(ephemerides: Sequence[Ephemeris]) -> NDArray[np.void]:
    """One record of numbers for each ephemeris; not to be written to."""
    return _table_of(_Chosen(ephemerides))


def satellite_states(
    ephemerides: Sequence[Ephemeris], reference: GpsTime, offset_s: FloatArray
) -> SatelliteStates:
    """Position, velocity and clock of satellites at given instants of GPST.

    Parameters
    ----------
    ephemerides: one of each satellite, k.
    reference, offset_s: the instants are reference + offset_s; shape (k,), or (…, k) for several
        instants of each satellite, or anything that broadcasts with (k,).

    Source: IS-GPS-200 table 20-IV, BDS-SIS-ICD B1I table 5-11 (geostationary satellites: an
    inclined plane in a frame that does not turn, brought back by 5° and the earth's rotation
    since toe); velocity by differentiating them; clock 20.3.3.3.3.1, 5.2.4.10.
    """
    offsets_s = np.asarray(offset_s, dtype=np.float64) + np.zeros(len(ephemerides))
    shape = offsets_s.shape
    table = _table(ephemerides)
    r_e_m, v_e_mps, clock_s, drift_sps = _states(
        table, *reference, offsets_s.reshape(math.prod(shape[:-1]), shape[-1])
    )
    return SatelliteStates(
        r_e_m.reshape(*shape, 3),
        v_e_mps.reshape(*shape, 3),
        clock_s.reshape(shape),
        drift_sps.reshape(shape),
        table["group_delay_s"].copy(),
    )


_Three = tuple[float, float, float]


@kernel
def _states(
    table: NDArray[np.void], week: int, tow_s: float, offset_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Satellites (k) at instants (n, k) after a reference."""
    r_e_m, v_e_mps = np.empty((*offset_s.shape, 3)), np.empty((*offset_s.shape, 3))
    clock_s, drift_sps = np.empty(offset_s.shape), np.empty(offset_s.shape)
    for n in range(offset_s.shape[0]):
        for k in range(offset_s.shape[1]):
            r, v, clock_s[n, k], drift_sps[n, k] = _state(table[k], week, tow_s, offset_s[n, k])
            r_e_m[n, k, 0], r_e_m[n, k, 1], r_e_m[n, k, 2] = r
            v_e_mps[n, k, 0], v_e_mps[n, k, 1], v_e_mps[n, k, 2] = v
    return r_e_m, v_e_mps, clock_s, drift_sps


@kernel
def _state(e: Any, week: int, tow_s: float, offset_s: float) -> tuple[_Three, _Three, float, float]:
    """Position, velocity, clock and its drift by a record of the table."""
    tk = offset_s + ((week - e.toe_week) * SECONDS_PER_WEEK + (tow_s - e.toe_tow_s))
    tc = offset_s + ((week - e.toc_week) * SECONDS_PER_WEEK + (tow_s - e.toc_tow_s))
    ecc = e.eccentricity

    a = e.sqrt_a_rm**2
    n = np.sqrt(e.gm_m3ps2 / a**3) + e.delta_n_radps
    E = _eccentric_anomaly(e.m0_rad + n * tk, ecc)
    sin_E, cos_E = np.sin(E), np.cos(E)
    E_dot = n / (1.0 - ecc * cos_E)

    root = np.sqrt(1.0 - ecc**2)
    phi = np.arctan2(root * sin_E, cos_E - ecc) + e.omega_rad
    phi_dot = root * E_dot / (1.0 - ecc * cos_E)
    sin_2, cos_2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u = phi + e.cus_rad * sin_2 + e.cuc_rad * cos_2
    u_dot = phi_dot * (1.0 + 2.0 * (e.cus_rad * cos_2 - e.cuc_rad * sin_2))
    r = a * (1.0 - ecc * cos_E) + e.crs_m * sin_2 + e.crc_m * cos_2
    r_dot = a * ecc * sin_E * E_dot + 2.0 * phi_dot * (e.crs_m * cos_2 - e.crc_m * sin_2)
    i = e.i0_rad + e.idot_radps * tk + e.cis_rad * sin_2 + e.cic_rad * cos_2
    i_dot = e.idot_radps + 2.0 * phi_dot * (e.cis_rad * cos_2 - e.cic_rad * sin_2)
    toe_tow_s = (e.toe_tow_s + e.minus_gpst_s) % SECONDS_PER_WEEK
    node_dot = e.omega_dot_radps - (0.0 if e.geostationary else e.earth_rate_radps)
    node = e.omega0_rad + node_dot * tk - e.earth_rate_radps * toe_tow_s

    sin_u, cos_u = np.sin(u), np.cos(u)
    sin_i, cos_i = np.sin(i), np.cos(i)
    sin_o, cos_o = np.sin(node), np.cos(node)
    x, y = r * cos_u, r * sin_u  # in the orbital plane, x towards the ascending node
    x_dot = r_dot * cos_u - y * u_dot
    y_dot = r_dot * sin_u + x * u_dot
    y_i, z_i = y * cos_i, y * sin_i
    y_i_dot = y_dot * cos_i - z_i * i_dot
    z_i_dot = y_dot * sin_i + y_i * i_dot
    X, Y = x * cos_o - y_i * sin_o, x * sin_o + y_i * cos_o
    r_e_m = (X, Y, z_i)
    v_e_mps = (
        x_dot * cos_o - y_i_dot * sin_o - Y * node_dot,
        x_dot * sin_o + y_i_dot * cos_o + X * node_dot,
        z_i_dot,
    )
    if e.geostationary:
        r_e_m, v_e_mps = _earth_fixed(r_e_m, v_e_mps, e.earth_rate_radps, tk)
    relativity_s = e.relativity_sprm * ecc * e.sqrt_a_rm
    clock_s = e.af0_s + tc * (e.af1_sps + tc * e.af2_sps2) + relativity_s * sin_E
    drift_sps = e.af1_sps + 2.0 * e.af2_sps2 * tc + relativity_s * cos_E * E_dot
    return r_e_m, v_e_mps, clock_s, drift_sps


@kernel
def _earth_fixed(r_m: _Three, v_mps: _Three, earth_rate: float, tk: float) -> tuple[_Three, _Three]:
    """Rz(ωₑ tₖ) Rx(−5°) of a position and its derivative (BDS-SIS-ICD B1I table 5-11)."""
    c, s = _GEO_TILT
    cos, sin = np.cos(earth_rate * tk), np.sin(earth_rate * tk)
    x, y, z = r_m[0], c * r_m[1] + s * r_m[2], c * r_m[2] - s * r_m[1]
    vx, vy, vz = v_mps[0], c * v_mps[1] + s * v_mps[2], c * v_mps[2] - s * v_mps[1]
    x, y = cos * x + sin * y, cos * y - sin * x
    vx, vy = cos * vx + sin * vy + earth_rate * y, cos * vy - sin * vx - earth_rate * x
    return (x, y, z), (vx, vy, vz)


@kernel
def _eccentric_anomaly(M: float, ecc: float) -> float:
    """Solve Kepler's equation M = E − e sin E by Newton's method; e < 0.1 needs three steps."""
    E = M + ecc * np.sin(M)
    for _ in range(10):
        step = (E - ecc * np.sin(E) - M) / (1.0 - ecc * np.cos(E))
        E = E - step
        if abs(step) < 1e-9:  # quadratic: the error left is its square
            break
    return E  # type: ignore[no-any-return]


def transmitted_states(
    ephemerides: Sequence[Ephemeris], reference: GpsTime, clock_reading_s: FloatArray
) -> SatelliteStates:
    """States at the instants at which the satellites' own clocks showed given readings.

    Parameters: clock readings as seconds after `reference`, shape (k,).
    Source: IS-GPS-200 20.3.3.3.3 (t = t_sv − Δt_sv).
    """
    return SatelliteStates(*_transmitted(_table(ephemerides), *reference, clock_reading_s))


@kernel
def _transmitted(
    table: NDArray[np.void], week: int, tow_s: float, clock_reading_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fields of `SatelliteStates` at readings (k,) after a reference.

    For their instants, clocks without relativity will do.
    """
    sent_s, group_delay_s = np.empty((1, table.size)), np.empty(table.size)
    for k in range(table.size):
        e = table[k]
        tc = clock_reading_s[k] + ((week - e.toc_week) * SECONDS_PER_WEEK + (tow_s - e.toc_tow_s))
        sent_s[0, k] = clock_reading_s[k] - (e.af0_s + tc * e.af1_sps)
        group_delay_s[k] = e.group_delay_s
    r_e_m, v_e_mps, clock_s, drift_sps = _states(table, week, tow_s, sent_s)
    return r_e_m[0], v_e_mps[0], clock_s[0], drift_sps[0], group_delay_s


def line_of_sight(r_e_m: FloatArray, v_e_mps: FloatArray, states: SatelliteStates) -> LineOfSight:
    """Range, range rate and direction with the earth's rotation during travel (Sagnac).

    The satellite is turned into the ECEF frame of reception by ω·range/c, so that
    ρ(t) = |R(ωρ/c) r_s(t − ρ/c) − r(t)|; its derivative, with what the shrinking or growing of
    the travel time itself does (some cm/s), is exact.

    Parameters: antenna position (3,) and velocity (3,) at reception; states (k) at transmission.
    """
    return LineOfSight(*_sights(r_e_m, v_e_mps, states.r_e_m, states.v_e_mps))


@kernel
def _sights(
    r_e_m: FloatArray, v_e_mps: FloatArray, satellites_e_m: FloatArray, moving_e_mps: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fields of `LineOfSight` to satellites (k, 3)."""
    count = satellites_e_m.shape[0]
    range_m, rate_mps, scale = np.empty(count), np.empty(count), np.empty(count)
    unit_e = np.empty((count, 3))
    antenna, motion = (r_e_m[0], r_e_m[1], r_e_m[2]), (v_e_mps[0], v_e_mps[1], v_e_mps[2])
    for k in range(count):
        r, v = satellites_e_m[k], moving_e_mps[k]
        range_m[k], rate_mps[k], unit, scale[k] = _sight(
            antenna, motion, (r[0], r[1], r[2]), (v[0], v[1], v[2])
        )
        unit_e[k, 0], unit_e[k, 1], unit_e[k, 2] = unit
    return range_m, rate_mps, unit_e, scale


@kernel
def _sight(
    antenna_e_m: _Three, moving_e_mps: _Three, r_e_m: _Three, v_e_mps: _Three
) -> tuple[float, float, _Three, float]:
    """Range, its rate, direction and scale of the rate."""
    x, y, z = r_e_m[0] - antenna_e_m[0], r_e_m[1] - antenna_e_m[1], r_e_m[2] - antenna_e_m[2]
    range_m = np.sqrt(x * x + y * y + z * z)
    satellite = r_e_m
    for _ in range(2):  # the turn changes the range by 30 m, this one's turn by 1e-7 of that
        satellite = _turned(r_e_m, range_m)
        x, y = satellite[0] - antenna_e_m[0], satellite[1] - antenna_e_m[1]
        range_m = np.sqrt(x * x + y * y + z * z)
    unit = (x / range_m, y / range_m, z / range_m)
    towards = _dot(unit, _turned(v_e_mps, range_m))
    sideways = EARTH_RATE_RADPS * (unit[0] * satellite[1] - unit[1] * satellite[0])
    scale = 1.0 / (1.0 + (towards - sideways) / SPEED_OF_LIGHT_MPS)
    return range_m, (towards - _dot(unit, moving_e_mps)) * scale, unit, scale


@kernel
def _dot(a: _Three, b: _Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _turned(vector: _Three, range_m: float) -> _Three:
    """Vector of the frame of transmission in that of reception, range/c later."""
    turn = EARTH_RATE_RADPS / SPEED_OF_LIGHT_MPS * range_m
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = vector
    return c * x + s * y, c * y - s * x, z


def predict(
    ephemerides: Sequence[Ephemeris],
    time: GpsTime,
    r_e_m: FloatArray,
    v_e_mps: FloatArray,
) -> Prediction:
    """What an antenna receives at an instant of GPST: light time, Sagnac, satellite clock.

    Parameters: antenna position (3,) and velocity (3,) at `time`.
    """
    *sight, moving_e_mps, clock_s, drift_sps, pseudorange_rate_mps = _predicted(
        _table(ephemerides), *time, r_e_m, v_e_mps
    )
    seen = LineOfSight(*sight)
    azimuth, elevation = directions(r_e_m, seen)
    return Prediction(
        seen,
        moving_e_mps,
        azimuth,
        elevation,
        clock_s,
        drift_sps,
        seen.range_m - SPEED_OF_LIGHT_MPS * clock_s,
        pseudorange_rate_mps,
    )


def rates(
    ephemerides: Sequence[Ephemeris], time: GpsTime, r_e_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of `predict` for an antenna at rest: rates of pseudoranges, directions and scales of rates.

    Returns (k,), m/s, without receiver clock; (k, 3), ECEF; (k,).
    """
    _, _, unit_e, scale, *_, rate_mps = _predicted(_table(ephemerides), *time, r_e_m, np.zeros(3))
    return rate_mps, unit_e, scale


@kernel
def _predicted(
    table: NDArray[np.void], week: int, tow_s: float, r_e_m: FloatArray, v_e_mps: FloatArray
) -> tuple[FloatArray, ...]:
    """Fields of `LineOfSight`, the satellites' velocity at reception, their clocks and drifts, and
    the rates of pseudoranges."""
    count = table.size
    range_m, rate_mps, scale = np.empty(count), np.empty(count), np.empty(count)
    clock_s, drift_sps = np.empty(count), np.empty(count)
    unit_e, moving_e_mps = np.empty((count, 3)), np.empty((count, 3))
    antenna, motion = (r_e_m[0], r_e_m[1], r_e_m[2]), (v_e_mps[0], v_e_mps[1], v_e_mps[2])
    for k in range(count):
        r, v, _, _ = _state(table[k], week, tow_s, -_TRAVEL_S)
        far_m, faster_mps, _, _ = _sight(antenna, (0.0, 0.0, 0.0), r, v)
        # The guess is wrong by up to 70 ms, in which a range rate of 1 km/s changes by 0.04 m/s.
        light_s = far_m / SPEED_OF_LIGHT_MPS
        travel_s = light_s + faster_mps / SPEED_OF_LIGHT_MPS * (_TRAVEL_S - light_s)
        r, v, clock_s[k], drift_sps[k] = _state(table[k], week, tow_s, -travel_s)
        clock_s[k] -= table[k].group_delay_s
        range_m[k], rate_mps[k], unit, scale[k] = _sight(antenna, motion, r, v)
        unit_e[k, 0], unit_e[k, 1], unit_e[k, 2] = unit
        moving_e_mps[k, 0], moving_e_mps[k, 1], moving_e_mps[k, 2] = _turned(v, range_m[k])
    pseudorange_rate_mps = rate_mps - (SPEED_OF_LIGHT_MPS - rate_mps) * drift_sps
    return range_m, rate_mps, unit_e, scale, moving_e_mps, clock_s, drift_sps, pseudorange_rate_mps


def directions(r_e_m: FloatArray, sight: LineOfSight) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation, rad, shape (k,) each; NaN while the position is deep in the earth."""
    if math.hypot(*r_e_m) < MINIMUM_ELEVATION_KNOWN_M:
        nothing = np.full_like(sight.range_m, np.nan)
        return nothing, nothing
    return azimuth_elevation(r_e_m, r_e_m + sight.range_m[:, np.newaxis] * sight.unit_e)


# --- choice of ephemerides -----------------------------------------------------------------------


def select(
    nav: NavData, satellite: str, time: GpsTime, margin_s: float = 7200.0
) -> Ephemeris | None:
    """The ephemeris of a satellite whose reference time is nearest, None if none fits.

    It fits within half its fit interval, plus a margin in which orbits are still good to some
    metres. Of several with the same reference time the one sent last counts. Health is the
    caller's matter.
    """
    best, best_age_s = None, math.inf
    for ephemeris in nav.ephemerides.get(satellite, ()):
        age_s = abs(time.since(ephemeris.toe))
        if age_s > min(ephemeris.fit_hours * 1800.0 + margin_s, best_age_s):
            continue
        if best is None or age_s < best_age_s or ephemeris.transmitted > best.transmitted:
            best, best_age_s = ephemeris, age_s
    return best


def with_ephemeris(nav: NavData, ephemeris: Ephemeris) -> NavData:
    """Navigation data enriched by an ephemeris; one that is known, told again, adds nothing."""
    known = nav.ephemerides.get(ephemeris.satellite, ())
    if any(replace(old, transmitted=ephemeris.transmitted) == ephemeris for old in known):
        return nav
    return replace(nav, ephemerides={**nav.ephemerides, ephemeris.satellite: (*known, ephemeris)})
