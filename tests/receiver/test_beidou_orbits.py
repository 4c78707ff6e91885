"""BeiDou orbits, geostationary ones too, and its ionosphere: by hand, by physics, by a station."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core import frames
from deepgnss.core.records import (
    Ephemeris,
    Epoch,
    FloatArray,
    Klobuchar,
    NavData,
    Observation,
    SampleInstant,
)
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.receiver import orbits, pvt
from deepgnss.receiver.atmosphere import beidou_klobuchar_delay

GM, EARTH_RATE, C = 3.986004418e14, 7.2921150e-5, 299_792_458.0
FOLDER = "real/gnss/esbc-2020177"
MODEL = Klobuchar(
    (12 * 2.0**-30, 2 * 2.0**-27, -(2.0**-24), -(2.0**-24)),
    (47 * 2.0**11, 4 * 2.0**14, -(2.0**16), -3 * 2.0**16),
)


@pytest.fixture(scope="module")
def nav(shared_data: Path) -> NavData:
    return read_nav(shared_data / FOLDER / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz")


def rotation(axis: int, angle: float) -> FloatArray:
    """Of coordinates about an axis, R_x and R_z of the interface document."""
    c, s = np.cos(angle), np.sin(angle)
    a, b = ((1, 2), (2, 0), (0, 1))[axis]
    out = np.eye(3)
    out[a, a] = out[b, b] = c
    out[a, b], out[b, a] = s, -s
    return out


def place_twin(e: Ephemeris, tk_s: float) -> FloatArray:
    """BDS-SIS-ICD B1I table 5-11 by rotations: perifocal, inertial of toe, then earth-fixed."""
    n = np.sqrt(GM / e.sqrt_a_rm**6) + e.delta_n_radps
    mean = anomaly = e.m0_rad + n * tk_s
    for _ in range(20):
        anomaly = mean + e.eccentricity * np.sin(anomaly)
    v = 2.0 * np.arctan(
        np.sqrt((1 + e.eccentricity) / (1 - e.eccentricity)) * np.tan(0.5 * anomaly)
    )
    phi = v + e.omega_rad
    c2, s2 = np.cos(2 * phi), np.sin(2 * phi)
    u = phi + e.cus_rad * s2 + e.cuc_rad * c2
    r = e.sqrt_a_rm**2 * (1 - e.eccentricity * np.cos(anomaly)) + e.crs_m * s2 + e.crc_m * c2
    i = e.i0_rad + e.idot_radps * tk_s + e.cis_rad * s2 + e.cic_rad * c2
    sow_s = e.toe.plus(-14.0).tow_s
    node = e.omega0_rad + e.omega_dot_radps * tk_s - EARTH_RATE * sow_s
    inertial = rotation(2, -node) @ rotation(0, -i) @ rotation(2, -u) @ np.array([r, 0.0, 0.0])
    if int(e.satellite[1:]) in (1, 2, 3, 4, 5, 59, 60, 61, 62, 63):
        inertial = rotation(0, np.radians(-5.0)) @ inertial
    return rotation(2, EARTH_RATE * tk_s) @ inertial


@pytest.mark.parametrize("satellite", ["C05", "C07", "C13", "C19", "C30"])
@pytest.mark.parametrize("tk_s", [-3600.0, 0.0, 1234.5, 7200.0])
def test_position_against_the_table_by_rotations(nav: NavData, satellite: str, tk_s: float) -> None:
    e = nav.ephemerides[satellite][0]
    got = orbits.satellite_states([e], e.toe, np.array([tk_s])).r_e_m[0]
    np.testing.assert_allclose(got, place_twin(e, tk_s), rtol=0.0, atol=2e-6)


def test_velocity_is_the_derivative_for_all_kinds_at_once(nav: NavData) -> None:
    """Geostationary, inclined and medium orbits beside GPS, in any order."""
    names = ("C19", "C05", "G05", "C07")
    chosen = [nav.ephemerides[name][3] for name in names]
    at = np.full(len(chosen), 40.0)
    states = [orbits.satellite_states(chosen, chosen[0].toe, at + dt) for dt in (-0.5, 0.0, 0.5)]
    slope = states[2].r_e_m - states[0].r_e_m
    np.testing.assert_allclose(states[1].v_e_mps, slope, rtol=0.0, atol=5e-6)
    speeds = np.linalg.norm(states[1].v_e_mps, axis=1)
    assert speeds[1] < 100.0
    assert 2000.0 < speeds[0] < 4000.0


@pytest.mark.parametrize(
    ("satellite", "east_deg"),
    [
        ("C01", 144.55),
        ("C02", 83.8),
        ("C03", 110.5),
        ("C04", 160.0),
        ("C05", 58.75),
        ("C59", 140.0),
    ],
)
def test_geostationary_satellites_stay_where_they_are(
    shared_data: Path, satellite: str, east_deg: float
) -> None:
    """In April 2023: longitude, radius, and the energy of an orbit with the period of the earth."""
    nav = read_nav(shared_data / "real/nav/tarc1030.23b")
    for e in nav.ephemerides[satellite]:
        at = np.linspace(-1800.0, 3600.0, 4)
        states = orbits.satellite_states([e], e.toe, at[:, np.newaxis])
        r, v = states.r_e_m[:, 0], states.v_e_mps[:, 0]
        longitude = np.degrees(np.arctan2(r[:, 1], r[:, 0]))
        assert np.abs(longitude - east_deg).max() < 0.4
        radius = np.linalg.norm(r, axis=1)
        assert np.abs(radius - 42_164e3).max() < 100e3
        assert np.abs(np.degrees(np.arcsin(r[:, 2] / radius))).max() < 3.0
        inertial = v + np.cross([0.0, 0.0, EARTH_RATE], r)
        axis_m = 1.0 / (2.0 / radius - (inertial**2).sum(axis=1) / GM)
        assert np.abs(axis_m - 42_165e3).max() < 5e3


@pytest.mark.parametrize("satellite", ["C05", "C07", "C19"])
def test_successive_sets_agree_where_they_meet(nav: NavData, satellite: str) -> None:
    """Half way between their reference times, to what the ground segment predicts."""
    sets = nav.ephemerides[satellite]
    jumps = []
    for before, after in itertools.pairwise(sets):
        gap_s = after.toe.since(before.toe)
        if 0.0 < gap_s <= 7200.0:
            middle = before.toe.plus(0.5 * gap_s)
            ends = [
                orbits.satellite_states([e], middle, np.zeros(1)).r_e_m[0] for e in (before, after)
            ]
            jumps.append(np.linalg.norm(ends[1] - ends[0]))
    assert len(jumps) >= 4
    assert np.median(jumps) < 3.0


def test_a_station_positions_itself_by_beidou_alone(shared_data: Path, nav: NavData) -> None:
    """ESBC, every half hour of a day: metres, C05 among the satellites used throughout."""
    table = read_obs(shared_data / FOLDER / "ESBC00DNK_R_20201770000_01D_30S_MO.crx.gz", "C")
    assert table.position_e_m is not None
    lat, lon, _ = frames.geodetic(table.position_e_m)
    C_ne = frames.C_ne(lat, lon)
    errors, velocities, geo, previous = [], [], [], None
    for number, ((week, tow_s), rows) in enumerate(table.frame.groupby(["week", "tow_s"])):
        if number % 60:
            continue
        time = GpsTime(int(week), float(tow_s))
        rows = rows[np.isfinite(rows.C2I)]
        observations = tuple(
            Observation(
                s, "BDS_B1I", p, 0.0, d, cn0, 1.0,
                slip=False, half_cycle=False, carrier_valid=False, transmit=time.plus(-p / C),
            )
            for s, p, d, cn0 in zip(rows.satellite, rows.C2I, rows.D2I, rows.S2I, strict=True)
        )  # fmt: skip
        epoch = Epoch(time, SampleInstant(0, 0.0), observations)
        previous = pvt.solve(epoch, nav, pvt.PvtParameters(), previous)
        assert previous.valid, previous.reason
        errors.append(C_ne @ (previous.r_e_m - table.position_e_m))
        velocities.append(C_ne @ previous.v_e_mps)
        assert "C05" in previous.used
        geo.append(previous.residuals_m["C05"])
    north, east, down = np.sqrt((np.array(errors) ** 2).mean(axis=0))
    assert len(errors) == 48
    assert np.hypot(north, east) < 2.5
    assert down < 4.0
    assert np.sqrt((np.array(velocities) ** 2).mean(axis=0)).max() < 0.05
    assert np.sqrt(np.mean(np.square(geo))) < 4.0


# --- ionosphere ----------------------------------------------------------------------------------


def beidou_twin(lat: float, lon: float, az: float, el: float, bdt_s: float) -> float:
    """BDS-SIS-ICD B1I 5.2.4.7 in the order of the text, seconds at B1I."""
    R, h = 6378.0, 375.0
    psi = np.pi / 2 - el - np.arcsin(R / (R + h) * np.cos(el))
    phi = np.arcsin(np.sin(lat) * np.cos(psi) + np.cos(lat) * np.sin(psi) * np.cos(az))
    lam = lon + np.arcsin(np.sin(psi) * np.sin(az) / np.cos(phi))
    t = (bdt_s + lam * 43_200 / np.pi) % 86_400
    A2 = max(sum(a * abs(phi / np.pi) ** n for n, a in enumerate(MODEL.alpha)), 0.0)
    A4 = sum(b * abs(phi / np.pi) ** n for n, b in enumerate(MODEL.beta))
    A4 = min(max(A4, 72_000.0), 172_800.0)
    vertical = 5e-9
    if abs(t - 50_400) < A4 / 4:
        vertical += A2 * np.cos(2 * np.pi * (t - 50_400) / A4)
    return float(vertical / np.sqrt(1 - (R / (R + h) * np.cos(el)) ** 2))


def test_ionosphere_against_the_text() -> None:
    random = np.random.default_rng(4)
    for _ in range(300):
        lat, lon = random.uniform(-1.2, 1.2), random.uniform(-3.1, 3.1)
        az, el = random.uniform(0.0, 6.28), random.uniform(0.0, 1.57)
        tow_s = random.uniform(20.0, 604_799.0)
        got = beidou_klobuchar_delay(MODEL, lat, lon, np.array([az]), np.array([el]), tow_s)
        assert got[0] == pytest.approx(C * beidou_twin(lat, lon, az, el, tow_s - 14.0), rel=1e-9)


def test_ionosphere_by_night_and_at_other_frequencies() -> None:
    az, el = np.zeros(2), np.radians([90.0, -20.0])
    night_m = beidou_klobuchar_delay(MODEL, 0.5, 0.0, az, el, 0.0)
    assert night_m[0] == pytest.approx(C * 5e-9)
    assert 2.5 < night_m[1] / night_m[0] < 3.5  # of the horizon
    noon = 50_400.0 + 14.0
    zenith_m = beidou_klobuchar_delay(MODEL, 0.5, 0.0, az[:1], el[:1], noon)[0]
    semicircles = 0.5 / np.pi
    amplitude_s = sum(a * semicircles**n for n, a in enumerate(MODEL.alpha))
    assert zenith_m == pytest.approx(C * (5e-9 + amplitude_s), rel=1e-12)
    at_l1_m = beidou_klobuchar_delay(MODEL, 0.5, 0.0, az[:1], el[:1], noon, 1_575.42e6)[0]
    assert at_l1_m == pytest.approx(zenith_m * (1561.098 / 1575.42) ** 2)
