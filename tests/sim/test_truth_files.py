"""Truth files against each other, and observations against a program that knows nothing of us."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import BDS_B1I, GPS_L1CA
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.observations import read_observations, read_ranges
from deepgnss.evaluate.rtklib import FIXED, installed, kinematic
from deepgnss.io.config import load_config
from deepgnss.io.imu import ImuLog
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import read_truth
from deepgnss.sim.output import write_simulation
from deepgnss.sim.output.clock import write_clock
from deepgnss.sim.output.inertial import write_imu
from deepgnss.sim.output.navbits import write_navbits
from deepgnss.sim.output.sections import write_sections
from deepgnss.sim.output.stations import base_station, perfect_rover, write_observations
from deepgnss.sim.output.truth import write_ranges, write_truth
from deepgnss.sim.schema import Simulation, build, load_scenario

BOTH_BANDS = "[{sample_rate: 4e6}, {name: B1, sample_rate: 4e6, centre_frequency: 1561.098e6}]"
WAVELENGTH_M = {
    "G": SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz,
    "C": SPEED_OF_LIGHT_MPS / BDS_B1I.carrier_hz,
}


def made(folder: Path, name: str, *settings: str) -> Simulation:
    """Truth, NAV and observations of a scenario, without its samples."""
    simulation = build(load_scenario(name, settings))
    scenario, config = simulation.scenario, simulation.config
    write_nav(folder / "nav.rnx", scenario.nav)
    write_truth(folder / "truth.csv", scenario, config.truth.rate)
    write_ranges(folder / "ranges.csv", scenario, config.truth.ranges)
    write_clock(folder / "clock.csv", scenario, config.truth.rate)
    write_observations(folder, perfect_rover(config.rover), scenario)
    if config.base is not None:
        write_observations(folder, *base_station(config.base, scenario, simulation.unblocked))
    return simulation


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Simulation]:
    folder = tmp_path_factory.mktemp("drive")
    settings = ("seconds=60", "truth.ranges=1.0", "base={offset: [500, 800, -3], interval: 1}")
    return folder, made(folder, "urban_short", *settings)


def test_velocity_is_the_slope_of_position(drive: tuple[Path, Simulation]) -> None:
    """Fifth-order differences over ±40 ms; the columns hold 1e-5 m and 1e-6 m/s."""
    frame = pd.read_csv(drive[0] / "truth.csv")
    truth = read_truth(drive[0] / "truth.csv")
    r, dt = truth.r_e_m, 0.02
    slope = (r[:-4] - 8.0 * r[1:-3] + 8.0 * r[3:-1] - r[4:]) / (12.0 * dt)
    assert truth.v_e_mps is not None
    assert np.abs(slope - truth.v_e_mps[2:-2]).max() < 2e-3
    assert np.hypot(frame["vn_mps"], frame["ve_mps"]).max() > 5.0


def test_attitude_turns_with_the_course(drive: tuple[Path, Simulation]) -> None:
    """Heading is the course of the reference point; the antenna's differs by its swing only."""
    frame = pd.read_csv(drive[0] / "truth.csv")
    fast = frame[np.hypot(frame["vn_mps"], frame["ve_mps"]) > 5.0]
    course = np.degrees(np.arctan2(fast["ve_mps"], fast["vn_mps"]))
    off = np.mod(fast["heading_deg"] - course + 180.0, 360.0) - 180.0
    assert off.abs().max() < 3.0
    assert off.abs().median() < 0.1


def test_antenna_stands_its_lever_arm_from_the_unit(drive: tuple[Path, Simulation]) -> None:
    _, simulation = drive
    scenario = simulation.scenario
    lever = np.array(scenario.antennas[0].lever_b_m)
    t_s = np.array([0.0, 20.0, 50.0])
    pose = scenario.vehicle.pose(t_s)
    expected = pose.r_e_m + np.einsum("kij,j->ki", pose.C_eb, lever)
    truth = read_truth(drive[0] / "truth.csv")
    start = scenario.start
    found, _ = truth.at(start.week, start.tow_s + t_s)
    assert found == pytest.approx(expected, abs=2e-5)
    assert np.linalg.norm(lever) > 0.5


def test_ranges_add_up(drive: tuple[Path, Simulation]) -> None:
    frame = pd.read_csv(drive[0] / "ranges.csv")
    wavelength_m = frame["satellite"].str[0].map(WAVELENGTH_M)
    neutral_m = frame["geom_range_m"] - frame["satellite_clock_m"] + frame["tropo_m"]
    assert (frame["pseudorange_m"] - neutral_m - frame["iono_m"]).abs().max() < 5e-5
    phase_m = frame["carrier_cycles"] * wavelength_m
    assert (phase_m - neutral_m + frame["iono_m"]).abs().max() < 5e-5
    assert frame["iono_m"].min() > 0.5 and frame["tropo_m"].min() > 2.0


