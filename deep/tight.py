"""Tight coupling: the ranges of a tag as the filter takes them, however few there are.

The clock the filter carries is that of the tags: solutions steer it to GPST, so that it starts
near zero; what steering bends goes into its noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepgnss.core.records import FloatArray, NavData
from deepgnss.ins.ranging import ClockNoise, RangeEpoch, RangeObservation
from deepgnss.receiver.measured import ranges_from
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.receiver import Fix

CLOCK_NOISE = ClockNoise(bias_m_rts=2.0, drift_mps_rts=0.3)
"""A TCXO (0.2 m/s in a second) under a receiver that steers it: by some cm/s, and by 2 m/s where
reflections or four satellites in one direction make its positions. Followed too slowly, what all
ranges have in common passes for a navigation that contradicts them."""

_CLOCK_M = 100.0
_DRIFT_MPS = 3.0
_BETWEEN_M = 300.0  # GPST and the clocks of other systems, hardware included


def clock_sigmas(systems: Sequence[str]) -> FloatArray:
    """1σ of the receiver's clock, its drift and the inter-system biases at the start."""
    return np.array([_CLOCK_M, _DRIFT_MPS, *[_BETWEEN_M] * (len(systems) - 1)])


def range_epoch(
    fix: Fix,
    nav: NavData,
    parameters: PvtParameters,
    r_e_m: FloatArray,
    systems: Sequence[str],
    lasting_m: float,
    together: float,
) -> RangeEpoch | None:
    """Ranges and their rates at a tag; None without any.

    What outlier test and RAIM threw out stays out; a Doppler alone, when it alone was wrong.

    Parameters
    ----------
    r_e_m: (3,) roughly the antenna. systems: those the filter knows.
    lasting_m, together: 1σ of errors that last, and so many tags that count as one.
    """
    rejected = fix.solution.rejected
    by_doppler = {s for s, reason in rejected.items() if reason.startswith("Doppler")}
    refused = {s: reason for s, reason in rejected.items() if s not in by_doppler}
    seen = ranges_from(fix.epoch, nav, parameters, r_e_m, refused)
    found = tuple(
        RangeObservation(
            satellite,
            satellite[0],
            seen.r_e_m[k],
            seen.v_e_mps[k],
            float(seen.range_m[k]),
            float(np.hypot(seen.sigma_m[k], lasting_m) * np.sqrt(together)),
            _known(float(seen.rate_mps[k])) if satellite not in by_doppler else None,
            float(seen.rate_sigma_mps[k]),
            together,
        )
        for k, satellite in enumerate(seen.satellites)
        if satellite[0] in systems
    )
    return RangeEpoch(fix.epoch.time, found) if found else None


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
