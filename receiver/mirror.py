"""Real samples at (nearly) zero IF hold every signal at its Doppler and at the mirror image of it.

Which of the two is found out from the Dopplers themselves: all share one offset of the oscillator.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from deepgnss.core.frames import ecef
from deepgnss.core.records import Ephemeris, FloatArray, SampleBlock
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.coarse_time import Rough
from deepgnss.receiver.precise import Measurement
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.snapshot_prediction import BELOW_HORIZON_RAD, dopplers

_PLACES = 800  # on earth, tried where mirrored Dopplers meet an unknown place
_SIGN_SETS = 12  # of them handed on to the solver


def mirror_doppler_hz(block: SampleBlock, signal: Signal, reach_hz: float) -> float | None:
    """Doppler about which real samples mirror the signals within ± reach, if there is one."""
    if block.samples.ndim == 2:
        return None
    stream = block.stream
    mix_hz = stream.intermediate_hz + signal.id.carrier_hz - stream.centre_hz
    mirror_hz = math.remainder(-2.0 * mix_hz, stream.sample_rate_hz) / 2.0
    return mirror_hz if abs(mirror_hz) < reach_hz else None


def sides(
    found: Sequence[Measurement],
    known: dict[int, Ephemeris],
    signal: Signal,
    rough: Rough,
    mirror_hz: float | None,
) -> Iterator[list[Measurement]]:
    """Measurements with each Doppler on its likely side of the mirror, likeliest first."""
    if mirror_hz is None or len(found) < 2:
        yield list(found)
        return
    doppler_hz = np.array([one.doppler_hz for one in found])
    both = np.stack([doppler_hz, 2.0 * mirror_hz - doppler_hz])
    ephemerides = [known[one.prn] for one in found]
    ranked = []
    for place in _places(rough):
        expected_hz = _expected(ephemerides, rough.time, place, signal)
        tolerance_hz = 1000.0 if rough.r_e_m is None else 50.0 + rough.position_sigma_m * 1e-3
        ranked.append(_choose(both, expected_hz, tolerance_hz, rough, signal))
    ranked.sort(key=lambda entry: entry[0])
    seen: set[tuple[int, ...]] = set()
    for _, side in ranked:
        if side not in seen:
            seen.add(side)
            chosen = both[list(side), np.arange(len(found))]
            yield [
                replace(one, doppler_hz=float(hz)) for one, hz in zip(found, chosen, strict=True)
            ]
        if len(seen) >= _SIGN_SETS:
            return


def _places(rough: Rough) -> Iterator[FloatArray]:
    if rough.r_e_m is not None:
        yield rough.r_e_m
        return
    golden = math.pi * (3.0 - math.sqrt(5.0))
    for n in range(_PLACES):
        yield ecef(math.asin(1.0 - (2 * n + 1) / _PLACES), n * golden, 0.0)


def _expected(
    ephemerides: Sequence[Ephemeris], time: GpsTime, place: FloatArray, signal: Signal
) -> FloatArray:
    at = orbits.predict(ephemerides, time, place, np.zeros(3))
    doppler_hz = dopplers(at.pseudorange_rate_mps, 0.0, signal)
    doppler_hz[at.elevation_rad < BELOW_HORIZON_RAD] = np.nan
    return doppler_hz


def _choose(
    both: FloatArray, expected_hz: FloatArray, tolerance_hz: float, rough: Rough, signal: Signal
) -> tuple[float, tuple[int, ...]]:
    """Sides that agree best on one offset of the oscillator, with their cost."""
    offsets = both - expected_hz
    centre_hz = -rough.drift_sps * signal.id.carrier_hz
    reach_hz = 4.0 * rough.drift_sigma_sps * signal.id.carrier_hz
    trials = offsets[np.isfinite(offsets) & (np.abs(offsets - centre_hz) < reach_hz)]
    if trials.size == 0:
        return math.inf, (0,) * both.shape[1]
    misfit = np.abs(offsets[np.newaxis] - trials[:, np.newaxis, np.newaxis]) / tolerance_hz
    misfit = np.where(np.isfinite(misfit), misfit, 10.0)  # below the horizon
    cost = (np.minimum(misfit.min(axis=1), 3.0) ** 2).sum(axis=1)
    best = int(cost.argmin())
    return float(cost[best]), tuple(int(side) for side in misfit[best].argmin(axis=0))
