"""Single-point solution: exact data give the truth, models have their sign, faults a name."""

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from synthetic_sky import observe, sky
from test_lnav import ublox_messages

from deepgnss.core import frames
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.records import Epoch, FloatArray, NavData, Observation, SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.receiver import pvt
from deepgnss.receiver.weights import range_sigma, rate_sigma

NAV = sky()
OPEN = pvt.PvtParameters(elevation_mask_rad=np.radians(5.0))
LAT, LON = 0.53, 1.99
HERE_E_M = frames.ecef(LAT, LON, 40.0)
V_E_MPS = frames.C_ne(LAT, LON).T @ np.array([12.0, -7.0, 0.5])
EPOCH = observe(NAV, HERE_E_M, V_E_MPS, OPEN, lowest_rad=np.radians(6.0))


def changed(epoch: Epoch, satellite: str, **changes: float) -> Epoch:
    """An epoch with increments on some observables of one satellite."""
    return replace(
        epoch,
        observations=tuple(
            o._replace(**{name: getattr(o, name) + by for name, by in changes.items()})
            if o.satellite == satellite
            else o
            for o in epoch.observations
        ),
    )


def only(epoch: Epoch, count: int) -> Epoch:
    """The `count` highest satellites."""
    angles = pvt.solve(epoch, NAV, OPEN).azimuth_elevation_rad
    best = sorted(angles, key=lambda s: -angles[s][1])[:count]
    return replace(epoch, observations=tuple(o for o in epoch.observations if o.satellite in best))


def test_exact_observations_give_back_the_truth_from_the_geocentre() -> None:
    got = pvt.solve(EPOCH, NAV, OPEN)
    assert got.valid
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3
    assert np.abs(got.v_e_mps - V_E_MPS).max() < 1e-5
    assert got.clock_s == pytest.approx(2e-4, abs=1e-11)
    assert got.drift_sps == pytest.approx(3e-7, abs=1e-13)
    assert max(abs(r) for r in got.residuals_m.values()) < 1e-3
    assert got.time == EPOCH.time
    assert len(got.used) >= 8


@pytest.mark.parametrize("distance_m", [1.0, 1e3, 1e6])
def test_the_start_does_not_matter(distance_m: float) -> None:
    cold = pvt.solve(EPOCH, NAV, OPEN)
    away = replace(cold, r_e_m=cold.r_e_m + distance_m * np.array([0.6, 0.0, 0.8]))
    warm = pvt.solve(EPOCH, NAV, OPEN, away)
    # the last model of the atmosphere may be 10 m off: 3 mm at zenith
    assert np.abs(warm.r_e_m - cold.r_e_m).max() < 5e-3
    assert warm.used == cold.used


@pytest.mark.parametrize(
    ("lat", "lon", "height"), [(1.4, -3.0, 0.0), (-0.8, 0.1, 11e3), (0, 3, 4e5)]
)
def test_anywhere(lat: float, lon: float, height: float) -> None:
    r_e_m = frames.ecef(lat, lon, height)
    got = pvt.solve(observe(NAV, r_e_m, np.zeros(3), OPEN), NAV, OPEN)
    assert got.valid, got.reason
    assert np.abs(got.r_e_m - r_e_m).max() < 1e-3


def test_a_fast_drifting_oscillator_does_not_disturb_the_velocity() -> None:
    """10 ppm times 800 m/s of range rate is 8 mm/s: in the equations, not in the result."""
    got = pvt.solve(observe(NAV, HERE_E_M, V_E_MPS, OPEN, drift_sps=1e-5), NAV, OPEN)
    assert np.abs(got.v_e_mps - V_E_MPS).max() < 1e-5
    assert got.drift_sps == pytest.approx(1e-5, abs=1e-13)


def test_residuals_are_measured_minus_modelled() -> None:
    satellite = pvt.solve(EPOCH, NAV, OPEN).used[0]
    got = pvt.solve(changed(EPOCH, satellite, pseudorange_m=1.0), NAV, OPEN)
    assert 0.0 < got.residuals_m[satellite] < 1.0


def test_models_left_out_show_with_their_sign() -> None:
    """A delay that is not modelled makes ranges long: the clock takes most, the height sinks."""
    full = pvt.solve(EPOCH, NAV, OPEN)
    for lacking in (
        replace(OPEN, ionosphere="none", raim=False),
        replace(OPEN, troposphere="none", raim=False),
    ):
        got = pvt.solve(EPOCH, NAV, lacking)
        assert C * (got.clock_s - full.clock_s) > 2.0
        height_m = frames.geodetic(got.r_e_m)[2]
        assert -100.0 < height_m - 40.0 < -2.0 or height_m - 40.0 > 2.0


