"""Satellite position, velocity and clock from broadcast ephemerides, and the line of sight to them.

Signs (SPEC 1): range rate is positive when range grows; Doppler is −range rate / wavelength.
Everything is ECEF; what a signal left at its transmission is turned into the frame of its
reception (Sagnac) by `line_of_sight` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import (
    BDT_MINUS_GPST_S,
    EARTH_RATE_RADPS,
    GM_GPS_M3PS2,
    RELATIVITY_F_SPRM,
    SECONDS_PER_WEEK,
    SPEED_OF_LIGHT_MPS,
)
from deepgnss.core.frames import azimuth_elevation
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
_GEO_TILT_RAD: Final = float(np.radians(-5.0))

MINIMUM_ELEVATION_KNOWN_M: Final = 1.0e6
_TRAVEL_S: Final = 0.075  # of a signal, roughly
_AT_REST: Final = np.zeros(3)
"""Distance from the geocentre below which a position has no meaningful horizon."""


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
)

_elements = attrgetter(*_ELEMENTS)


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
    table = np.array([_elements(e) for e in ephemerides]).T
    (sqrt_a, ecc, m0, delta_n, omega0, omega, omega_dot, i0, idot) = table[:9]
    (cuc, cus, crc, crs, cic, cis, af0, af1, af2, group_delay_s) = table[9:]
    constants = np.array([SYSTEMS[e.satellite[0]] for e in ephemerides]).T
    gm, earth_rate, relativity, minus_gpst_s = constants
    toe_tow = (np.array([e.toe.tow_s for e in ephemerides]) + minus_gpst_s) % SECONDS_PER_WEEK
    tk = offset_s + np.array([reference.since(e.toe) for e in ephemerides])
    tc = offset_s + np.array([reference.since(e.toc) for e in ephemerides])

    a = sqrt_a**2
    n = np.sqrt(gm / a**3) + delta_n
    E = _eccentric_anomaly(m0 + n * tk, ecc)
    sin_E, cos_E = np.sin(E), np.cos(E)
    E_dot = n / (1.0 - ecc * cos_E)

    root = np.sqrt(1.0 - ecc**2)
    phi = np.arctan2(root * sin_E, cos_E - ecc) + omega
    phi_dot = root * E_dot / (1.0 - ecc * cos_E)
    sin_2, cos_2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u = phi + cus * sin_2 + cuc * cos_2
    u_dot = phi_dot * (1.0 + 2.0 * (cus * cos_2 - cuc * sin_2))
    r = a * (1.0 - ecc * cos_E) + crs * sin_2 + crc * cos_2
    r_dot = a * ecc * sin_E * E_dot + 2.0 * phi_dot * (crs * cos_2 - crc * sin_2)
    i = i0 + idot * tk + cis * sin_2 + cic * cos_2
    i_dot = idot + 2.0 * phi_dot * (cis * cos_2 - cic * sin_2)
    geostationary = np.array([e.satellite in _GEOSTATIONARY for e in ephemerides])
    node_dot = omega_dot - np.where(geostationary, 0.0, earth_rate)
    node = omega0 + node_dot * tk - earth_rate * toe_tow

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
    r_e_m = np.stack([X, Y, z_i], axis=-1)
    v_e_mps = np.stack(
        [
            x_dot * cos_o - y_i_dot * sin_o - Y * node_dot,
            x_dot * sin_o + y_i_dot * cos_o + X * node_dot,
            z_i_dot,
        ],
        axis=-1,
    )
    if geostationary.any():
        turned = _earth_fixed(r_e_m, v_e_mps, earth_rate, tk)
        at_rest = geostationary[:, np.newaxis]
        r_e_m, v_e_mps = (
            np.where(at_rest, new, old) for new, old in zip(turned, (r_e_m, v_e_mps), strict=True)
        )
    return SatelliteStates(
        r_e_m=r_e_m,
        v_e_mps=v_e_mps,
        clock_s=af0 + tc * (af1 + tc * af2) + relativity * ecc * sqrt_a * sin_E,
        drift_sps=af1 + 2.0 * af2 * tc + relativity * ecc * sqrt_a * cos_E * E_dot,
        group_delay_s=group_delay_s,
    )


def _earth_fixed(
    r_m: FloatArray, v_mps: FloatArray, earth_rate: FloatArray, tk: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rz(ωₑ tₖ) Rx(−5°) of positions (…, 3) and its derivative (BDS-SIS-ICD B1I table 5-11)."""
    c, s = np.cos(_GEO_TILT_RAD), np.sin(_GEO_TILT_RAD)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    cos, sin = np.cos(earth_rate * tk), np.sin(earth_rate * tk)
    (x, y, z), (vx, vy, vz) = (np.moveaxis(a @ tilt.T, -1, 0) for a in (r_m, v_mps))
    x, y = cos * x + sin * y, cos * y - sin * x
    vx, vy = cos * vx + sin * vy + earth_rate * y, cos * vy - sin * vx - earth_rate * x
    return np.stack([x, y, z], axis=-1), np.stack([vx, vy, vz], axis=-1)


