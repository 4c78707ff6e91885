"""Aiding: what the navigation knows of each satellite's carrier over an epoch, T(4.1–4.6).

The Doppler of a satellite follows from its orbit and clock, the antenna's velocity by the inertial
navigation with its lever arm and rotation, and the rates of the atmosphere. Only its changes enter
a closed loop, which follows the receiver's clock by itself; in open loop the clock's frequency
comes with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, FloatArray, NavData, SignalId
from deepgnss.core.time import GpsTime
from deepgnss.ins.trajectory import Trajectory
from deepgnss.receiver import orbits
from deepgnss.receiver.clock import ReceiverClock, from_ns
from deepgnss.receiver.modes import AidingRate
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.weights import delays

STEP_S = 1e-3  # between the points of a profile
AHEAD_S = 0.02  # over which a command is taken as linear: an update of the loops
_BEFORE_S = 0.04  # updates that straddle the epoch's start
_DELAY_STEP_S = 10.0  # over which the atmosphere's rate is taken …
_DELAYS_KEPT_S = 5.0  # … and for how long it is used


class Listener(NamedTuple):
    """Somebody who wants aiding: a satellite's signal in a stream."""

    satellite: str
    signal: SignalId
    rate_hz: float


class Motion(NamedTuple):
    """Antenna on the points of a profile."""

    time_s: FloatArray  # (n,) since `origin`, rising evenly
    origin: GpsTime
    r_e_m: FloatArray  # (n, 3)
    v_e_mps: FloatArray  # (n, 3)


@dataclass(frozen=True, slots=True)
class Profile:
    """Predicted carrier of one satellite: Doppler on even points, linear in between and beyond.

    first, step: sample of the first point and samples between points, of the signal's stream;
    ahead: points in an update of the loops.
    """

    first: float
    step: float
    ahead: float
    doppler_hz: FloatArray
    clock_hz: float  # what the receiver's clock adds to it

    def __call__(self, sample: int) -> AidingRate:
        """Doppler at a sample, and its mean slope over the update that begins there."""
        here = (sample - self.first) / self.step
        now_hz, then_hz = self._at(here), self._at(here + self.ahead)
        return AidingRate(now_hz, (then_hz - now_hz) / AHEAD_S, self.clock_hz)

    def _at(self, place: float) -> float:
        values, last = self.doppler_hz, self.doppler_hz.size - 1
        k = min(max(int(place), 0), last - 1)
        return float(values[k] + (place - k) * (values[k + 1] - values[k]))


def motion_over(
    trajectory: Trajectory, lever_b_m: FloatArray, from_s: float, to_s: float
) -> Motion:
    """Antenna every millisecond of a stretch of the trajectory, as far as that reaches."""
    from_s = max(from_s - _BEFORE_S, float(trajectory.time_s[0]))
    to_s = min(to_s, float(trajectory.time_s[-1]))
    count = max(2, int((to_s - from_s) / STEP_S) + 1)
    time_s = np.linspace(from_s, to_s, count)
    antenna = trajectory.antenna(time_s, lever_b_m)
    return Motion(time_s, trajectory.origin, antenna.r_e_m, antenna.v_e_mps)


def range_rates(ephemerides: Sequence[Ephemeris], motion: Motion) -> FloatArray:
    """Pseudorange rate without atmosphere and receiver clock, m/s, (satellites, n).

    What the satellite does is all but linear over an epoch and is computed at its ends; what the
    antenna does is taken at every point.
    """
    ends = []
    for k in (0, -1):
        seen = orbits.predict(
            ephemerides,
            motion.origin.plus(float(motion.time_s[k])),
            motion.r_e_m[k],
            motion.v_e_mps[k],
        )
        toward = seen.sight.unit_e * seen.sight.rate_scale[:, np.newaxis]
        ends.append((seen.pseudorange_rate_mps + toward @ motion.v_e_mps[k], toward))
    (rate_0, toward_0), (rate_1, toward_1) = ends
    share = (motion.time_s - motion.time_s[0]) / (motion.time_s[-1] - motion.time_s[0])
    satellite = rate_0[:, np.newaxis] + np.outer(rate_1 - rate_0, share)
    antenna = toward_0 @ motion.v_e_mps.T + (toward_1 - toward_0) @ motion.v_e_mps.T * share
    return np.asarray(satellite - antenna)


