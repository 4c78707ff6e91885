"""Tight coupling: the ranges of a tag as the filter takes them, however few there are.

The clock the filter carries is the sample counter's: an oscillator, which nobody bends. The tags'
clock is steered by every solution, and by metres a second where reflections or four satellites in
one direction make them; a filter that followed the tags would take what all ranges then have in
common for a navigation that contradicts them. So that the clock starts near zero, the line on which
the counter ran ahead of the tags when the filter began is taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Counter, Epoch, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.ins.ranging import ClockNoise, RangeEpoch, RangeObservation
from deepgnss.receiver.measured import ranges_from
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.receiver import Fix

CLOCK_NOISE = ClockNoise(bias_m_rts=0.1, drift_mps_rts=0.2)
"""Of a TCXO's counter."""

_CLOCK_M = 100.0
_DRIFT_MPS = 3.0
_BETWEEN_M = 300.0  # GPST and the clocks of other systems, hardware included


class CounterLine(NamedTuple):
    """The counter's lead on the tags as it would go on from a tag without any steering."""

    time: GpsTime
    counter: Counter

    def off(self, epoch: Epoch) -> tuple[float, float]:
        """Lead of the counter on this line, m, and its rate, m/s, at a later tag."""
        ahead_s, drift_sps = self.counter
        passed_s = epoch.time.since(self.time)
        off_s = epoch.counter.ahead_s - ahead_s - drift_sps * passed_s
        off_sps = epoch.counter.drift_sps - drift_sps
        return SPEED_OF_LIGHT_MPS * off_s, SPEED_OF_LIGHT_MPS * off_sps


def clock_sigmas(systems: Sequence[str]) -> FloatArray:
    """1σ of the receiver's clock, its drift and the inter-system biases at the start."""
    return np.array([_CLOCK_M, _DRIFT_MPS, *[_BETWEEN_M] * (len(systems) - 1)])


def range_epoch(
    fix: Fix,
    parameters: PvtParameters,
    r_e_m: FloatArray,
    systems: Sequence[str],
    line: CounterLine,
    lasting_m: float,
    together: float,
) -> RangeEpoch | None:
    """Ranges and their rates at a tag; None without any.

    What outlier test and RAIM threw out stays out; a Doppler alone, when it alone was wrong.

    Parameters
    ----------
    r_e_m: (3,) roughly the antenna. systems: those the filter knows. line: its clock is against.
    lasting_m, together: 1σ of errors that last, and so many tags that count as one.
    """
    rejected = fix.solution.rejected
    by_doppler = {s for s, reason in rejected.items() if reason.startswith("Doppler")}
    refused = {s: reason for s, reason in rejected.items() if s not in by_doppler}
    seen = ranges_from(fix.measured, parameters, r_e_m, refused)
    off_m, off_mps = line.off(fix.epoch)
    found = tuple(
        RangeObservation(
            satellite,
            satellite[0],
            seen.r_e_m[k],
            seen.v_e_mps[k],
            float(seen.range_m[k]) + off_m,
            float(np.hypot(seen.sigma_m[k], lasting_m) * np.sqrt(together)),
            _known(float(seen.rate_mps[k]) + off_mps) if satellite not in by_doppler else None,
            float(seen.rate_sigma_mps[k]),
            together,
        )
        for k, satellite in enumerate(seen.satellites)
        if satellite[0] in systems
    )
    return RangeEpoch(fix.epoch.time, found) if found else None


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
