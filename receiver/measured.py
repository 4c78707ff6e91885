"""What an epoch measured, satellite by satellite, freed of what is known of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import (
    SIGNAL_IDS,
    Ephemeris,
    Epoch,
    FloatArray,
    NavData,
    Observation,
    RangeCorrections,
)
from deepgnss.receiver import orbits
from deepgnss.receiver.weights import PvtParameters, delays, range_sigma, rate_sigma

NOBODY_REFUSED: Mapping[str, str] = MappingProxyType({})


class Measured(NamedTuple):
    """An epoch's observations that have an ephemeris, as columns."""

    epoch: Epoch
    nav: NavData
    satellites: tuple[str, ...]
    ephemerides: tuple[Ephemeris, ...]
    states: orbits.SatelliteStates
    ranges_m: FloatArray  # pseudorange with the satellite clock taken off
    rates_mps: FloatArray  # −λD, NaN where there is none
    carriers_hz: FloatArray
    cn0_dbhz: FloatArray
    rate_sigmas_mps: FloatArray  # as the loops have them; NaN where C/N0 tells
    unusable: Mapping[str, str]  # satellites of the epoch that are of no use, and why

    def without(self, refused: Mapping[str, str]) -> tuple[NDArray[np.bool_], dict[str, str]]:
        """Rows that are left without satellites somebody else refused; why others are not."""
        rejected = {
            one.satellite: why
            for one in self.epoch.observations
            if (why := self.unusable.get(one.satellite) or refused.get(one.satellite))
        }
        return np.array([name not in rejected for name in self.satellites], dtype=bool), rejected

    def delays(
        self,
        parameters: PvtParameters,
        r_e_m: FloatArray,
        azimuth_rad: FloatArray,
        elevation_rad: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Delays by the atmosphere and their variances (`weights.delays`), m and m²."""
        return delays(
            self.nav,
            parameters,
            self.epoch.time,
            r_e_m,
            azimuth_rad,
            elevation_rad,
            self.carriers_hz,
        )


def measure(epoch: Epoch, nav: NavData) -> Measured:
    """Observations with their satellites' states."""
    unusable: dict[str, str] = {}
    chosen: list[tuple[Observation, Ephemeris]] = []
    for observation in epoch.observations:
        satellite = observation.satellite
        ephemeris = orbits.select(nav, satellite, epoch.time)
        if ephemeris is None:
            unusable[satellite] = "no ephemeris"
        elif not math.isfinite(observation.pseudorange_m):
            unusable[satellite] = "no pseudorange"
        else:
            chosen.append((observation, ephemeris))
            if ephemeris.health != 0:
                unusable[satellite] = "unhealthy"
            elif nav.corrections is not None and satellite not in nav.corrections:
                unusable[satellite] = "no correction of the base's"
    ephemerides = tuple(ephemeris for _, ephemeris in chosen)
    rows = [
        (
            one.transmit.since(epoch.time),
            one.pseudorange_m,
            one.doppler_hz,
            one.doppler_sigma_hz,
            one.cn0_dbhz,
            SIGNAL_IDS[one.signal].carrier_hz,
        )
        for one, _ in chosen
    ]
    columns = np.array(rows, dtype=np.float64).reshape(-1, 6).T.copy()
    readings_s, ranges_m, dopplers_hz, doppler_sigmas_hz, cn0_dbhz, carriers_hz = columns
    if nav.corrections is not None:
        ranges_m = ranges_m - [_correction_m(nav.corrections, one, epoch) for one, _ in chosen]
    states = orbits.transmitted_states(ephemerides, epoch.time, readings_s)
    return Measured(
        epoch,
        nav,
        satellites=tuple(one.satellite for one, _ in chosen),
        ephemerides=ephemerides,
        states=states,
        ranges_m=ranges_m + SPEED_OF_LIGHT_MPS * (states.clock_s - states.group_delay_s),
        rates_mps=-SPEED_OF_LIGHT_MPS / carriers_hz * dopplers_hz,
        carriers_hz=carriers_hz,
        cn0_dbhz=cn0_dbhz,
        rate_sigmas_mps=SPEED_OF_LIGHT_MPS / carriers_hz * doppler_sigmas_hz,
        unusable=unusable,
    )


def _correction_m(
    corrections: Mapping[str, RangeCorrections], observation: Observation, epoch: Epoch
) -> float:
    found = corrections.get(observation.satellite)
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
    measured: Measured,
    parameters: PvtParameters,
    r_e_m: FloatArray,
    refused: Mapping[str, str] = NOBODY_REFUSED,
) -> Ranges:
    """Ranges of the usable satellites above the mask, seen from the antenna's place (3,), ECEF."""
    usable, _ = measured.without(refused)
    states = measured.states
    sight = orbits.line_of_sight(r_e_m, np.zeros(3), states)
    azimuth, elevation = orbits.directions(r_e_m, sight)
    delays_m, variance_m2 = measured.delays(parameters, r_e_m, azimuth, elevation)
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
        sigma_m=range_sigma(errors, measured.ephemerides, elevation, cn0_dbhz, variance_m2),
        rate_sigma_mps=rate_sigma(errors, cn0_dbhz, measured.rate_sigmas_mps),
    )
    rows = np.flatnonzero(usable & (elevation >= parameters.elevation_mask_rad))
    if len(rows) == len(every.satellites):
        return every
    names = tuple(every.satellites[row] for row in rows)
    return Ranges(names, *(column[rows] for column in every[1:]))