def _eccentric_anomaly(M: FloatArray, ecc: FloatArray) -> FloatArray:
    """Solve Kepler's equation M = E − e sin E by Newton's method; e < 0.1 needs three steps."""
    E = M + ecc * np.sin(M)
    for _ in range(10):
        step = (E - ecc * np.sin(E) - M) / (1.0 - ecc * np.cos(E))
        E = E - step
        if np.max(np.abs(step), initial=0.0) < 1e-9:  # quadratic: the error left is its square
            break
    return E


def transmitted_states(
    ephemerides: Sequence[Ephemeris], reference: GpsTime, clock_reading_s: FloatArray
) -> SatelliteStates:
    """States at the instants at which the satellites' own clocks showed given readings.

    Parameters: clock readings as seconds after `reference`, shape (k,).
    Source: IS-GPS-200 20.3.3.3.3 (t = t_sv − Δt_sv).
    """
    tc = clock_reading_s + np.array([reference.since(e.toc) for e in ephemerides])
    clock_s = np.array([e.af0_s for e in ephemerides]) + tc * [e.af1_sps for e in ephemerides]
    return satellite_states(ephemerides, reference, clock_reading_s - clock_s)


def line_of_sight(r_e_m: FloatArray, v_e_mps: FloatArray, states: SatelliteStates) -> LineOfSight:
    """Range, range rate and direction with the earth's rotation during travel (Sagnac).

    The satellite is turned into the ECEF frame of reception by ω·range/c, so that
    ρ(t) = |R(ωρ/c) r_s(t − ρ/c) − r(t)|; its derivative, with what the shrinking or growing of
    the travel time itself does (some cm/s), is exact.

    Parameters: antenna position (3,) and velocity (3,) at reception; states (k) at transmission.
    """
    range_m = np.linalg.norm(states.r_e_m - r_e_m, axis=-1)
    for _ in range(2):  # the turn changes the range by 30 m, this one's turn by 1e-7 of that
        satellite = _turned(states.r_e_m, range_m)
        vector = satellite - r_e_m
        range_m = np.linalg.norm(vector, axis=-1)
    unit = vector / range_m[:, np.newaxis]
    towards = np.einsum("ki,ki->k", unit, _turned(states.v_e_mps, range_m))
    sideways = EARTH_RATE_RADPS * (unit[:, 0] * satellite[:, 1] - unit[:, 1] * satellite[:, 0])
    scale = 1.0 / (1.0 + (towards - sideways) / SPEED_OF_LIGHT_MPS)
    return LineOfSight(range_m, (towards - unit @ v_e_mps) * scale, unit, scale)


def _turned(vectors: FloatArray, range_m: FloatArray) -> FloatArray:
    """Vectors (k, 3) of the frame of transmission in that of reception, range/c later."""
    turn = EARTH_RATE_RADPS / SPEED_OF_LIGHT_MPS * range_m
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = vectors.T
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def predict(
    ephemerides: Sequence[Ephemeris],
    time: GpsTime,
    r_e_m: FloatArray,
    v_e_mps: FloatArray,
) -> Prediction:
    """What an antenna receives at an instant of GPST: light time, Sagnac, satellite clock.

    Parameters: antenna position (3,) and velocity (3,) at `time`.
    """
    guess_s = np.full(len(ephemerides), _TRAVEL_S)
    states = satellite_states(ephemerides, time, -guess_s)
    sight = line_of_sight(r_e_m, _AT_REST, states)
    # The guess is wrong by up to 70 ms, in which a range rate of 1 km/s changes by 0.04 m/s.
    light_s = sight.range_m / SPEED_OF_LIGHT_MPS
    travel_s = light_s + sight.range_rate_mps / SPEED_OF_LIGHT_MPS * (guess_s - light_s)
    states = satellite_states(ephemerides, time, -travel_s)
    sight = line_of_sight(r_e_m, v_e_mps, states)
    azimuth, elevation = directions(r_e_m, sight)
    clock_s = states.clock_s - states.group_delay_s
    rate = sight.range_rate_mps
    return Prediction(
        sight,
        _turned(states.v_e_mps, sight.range_m),
        azimuth,
        elevation,
        clock_s,
        states.drift_sps,
        sight.range_m - SPEED_OF_LIGHT_MPS * clock_s,
        rate - (SPEED_OF_LIGHT_MPS - rate) * states.drift_sps,
    )


def directions(r_e_m: FloatArray, sight: LineOfSight) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation, rad, shape (k,) each; NaN while the position is deep in the earth."""
    if np.linalg.norm(r_e_m) < MINIMUM_ELEVATION_KNOWN_M:
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
    best, best_key = None, (np.inf, 0.0)
    for ephemeris in nav.ephemerides.get(satellite, ()):
        age_s = abs(time.since(ephemeris.toe))
        key = (age_s, -ephemeris.transmitted.since(time))
        if age_s <= ephemeris.fit_hours * 1800.0 + margin_s and key < best_key:
            best, best_key = ephemeris, key
    return best


def with_ephemeris(nav: NavData, ephemeris: Ephemeris) -> NavData:
    """Navigation data enriched by an ephemeris; one that is known, told again, adds nothing."""
    known = nav.ephemerides.get(ephemeris.satellite, ())
    if any(replace(old, transmitted=ephemeris.transmitted) == ephemeris for old in known):
        return nav
    return replace(nav, ephemerides={**nav.ephemerides, ephemeris.satellite: (*known, ephemeris)})
