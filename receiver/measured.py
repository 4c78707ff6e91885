"""What an epoch measured, satellite by satellite, freed of what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import SIGNAL_IDS, Ephemeris, Epoch, FloatArray, NavData, Observation
from deepgnss.receiver import orbits
from deepgnss.receiver.weights import PvtParameters, delays, range_sigma, rate_sigma

NOBODY_REFUSED: Mapping[str, str] = MappingProxyType({})

_NOBODY = orbits.SatelliteStates(np.zeros((0, 3)), np.zeros((0, 3)), *(np.zeros(0),) * 3)


class Measured(NamedTuple):
    """Observations that have an ephemeris, as columns."""

    satellites: tuple[str, ...]
    usable: NDArray[np.bool_]  # False: unhealthy, or refused by somebody else
    ephemerides: tuple[Ephemeris, ...]
    states: orbits.SatelliteStates
    ranges_m: FloatArray  # pseudorange with the satellite clock taken off
    rates_mps: FloatArray  # −λD, NaN where there is none
    carriers_hz: FloatArray
    cn0_dbhz: FloatArray
    rate_sigmas_mps: FloatArray  # as the loops have them; NaN where C/N0 tells


def measure(
    epoch: Epoch, nav: NavData, refused: Mapping[str, str] = NOBODY_REFUSED
) -> tuple[Measured, dict[str, str]]:
    """Observations with their satellites' states, and why others were left out."""
    rejected: dict[str, str] = {}
    chosen: list[tuple[Observation, Ephemeris]] = []
    for observation in epoch.observations:
        satellite = observation.satellite
        ephemeris = orbits.select(nav, satellite, epoch.time)
        if ephemeris is None:
            rejected[satellite] = "no ephemeris"
        elif not np.isfinite(observation.pseudorange_m):
            rejected[satellite] = "no pseudorange"
        else:
            chosen.append((observation, ephemeris))
            if ephemeris.health != 0:
                rejected[satellite] = "unhealthy"
            elif satellite in refused:
                rejected[satellite] = refused[satellite]
            elif nav.corrections is not None and satellite not in nav.corrections:
                rejected[satellite] = "no correction of the base's"
    observations = tuple(observation for observation, _ in chosen)
    ephemerides = tuple(ephemeris for _, ephemeris in chosen)
    readings_s = np.array([o.transmit.since(epoch.time) for o in observations])
    carriers_hz = np.array([SIGNAL_IDS[o.signal].carrier_hz for o in observations])
    dopplers_hz = np.array([o.doppler_hz for o in observations])
    states = orbits.transmitted_states(ephemerides, epoch.time, readings_s) if chosen else _NOBODY
    measured = Measured(
        satellites=tuple(o.satellite for o in observations),
        usable=np.array([o.satellite not in rejected for o in observations], dtype=bool),
        ephemerides=ephemerides,
        states=states,
        ranges_m=np.array([o.pseudorange_m - _correction_m(nav, o, epoch) for o in observations])
        + SPEED_OF_LIGHT_MPS * (states.clock_s - states.group_delay_s),
        rates_mps=-SPEED_OF_LIGHT_MPS / carriers_hz * dopplers_hz,
        carriers_hz=carriers_hz,
        cn0_dbhz=np.array([o.cn0_dbhz for o in observations]),
        rate_sigmas_mps=SPEED_OF_LIGHT_MPS
        / carriers_hz
        * np.array([o.doppler_sigma_hz for o in observations]),
    )
    return measured, rejected


def _correction_m(nav: NavData, observation: Observation, epoch: Epoch) -> float:
    found = (nav.corrections or {}).get(observation.satellite)
    return found.at(epoch.time) if found is not None else 0.0


class Ranges(NamedTuple):
    """Ranges and their rates as columns: what is left is geometry and the receiver's clock.

    Range = |satellite − antenna| + c·clock; rate = unit · (v of satellite − v of antenna)
    + c·drift, exact for an antenna at rest and to 4e-6 of its velocity.
    """

    satellites: tuple[str, ...]
    r_e_m: FloatArray  # (k, 3) satellites, in the Earth-fixed frame of reception
    v_e_mps: FloatArray  # (k, 3)
    unit_e: FloatArray  # (k, 3) from the antenna to them
    misfit_m: FloatArray  # (k,) range less that from the antenna's place
    range_m: FloatArray  # (k,)
    rate_mps: FloatArray  # (k,) NaN where there is none
    cn0_dbhz: FloatArray
    sigma_m: FloatArray  # (k,)
    rate_sigma_mps: FloatArray  # (k,)


def ranges_from(
    epoch: Epoch,
    nav: NavData,
    parameters: PvtParameters,
    r_e_m: FloatArray,
    refused: Mapping[str, str] = NOBODY_REFUSED,
) -> Ranges:
    """Ranges of the usable satellites above the mask, seen from the antenna's place (3,), ECEF."""
    measured, _ = measure(epoch, nav, refused)
    states, ephemerides = measured.states, measured.ephemerides
    sight = orbits.line_of_sight(r_e_m, np.zeros(3), states)
    azimuth, elevation = orbits.directions(r_e_m, sight)
    delays_m, variance_m2 = delays(
        nav, parameters, epoch.time, r_e_m, azimuth, elevation, measured.carriers_hz
    )
    errors, cn0_dbhz = parameters.errors, measured.cn0_dbhz
    still = sight.range_rate_mps
    along = np.einsum("ki,ki->k", sight.unit_e, states.v_e_mps)
    range_m = measured.ranges_m - delays_m
    every = Ranges(
        satellites=measured.satellites,
        r_e_m=r_e_m + sight.range_m[:, np.newaxis] * sight.unit_e,
        v_e_mps=states.v_e_mps + (still - along)[:, np.newaxis] * sight.unit_e,
        unit_e=sight.unit_e,
        misfit_m=range_m - sight.range_m,
        range_m=range_m,
        rate_mps=measured.rates_mps + (SPEED_OF_LIGHT_MPS - still) * states.drift_sps,
        cn0_dbhz=cn0_dbhz,
        sigma_m=range_sigma(errors, ephemerides, elevation, cn0_dbhz, variance_m2),
        rate_sigma_mps=rate_sigma(errors, cn0_dbhz, measured.rate_sigmas_mps),
    )
    rows = np.flatnonzero(measured.usable & (elevation >= parameters.elevation_mask_rad))
    names = tuple(every.satellites[row] for row in rows)
    return Ranges(names, *(column[rows] for column in every[1:]))
