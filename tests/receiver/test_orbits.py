"""Orbits and lines of sight: against differences, an inertial twin, and a simulator of others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_sky import WHEN, sky

from deepgnss.core import frames
from deepgnss.core.constants import EARTH_RATE_RADPS, GM_GPS_M3PS2
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.records import Ephemeris, FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver import orbits
from deepgnss.receiver.atmosphere import klobuchar_delay

NAV = sky()
ALL = [sets[0] for sets in NAV.ephemerides.values()]
HERE_E_M = frames.ecef(0.53, 1.99, 40.0)
quiet = settings(deadline=None, derandomize=True, max_examples=30)


def position_twin(e: Ephemeris, tk_s: float) -> FloatArray:
    """IS-GPS-200 table 20-IV, one satellite, one line per equation."""
    n = np.sqrt(GM_GPS_M3PS2 / e.sqrt_a_rm**6) + e.delta_n_radps
    M = E = e.m0_rad + n * tk_s
    for _ in range(50):
        E = M + e.eccentricity * np.sin(E)
    nu = 2 * np.arctan(np.sqrt((1 + e.eccentricity) / (1 - e.eccentricity)) * np.tan(E / 2))
    phi = nu + e.omega_rad
    u = phi + e.cus_rad * np.sin(2 * phi) + e.cuc_rad * np.cos(2 * phi)
    r = e.sqrt_a_rm**2 * (1 - e.eccentricity * np.cos(E))
    r += e.crs_m * np.sin(2 * phi) + e.crc_m * np.cos(2 * phi)
    i = e.i0_rad + e.idot_radps * tk_s
    i += e.cis_rad * np.sin(2 * phi) + e.cic_rad * np.cos(2 * phi)
    node = e.omega0_rad + (e.omega_dot_radps - EARTH_RATE_RADPS) * tk_s
    node -= EARTH_RATE_RADPS * e.toe.tow_s
    x, y = r * np.cos(u), r * np.sin(u)
    return np.array(
        [
            x * np.cos(node) - y * np.cos(i) * np.sin(node),
            x * np.sin(node) + y * np.cos(i) * np.cos(node),
            y * np.sin(i),
        ]
    )


@quiet
@given(st.floats(-7200.0, 7200.0))
def test_position_against_the_table_written_out(tk_s: float) -> None:
    got = orbits.satellite_states(ALL, ALL[0].toe.plus(tk_s), np.zeros(len(ALL)))
    wanted = np.array([position_twin(e, tk_s) for e in ALL])
    assert np.abs(got.r_e_m - wanted).max() < 1e-5


def test_velocity_and_clock_rate_are_derivatives() -> None:
    grid_s = np.arange(-7200.0, 7201.0, 300.0)[:, np.newaxis]
    states = orbits.satellite_states(ALL, ALL[0].toe, grid_s + np.zeros(len(ALL)))
    h_s = 0.5
    before, after = (
        orbits.satellite_states(ALL, ALL[0].toe, grid_s + np.full(len(ALL), sign * h_s))
        for sign in (-1, 1)
    )
    difference_mps = (after.r_e_m - before.r_e_m) / (2 * h_s)
    assert states.r_e_m.shape == (49, 30, 3)
    assert np.abs(difference_mps - states.v_e_mps).max() < 1e-4
    clock_rate = (after.clock_s - before.clock_s) / (2 * h_s)
    assert np.abs(clock_rate - states.drift_sps).max() < 1e-16


def test_relativity_has_the_size_and_sign_of_the_specification() -> None:
    """−2 r·v/c² of the inertial Kepler orbit (IS-GPS-200 20.3.3.3.3.1)."""
    plain = {"crc_m": 0.0, "crs_m": 0.0, "cuc_rad": 0.0, "cus_rad": 0.0, "delta_n_radps": 0.0}
    kepler = [replace(e, **plain) for e in ALL]
    states = orbits.satellite_states(kepler, WHEN, np.zeros(len(ALL)))
    v_i = states.v_e_mps + np.cross([0.0, 0.0, EARTH_RATE_RADPS], states.r_e_m)
    wanted_s = -2.0 * np.einsum("ij,ij->i", states.r_e_m, v_i) / C**2
    polynomial_s = [e.af0_s + e.af1_sps * WHEN.since(e.toc) for e in ALL]
    assert np.abs(states.clock_s - polynomial_s - wanted_s).max() < 1e-14
    assert np.abs(wanted_s).max() > 2e-8


def test_transmission_by_the_satellite_clock() -> None:
    reading_s = np.linspace(-0.09, -0.06, len(ALL))
    got = orbits.transmitted_states(ALL, WHEN, reading_s)
    direct = orbits.satellite_states(ALL, WHEN, reading_s - got.clock_s)
    assert np.abs(got.r_e_m - direct.r_e_m).max() < 1e-3  # relativity is left out of the instant


def test_range_against_an_inertial_twin() -> None:
    """Signals go straight in the inertial frame that coincides with ECEF at reception."""
    got = orbits.predict(ALL, WHEN, HERE_E_M, np.zeros(3))
    for k, e in enumerate(ALL):
        travel_s = 0.07
        for _ in range(10):
            at = position_twin(e, WHEN.since(e.toe) - travel_s)
            turn = -EARTH_RATE_RADPS * travel_s  # the ECEF axes of then, seen from now
            x = at[0] * np.cos(turn) - at[1] * np.sin(turn)
            y = at[0] * np.sin(turn) + at[1] * np.cos(turn)
            range_m = float(np.linalg.norm(np.array([x, y, at[2]]) - HERE_E_M))
            travel_s = range_m / C
        assert got.sight.range_m[k] == pytest.approx(range_m, abs=1e-5)


def test_sagnac_makes_eastern_satellites_nearer() -> None:
    """The earth carries the receiver eastwards while the signal travels."""
    states = orbits.satellite_states(ALL, WHEN, np.zeros(len(ALL)))
    sight = orbits.line_of_sight(HERE_E_M, np.zeros(3), states)
    plain_m = np.linalg.norm(states.r_e_m - HERE_E_M, axis=1)
    azimuth, _ = orbits.directions(HERE_E_M, sight)
    correction_m = sight.range_m - plain_m
    first_order_m = (
        EARTH_RATE_RADPS / C * (states.r_e_m[:, 0] * HERE_E_M[1] - states.r_e_m[:, 1] * HERE_E_M[0])
    )
    assert np.abs(correction_m - first_order_m).max() < 1e-3
    assert np.array_equal(correction_m < 0.0, np.sin(azimuth) > 0.0)
    assert np.abs(correction_m).max() > 20.0


@quiet
@given(st.integers(0, 10**6))
def test_range_rate_is_the_derivative_of_range_along_the_path(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v_e_mps = rng.normal(0.0, 200.0, 3)
    h_s = 0.5
    rate = orbits.predict(ALL, WHEN, HERE_E_M, v_e_mps)
    before, after = (
        orbits.predict(ALL, WHEN.plus(s * h_s), HERE_E_M + s * h_s * v_e_mps, v_e_mps)
        for s in (-1, 1)
    )
    assert (
        np.abs(
            (after.sight.range_m - before.sight.range_m) / (2 * h_s) - rate.sight.range_rate_mps
        ).max()
        < 1e-5
    )
    assert (
        np.abs(
            (after.pseudorange_m - before.pseudorange_m) / (2 * h_s) - rate.pseudorange_rate_mps
        ).max()
        < 1e-5
    )
    faster = orbits.predict(ALL, WHEN, HERE_E_M, v_e_mps + [1.0, 0.0, 0.0])
    slope = faster.sight.range_rate_mps - rate.sight.range_rate_mps
    assert slope == pytest.approx(-rate.sight.unit_e[:, 0] * rate.sight.rate_scale, abs=1e-7)


def test_group_delay_makes_the_pseudorange_longer() -> None:
    """A single-frequency user's satellite clock is Δt_sv − TGD (IS-GPS-200 20.3.3.3.3.2)."""
    later = [replace(e, group_delay_s=e.group_delay_s + 1e-8) for e in ALL]
    plain = orbits.predict(ALL, WHEN, HERE_E_M, np.zeros(3)).pseudorange_m
    assert orbits.predict(later, WHEN, HERE_E_M, np.zeros(3)).pseudorange_m - plain == (
        pytest.approx(C * 1e-8, abs=1e-6)
    )


