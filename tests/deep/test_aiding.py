"""What aiding says of a satellite, against pseudoranges predicted at instants close together."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import ecef
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Ephemeris, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.deep.aiding import AHEAD_S, Motion, Profile, carrier_delay_rates, range_rates
from deepgnss.deep.coupled import ClockMemory
from deepgnss.receiver import orbits
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.weights import delays
from deepgnss.sim.constellation import nominal

START = GpsTime(2290, 382_300.0)
NAV = nominal(START, 60.0, "GC")
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
    return Motion(t, START, PLACE_E_M + r, v0 + np.outer(t, a) + np.outer(t**2, j / 2))


def _pseudorange_m(ephemerides: list[Ephemeris], time_s: float, r_e_m: FloatArray) -> FloatArray:
    return orbits.predict(ephemerides, START.plus(time_s), r_e_m, np.zeros(3)).pseudorange_m


def test_range_rates_are_the_slope_of_the_pseudorange() -> None:
    ephemerides, motion = _in_view(), _motion()
    assert {e.satellite[0] for e in ephemerides} == {"G", "C"}
    rates = range_rates(ephemerides, motion)
    for k in (1, 17, 50, 99):
        later, earlier = (
            _pseudorange_m(ephemerides, float(motion.time_s[i]), motion.r_e_m[i])
            for i in (k + 1, k - 1)
        )
        slope = (later - earlier) / (motion.time_s[k + 1] - motion.time_s[k - 1])
        assert np.abs(rates[:, k] - slope).max() < 3e-4  # 1.5 mHz


def test_the_ionosphere_advances_the_carrier_and_the_troposphere_delays_it() -> None:
    ephemerides = _in_view()
    carriers_hz = np.array(
        [(GPS_L1CA if e.satellite[0] == "G" else BDS_B1I).carrier_hz for e in ephemerides]
    )
    rates = carrier_delay_rates(ephemerides, NAV, PvtParameters(), carriers_hz, START, PLACE_E_M)
    lengths = []
    for wait_s in (0.0, 10.0):
        time = START.plus(wait_s)
        seen = orbits.predict(ephemerides, time, PLACE_E_M, np.zeros(3))
        place = (PLACE_E_M, seen.azimuth_rad, seen.elevation_rad, carriers_hz)
        neutral, _ = delays(NAV, PvtParameters(ionosphere="none"), time, *place)
        charged, _ = delays(NAV, PvtParameters(troposphere="none"), time, *place)
        lengths.append(neutral - charged)
    np.testing.assert_allclose(rates, (lengths[1] - lengths[0]) / 10.0, atol=1e-9)
    assert 1e-4 < np.abs(rates).max() < 0.05  # a satellite at 10°: a cycle in some 20 s


@pytest.mark.parametrize("beyond", [False, True])
def test_a_profile_gives_the_mean_slope_of_the_update_ahead(beyond: bool) -> None:
    rate_hz = 4.0e6
    t = np.arange(131) * 1e-3
    doppler_hz = 100.0 + 50.0 * t if beyond else 100.0 + 50.0 * t + 900.0 * t**2
    profile = Profile(8000.5, 4000.0, AHEAD_S / 1e-3, doppler_hz, -3.0)
    at_s = 0.125 if beyond else 0.05
    given = profile(round(8000.5 + at_s * rate_hz))
    expected = [np.interp(at_s + d, t, doppler_hz) for d in (0.0, AHEAD_S)]
    if beyond:  # carried on along its last slope
        expected[1] = 100.0 + 50.0 * (at_s + AHEAD_S)
    assert given.frequency_hz == pytest.approx(expected[0], abs=1e-3)
    assert given.rate_hzps == pytest.approx((expected[1] - expected[0]) / AHEAD_S, abs=0.05)
    assert given.clock_hz == -3.0


def test_doppler_is_positive_when_range_shrinks() -> None:
    """The sign the channels expect: one wavelength per second nearer is +1 Hz."""
    ephemerides = _in_view()[:1]
    toward = orbits.predict(ephemerides, START, PLACE_E_M, np.zeros(3)).sight.unit_e[0]
    wavelength_m = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
    t = np.array([0.0, 0.05, 0.1])
    still = Motion(t, START, np.tile(PLACE_E_M, (3, 1)), np.zeros((3, 3)))
    nearer = still._replace(v_e_mps=np.tile(toward * wavelength_m, (3, 1)))
    gained_hz = -(range_rates(ephemerides, nearer) - range_rates(ephemerides, still)) / wavelength_m
    np.testing.assert_allclose(gained_hz, 1.0, atol=1e-4)


def test_clock_memory_is_a_mean_that_forgets_and_ignores_gaps() -> None:
    memory = ClockMemory()
    memory.take(START, float("nan"))
    assert not np.isfinite(memory.drift_sps)
    memory.take(START, 1.0e-7)
    assert memory.drift_sps == 1.0e-7
    for k in range(1, 100):
        memory.take(START.plus(0.1 * k), 2.0e-7)
    assert memory.drift_sps == pytest.approx(2.0e-7, rel=0.03)
    before = memory.drift_sps
    memory.take(START.plus(20.0), float("nan"))
    assert memory.drift_sps == before