def test_unknown_ionosphere_coefficients_widen_the_covariance() -> None:
    blind = replace(NAV, klobuchar={})
    known, unknown = (pvt.solve(EPOCH, nav, replace(OPEN, raim=False)) for nav in (NAV, blind))
    assert np.trace(unknown.covariance_m2) > 1.5 * np.trace(known.covariance_m2)


def test_intersystem_bias() -> None:
    both = sky("GC")
    epoch = observe(both, HERE_E_M, V_E_MPS, OPEN, isb_s={"C": 45e-9})
    got = pvt.solve(epoch, both, OPEN)
    assert {s[0] for s in got.used} == {"G", "C"}
    assert got.isb_s == {"C": pytest.approx(45e-9, abs=1e-11)}
    assert got.clock_s == pytest.approx(2e-4, abs=1e-11)
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3
    alone = pvt.solve(
        replace(epoch, observations=tuple(o for o in epoch.observations if o.satellite[0] == "C")),
        both,
        OPEN,
    )
    assert alone.isb_s == {}
    assert alone.clock_s == pytest.approx(2e-4 + 45e-9, abs=1e-11)


def test_a_known_bias_between_systems_replaces_a_satellite() -> None:
    """Two of each system are enough once the bias is known, and it is learnt over time."""
    both = sky("GC")
    epoch = observe(both, HERE_E_M, V_E_MPS, OPEN, isb_s={"C": 45e-9})
    first = pvt.solve(epoch, both, OPEN)
    second = pvt.solve(epoch, both, OPEN, first)
    assert 0.0 < second.isb_sigma_s["C"] < 0.8 * first.isb_sigma_s["C"]
    assert second.isb_s["C"] == pytest.approx(45e-9, abs=1e-11)
    pairs = [o for s in "GC" for o in [o for o in epoch.observations if o.satellite[0] == s][:2]]
    few = replace(epoch, observations=tuple(pairs))
    assert not pvt.solve(few, both, OPEN).valid
    got = pvt.solve(few, both, OPEN, first)
    assert got.valid, got.reason
    assert np.abs(got.r_e_m - HERE_E_M).max() < 0.1


def test_a_bias_that_is_no_longer_true_is_learnt_anew() -> None:
    """Its system is left out once, which forgets the bias: two tags later all is well."""
    both = sky("GC")
    last = pvt.solve(observe(both, HERE_E_M, V_E_MPS, OPEN, isb_s={"C": 45e-9}), both, OPEN)
    epoch = observe(both, HERE_E_M, V_E_MPS, OPEN, isb_s={"C": 5e-6})
    for _ in range(2):
        last = pvt.solve(epoch, both, OPEN, last)
        assert last.valid, last.reason
        assert np.abs(last.r_e_m - HERE_E_M).max() < 0.1
    assert last.isb_s["C"] == pytest.approx(5e-6, abs=1e-10)


def test_dilutions_of_a_known_geometry() -> None:
    """Zenith and three at the horizon, 120° apart: HDOP² = 4/3, by hand."""
    az = 2 * np.pi / 3 * np.arange(3)
    towards = np.vstack([[0.0, 0.0, -1.0], np.column_stack([np.cos(az), np.sin(az), 0 * az])])
    got = pvt.dilutions(np.column_stack([-towards, np.ones(4)]), np.eye(3))
    assert got["hdop"] == pytest.approx(np.sqrt(4 / 3))
    assert got["vdop"] == pytest.approx(np.sqrt(4 / 3))
    assert got["tdop"] == pytest.approx(np.sqrt(1 / 3))
    assert got["pdop"] == pytest.approx(np.sqrt(8 / 3))
    assert got["gdop"] == pytest.approx(np.sqrt(3))