def test_phase_rate_is_minus_doppler(tmp_path: Path) -> None:
    """dL/dt = −D by fifth-order differences over ±20 ms on an accelerating car."""
    made(tmp_path, "urban_short", "seconds=12", "truth.ranges=0.01")
    frame = pd.read_csv(tmp_path / "ranges.csv")
    for satellite, rows in frame.groupby("satellite"):
        phase, doppler = rows["carrier_cycles"].to_numpy(), rows["doppler_hz"].to_numpy()
        slope = (phase[:-4] - 8.0 * phase[1:-3] + 8.0 * phase[3:-1] - phase[4:]) / 0.12
        assert np.abs(slope + doppler[2:-2]).max() < 0.01, satellite


def test_rover_observes_the_ranges(drive: tuple[Path, Simulation]) -> None:
    observed = read_observations(drive[0] / "rover.obs")
    ranges = read_ranges(drive[0] / "ranges.csv")
    both = observed.merge(ranges, on=["week", "tow_s", "satellite"])
    assert len(both) == len(observed) == len(ranges)
    assert (both["pseudorange_m"] - both["range_m"]).abs().max() < 6e-4  # digits of RINEX
    wavelength_m = both["satellite"].str[0].map(WAVELENGTH_M)
    cycles = both["carrier_cycles"] - both["phase_m"] / wavelength_m
    assert (cycles - cycles.round()).abs().max() < 6e-4
    both["ambiguity"] = cycles.round()
    for satellite, rows in both.sort_values("tow_s").groupby("satellite"):
        changed = rows["ambiguity"].diff().fillna(1.0) != 0.0
        assert (changed == rows["slip"]).all(), satellite
    arcs = both.groupby("satellite")["slip"].sum()
    assert arcs.max() > 1  # the tunnel


def test_base_is_where_it_says_and_noisy_as_it_says(drive: tuple[Path, Simulation]) -> None:
    folder, simulation = drive
    scenario = simulation.scenario
    station = read_obs(folder / "base.obs", "GC")
    _, base = base_station(simulation.config.base, scenario, simulation.unblocked)
    place = base.vehicle.point(np.zeros(1)).r_m[0]
    assert station.position_e_m == pytest.approx(place, abs=1e-4)
    v = scenario.vehicle
    origin = v.point(np.zeros(1)).r_m[0] - v.path(np.zeros(1)).r_m[0] @ C_ne(
        v.latitude_rad, v.longitude_rad
    )
    assert C_ne(*geodetic(origin)[:2]) @ (place - origin) == pytest.approx([500, 800, -3], abs=1e-3)
    write_ranges(folder / "base_ranges.csv", base, 1.0)
    both = read_observations(folder / "base.obs").merge(
        read_ranges(folder / "base_ranges.csv"), on=["week", "tow_s", "satellite"]
    )
    code_m = both["pseudorange_m"] - both["range_m"]
    count = len(both)
    assert count > 400
    assert code_m.std() == pytest.approx(0.3, rel=4.0 / math.sqrt(2 * count))
    assert abs(code_m.mean()) < 4.0 * 0.3 / math.sqrt(count)
    cycles = both["carrier_cycles"] - both["phase_m"] / both["satellite"].str[0].map(WAVELENGTH_M)
    phase_m = (cycles - cycles.round()) * both["satellite"].str[0].map(WAVELENGTH_M)
    assert phase_m.std() == pytest.approx(0.002, rel=4.0 / math.sqrt(2 * count))


def test_clock_file_holds_offset_and_drift(tmp_path: Path) -> None:
    made(tmp_path, "static", "seconds=20", "clock={offset: 3e-4, drift: -2e-6}", "oscillator=null")
    frame = pd.read_csv(tmp_path / "clock.csv")
    elapsed_s = frame["gps_tow_s"] - frame["gps_tow_s"].iloc[0]
    # sample 0 lies at GPST = start − offset; the drift counts on the clock's own time
    t_s = frame["gps_tow_s"] - 382_256.0
    expected = (3e-4 - 2e-6 * t_s) / (1.0 + 2e-6)
    assert (frame["offset_s"] - expected).abs().max() < 1e-12
    assert (frame["drift_sps"] + 2e-6).abs().max() < 1e-11
    assert elapsed_s.iloc[-1] == pytest.approx(20.0)


