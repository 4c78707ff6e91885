"""What aiding says of a satellite, against pseudoranges predicted at instants close together."""

from __future__ import annotations

from fractions import Fraction
from typing import cast

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import ecef
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Ephemeris, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.aiding import (
    AHEAD_S,
    Aider,
    Listener,
    Motion,
    Profile,
    carrier_delay_rates,
    range_changes,
    sights_over,
)
from deepgnss.ins.trajectory import Trajectory
from deepgnss.receiver import orbits
from deepgnss.receiver.clock import ReceiverClock, to_ns
from deepgnss.receiver.leading import Grid
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.weights import delays
from deepgnss.sim.constellation import nominal

START = GpsTime(2290, 382_300.0)
NAV = nominal(START, 60.0, "GC")
SIGNALS = {"G": GPS_L1CA, "C": BDS_B1I}
PLACE_E_M = ecef(0.912, 0.184, 120.0)


def _in_view() -> list[Ephemeris]:
    sets = [orbits.select(NAV, satellite, START) for satellite in sorted(NAV.ephemerides)]
    known = [one for one in sets if one is not None]
    seen = orbits.predict(known, START, PLACE_E_M, np.zeros(3))
    return [one for one, up in zip(known, seen.elevation_rad > 0.1, strict=True) if up]


def _motion() -> Motion:
    """A tenth of a second of hard braking in a bend: 30 m/s, 20 m/s² and 200 m/s³."""
    t = np.linspace(0.0, 0.1, 101)
    v0, a, j = np.array([20.0, -15.0, 16.0]), np.array([-12.0, 9.0, 13.0]), np.full(3, 115.0)
    r = np.outer(t, v0) + np.outer(t**2, a / 2) + np.outer(t**3, j / 6)
    return Motion(t, START, PLACE_E_M + r)


def _pseudorange_m(ephemerides: list[Ephemeris], time_s: float, r_e_m: FloatArray) -> FloatArray:
    return orbits.predict(ephemerides, START.plus(time_s), r_e_m, np.zeros(3)).pseudorange_m


def test_ranges_change_as_the_pseudorange_does() -> None:
    ephemerides, motion = _in_view(), _motion()
    assert {e.satellite[0] for e in ephemerides} == {"G", "C"}
    changes_m = range_changes(sights_over(ephemerides, motion), motion)
    rates = np.diff(changes_m) / np.diff(motion.time_s)
    for k in (0, 17, 50, 99):
        later, earlier = (
            _pseudorange_m(ephemerides, float(motion.time_s[i]), motion.r_e_m[i])
            for i in (k + 1, k)
        )
        slope = (later - earlier) / (motion.time_s[k + 1] - motion.time_s[k])
        assert np.abs(rates[:, k] - slope).max() < 3e-4  # 1.5 mHz


def test_the_ionosphere_advances_the_carrier_and_the_troposphere_delays_it() -> None:
    ephemerides = _in_view()
    carriers_hz = np.array(
        [(GPS_L1CA if e.satellite[0] == "G" else BDS_B1I).carrier_hz for e in ephemerides]
    )
    rates = carrier_delay_rates(ephemerides, NAV, PvtParameters(), carriers_hz, START, PLACE_E_M)
    lengths = []
    for wait_s in (0.0, 5.0):  # for which the rate is used
        time = START.plus(wait_s)
        seen = orbits.predict(ephemerides, time, PLACE_E_M, np.zeros(3))
        place = (PLACE_E_M, seen.azimuth_rad, seen.elevation_rad, carriers_hz)
        neutral, _ = delays(NAV, PvtParameters(ionosphere="none"), time, *place)
        charged, _ = delays(NAV, PvtParameters(troposphere="none"), time, *place)
        lengths.append(neutral - charged)
    np.testing.assert_allclose(rates, (lengths[1] - lengths[0]) / 5.0, atol=1e-9)
    assert 1e-4 < np.abs(rates).max() < 0.05  # a satellite at 10°: a cycle in some 20 s


