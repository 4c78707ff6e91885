"""Which satellites to search, when, and where: bounded in cost for the whole run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.acquisition import SearchWindow
from deepgnss.receiver.signals import Signal


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How often satellites that are not tracked are looked for."""

    predicted_every_s: float = 1.0  # risen or lost ones, in a narrow window
    blind_every_s: float = 5.0  # one of those nothing is known of
    below_mask_rad: float = float(np.radians(3.0))  # predicted ones are sought above this
    code_half_m: float = 3000.0  # half width of a predicted window
    doppler_half_hz: float = 120.0


class Sight(NamedTuple):
    """What is predicted of one satellite at a sample."""

    satellite: str
    elevation_rad: float
    doppler_hz: float  # on the recording's own frequency scale
    transmit_s: float  # satellite clock reading, s after the given time
    healthy: bool


class Place(NamedTuple):
    """Where and when the receiver is believed to be."""

    time: GpsTime
    r_e_m: FloatArray
    v_e_mps: FloatArray
    drift_sps: float  # of the sample counter


def predict_sights(place: Place, nav: NavData, signal: Signal) -> list[Sight]:
    """Satellites of a signal's system with a usable ephemeris, as seen from a place."""
    chosen: list[Ephemeris] = []
    for satellite in sorted(nav.ephemerides):
        if satellite[0] == signal.id.system:
            ephemeris = orbits.select(nav, satellite, place.time)
            if ephemeris is not None:
                chosen.append(ephemeris)
    if not chosen:
        return []
    seen = orbits.predict(chosen, place.time, place.r_e_m, place.v_e_mps)
    received_hz = -seen.pseudorange_rate_mps / SPEED_OF_LIGHT_MPS * signal.id.carrier_hz
    doppler_hz = (received_hz - place.drift_sps * signal.id.carrier_hz) / (1.0 + place.drift_sps)
    return [
        Sight(
            ephemeris.satellite,
            float(seen.elevation_rad[k]),
            float(doppler_hz[k]),
            -float(seen.pseudorange_m[k]) / SPEED_OF_LIGHT_MPS,
            ephemeris.health == 0,
        )
        for k, ephemeris in enumerate(chosen)
    ]


def window_of(sight: Sight, place: Place, signal: Signal, settings: SearchSettings) -> SearchWindow:
    """Window of code phase and Doppler around a prediction."""
    sent_s = place.time.tow_s % 1.0 + sight.transmit_s
    chips = (sent_s / signal.period_s % 1.0) * signal.id.code_chips
    half_chips = settings.code_half_m / SPEED_OF_LIGHT_MPS * signal.id.chip_rate_hz
    return SearchWindow(sight.doppler_hz, settings.doppler_half_hz, chips, half_chips)


def next_blind(
    prns: Iterable[int], busy: frozenset[int], last_tried: Mapping[int, int]
) -> int | None:
    """The satellite not tracked or predicted whose last search lies back longest."""
    free = [prn for prn in prns if prn not in busy]
    return min(free, key=lambda prn: (last_tried.get(prn, -1), prn)) if free else None