def test_navigation_file_reads_back(drive: tuple[Path, Simulation]) -> None:
    nav = read_nav(drive[0] / "nav.rnx")
    assert {e.satellite for e in drive[1].scenario.emitters} <= set(nav.ephemerides)


@pytest.mark.parametrize("systems", ["[GPS]", "[BDS]", "[GPS, BDS]"])
def test_rtklib_fixes_rover_against_base(tmp_path: Path, systems: str) -> None:
    """Over 99 % fixed, centimetres from the truth, within a kilometre of the base."""
    if installed() is None:
        pytest.skip("rnx2rtkp is not installed")
    settings = [f"satellites.systems={systems}", "seconds=90", "surroundings=[]"]
    simulation = made(tmp_path, "urban_short", *settings)
    found = kinematic(*(tmp_path / name for name in ("rover.obs", "base.obs", "nav.rnx")))
    assert len(found) >= 90
    fixed = found["quality"] == FIXED
    assert fixed.mean() > 0.99
    start = simulation.scenario.start
    t_s = found["tow_s"].to_numpy() - start.tow_s
    lever = simulation.scenario.antennas[0].lever_b_m
    true_e_m = simulation.scenario.vehicle.point(t_s, lever).r_m
    error_m = found[["x_e_m", "y_e_m", "z_e_m"]].to_numpy() - true_e_m
    assert np.sqrt((error_m**2).mean(axis=0)).max() < 0.01
    assert np.linalg.norm(error_m, axis=1)[fixed].max() < 0.05


def test_navigation_bits_are_the_frames_sent(tmp_path: Path) -> None:
    """Preambles where each system's subframes begin: 0x8B every 6 s, 0x712 every 6 or 0.6 s."""
    settings = ("seconds=30", "satellites.systems=[GPS, BDS]", "streams=" + BOTH_BANDS)
    write_navbits(tmp_path / "navbits.csv", build(load_scenario("static", settings)).scenario)
    frame = pd.read_csv(tmp_path / "navbits.csv")
    assert {"G", "C"} == set(frame["satellite"].str[0])
    for satellite, rows in frame.groupby("satellite"):
        geostationary = satellite in ("C01", "C02", "C03", "C04", "C05")
        every_s, shift_s = (0.6 if geostationary else 6.0), (0.0 if satellite[0] == "G" else 14.0)
        starts_s = (rows["gps_tow_s"] - shift_s) / every_s
        assert (starts_s - starts_s.round()).abs().max() < 1e-6
        assert np.diff(starts_s) == pytest.approx(1.0)
        assert rows["gps_tow_s"].min() < 382_256.0 < 382_286.0 < rows["gps_tow_s"].max() + every_s
        for text in rows["bits_hex"]:
            bits = f"{int(text, 16):0300b}"
            assert len(text) == 75
            if satellite[0] == "G":
                assert bits.startswith("10001011")
            else:
                assert bits.startswith("11100010010")


@pytest.mark.parametrize(
    ("keys", "container"),
    [
        ("format: csv", False),
        ("format: csv, kind: rates, axes: RFU", False),
        ("format: kfgins", False),
        ("format: novatel_rawimu, model: FSAS", False),
        ("format: hdf5", False),
        ("format: hdf5", True),
    ],
)
def test_inertial_log_reads_back_by_the_config(tmp_path: Path, keys: str, container: bool) -> None:
    """The error-free unit at rest reads the earth's rate and gravity, whatever its format."""
    settings = (
        *("seconds=0.5", "streams=[{sample_rate: 2.6e6, format: bits1}]"),
        f"imu={{rate: 100, grade: null, {keys}}}",
        f"container={str(container).lower()}",
    )
    written = write_simulation(build(load_scenario("static", settings)), tmp_path)
    config = load_config(written.config)
    assert config.imu is not None
    start = GpsTime(2290, 382_256.0)
    blocks = list(ImuLog(config.imu, recording=written.recording, near=start))
    dtheta, dv, dt_s = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("dtheta_b_rad", "dv_b_mps", "dt_s")
    )
    first, last = blocks[0], blocks[-1]
    assert first.origin.plus(float(first.time_s[0])).since(start) == pytest.approx(-0.99, abs=1e-6)
    assert last.origin.plus(float(last.time_s[-1])).since(start) == pytest.approx(1.5, abs=1e-6)
    count = 0.0 if "novatel" not in keys else 1.0  # of the log's steps: 0.1 arc-s·2⁻⁸, 0.05/2¹⁵
    rate_radps = dtheta.sum(axis=0) / dt_s.sum()
    latitude = math.radians(52.264)
    earth = 7.2921151467e-5 * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
    assert rate_radps == pytest.approx(earth, abs=1e-9 + count * 1e-9)
    force = dv.sum(axis=0) / dt_s.sum()
    assert force == pytest.approx([0.0, 0.0, -9.8125], abs=2e-3)