@pytest.mark.parametrize("shaken", [False, True])
def test_a_command_makes_the_cycles_of_both_halves_of_its_update(shaken: bool) -> None:
    """Also where 45 Hz shake the unit, whose values at the ends of updates would fold down."""
    rate_hz, step_s = 4.0e6, 1e-3
    t = np.arange(131) * step_s
    cycles = 100.0 * t + 25.0 * t**2 + 300.0 * t**3
    if shaken:
        cycles += 0.03 * np.sin(2.0 * np.pi * 45.0 * t)
    profile = Profile(Grid(8000.5, step_s * rate_hz, AHEAD_S / step_s, AHEAD_S), cycles, -3.0)
    for k in (0, 37, 110):
        given = profile(round(8000.5 + t[k] * rate_hz))
        for share in (0.5, 1.0):
            wait_s = share * AHEAD_S
            moved = given.frequency_hz * wait_s + 0.5 * given.rate_hzps * wait_s**2
            true = cycles[k + round(wait_s / step_s)] - cycles[k]
            assert moved == pytest.approx(true, abs=1e-5)
        assert given.clock_hz == -3.0


def test_a_profile_goes_on_beyond_its_end_with_its_last_doppler() -> None:
    t = np.arange(131) * 1e-3
    given = Profile(Grid(0.0, 4000.0, 20.0, AHEAD_S), 100.0 * t + 25.0 * t**2, 0.0)(
        round(0.2 * 4.0e6)
    )
    assert given.frequency_hz == pytest.approx(106.5, abs=0.1)
    assert given.rate_hzps == pytest.approx(0.0, abs=1e-3)


def test_doppler_is_positive_when_range_shrinks() -> None:
    """The sign the channels expect: one wavelength per second nearer is +1 Hz."""
    ephemerides = _in_view()[:1]
    toward = orbits.predict(ephemerides, START, PLACE_E_M, np.zeros(3)).sight.unit_e[0]
    wavelength_m = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
    t = np.array([0.0, 0.05, 0.1])
    still = Motion(t, START, np.tile(PLACE_E_M, (3, 1)))
    nearer = still._replace(r_e_m=PLACE_E_M + np.outer(t, toward * wavelength_m))
    sights = sights_over(ephemerides, still)
    changes_m = range_changes(sights, nearer) - range_changes(sights, still)
    gained_hz = -np.diff(changes_m) / np.diff(still.time_s) / wavelength_m
    np.testing.assert_allclose(gained_hz, 1.0, atol=1e-4)


class _Straight:
    """A trajectory from the place at a constant velocity."""

    origin = START
    time_s = np.linspace(-0.1, 0.3, 41)

    def __init__(self, v_e_mps: FloatArray) -> None:
        self._v_e_mps = v_e_mps

    def antenna_place(self, time_s: FloatArray, _lever_b_m: FloatArray) -> FloatArray:
        return np.asarray(PLACE_E_M + np.outer(time_s, self._v_e_mps))


def test_open_loop_is_led_by_the_velocity_that_phases_have_put_right() -> None:
    """A navigation too fast by an error that is known, against one that is right."""
    right_e_mps, error_e_mps = np.array([3.0, -7.0, 2.0]), np.array([0.4, 0.3, -0.5])
    listeners = [Listener(e.satellite, SIGNALS[e.satellite[0]], 4e6) for e in _in_view()]
    clock = ReceiverClock(Fraction(4_000_000), to_ns(START))
    span = (START, START.plus(0.1))

    def led_hz(v_e_mps: FloatArray, *error: FloatArray) -> FloatArray:
        aider = Aider(PvtParameters(), np.zeros(3))
        way = cast(Trajectory, _Straight(v_e_mps))
        made = aider.profiles(way, span, listeners, NAV, clock, 2e-9, *error)
        told = [made[listener.satellite](200_000) for listener in listeners]
        return np.array([one.frequency_hz + one.clock_hz for one in told])

    right_hz = led_hz(right_e_mps)
    wrong_hz = led_hz(right_e_mps + error_e_mps)
    mended_hz = led_hz(right_e_mps + error_e_mps, error_e_mps)
    assert np.abs(wrong_hz - right_hz).max() > 1.0
    np.testing.assert_allclose(mended_hz, right_hz, atol=2e-3)
