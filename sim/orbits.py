"""True orbits and satellite clocks, and the travel time of the signal, solved without shortcuts.

The broadcast elements are taken as the truth (IS-GPS-200 20.3.3.4.3, BDS-SIS-ICD B1I 5.2.4). The
satellite is placed at the instant its signal left and turned by the earth's rotation during the
travel; the light-time equation is iterated to the last bit. Nothing here is shared with the
receiver's own orbits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
from deepgnss.core.jit import kernel
from deepgnss.core.records import Ephemeris, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.receiver.signals import BDS_B1I_D2

GM_BDS_M3PS2: Final = 3.986004418e14
_EARTH_RATE_BDS_RADPS: Final = 7.2921150e-5  # CGCS2000
_RELATIVITY_BDS_SPRM: Final = -2.0 * math.sqrt(GM_BDS_M3PS2) / SPEED_OF_LIGHT_MPS**2
_COS_TILT: Final = math.cos(math.radians(5.0))
_SIN_TILT: Final = math.sin(math.radians(5.0))


class Orbit(NamedTuple):
    """Ephemeris and clock of one satellite as bare floats, times counted from the start."""

    geostationary: bool  # of BeiDou: elements of a tilted frame
    earth_rate_radps: float  # the message's
    relativity_sprm: float
    toe_s: float
    toc_s: float
    toe_tow_s: float
    af0_s: float
    af1_sps: float
    af2_sps2: float
    group_delay_s: float
    sqrt_a_rm: float
    eccentricity: float
    m0_rad: float
    mean_motion_radps: float
    omega0_rad: float
    omega_rad: float
    omega_dot_radps: float
    i0_rad: float
    idot_radps: float
    cuc_rad: float
    cus_rad: float
    crc_m: float
    crs_m: float
    cic_rad: float
    cis_rad: float


class Travel(NamedTuple):
    """Signal travel to the receiver, each (n,) or (n, 3)."""

    range_m: FloatArray  # geometric, in the inertial frame (Sagnac included)
    satellite_clock_s: FloatArray  # time tag of L1 C/A or B1I − GPST when the signal left
    satellite_e_m: FloatArray  # where it left, in the ECEF frame of the instant of reception


def nearest_set(sets: Sequence[Ephemeris], time: GpsTime) -> Ephemeris:
    """The ephemeris of a satellite whose toe lies nearest to `time`."""
    return min(sets, key=lambda ephemeris: abs(ephemeris.toe.since(time)))


def orbit_of(ephemeris: Ephemeris, start: GpsTime) -> Orbit:
    """Broadcast elements with times counted from `start`."""
    bds = ephemeris.satellite[0] == "C"
    gm_m3ps2 = GM_BDS_M3PS2 if bds else GM_GPS_M3PS2
    semi_major_m = ephemeris.sqrt_a_rm**2
    toe_tow_s = ephemeris.toe.tow_s + (BDT_MINUS_GPST_S if bds else 0.0)
    return Orbit(
        geostationary=bds and int(ephemeris.satellite[1:]) in BDS_B1I_D2.prns,
        earth_rate_radps=_EARTH_RATE_BDS_RADPS if bds else EARTH_RATE_RADPS,
        relativity_sprm=_RELATIVITY_BDS_SPRM if bds else RELATIVITY_F_SPRM,
        toe_s=ephemeris.toe.since(start),
        toc_s=ephemeris.toc.since(start),
        toe_tow_s=toe_tow_s % SECONDS_PER_WEEK,
        af0_s=ephemeris.af0_s,
        af1_sps=ephemeris.af1_sps,
        af2_sps2=ephemeris.af2_sps2,
        group_delay_s=ephemeris.group_delay_s,
        sqrt_a_rm=ephemeris.sqrt_a_rm,
        eccentricity=ephemeris.eccentricity,
        m0_rad=ephemeris.m0_rad,
        mean_motion_radps=math.sqrt(gm_m3ps2 / semi_major_m**3) + ephemeris.delta_n_radps,
        omega0_rad=ephemeris.omega0_rad,
        omega_rad=ephemeris.omega_rad,
        omega_dot_radps=ephemeris.omega_dot_radps,
        i0_rad=ephemeris.i0_rad,
        idot_radps=ephemeris.idot_radps,
        cuc_rad=ephemeris.cuc_rad,
        cus_rad=ephemeris.cus_rad,
        crc_m=ephemeris.crc_m,
        crs_m=ephemeris.crs_m,
        cic_rad=ephemeris.cic_rad,
        cis_rad=ephemeris.cis_rad,
    )


def travel(orbit: Orbit, t_s: FloatArray, r_e_m: FloatArray) -> Travel:
    """Travel of the signals received at true times t_s (n,) at r_e_m (n, 3)."""
    out = Travel(np.empty(t_s.size), np.empty(t_s.size), np.empty((t_s.size, 3)))
    _light_time(orbit, t_s, r_e_m, *out)
    return out


@kernel
def _eccentric_anomaly(orbit: Orbit, t_s: float) -> float:
    """Kepler's equation by Newton's method, rad."""
    mean = orbit.m0_rad + orbit.mean_motion_radps * (t_s - orbit.toe_s)
    anomaly = mean
    for _ in range(8):
        error = anomaly - orbit.eccentricity * math.sin(anomaly) - mean
        anomaly -= error / (1.0 - orbit.eccentricity * math.cos(anomaly))
    return anomaly


@kernel
def _clock(orbit: Orbit, t_s: float) -> float:
    """Satellite clock of the L1 or B1I signal − GPST, s (IS-GPS-200 20.3.3.3.3.1)."""
    dt = t_s - orbit.toc_s
    relativity = (
        orbit.relativity_sprm
        * orbit.eccentricity
        * orbit.sqrt_a_rm
        * math.sin(_eccentric_anomaly(orbit, t_s))
    )
    polynomial = orbit.af0_s + dt * (orbit.af1_sps + dt * orbit.af2_sps2)
    return polynomial + relativity - orbit.group_delay_s


@kernel
def _place(orbit: Orbit, t_s: float, turn_s: float) -> tuple[float, float, float]:
    """Satellite at t_s in the ECEF frame of t_s + turn_s, m.

    IS-GPS-200 table 20-IV, BDS-SIS-ICD B1I table 5-11.
    """
    since_toe = t_s - orbit.toe_s
    anomaly = _eccentric_anomaly(orbit, t_s)
    e = orbit.eccentricity
    latitude = orbit.omega_rad + 2.0 * math.atan2(
        math.sqrt(1.0 + e) * math.sin(0.5 * anomaly), math.sqrt(1.0 - e) * math.cos(0.5 * anomaly)
    )
    sin2, cos2 = math.sin(2.0 * latitude), math.cos(2.0 * latitude)
    radius = orbit.sqrt_a_rm**2 * (1.0 - e * math.cos(anomaly))
    radius += orbit.crs_m * sin2 + orbit.crc_m * cos2
    inclination = orbit.i0_rad + orbit.idot_radps * since_toe
    inclination += orbit.cis_rad * sin2 + orbit.cic_rad * cos2
    latitude += orbit.cus_rad * sin2 + orbit.cuc_rad * cos2
    node = orbit.omega0_rad + orbit.omega_dot_radps * since_toe
    node -= orbit.earth_rate_radps * orbit.toe_tow_s
    turned = orbit.earth_rate_radps * (since_toe + turn_s)  # by the earth since toe
    x, y = radius * math.cos(latitude), radius * math.sin(latitude)
    y_level, z = y * math.cos(inclination), y * math.sin(inclination)
    x, y = (
        x * math.cos(node) - y_level * math.sin(node),
        x * math.sin(node) + y_level * math.cos(node),
    )
    if orbit.geostationary:  # the elements' frame leans by 5° about its x axis
        y, z = y * _COS_TILT - z * _SIN_TILT, y * _SIN_TILT + z * _COS_TILT
    c, s = math.cos(turned), math.sin(turned)
    return x * c + y * s, y * c - x * s, z


@kernel
def _light_time(
    orbit: Orbit,
    t_s: FloatArray,
    r_e_m: FloatArray,
    range_m: FloatArray,
    clock_s: FloatArray,
    satellite_e_m: FloatArray,
) -> None:
    """Fill range (n,), satellite clock (n,) and satellite position (n, 3) for each reception."""
    for k in range(t_s.size):
        travel_s = 0.075
        for _ in range(4):  # each turn shrinks the error by v/c, 1e-5: four reach the last bit
            x, y, z = _place(orbit, t_s[k] - travel_s, travel_s)
            dx, dy, dz = x - r_e_m[k, 0], y - r_e_m[k, 1], z - r_e_m[k, 2]
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            travel_s = distance / SPEED_OF_LIGHT_MPS
        range_m[k] = distance
        clock_s[k] = _clock(orbit, t_s[k] - travel_s)
        satellite_e_m[k, 0], satellite_e_m[k, 1], satellite_e_m[k, 2] = x, y, z