def test_choice_of_ephemeris() -> None:
    e = ALL[0]
    next_one = replace(e, toe=e.toe.plus(7200.0), iode=99)
    resent = replace(e, transmitted=e.transmitted.plus(600.0), iode=98)
    nav = NavData({e.satellite: (resent, e, next_one)})
    assert orbits.select(nav, e.satellite, e.toe.plus(3500.0)) == resent
    assert orbits.select(nav, e.satellite, e.toe.plus(3700.0)) == next_one
    assert orbits.select(nav, e.satellite, e.toe.plus(7200.0 + 14_500.0)) is None
    assert orbits.select(nav, "G99", e.toe) is None


def test_directions_are_unknown_at_the_geocentre() -> None:
    sight = orbits.line_of_sight(
        np.zeros(3), np.zeros(3), orbits.satellite_states(ALL, WHEN, np.zeros(len(ALL)))
    )
    azimuth, elevation = orbits.directions(np.zeros(3), sight)
    assert np.isnan(azimuth).all()
    assert np.isnan(elevation).all()


def test_against_the_ranges_of_another_simulator(shared_data: Path) -> None:
    """Geometry, satellite clock with group delay, ionosphere and angles of drive/ranges.csv.

    The 1–2 mm left are the simulator's own: it moves the satellite back along a straight line by
    the travel time, which misses a·τ²/2.
    """
    folder = shared_data / "independent/drive"
    nav = read_nav(folder / "brdc0010.22n")
    truth = pd.read_csv(folder / "truth.csv")
    truth.index = pd.Index(np.round(truth.gps_tow_s * 100).astype(int))
    table = pd.read_csv(folder / "ranges.csv")
    checked = 0
    for tow_s, rows in table.groupby("tow"):
        tick = round(float(tow_s) * 100)
        if tick % 1000:
            continue
        at = truth.loc[tick]
        lat, lon = np.radians(at.lat_deg), np.radians(at.lon_deg)
        time = GpsTime(2190, tick / 100)
        chosen = [orbits.select(nav, f"G{prn:02d}", time) for prn in rows.prn]
        known = [e for e in chosen if e is not None]
        assert len(known) == len(rows) >= 13
        r_e_m = frames.ecef(lat, lon, at.height_m)
        got = orbits.predict(known, time, r_e_m, np.zeros(3))
        assert np.abs(got.sight.range_m - rows.geom_range_m).max() < 3e-3
        assert np.abs(got.pseudorange_m + rows.iono_m - rows.pseudorange_m).max() < 3e-3
        assert np.abs(np.degrees(got.azimuth_rad) - rows.az_deg).max() < 1e-5
        assert np.abs(np.degrees(got.elevation_rad) - rows.el_deg).max() < 1e-5
        delay_m = klobuchar_delay(
            nav.klobuchar["G"], lat, lon, got.azimuth_rad, got.elevation_rad, time.tow_s
        )
        assert np.abs(delay_m - rows.iono_m).max() < 1e-3
        checked += 1
    assert checked == 6