def test_inertial_truth_holds_the_errors_of_the_log(tmp_path: Path) -> None:
    """Log minus an error-free one of the same motion = scale·true + bias·dt + noise."""
    for grade in ("null", "automotive"):
        settings = ("seconds=20", f"imu={{rate: 100, grade: {grade}}}", "seed=3")
        (tmp_path / grade).mkdir()
        write_imu(tmp_path / grade, build(load_scenario("blockage_20s", settings)))
    true, read = (pd.read_csv(tmp_path / grade / "imu.csv") for grade in ("null", "automotive"))
    errors = pd.read_csv(tmp_path / "automotive" / "imu_truth.csv")
    assert (errors["gps_tow_s"] - read["gps_tow_s"]).abs().max() < 1e-6
    for axis in "xyz":
        for column, kind, unit in (
            (f"dtheta_{axis}_rad", "gyro", "radps"),
            (f"dvel_{axis}_mps", "accel", "mps2"),
        ):
            bias = errors[f"{kind}_bias_{axis}_{unit}"]
            expected = errors[f"{kind}_scale_{axis}"] * true[column] + bias * 0.01
            noise = read[column] - true[column] - expected
            assert bias.abs().min() > 0.0
            assert abs(noise.mean()) < 5.0 * noise.std() / math.sqrt(len(noise))
            assert noise.std() < 0.2 * (bias.abs().mean() + 1e-2)


def test_obstacles_are_named_where_they_stand(drive: tuple[Path, Simulation]) -> None:
    """In the tunnel's middle every satellite is blocked by it; before the trees all are free."""
    frame = pd.read_csv(drive[0] / "ranges.csv", keep_default_na=False)
    elapsed_s = frame["tow"].astype(float) - 382_256.0
    early = frame[(elapsed_s > 2.0) & (elapsed_s < 15.0)]
    assert (early["line_of_sight"] == "free").all() and (early["cause"] == "").all()
    assert (early["visible"] == 1).all()
    path = drive[1].scenario.vehicle.path
    at_m = path.distance(elapsed_s.to_numpy())  # type: ignore[attr-defined]
    inside = frame[(at_m > 400.0) & (at_m < 420.0)]
    assert len(inside) > 10
    assert inside["line_of_sight"].isin(["blocked", "diffracted"]).all()
    assert inside["cause"].str.contains("tunnel").all()
    assert (inside["visible"] == 0).all()
    below = frame[(at_m > 140.0) & (at_m < 160.0)]
    assert below["cause"].str.contains("trees").any()
    silent = build(load_scenario("blockage_20s", ("seconds=80",)))
    write_ranges(drive[0] / "silent.csv", silent.scenario, 1.0)
    frame = pd.read_csv(drive[0] / "silent.csv")
    off = frame["line_of_sight"] == "silent"
    elapsed_s = frame["tow"] - 382_256.0
    assert (off == ((elapsed_s >= 55.0) & (elapsed_s < 75.0))).all()
    assert (frame["visible"] == ~off).all()


def test_sections_are_when_the_road_passes_obstacles(tmp_path: Path) -> None:
    simulation = build(load_scenario("urban_short", ()))
    assert write_sections(tmp_path / "sections.csv", simulation)
    frame = pd.read_csv(tmp_path / "sections.csv").set_index("name")
    write_truth(tmp_path / "truth.csv", simulation.scenario, 10.0)
    truth = read_truth(tmp_path / "truth.csv")
    assert list(frame.index) == ["trees", "footbridge", "tunnel", "canyon", "viaduct", "barrier"]
    inside = frame.loc["tunnel"]  # from 370 to 450 m along the road
    ways_m = [
        np.linalg.norm(np.diff(truth.r_e_m[truth.tow_s <= tow_s + 1e-6], axis=0), axis=1).sum()
        for tow_s in (inside["from_tow_s"], inside["to_tow_s"])
    ]
    assert ways_m == pytest.approx([370.0, 450.0], abs=2.0)
    assert not write_sections(tmp_path / "none.csv", build(load_scenario("static", ())))
