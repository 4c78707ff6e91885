"""Orbits, atmosphere, trajectories and messages of the simulator against independent ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.constants import EARTH_RATE_RADPS, SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import ecef
from deepgnss.core.records import Ephemeris, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.receiver.atmosphere import klobuchar_delay, saastamoinen_delay
from deepgnss.receiver.lnav import IonoUtc, collect, decode_subframe, encode_subframe, start
from deepgnss.receiver.orbits import predict, satellite_states
from deepgnss.sim.atmosphere import ionosphere_m, troposphere_m
from deepgnss.sim.constellation import KLOBUCHAR, nominal_gps
from deepgnss.sim.delays import hermite_cubics
from deepgnss.sim.motion.paths import Static
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of, travel
from deepgnss.sim.sky import elevations

START = GpsTime(2290, 382_256.25)
PLACE = (0.91, 0.18, 120.0)


def _sets(begin: GpsTime = START) -> list[Ephemeris]:
    return [sets[0] for sets in nominal_gps(begin, 60.0).ephemerides.values()]


def test_travel_agrees_with_the_receivers_prediction() -> None:
    r_e_m = ecef(*PLACE)
    for ephemeris in _sets():
        path = travel(orbit_of(ephemeris, START), np.array([37.5]), r_e_m[None])
        expected = predict([ephemeris], START.plus(37.5), r_e_m, np.zeros(3))
        pseudorange_m = path.range_m[0] - SPEED_OF_LIGHT_MPS * path.satellite_clock_s[0]
        assert path.range_m[0] == pytest.approx(expected.sight.range_m[0], abs=1e-5)
        assert pseudorange_m == pytest.approx(expected.pseudorange_m[0], abs=1e-5)


def test_light_time_holds_in_the_inertial_frame() -> None:
    """Both ends turned into the inertial frame of t = 0: their distance is c times the travel."""
    t_s = np.linspace(0.0, 50.0, 7)
    r_e_m = np.tile(ecef(*PLACE), (7, 1))

    def inertial(r: FloatArray, at_s: FloatArray) -> FloatArray:
        cos, sin = np.cos(EARTH_RATE_RADPS * at_s), np.sin(EARTH_RATE_RADPS * at_s)
        x, y, z = r.T
        return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])

    for ephemeris in _sets()[:6]:
        path = travel(orbit_of(ephemeris, START), t_s, r_e_m)
        sent_s = t_s - path.range_m / SPEED_OF_LIGHT_MPS
        satellites = satellite_states([ephemeris], START, sent_s[:, None]).r_e_m[:, 0]
        apart_m = np.linalg.norm(inertial(satellites, sent_s) - inertial(r_e_m, t_s), axis=1)
        np.testing.assert_allclose(apart_m, path.range_m, atol=1e-5, rtol=0.0)


def test_ranges_change_smoothly() -> None:
    """No step above rounding from millisecond to millisecond: third differences vanish."""
    t_s = 10.0 + np.arange(400) * 1.0e-3
    path = travel(orbit_of(_sets()[0], START), t_s, np.tile(ecef(*PLACE), (400, 1)))
    assert np.abs(np.diff(path.range_m, 3)).max() < 5.0e-7
    assert np.abs(np.diff(path.satellite_clock_s, 2)).max() * SPEED_OF_LIGHT_MPS < 1.0e-9


def test_atmosphere_agrees_with_the_receivers() -> None:
    elevation = np.radians([10.0, 20.0, 45.0, 80.0])
    azimuth = np.radians([0.0, 100.0, 190.0, 300.0])
    same = np.ones(4)
    for tow_s in (0.0, 20_000.0, 50_400.0, 300_000.0):
        ours = ionosphere_m(
            KLOBUCHAR, 0.9 * same, 0.2 * same, azimuth, elevation, tow_s * same, 1575.42e6
        )
        theirs = klobuchar_delay(KLOBUCHAR, 0.9, 0.2, azimuth, elevation, tow_s)
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    for height_m in (0.0, 1500.0):
        ours = troposphere_m(0.9 * same, height_m * same, elevation)
        theirs = saastamoinen_delay(0.9, height_m, elevation)
        # Their mappings differ: Saastamoinen's tan² z here, Black and Eisner's there.
        np.testing.assert_allclose(ours, theirs, rtol=0.012)
        assert ours[3] == pytest.approx(theirs[3], abs=0.02)
    assert troposphere_m(np.array([0.8]), np.zeros(1), np.array([np.pi / 2]))[0] == pytest.approx(
        2.4, abs=0.05
    )


# --- constellation -------------------------------------------------------------------------------


def test_broadcast_gives_back_the_true_orbit_to_the_last_bit() -> None:
    nav = nominal_gps(START, 60.0)
    frame = GpsTime(2290, 382_260.0)
    assert nav.utc is not None
    for satellite, (ephemeris,) in nav.ephemerides.items():
        state = start(satellite)
        for number in (1, 2, 3):
            bits = encode_subframe(frame.plus(6.0 * (number - 1)), number, ephemeris)
            subframe = decode_subframe(bits)
            assert subframe is not None
            state, _ = collect(state, subframe)
        assert state.ephemeris is not None
        for name in Ephemeris.__dataclass_fields__:
            if name != "transmitted":
                assert getattr(state.ephemeris, name) == getattr(ephemeris, name), name
    message = IonoUtc(nav.klobuchar["G"], nav.utc)
    bits = encode_subframe(frame.plus(18.0), 4, ephemeris, message, page=18)
    subframe = decode_subframe(bits)
    assert subframe is not None
    assert collect(start("G01"), subframe, near=START)[1] == (message,)


@pytest.mark.parametrize("week", [2290, 2189])
def test_successive_sets_describe_one_orbit(week: int) -> None:
    """At the change of sets, also over the end of a week, orbits agree within message rounding."""
    end_of_week = GpsTime(week, 603_000.0)
    nav = nominal_gps(end_of_week, 7200.0)
    for old, new in nav.ephemerides.values():
        states = satellite_states([old, new], end_of_week, np.full(2, 1800.0))
        assert np.linalg.norm(np.diff(states.r_e_m, axis=0)) < 3.0
        assert new.toe.since(old.toe) == 7200.0
        assert old.iode != new.iode
        assert np.ptp(states.clock_s) * SPEED_OF_LIGHT_MPS < 1.0


def test_enough_satellites_everywhere() -> None:
    for latitude in (-80.0, -35.0, 0.0, 35.0, 52.0, 80.0):
        for longitude in (-120.0, 0.0, 90.0):
            place = Vehicle(np.radians(latitude), np.radians(longitude), 0.0, Static())
            seen = elevations(nominal_gps(START, 60.0), START, place)
            assert sum(angle > np.radians(5.0) for angle in seen.values()) >= 6
    assert len(seen) == 30


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=4))
def test_cubics_reproduce_cubics_and_join(coefficients: list[float]) -> None:
    polynomial = np.polynomial.Polynomial(coefficients)
    nodes = polynomial(np.arange(9.0))[None]
    cubics = hermite_cubics(nodes)[0]
    assert cubics.shape == (4, 4)
    for k, cubic in enumerate(cubics):
        for u in (0.0, 0.3, 1.0):
            value = np.polynomial.polynomial.polyval(u, cubic)
            assert value == pytest.approx(polynomial(k + 2 + u), abs=1e-9, rel=1e-12)
