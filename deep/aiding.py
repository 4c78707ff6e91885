"""Aiding: what the navigation knows of each satellite's carrier over an epoch, T(4.1–4.6).

The Doppler of a satellite follows from its orbit and clock, the antenna's velocity by the inertial
navigation with its lever arm and rotation, and the rates of the atmosphere. Only its changes enter
a closed loop, which follows the receiver's clock by itself; in open loop the clock's frequency
comes with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import Ephemeris, FloatArray, NavData, SignalId
from deepgnss.core.time import GpsTime
from deepgnss.ins.trajectory import Trajectory
from deepgnss.receiver import orbits
from deepgnss.receiver.clock import ReceiverClock, from_ns
from deepgnss.receiver.leading import Grid, Profile
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.weights import delays

STEP_S = 1e-3  # between the points of a profile
AHEAD_S = 0.02  # over which a command is taken as linear: an update of the loops
_BEFORE_S = 0.04  # updates that straddle the epoch's start
_DELAYS_KEPT_S = 5.0  # over which the atmosphere's rate is taken, and for how long it is used


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


def motion_over(
    trajectory: Trajectory, lever_b_m: FloatArray, from_s: float, to_s: float
) -> Motion:
    """Antenna every millisecond of a stretch of the trajectory, as far as that reaches."""
    from_s = max(from_s - _BEFORE_S, float(trajectory.time_s[0]))
    to_s = min(to_s, float(trajectory.time_s[-1]))
    count = max(2, int((to_s - from_s) / STEP_S) + 1)
    time_s = np.linspace(from_s, to_s, count)
    return Motion(time_s, trajectory.origin, trajectory.antenna_place(time_s, lever_b_m))


class Sights(NamedTuple):
    """Satellites as a resting antenna sees them; all but linear in time over an epoch.

    rate_mps: of the pseudorange without receiver clock; toward: what the antenna's velocity takes
    off it.
    """

    time_s: FloatArray  # (2,) since the motion's origin
    rate_mps: FloatArray  # (2, satellites)
    toward_e: FloatArray  # (2, satellites, 3)

    def at(self, time_s: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Rates (n, satellites) and directions (n, satellites, 3) at instants (n,)."""
        share = (np.atleast_1d(time_s) - self.time_s[0]) / (self.time_s[1] - self.time_s[0])
        rate, toward = (
            start + np.multiply.outer(share, end - start)
            for start, end in (self.rate_mps, self.toward_e)
        )
        return rate, toward


def sights_over(ephemerides: Sequence[Ephemeris], motion: Motion) -> Sights:
    """Satellites over a motion, without atmosphere, computed at its ends."""
    rates, towards = [], []
    for k in (0, -1):
        time = motion.origin.plus(float(motion.time_s[k]))
        rate_mps, unit_e, rate_scale = orbits.rates(ephemerides, time, motion.r_e_m[k])
        towards.append(unit_e * rate_scale[:, np.newaxis])
        rates.append(rate_mps)
    return Sights(motion.time_s[[0, -1]], np.array(rates), np.array(towards))


def range_changes(sights: Sights, motion: Motion) -> FloatArray:
    """Pseudoranges without receiver clock, less those at the first point: (satellites, n), m.

    What the antenna does is taken between all points.
    """
    return _range_changes(*sights, motion.time_s, motion.r_e_m)


