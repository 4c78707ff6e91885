"""A nominal BeiDou constellation: C01–C05 geostationary, C06–C13 inclined, C19–C42 medium orbits.

The geostationary longitudes are those of the interface document; the inclined ones cross the
equator at 118°, 112° and 95° E; 24 medium ones fill a Walker pattern 24/3/1 (BDS-SIS-ICD B1I 3.1).
Small deviations are drawn from a seed; everything is rounded to what D1 and D2 can carry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from deepgnss.core.constants import BDT_MINUS_GPST_S, SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, FloatArray, Klobuchar, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.beidou_layout import FIELDS
from deepgnss.sim.constellation.sets import rounded, utc_at

_GM_M3PS2: Final = 3.986004418e14
_EARTH_RATE_RADPS: Final = 7.2921150e-5
_SYNCHRONOUS_M: Final = (_GM_M3PS2 / _EARTH_RATE_RADPS**2) ** (1.0 / 3.0)
_MEDIUM_M: Final = 27_906_100.0
_INCLINATION_RAD: Final = math.radians(55.0)
_TILT_RAD: Final = math.radians(-5.0)  # of the frame that geostationary elements count in
_EPOCH: Final = GpsTime(2190, -BDT_MINUS_GPST_S)  # start of a BDT week
_SET_S: Final = 3600.0  # a new set every hour, its toe the hour of its first transmission
_SCALES: Final = {name: field.scale for name, field in FIELDS.items()}

_GEOSTATIONARY_DEG: Final = (140.0, 80.0, 110.5, 160.0, 58.75)  # C01 to C05
# Where the equator is crossed northward, and when: degrees of longitude and of latitude argument.
_INCLINED_DEG: Final = (
    *((118.0, 120.0 * k) for k in range(3)),
    *((95.0, 60.0 + 120.0 * k) for k in range(3)),
    *((112.0, 90.0 + 180.0 * k) for k in range(2)),
)

KLOBUCHAR: Final = Klobuchar(
    (14 * 2.0**-30, 4 * 2.0**-27, -4 * 2.0**-24, 3 * 2.0**-24),
    (60 * 2.0**11, -5 * 2.0**14, 1 * 2.0**16, -1 * 2.0**16),
)
"""An ionosphere of moderate activity, some 4 m at zenith in the early afternoon."""


def nominal_beidou(start: GpsTime, seconds: float, seed: int = 37) -> NavData:
    """37 satellites with every set in force from `start` on, and ionosphere and UTC."""
    random = np.random.Generator(np.random.PCG64(seed))
    movers: list[tuple[Ephemeris, Callable[[Ephemeris, GpsTime], Ephemeris]]] = []
    for prn, longitude_deg in enumerate(_GEOSTATIONARY_DEG, start=1):
        movers.append((_geostationary(f"C{prn:02d}", longitude_deg, random), _tilted_at))
    for prn, (longitude_deg, argument_deg) in enumerate(_INCLINED_DEG, start=6):
        node_deg = longitude_deg - argument_deg
        inclined = _elements(f"C{prn:02d}", _SYNCHRONOUS_M, node_deg, argument_deg, random)
        # The ground track stays: node and latitude argument together keep pace with the earth.
        inclined = replace(inclined, delta_n_radps=-inclined.omega_dot_radps)
        movers.append((inclined, _at))
    for slot, prn in enumerate(range(19, 43)):
        plane, place = divmod(slot, 8)
        argument_deg = 45.0 * place + 15.0 * plane
        elements = _elements(f"C{prn:02d}", _MEDIUM_M, 120.0 * plane, argument_deg, random)
        movers.append((elements, _at))
    begin = start.plus(BDT_MINUS_GPST_S)
    first = math.floor(begin.tow_s / _SET_S)
    sets = range(first, math.floor((begin.tow_s + seconds) / _SET_S) + 1)
    toes = [GpsTime(begin.week, -BDT_MINUS_GPST_S).plus(k * _SET_S) for k in sets]
    return NavData(
        ephemerides={e.satellite: tuple(move(e, toe) for toe in toes) for e, move in movers},
        klobuchar={"C": KLOBUCHAR},
        utc=utc_at(start),
    )


def _elements(
    satellite: str,
    semi_major_m: float,
    node_deg: float,
    argument_deg: float,
    random: np.random.Generator,
) -> Ephemeris:
    """Elements at the epoch; deviations as in broadcast messages of our years."""
    perigee_rad = random.uniform(-math.pi, math.pi)
    return Ephemeris(
        satellite=satellite,
        toe=_EPOCH,
        toc=_EPOCH,
        transmitted=_EPOCH,
        iode=1,
        iodc=1,
        af0_s=random.uniform(-6.0e-4, 6.0e-4),
        af1_sps=random.normal(0.0, 1.0e-11),
        af2_sps2=0.0,
        group_delay_s=random.uniform(-1.5e-8, 1.5e-8),
        group_delay2_s=random.uniform(-1.5e-8, 1.5e-8),
        sqrt_a_rm=math.sqrt(semi_major_m),
        eccentricity=random.uniform(3.0e-4, 4.0e-3),
        m0_rad=math.radians(argument_deg) + random.normal(0.0, 0.01) - perigee_rad,
        delta_n_radps=random.uniform(3.0e-9, 4.5e-9),
        omega0_rad=math.radians(node_deg) + random.normal(0.0, 0.01),
        omega_rad=perigee_rad,
        omega_dot_radps=random.normal(-6.5e-9, 2.0e-10)
        if semi_major_m < _SYNCHRONOUS_M
        else random.normal(-2.0e-9, 2.0e-10),
        i0_rad=_INCLINATION_RAD + random.normal(0.0, 0.01),
        idot_radps=random.normal(0.0, 2.0e-10),
        cuc_rad=random.normal(0.0, 3.0e-6),
        cus_rad=random.normal(0.0, 6.0e-6),
        crc_m=random.normal(180.0, 80.0),
        crs_m=random.normal(0.0, 60.0),
        cic_rad=random.normal(0.0, 5.0e-8),
        cis_rad=random.normal(0.0, 5.0e-8),
        health=0,
        accuracy_m=2.0,
    )


def _geostationary(satellite: str, longitude_deg: float, random: np.random.Generator) -> Ephemeris:
    """Over a longitude, inclined to the equator by a degree or two, without disturbances.

    The elements count from the equator of the epoch here; `_tilted_at` turns them.
    """
    node_deg = random.uniform(0.0, 360.0)
    elements = _elements(satellite, _SYNCHRONOUS_M, node_deg, longitude_deg - node_deg, random)
    return replace(
        elements,
        eccentricity=random.uniform(1.0e-4, 6.0e-4),
        m0_rad=math.radians(longitude_deg) - elements.omega0_rad - elements.omega_rad,
        i0_rad=math.radians(random.uniform(0.8, 1.8)),
        delta_n_radps=0.0,
        omega_dot_radps=0.0,
        idot_radps=0.0,
        cuc_rad=0.0,
        cus_rad=0.0,
        crc_m=0.0,
        crs_m=0.0,
        cic_rad=0.0,
        cis_rad=0.0,
    )


def _at(elements: Ephemeris, toe: GpsTime) -> Ephemeris:
    """The same orbit and clock told for another toe, which is when the set is first sent."""
    elapsed_s = toe.since(elements.toe)
    # Slow drifts start afresh every week, as if the control segment had steered them back.
    drifted_s = math.remainder(elapsed_s, SECONDS_PER_WEEK)
    weeks = math.floor(elapsed_s / SECONDS_PER_WEEK)
    motion = math.sqrt(_GM_M3PS2 / elements.sqrt_a_rm**6) + elements.delta_n_radps
    # Ω0 counts from the Greenwich meridian at the start of the week: the earth turns in between.
    node_rad = elements.omega0_rad + elements.omega_dot_radps * elapsed_s
    node_rad -= _EARTH_RATE_RADPS * SECONDS_PER_WEEK * weeks
    moved = replace(
        elements,
        toe=toe,
        toc=toe,
        transmitted=toe,
        af0_s=elements.af0_s + elements.af1_sps * drifted_s,
        m0_rad=math.remainder(elements.m0_rad + motion * elapsed_s, 2.0 * math.pi),
        omega0_rad=math.remainder(node_rad, 2.0 * math.pi),
        i0_rad=elements.i0_rad + elements.idot_radps * drifted_s,
    )
    return rounded(moved, _SCALES)


def _tilted_at(elements: Ephemeris, toe: GpsTime) -> Ephemeris:
    """`_at` for a geostationary satellite.

    Its elements count in the earth's axes at toe, leaning by 5° about the one to Greenwich: their
    angles follow from the orientation of the orbit, which stands still among the stars.
    """
    moved = _at(elements, toe)
    week_s = toe.plus(BDT_MINUS_GPST_S).tow_s
    since_epoch_rad = math.remainder(_EARTH_RATE_RADPS * toe.since(elements.toe), 2.0 * math.pi)
    orientation = (
        _turn(0, -_TILT_RAD)
        @ _turn(2, since_epoch_rad)
        @ _turn(2, -elements.omega0_rad)
        @ _turn(0, -elements.i0_rad)
        @ _turn(2, -elements.omega_rad)
    )
    node_rad = math.atan2(orientation[0, 2], -orientation[1, 2])
    moved = replace(
        moved,
        omega0_rad=math.remainder(node_rad + _EARTH_RATE_RADPS * week_s, 2.0 * math.pi),
        i0_rad=math.acos(orientation[2, 2]),
        omega_rad=math.atan2(orientation[2, 0], orientation[2, 1]),
    )
    return rounded(moved, _SCALES)


def _turn(axis: int, angle_rad: float) -> FloatArray:
    """Matrix that takes coordinates into axes turned by an angle about axis 0 or 2."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