def carrier_delay_rates(
    ephemerides: Sequence[Ephemeris],
    nav: NavData,
    parameters: PvtParameters,
    carriers_hz: FloatArray,
    time: GpsTime,
    r_e_m: FloatArray,
) -> FloatArray:
    """Rate at which the atmosphere lengthens each carrier's way, m/s, (satellites,).

    The troposphere delays the carrier as the code, the ionosphere advances it.
    """
    lengths = []
    for wait_s in (0.0, _DELAY_STEP_S):
        later = time.plus(wait_s)
        seen = orbits.predict(ephemerides, later, r_e_m, np.zeros(3))
        place = (r_e_m, seen.azimuth_rad, seen.elevation_rad, carriers_hz)
        both_m, _ = delays(nav, parameters, later, *place)
        neutral_m, _ = delays(nav, replace(parameters, ionosphere="none"), later, *place)
        lengths.append(2.0 * neutral_m - both_m)
    return np.asarray((lengths[1] - lengths[0]) / _DELAY_STEP_S)


class Aider:
    """Makes the profiles of an epoch; atmosphere rates are kept for a while."""

    def __init__(self, parameters: PvtParameters, lever_b_m: FloatArray) -> None:
        self._parameters = parameters
        self.lever_b_m = lever_b_m
        self._delay_rates: dict[str, tuple[GpsTime, float]] = {}

    def profiles(
        self,
        trajectory: Trajectory,
        span: tuple[GpsTime, GpsTime],
        listeners: Sequence[Listener],
        nav: NavData,
        clock: ReceiverClock,
        drift_sps: float,
    ) -> dict[str, Profile]:
        """Profiles by satellite over an epoch, for those whose orbit is known.

        drift_sps: of the receiver's clock, as open loop shall have it.
        """
        begin, end = (instant.since(trajectory.origin) for instant in span)
        motion = motion_over(trajectory, self.lever_b_m, begin, end)
        known = [
            (listener, ephemeris)
            for listener in listeners
            if (ephemeris := orbits.select(nav, listener.satellite, span[0])) is not None
        ]
        if not known:
            return {}
        ephemerides = [ephemeris for _, ephemeris in known]
        rates_mps = range_rates(ephemerides, motion)
        rates_mps += self._atmosphere(known, nav, span[0], motion.r_e_m[0])[:, np.newaxis]
        start_s = motion.origin.since(from_ns(clock.origin_ns)) + float(motion.time_s[0])
        step_s = float(motion.time_s[1] - motion.time_s[0])
        made = {}
        for (listener, _), one_mps in zip(known, rates_mps, strict=True):
            carrier_hz = listener.signal.carrier_hz
            made[listener.satellite] = Profile(
                first=(start_s + clock.error_s(start_s)) * listener.rate_hz,
                step=step_s * listener.rate_hz,
                ahead=AHEAD_S / step_s,
                doppler_hz=-one_mps * (carrier_hz / SPEED_OF_LIGHT_MPS),
                clock_hz=-drift_sps * carrier_hz,
            )
        return made

    def _atmosphere(
        self,
        known: Sequence[tuple[Listener, Ephemeris]],
        nav: NavData,
        time: GpsTime,
        r_e_m: FloatArray,
    ) -> FloatArray:
        fresh = [
            pair
            for pair in known
            if (kept := self._delay_rates.get(pair[0].satellite)) is None
            or time.since(kept[0]) > _DELAYS_KEPT_S
        ]
        if fresh:
            found = carrier_delay_rates(
                [ephemeris for _, ephemeris in fresh],
                nav,
                self._parameters,
                np.array([listener.signal.carrier_hz for listener, _ in fresh]),
                time,
                r_e_m,
            )
            for (listener, _), rate in zip(fresh, found, strict=True):
                self._delay_rates[listener.satellite] = (time, float(rate))
        return np.array([self._delay_rates[listener.satellite][1] for listener, _ in known])