@brief_kernel
def _range_changes(
    ends_s: FloatArray,
    rate_mps: FloatArray,
    toward_e: FloatArray,
    time_s: FloatArray,
    r_e_m: FloatArray,
) -> FloatArray:
    satellites, points = rate_mps.shape[1], time_s.size
    changes_m = np.zeros((satellites, points))
    step_s = (time_s[-1] - time_s[0]) / (points - 1)
    shares = (0.5 * (time_s[:-1] + time_s[1:]) - ends_s[0]) / (ends_s[1] - ends_s[0])
    moved_e_m = r_e_m[1:] - r_e_m[:-1]
    for s in range(satellites):
        rate, faster = rate_mps[0, s], rate_mps[1, s] - rate_mps[0, s]
        toward, turned = toward_e[0, s], toward_e[1, s] - toward_e[0, s]
        for k in range(points - 1):
            share, moved = shares[k], moved_e_m[k]
            along_m = (
                (toward[0] + share * turned[0]) * moved[0]
                + (toward[1] + share * turned[1]) * moved[1]
                + (toward[2] + share * turned[2]) * moved[2]
            )
            changes_m[s, k + 1] = changes_m[s, k] + (rate + share * faster) * step_s - along_m
    return changes_m


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
    for wait_s in (0.0, _DELAYS_KEPT_S):
        later = time.plus(wait_s)
        seen = orbits.predict(ephemerides, later, r_e_m, np.zeros(3))
        place = (r_e_m, seen.azimuth_rad, seen.elevation_rad, carriers_hz)
        both_m, _ = delays(nav, parameters, later, *place)
        neutral_m, _ = delays(nav, replace(parameters, ionosphere="none"), later, *place)
        lengths.append(2.0 * neutral_m - both_m)
    return np.asarray((lengths[1] - lengths[0]) / _DELAYS_KEPT_S)


class Skyline(NamedTuple):
    """What the profiles of an epoch were made from."""

    row: Mapping[str, int]  # by satellite
    sights: Sights  # atmosphere included
    delay_rate_mps: FloatArray  # the atmosphere's share


_NO_ERROR: Final = np.zeros(3)
NO_SKYLINE = Skyline({}, Sights(np.zeros(2), np.zeros((2, 0)), np.zeros((2, 0, 3))), np.zeros(0))


class Aider:
    """Makes the profiles of an epoch; atmosphere rates are kept for a while."""

    def __init__(self, parameters: PvtParameters, lever_b_m: FloatArray) -> None:
        self._parameters = parameters
        self.lever_b_m = lever_b_m
        self.skyline = NO_SKYLINE  # of the last epoch
        self._delay_rates: dict[str, tuple[GpsTime, float]] = {}

    def profiles(
        self,
        trajectory: Trajectory,
        span: tuple[GpsTime, GpsTime],
        listeners: Sequence[Listener],
        nav: NavData,
        clock: ReceiverClock,
        drift_sps: float,
        velocity_error_e_mps: FloatArray = _NO_ERROR,
    ) -> dict[str, Profile]:
        """Profiles by satellite over an epoch, for those whose orbit is known.

        For open loop alone: drift of the receiver's clock, s/s, and what carrier phases say of the
        trajectory's velocity, estimate − truth.
        """
        self.skyline = NO_SKYLINE
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
        delay_rates_mps = self._atmosphere(known, nav, span[0], motion.r_e_m[0])
        sights = sights_over(ephemerides, motion)
        sights = sights._replace(rate_mps=sights.rate_mps + delay_rates_mps)
        changes_m = range_changes(sights, motion)
        self.skyline = Skyline(
            {listener.satellite: row for row, (listener, _) in enumerate(known)},
            sights,
            delay_rates_mps,
        )
        start_s = motion.origin.since(from_ns(clock.origin_ns)) + float(motion.time_s[0])
        start_s += clock.error_s(start_s)
        step_s = float(motion.time_s[1] - motion.time_s[0])
        grids = {
            rate_hz: Grid(start_s * rate_hz, step_s * rate_hz, AHEAD_S / step_s, AHEAD_S)
            for rate_hz in {listener.rate_hz for listener, _ in known}
        }
        carriers_hz = np.array([listener.signal.carrier_hz for listener, _ in known])
        wavelengths_m = SPEED_OF_LIGHT_MPS / carriers_hz
        cycles = changes_m * (-1.0 / wavelengths_m)[:, np.newaxis]
        slower_mps = sights.toward_e[0] @ velocity_error_e_mps
        clocks_hz = -drift_sps * carriers_hz - slower_mps / wavelengths_m
        return {
            listener.satellite: Profile(grids[listener.rate_hz], one, clock_hz)
            for (listener, _), one, clock_hz in zip(known, cycles, clocks_hz.tolist(), strict=True)
        }

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