def test_errors_agree_with_the_covariance() -> None:
    """Noise of the stated standard deviations: mean normalized square of 4 for 4 states."""
    rng = np.random.default_rng(7)
    parameters = replace(OPEN, raim=False)
    exact = pvt.solve(EPOCH, NAV, parameters)
    elevation = np.array([exact.azimuth_elevation_rad[o.satellite][1] for o in EPOCH.observations])
    ephemerides = [NAV.ephemerides[o.satellite][0] for o in EPOCH.observations]
    cn0 = np.full(len(ephemerides), 45.0)
    # atmosphere exactly known here, as its uncertainty is no noise between satellites
    parameters = replace(
        parameters, errors=replace(parameters.errors, ionosphere=0.0, troposphere=0.0)
    )
    sigma_m = range_sigma(parameters.errors, ephemerides, elevation, cn0, np.zeros(len(cn0)))
    sigma_hz = rate_sigma(parameters.errors, cn0, np.full(cn0.shape, np.nan)) * 1_575.42e6 / C
    nees, velocity_nees = [], []
    for _ in range(150):
        noisy = replace(
            EPOCH,
            observations=tuple(
                o._replace(
                    pseudorange_m=o.pseudorange_m + s * rng.normal(),
                    doppler_hz=o.doppler_hz + d * rng.normal(),
                )
                for o, s, d in zip(EPOCH.observations, sigma_m, sigma_hz, strict=True)
            ),
        )
        got = pvt.solve(noisy, NAV, parameters, exact)
        e = np.append(got.r_e_m - HERE_E_M, C * (got.clock_s - 2e-4))
        nees.append(e @ np.linalg.solve(got.covariance_m2, e))
        e = np.append(got.v_e_mps - V_E_MPS, C * (got.drift_sps - 3e-7))
        velocity_nees.append(e @ np.linalg.solve(got.velocity_covariance_m2ps2, e))
    limit = 4.0 * np.sqrt(2.0 * 4.0 / 150)  # four sigma of the mean
    assert np.mean(nees) == pytest.approx(4.0, abs=limit)
    assert np.mean(velocity_nees) == pytest.approx(4.0, abs=limit)


# --- faults --------------------------------------------------------------------------------------


def test_faulty_satellites_are_named() -> None:
    first, second, *_ = pvt.solve(EPOCH, NAV, OPEN).used
    faulty = changed(changed(EPOCH, first, pseudorange_m=150.0), second, pseudorange_m=-80.0)
    got = pvt.solve(faulty, NAV, OPEN)
    assert got.valid
    assert set(got.rejected) == {first, second}
    assert got.rejected[first].startswith("residual ")
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3
    assert got.residuals_m[first] == pytest.approx(150.0, abs=1e-2)
    off = pvt.solve(faulty, NAV, replace(OPEN, raim=False))
    assert np.abs(off.r_e_m - HERE_E_M).max() > 5.0


@pytest.mark.parametrize("periods", [(1,), (-1,), (20,), (-20,), (1, 1), (20, -3), (1, 40)])
@pytest.mark.parametrize("warm", [False, True])
def test_whole_milliseconds_wrong_are_named_alone(periods: tuple[int, ...], warm: bool) -> None:
    """A wrong bit edge moves transmit time and range by 1 ms, a wrong bit count by 20 ms."""
    right = pvt.solve(EPOCH, NAV, OPEN)
    wrong = dict(zip(right.used[1::3], periods, strict=False))
    observations = []
    for o in EPOCH.observations:
        late_s = 1e-3 * wrong.get(o.satellite, 0)
        observations.append(
            o._replace(
                pseudorange_m=o.pseudorange_m + C * late_s,
                transmit=o.transmit.plus(-late_s),
            )
        )
    epoch = replace(EPOCH, observations=tuple(observations))
    got = pvt.solve(epoch, NAV, OPEN, right if warm else None)
    assert set(got.rejected) == set(wrong)
    assert len(wrong) == len(periods)
    assert all(reason.startswith("range off by ") for reason in got.rejected.values())
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3


def test_a_false_lock_leaves_the_velocity_not_the_position() -> None:
    satellite = pvt.solve(EPOCH, NAV, OPEN).used[2]
    got = pvt.solve(changed(EPOCH, satellite, doppler_hz=25.0), NAV, OPEN)
    assert got.rejected == {satellite: "Doppler: residual -4.76 m/s"} or (
        satellite in got.rejected and got.rejected[satellite].startswith("Doppler: residual -")
    )
    assert satellite in got.used
    assert np.abs(got.v_e_mps - V_E_MPS).max() < 1e-5


def test_unhealthy_and_unknown_satellites_are_named() -> None:
    sick, lost = pvt.solve(EPOCH, NAV, OPEN).used[:2]
    sets = dict(NAV.ephemerides)
    sets[sick] = (replace(sets[sick][0], health=63),)
    del sets[lost]
    got = pvt.solve(EPOCH, replace(NAV, ephemerides=MappingProxyType(sets)), OPEN)
    assert got.rejected == {sick: "unhealthy", lost: "no ephemeris"}
    assert sick in got.residuals_m
    assert sick in got.azimuth_elevation_rad
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3


