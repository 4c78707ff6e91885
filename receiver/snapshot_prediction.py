"""What satellites are to be expected in a snapshot, and how."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.coarse_time import Rough, SnapshotFix
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.weights import PvtParameters, delays

LOWEST_RAD = math.radians(3.0)
BELOW_HORIZON_RAD = math.radians(-10.0)
_KNOWN_PLACE_M = 500e3  # a prior this good says which satellites are below the horizon


class Predicted(NamedTuple):
    """A satellite as a fix lets it be expected at the first sample."""

    prn: int
    code_s: float  # modulo the code period
    doppler_hz: float
    elevation_rad: float
    travel_s: float  # time of reception minus satellite clock reading


def usable(nav: NavData, signal: Signal, rough: Rough) -> dict[int, Ephemeris]:
    """Healthy satellites with an ephemeris that may be above the horizon, by PRN."""
    chosen = {}
    for prn in signal.prns:
        ephemeris = orbits.select(nav, signal.satellite(prn), rough.time)
        if ephemeris is not None and ephemeris.health == 0:
            chosen[prn] = ephemeris
    if chosen and rough.r_e_m is not None and rough.position_sigma_m <= _KNOWN_PLACE_M:
        at = orbits.predict(list(chosen.values()), rough.time, rough.r_e_m, np.zeros(3))
        up = at.elevation_rad > BELOW_HORIZON_RAD
        chosen = {prn: chosen[prn] for prn, above in zip(list(chosen), up, strict=True) if above}
    return chosen


def predict(
    fix: SnapshotFix,
    known: dict[int, Ephemeris],
    nav: NavData,
    signal: Signal,
    parameters: PvtParameters,
) -> list[Predicted]:
    """Code phase and Doppler of satellites at the instant of a fix."""
    solution = fix.solution
    return expect(
        known,
        nav,
        signal,
        parameters,
        solution.time,
        solution.r_e_m,
        solution.v_e_mps,
        solution.clock_s,
        solution.drift_sps,
    )


def expect(
    known: dict[int, Ephemeris],
    nav: NavData,
    signal: Signal,
    parameters: PvtParameters,
    time: GpsTime,
    r_e_m: FloatArray,
    v_e_mps: FloatArray | None = None,
    clock_s: float = 0.0,
    drift_sps: float = 0.0,
) -> list[Predicted]:
    """Code phase and Doppler of satellites at a place and time (default: at rest, right clock)."""
    prns = sorted(known)
    ephemerides = [known[prn] for prn in prns]
    at = orbits.predict(ephemerides, time, r_e_m, np.zeros(3) if v_e_mps is None else v_e_mps)
    carriers_hz = np.full(len(prns), signal.id.carrier_hz)
    elevation_rad = np.maximum(at.elevation_rad, LOWEST_RAD)
    delay_m, _ = delays(nav, parameters, time, r_e_m, at.azimuth_rad, elevation_rad, carriers_hz)
    travel_s = (at.pseudorange_m + delay_m) / SPEED_OF_LIGHT_MPS
    code_s = (-travel_s - clock_s) % signal.period_s
    doppler_hz = dopplers(at.pseudorange_rate_mps, drift_sps, signal)
    columns = (prns, code_s, doppler_hz, at.elevation_rad, travel_s)
    return [Predicted(int(prn), *map(float, rest)) for prn, *rest in zip(*columns, strict=True)]


def dopplers(rates_mps: FloatArray, drift_sps: float, signal: Signal) -> FloatArray:
    """Dopplers against a sample clock that drifts, from pseudorange rates."""
    received = -rates_mps / SPEED_OF_LIGHT_MPS - drift_sps
    return np.asarray(received * signal.id.carrier_hz / (1.0 + drift_sps))
