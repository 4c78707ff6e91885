"""A nominal GPS constellation.

The 24 slots of the GPS standard (SPS Performance Standard, 3.2) with one spare in the widest gap
of each plane, small deviations drawn from a seed, all rounded to what a message can carry: what
is broadcast is the truth.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from deepgnss.core.constants import EARTH_RATE_RADPS, GM_GPS_M3PS2, SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, Klobuchar, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.lnav import PAGES
from deepgnss.sim.constellation.sets import rounded, utc_at

_SEMI_MAJOR_M: Final = 26_559_710.0
_INCLINATION_RAD: Final = math.radians(55.0)
_NODE_RATE_RADPS: Final = -8.0e-9
_MEAN_MOTION_RADPS: Final = math.sqrt(GM_GPS_M3PS2 / _SEMI_MAJOR_M**3)
_EPOCH: Final = GpsTime(2190, 0.0)  # the instant at which the slots below hold
_SET_S: Final = 7_200.0  # a new ephemeris every two hours, toe in the middle of its four
_LEAD_S: Final = 7_200.0  # from the first transmission of a set to its toe

_SCALES: Final = {field.name: field.scale for page in (1, 2, 3) for field in PAGES[page]}

# Longitude of the ascending node at the epoch and arguments of latitude per plane, degrees.
_PLANES: Final = {
    272.85: (268.126, 161.786, 11.676, 41.806),
    332.85: (80.956, 173.336, 309.976, 204.376),
    32.85: (111.876, 11.796, 339.666, 241.556),
    92.85: (135.226, 265.446, 35.156, 167.356),
    152.85: (197.046, 302.596, 66.066, 333.686),
    212.85: (238.886, 345.226, 105.206, 135.346),
}

KLOBUCHAR: Final = Klobuchar(
    (12 * 2.0**-30, 2 * 2.0**-27, -1 * 2.0**-24, -1 * 2.0**-24),
    (47 * 2.0**11, 4 * 2.0**14, -1 * 2.0**16, -3 * 2.0**16),
)
"""An ionosphere of moderate activity: some 4 m at zenith in the early afternoon."""


def nominal_gps(start: GpsTime, seconds: float, seed: int = 24) -> NavData:
    """Thirty satellites, G01–G30, with every set in force from `start` on, and iono and UTC."""
    random = np.random.Generator(np.random.PCG64(seed))
    slots = [
        (node, argument)
        for node, arguments in _PLANES.items()
        for argument in (*arguments, _widest_gap(arguments))
    ]
    order = random.permutation(len(slots))
    first = math.floor(start.tow_s / _SET_S)
    sets = range(first, math.floor((start.tow_s + seconds) / _SET_S) + 1)
    ephemerides = {}
    for prn, slot in enumerate(order, start=1):
        node_deg, argument_deg = slots[slot]
        elements = _elements(f"G{prn:02d}", node_deg, argument_deg, random)
        ephemerides[elements.satellite] = tuple(
            _at(elements, GpsTime(start.week, 0.0).plus(k * _SET_S)) for k in sets
        )
    return NavData(ephemerides=ephemerides, klobuchar={"G": KLOBUCHAR}, utc=utc_at(start))


def _widest_gap(arguments: tuple[float, ...]) -> float:
    """Middle of the widest gap between slots of a plane, degrees."""
    ordered = np.sort(arguments)
    gaps = np.diff(ordered, append=ordered[0] + 360.0)
    widest = int(np.argmax(gaps))
    return float(ordered[widest] + gaps[widest] / 2.0)


def _elements(
    satellite: str, node_deg: float, argument_deg: float, random: np.random.Generator
) -> Ephemeris:
    """Elements at the constellation's epoch; deviations as in broadcast messages of our years."""
    perigee_rad = random.uniform(-math.pi, math.pi)
    return Ephemeris(
        satellite=satellite,
        toe=_EPOCH,
        toc=_EPOCH,
        transmitted=_EPOCH,
        iode=0,
        iodc=0,
        af0_s=random.uniform(-5.0e-4, 5.0e-4),
        af1_sps=random.normal(0.0, 4.0e-12),
        af2_sps2=0.0,
        group_delay_s=random.uniform(-1.2e-8, 5.0e-9),
        sqrt_a_rm=math.sqrt(_SEMI_MAJOR_M),  # equal periods: the sets of years hang together
        eccentricity=random.uniform(1.0e-3, 1.5e-2),
        m0_rad=math.radians(argument_deg) + random.normal(0.0, 0.02) - perigee_rad,
        delta_n_radps=random.uniform(4.0e-9, 5.0e-9),
        omega0_rad=math.radians(node_deg) + random.normal(0.0, 0.02),
        omega_rad=perigee_rad,
        omega_dot_radps=_NODE_RATE_RADPS + random.normal(0.0, 2.0e-10),
        i0_rad=_INCLINATION_RAD + random.normal(0.0, 0.01),
        idot_radps=random.normal(0.0, 2.0e-10),
        cuc_rad=random.normal(0.0, 3.0e-6),
        cus_rad=random.normal(0.0, 6.0e-6),
        crc_m=random.normal(220.0, 80.0),
        crs_m=random.normal(0.0, 60.0),
        cic_rad=random.normal(0.0, 1.0e-7),
        cis_rad=random.normal(0.0, 1.0e-7),
        health=0,
        accuracy_m=2.0,
    )


def _at(elements: Ephemeris, sent: GpsTime) -> Ephemeris:
    """The set first sent at `sent`: the same orbit and clock told for its own toe."""
    toe = sent.plus(_LEAD_S)
    elapsed_s = toe.since(elements.toe)
    weeks = toe.week - elements.toe.week
    # Slow drifts start afresh every week, as if the control segment had steered them back.
    drifted_s = math.remainder(elapsed_s, SECONDS_PER_WEEK)
    issue = round(toe.tow_s / _SET_S) % 240
    motion = _MEAN_MOTION_RADPS + elements.delta_n_radps
    # Ω0 counts from the Greenwich meridian at the start of the week: the earth turns in between.
    node_rad = elements.omega0_rad + elements.omega_dot_radps * elapsed_s
    node_rad -= EARTH_RATE_RADPS * SECONDS_PER_WEEK * weeks
    moved = replace(
        elements,
        toe=toe,
        toc=toe,
        transmitted=sent,
        iode=issue,
        iodc=issue,
        af0_s=elements.af0_s + elements.af1_sps * drifted_s,
        m0_rad=math.remainder(elements.m0_rad + motion * elapsed_s, 2.0 * math.pi),
        omega0_rad=math.remainder(node_rad, 2.0 * math.pi),
        i0_rad=elements.i0_rad + elements.idot_radps * drifted_s,
    )
    return rounded(moved, _SCALES)