def test_refused_satellites_stay_out_and_show_by_how_much_they_are_wrong() -> None:
    """The reason given stands, and so do the residuals they would have had."""
    wrong = pvt.solve(EPOCH, NAV, OPEN).used[:2]
    epoch = changed(changed(EPOCH, wrong[0], pseudorange_m=12.0), wrong[1], pseudorange_m=-9.0)
    got = pvt.solve(epoch, NAV, replace(OPEN, raim=False), refused=dict.fromkeys(wrong, "outlier"))
    assert {name: got.rejected[name] for name in wrong} == dict.fromkeys(wrong, "outlier")
    assert not set(got.used) & set(wrong)
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3
    assert got.residuals_m[wrong[0]] == pytest.approx(12.0, abs=1e-3)
    assert got.residuals_m[wrong[1]] == pytest.approx(-9.0, abs=1e-3)


def test_low_satellites_are_named_with_their_elevation() -> None:
    got = pvt.solve(EPOCH, NAV, replace(OPEN, elevation_mask_rad=np.radians(30.0)))
    low = {
        s for s, (_, elevation) in got.azimuth_elevation_rad.items() if elevation < np.radians(30)
    }
    assert set(got.rejected) == low
    assert len(low) > 1
    assert all(reason.endswith("° below 30.0°") for reason in got.rejected.values())


def test_too_few_satellites_are_counted() -> None:
    assert pvt.solve(only(EPOCH, 3), NAV, OPEN).reason == "3 of 4 satellites needed"
    got = pvt.solve(only(EPOCH, 4), replace(NAV, ephemerides={}), OPEN)
    assert not got.valid
    assert got.reason == "0 of 4 satellites needed (left out: 4 no ephemeris)"
    assert np.isnan(got.r_e_m).all()
    assert (
        pvt.solve(replace(EPOCH, observations=()), NAV, OPEN).reason == "0 of 4 satellites needed"
    )


def test_five_that_disagree_give_no_fix() -> None:
    five = only(EPOCH, 5)
    got = pvt.solve(changed(five, five.observations[0].satellite, pseudorange_m=500.0), NAV, OPEN)
    assert not got.valid
    assert got.reason.startswith("residuals disagree: chi-square")
    assert "5 satellites" in got.reason


def test_four_fix_without_a_test() -> None:
    got = pvt.solve(only(EPOCH, 4), NAV, OPEN)
    assert got.valid
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-2


# --- data of others ------------------------------------------------------------------------------


def epochs(path: Path, every: int = 1) -> Iterator[Epoch]:
    """GPS C1C and D1C of a RINEX file."""
    table = read_obs(path, "G").frame
    for number, ((week, tow_s), rows) in enumerate(table.groupby(["week", "tow_s"])):
        if number % every:
            continue
        time = GpsTime(int(week), float(tow_s))
        rows = rows[np.isfinite(rows.C1C)]
        doppler = rows.D1C if "D1C" in rows else np.full(len(rows), np.nan)
        strength = rows.S1C if "S1C" in rows else np.full(len(rows), 45.0)
        yield Epoch(
            time,
            SampleInstant(0, 0.0),
            tuple(
                Observation(
                    s, "GPS_L1CA", p, 0.0, d, 45.0 if np.isnan(cn0) else cn0, 1.0,
                    slip=False, half_cycle=False, carrier_valid=False, transmit=time.plus(-p / C),
                )
                for s, p, d, cn0 in zip(rows.satellite, rows.C1C, doppler, strength, strict=True)
            ),
        )  # fmt: skip


def errors_n_m(
    path: Path, nav: NavData, reference_e_m: FloatArray, every: int
) -> tuple[FloatArray, FloatArray]:
    """Errors and velocities NED of all epochs, each of which must have a fix."""
    lat, lon, _ = frames.geodetic(reference_e_m)
    C_ne = frames.C_ne(lat, lon)
    errors, velocities, previous = [], [], None
    for epoch in epochs(path, every):
        previous = pvt.solve(epoch, nav, pvt.PvtParameters(), previous)
        assert previous.valid, previous.reason
        errors.append(C_ne @ (previous.r_e_m - reference_e_m))
        velocities.append(C_ne @ previous.v_e_mps)
    return np.array(errors), np.array(velocities)


