"""When the vehicle stands: gyros and accelerometers quiet over a window up to the instant."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.earth import Real
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade

_CREEPING_MPS: Final = 0.5


class StandstillLimits(NamedTuple):
    """A window counts as standing when every axis stays below these, as 1σ about its mean.

    Steady speed, a steady turn, steady braking are as quiet as rest where the road does not shake:
    a filter believes the detector only while its own speed is small.
    """

    window_s: float
    gyro_radps: float
    accel_mps2: float


def standstill_limits(
    grade: ImuGrade,
    rate_hz: float,
    window_s: float = 1.0,
    factor: float = 1.5,
    engine_radps: float = 0.003,
    engine_mps2: float = 0.05,
) -> StandstillLimits:
    """Limits from a grade's white noise at a rate, with the shaking of an idling engine on top.

    The spread of n samples scatters by 1/√(2n) of itself: 1.5 is far out for a second at 50 Hz.
    """
    return StandstillLimits(
        window_s,
        factor * np.hypot(grade.gyro_noise_rad_rts * np.sqrt(rate_hz), engine_radps),
        factor * np.hypot(grade.accel_noise_mps_rts * np.sqrt(rate_hz), engine_mps2),
    )


def fastest_at_rest_mps(sigma_mps: Real) -> Real:
    """Speed of a fix, by its 1σ, up to which what is quiet may be taken for at rest."""
    return _CREEPING_MPS + 3.0 * sigma_mps


def standing(
    block: ImuBlock, limits: StandstillLimits
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether the vehicle stood over the window that ends with each increment (n,).

    False until a whole window has passed, and over windows with gaps.
    """
    first = np.searchsorted(block.time_s, block.time_s - limits.window_s + 0.5 * block.dt_s)
    count = np.arange(block.time_s.size) - first + 1
    covered_s = _windows(block.dt_s[:, np.newaxis], first)[:, 0]
    full = np.abs(covered_s - limits.window_s) < 1.5 * block.dt_s
    quiet = np.ones(block.time_s.size, dtype=np.bool_)
    for increments, limit in (
        (block.dtheta_b_rad, limits.gyro_radps),
        (block.dv_b_mps, limits.accel_mps2),
    ):
        rate = increments / block.dt_s[:, np.newaxis]
        rate = rate - rate.mean(axis=0)  # or the squares of gravity eat the digits
        mean = _windows(rate, first) / count[:, np.newaxis]
        spread2 = _windows(rate**2, first) / count[:, np.newaxis] - mean**2
        quiet &= np.all(spread2 < limit**2, axis=1)
    return full & (count > 2) & quiet


def _windows(values: FloatArray, first: FloatArray | np.ndarray) -> FloatArray:
    """Sums (n, m) of the rows first[k] … k."""
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    total: FloatArray = sums[1:] - sums[first]
    return total
