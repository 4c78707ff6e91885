"""Is this the log its settings describe? What does not fit, with the mistake it most looks like.

Looks at the first minutes of increments, in SI units and body axes FRD as the settings made them.
Nothing here is certain: a finding is a sentence for the user, not an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK, STANDARD_GRAVITY_MPS2
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime, leap_seconds_at

_G: Final = STANDARD_GRAVITY_MPS2
_GRAVITY_WITHIN: Final = 0.12  # of g: bias, scale, and a drive that is not straight and level
_FACTOR_WITHIN: Final = 0.2
_TOO_FAST_RADPS: Final = 10.0  # a car's body at its liveliest turns with 1 to 2
_TOO_SLOW_RADPS: Final = 0.02
_LIVELY_MPS2: Final = 1.0  # forces that vary so much come with turns
_LEVEL: Final = 0.9  # share of the mean force along one axis that makes it the vertical
_RATE_WITHIN: Final = 0.02
_DAY_S: Final = 86_400.0
_OTHER_CLOCKS_S: Final = {
    "BeiDou time taken for GPST": 14.0,
    "a time zone of one hour": 3600.0,
    "another GPS week": float(SECONDS_PER_WEEK),
    "a 10-bit week number": 1024.0 * SECONDS_PER_WEEK,
}


def findings(
    block: ImuBlock,
    *,
    stated_rate_hz: float | None = None,
    recording: tuple[GpsTime, GpsTime] | None = None,
    last: GpsTime | None = None,
) -> tuple[str, ...]:
    """Say what of a log cannot be as its settings have it, one sentence each.

    Parameters
    ----------
    block: a minute or more from its beginning.
    stated_rate_hz: rate the settings state.
    recording: first and last instant of what the log is to go with.
    last: last instant of the log; None: not known, a day at most is allowed for.
    """
    if block.dt_s.size < 2:
        return ("the log holds fewer than two intervals",)
    found = [*(_gravity(block) or [*_vertical(block), *_turning(block)])]
    if stated_rate_hz is not None:
        found += _rate(block, stated_rate_hz)
    if recording is not None:
        first = block.origin.plus(float(block.time_s[0]))
        found += _overlap(first, last or first.plus(_DAY_S), *recording)
    return tuple(found)


def _gravity(block: ImuBlock) -> Sequence[str]:
    """The size of the force tells units and kind, those of the gyros' columns too."""
    # Its median size is that of gravity also where its mean is not: on a winding road.
    force_mps2 = float(np.median(np.linalg.norm(block.dv_b_mps, axis=1) / block.dt_s))
    ratio, dt_s = force_mps2 / _G, float(np.median(block.dt_s))
    if abs(ratio - 1.0) <= _GRAVITY_WITHIN:
        return []
    factors = {
        "accelerations in g taken for m/s² (imu.units.accel: g)": 1.0 / _G,
        "accelerations in m/s² taken for g (imu.units.accel: m/s^2)": _G,
        "increments taken for rates (imu.kind: increments)": dt_s,
        "rates taken for increments (imu.kind: rates)": 1.0 / dt_s,
        "rates in g taken for increments (imu.kind: rates, imu.units.accel: g)": 1.0 / (dt_s * _G),
        "milli-g taken for g": 1e3,
        "cm/s² taken for m/s²": 1e2,
    }
    near = {name: abs(np.log(ratio / factor)) for name, factor in factors.items()}
    likely = sorted((name for name in near if near[name] < _FACTOR_WITHIN), key=near.__getitem__)
    return [f"the force at rest is {force_mps2:.4g} m/s², gravity 9.8" + _asked(likely)]


def _vertical(block: ImuBlock) -> Sequence[str]:
    """The direction of the mean force tells the axes."""
    mean_b = block.dv_b_mps.sum(axis=0) / block.dt_s.sum()
    share_b = mean_b / np.linalg.norm(mean_b)
    axis = int(np.abs(share_b).argmax())
    if abs(share_b[axis]) < _LEVEL or (axis == 2 and share_b[2] < 0.0):
        return []
    names = (("forward", "backward"), ("right", "left"), ("down", "up"))
    pointing = names[axis][int(share_b[axis] < 0.0)]
    advice = (
        "the letters of imu.axes may be another's (FRD for z down, RFU or FLU for z up)"
        if axis == 2
        else "the unit stands on its side, or imu.axes has the wrong letters"
    )
    return [f"at rest the force must point up, it points {pointing} in the body axes: {advice}"]


def _turning(block: ImuBlock) -> Sequence[str]:
    """How fast it turns tells degrees from radians."""
    rates = np.linalg.norm(block.dtheta_b_rad, axis=1) / block.dt_s
    fast = float(np.quantile(rates, 0.99))
    if fast > _TOO_FAST_RADPS:
        degrees = "degrees taken for radians (imu.units.gyro: deg or deg/s)"
        return [f"it turns with {fast:.4g} rad/s" + _asked([degrees])]
    forces = _seconds(block.dv_b_mps / block.dt_s[:, np.newaxis], block.dt_s)
    if fast < _TOO_SLOW_RADPS and np.std(forces, axis=0).max() > _LIVELY_MPS2:
        radians = "radians taken for degrees (imu.units.gyro: rad or rad/s)"
        text = f"it turns with no more than {fast:.3g} rad/s while forces vary"
        return [text + _asked([radians])]
    return []


def _seconds(values: FloatArray, dt_s: FloatArray) -> FloatArray:
    """Means over about a second: noise and vibration are no turns."""
    width = max(round(1.0 / float(np.median(dt_s))), 1)
    count = max(len(values) // width, 1)
    means: FloatArray = values[: count * width].reshape(count, -1, 3).mean(axis=1)
    return means


def _rate(block: ImuBlock, stated_hz: float) -> Sequence[str]:
    found_hz = block.dt_s.size / float(block.dt_s.sum())
    if abs(found_hz / stated_hz - 1.0) < _RATE_WITHIN:
        return []
    return [f"rows come at {found_hz:.5g} Hz, imu.rate says {stated_hz:.5g} Hz"]


def _overlap(first: GpsTime, last: GpsTime, start: GpsTime, end: GpsTime) -> Sequence[str]:
    """Log and recording side by side; what clock would set the one beside the other."""
    clocks_s = {"UTC taken for GPST": float(leap_seconds_at(start.utc())), **_OTHER_CLOCKS_S}
    late_s = first.since(start)
    if first.since(end) < 0.0 and start.since(last) < 0.0:
        text, within_s = f"the log begins {late_s:.3f} s after the recording", 0.5
        if late_s <= 0.0:
            return []
    else:
        text = f"log and recording have no second in common, they start {late_s:.3f} s apart"
        within_s = end.since(start)
    shifts = {name: abs(abs(late_s) - shift_s) for name, shift_s in clocks_s.items()}
    nearest = min(shifts, key=shifts.__getitem__)
    return [text + _asked([nearest] if shifts[nearest] <= within_s else [])]


def _asked(mistakes: Sequence[str]) -> str:
    return f": {', or '.join(mistakes)}?" if mistakes else ""