@pytest.mark.parametrize(
    ("observations", "navigation", "every", "count"),
    [
        ("rtklib-2005/07590920.05o", "rtklib-2005/07590920.05n", 4, 30),
        ("rtklib-2005/30400920.05o", "rtklib-2005/30400920.05n", 4, 30),
        ("cssrlib-baseline/3034265G.21O", "cssrlib-baseline/SEPT2650.21P", 10, 36),
    ],
)
def test_stations(
    shared_data: Path, observations: str, navigation: str, every: int, count: int
) -> None:
    """Survey stations, broadcast orbits and Klobuchar: metres, as any receiver has them."""
    folder = shared_data / "real/gnss"
    reference = read_obs(folder / observations, "G").position_e_m
    assert reference is not None
    error, _ = errors_n_m(folder / observations, read_nav(folder / navigation), reference, every)
    assert len(error) == count
    assert np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()) < 2.5
    assert np.abs(error[:, 2]).mean() < 6.0


def test_walk_against_carrier_phase_truth(shared_data: Path) -> None:
    """A consumer receiver carried about, against its own RTK positions and velocities."""
    folder = shared_data / "real/gnss/snapper-ubx"
    truth = {}
    for kind, p in ublox_messages((folder / "COM6_211122_123733.ubx").read_bytes()):
        if kind == 0x0107 and p[21] >> 6 == 2:
            tow_ms = struct.unpack_from("<I", p)[0]
            lon, lat, height = np.array(struct.unpack_from("<3i", p, 24)) * [1e-7, 1e-7, 1e-3]
            v_n_mps = np.array(struct.unpack_from("<3i", p, 48)) * 1e-3
            truth[tow_ms] = frames.ecef(np.radians(lat), np.radians(lon), height), v_n_mps
    nav = read_nav(folder / "w00_f9p.nav")
    position, velocity, previous = [], [], None
    for epoch in epochs(folder / "w00_f9p.obs"):
        # receiver clock steps of a millisecond are in the time tags: 0.993 s for a whole second
        known = truth.get(round(epoch.time.tow_s) * 1000)
        previous = pvt.solve(epoch, nav, pvt.PvtParameters(), previous)
        if known is None or not previous.valid:
            continue
        lat, lon, _ = frames.geodetic(known[0])
        C_ne = frames.C_ne(lat, lon)
        moved_s = round(epoch.time.tow_s) - (epoch.time.tow_s - previous.clock_s)
        position.append(C_ne @ (previous.r_e_m - known[0]) + known[1] * moved_s)
        velocity.append(C_ne @ previous.v_e_mps - known[1])
    assert len(position) > 100
    horizontal_m = np.linalg.norm(np.array(position)[:, :2], axis=1)
    assert np.sqrt((horizontal_m**2).mean()) < 3.0
    assert np.sqrt((np.array(velocity)[:, :2] ** 2).sum(axis=1).mean()) < 0.15


def test_against_the_ranges_of_another_simulator(shared_data: Path) -> None:
    """Noise-free pseudoranges of drive/ranges.csv: within a centimetre, all fixed, none doubted."""
    folder = shared_data / "independent/drive"
    nav = read_nav(folder / "brdc0010.22n")
    truth = pd.read_csv(folder / "truth.csv")
    truth.index = pd.Index(np.round(truth.gps_tow_s * 100).astype(int))
    parameters = pvt.PvtParameters(troposphere="none")
    count = 0
    for tow_s, rows in pd.read_csv(folder / "ranges.csv").groupby("tow"):
        tick = round(float(tow_s) * 100)
        if tick % 300:
            continue
        at, time = truth.loc[tick], GpsTime(2190, tick / 100)
        epoch = Epoch(
            time,
            SampleInstant(0, 0.0),
            tuple(
                Observation(
                    f"G{prn:02d}", "GPS_L1CA", p, 0.0, -rate * 1_575.42e6 / C, 45.0, 1.0,
                    slip=False, half_cycle=False, carrier_valid=False, transmit=time.plus(-p / C),
                )
                for prn, p, rate in zip(
                    rows.prn, rows.pseudorange_m, rows.range_rate_mps, strict=True
                )
            ),
        )  # fmt: skip
        got = pvt.solve(epoch, nav, parameters)
        r_e_m = frames.ecef(np.radians(at.lat_deg), np.radians(at.lon_deg), at.height_m)
        assert np.abs(got.r_e_m - r_e_m).max() < 0.01
        assert abs(got.clock_s) < 3e-11
        assert got.rejected["G22"] == "unhealthy"
        assert not any("residual" in reason for reason in got.rejected.values())
        count += 1
    assert count >= 19
