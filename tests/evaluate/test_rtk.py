"""RTK and RTKLIB's numbers: fixes counted right and wrong, and ours beside RTKLIB's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.evaluate import rtklib
from deepgnss.evaluate.beside_rtklib import code_differences, single_points
from deepgnss.evaluate.rtk import rtk_errors, shares
from deepgnss.io.rinex_nav import write_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import Trajectory
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.sim.output.stations import base_station, perfect_rover, write_observations
from deepgnss.sim.output.truth import write_truth
from deepgnss.sim.schema import Simulation, build, load_scenario

needs_rtklib = pytest.mark.skipif(
    rtklib.installed() is None, reason="rnx2rtkp is not installed (Debian, Ubuntu: rtklib)"
)
_BANDS = "[{sample_rate: 4e6}, {name: B1, sample_rate: 4e6, centre_frequency: 1561.098e6}]"


def _stations(folder: Path, name: str, *settings: str) -> Simulation:
    """Truth, NAV, perfect rover and base of a scenario, without its samples."""
    simulation = build(load_scenario(name, settings))
    scenario, config = simulation.scenario, simulation.config
    write_nav(folder / "nav.rnx", scenario.nav)
    write_truth(folder / "truth.csv", scenario, config.truth.rate)
    write_observations(folder, perfect_rover(config.rover), scenario)
    assert config.base is not None
    write_observations(folder, *base_station(config.base, scenario, simulation.unblocked))
    return simulation


# --- counting ------------------------------------------------------------------------------------


def test_a_fix_is_right_within_the_limit_and_nothing_else_counts_as_one() -> None:
    table = pd.DataFrame(
        {
            "horizontal_m": [0.03, 0.01, 0.06, 4.0, 0.01, 1.0, 0.0],
            "quality": [1, 1, 1, 1, 2, 5, 1],
        },
        index=pd.Index([10, 11, 12, 13, 14, 15, 99], name="instant"),
    )
    found = shares({"a": table}, np.arange(10, 18), right_m=0.05)["a"]
    assert (found.right, found.wrong, found.floating, found.without) == (2, 2, 1, 3)
    assert found.epochs == found.right + found.wrong + found.floating + found.without
    assert found.right_rms_m == pytest.approx(np.sqrt((0.03**2 + 0.01**2) / 2.0))
    assert np.isnan(shares({"a": table.iloc[2:4]}, np.arange(10, 18))["a"].right_rms_m)


def test_quality_stays_with_its_tag_where_tags_lie_off_the_grid() -> None:
    """Two tags for one instant: the nearer one stands for it, with its own quality."""
    tow_s = np.array([1000.0, 1000.9, 1001.005, 1002.005])
    place = np.tile([3845556.0, 714943.0, 5021238.0], (4, 1))
    found = pd.DataFrame(
        {
            "week": 2290,
            "tow_s": tow_s,
            **{f"{axis}_e_m": place[:, k] for k, axis in enumerate("xyz")},
            "quality": [1, 2, 1, 5],
            "satellites": 9,
        }
    )
    every = np.arange(990.0, 1010.0, 0.005)
    truth = Trajectory(np.full(every.size, 2290), every, np.tile(place[0], (every.size, 1)))
    errors = rtk_errors(found, truth, 1.0)
    assert list(errors["quality"]) == [1, 1, 5]
    assert errors["horizontal_m"].max() < 1e-6


def test_a_receiver_without_any_position_counts_as_one_without() -> None:
    nothing = pd.DataFrame(
        columns=["week", "tow_s", "x_e_m", "y_e_m", "z_e_m", "quality", "satellites"], dtype=float
    )
    every = np.arange(990.0, 1010.0, 0.5)
    place = np.tile([3845556.0, 714943.0, 5021238.0], (every.size, 1))
    truth = Trajectory(np.full(every.size, 2290), every, place)
    found = shares({"a": rtk_errors(nothing, truth, 1.0)}, np.arange(10))["a"]
    assert (found.epochs, found.right, found.without) == (10, 0, 10)


# --- RTKLIB --------------------------------------------------------------------------------------


@needs_rtklib
def test_the_command_counts_the_fixes_of_a_perfect_rover(tmp_path: Path) -> None:
    """In the open nearly every instant is fixed right, whatever the mode; two systems are used."""
    settings = ("seconds=40", "satellites.systems=[GPS, BDS]", "surroundings=[]", "streams=")
    _stations(tmp_path, "urban_short", *settings[:3], settings[3] + _BANDS)
    files = {name: str(tmp_path / name) for name in ("rover.obs", "base.obs", "nav.rnx")}
    for mode in ("instantaneous", "fix-and-hold"):
        out = tmp_path / mode
        told = CliRunner().invoke(
            cli,
            [
                *("compare", "--log", files["rover.obs"], "--truth", str(tmp_path / "truth.csv")),
                *("--base", files["base.obs"], "--nav", files["nav.rnx"]),
                *("--rtk", "--rtk-mode", mode, "-o", str(out)),
            ],
        )
        assert told.exit_code == 0, told.output
        assert "RTK by RTKLIB" in told.output
        found = json.loads((out / "summary.json").read_text())["rtk"]["rover"]
        assert found["epochs"] == 41
        assert found["right"] >= 40 and found["wrong"] == 0
        assert found["right_rms_m"] < 0.01
        table = pd.read_csv(out / "rtk.csv")
        assert set(table["receiver"]) == {"rover"} and set(table["quality"]) <= {1, 2}


def test_without_rtklib_a_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _stations(tmp_path, "urban_short", "seconds=3")
    monkeypatch.setenv("PATH", "")
    files = [str(tmp_path / name) for name in ("rover.obs", "truth.csv", "base.obs", "nav.rnx")]
    options = ["--log", "--truth", "--base", "--nav"]
    given = [word for pair in zip(options, files, strict=True) for word in pair]
    told = CliRunner().invoke(cli, ["compare", *given, "--rtk", "-o", str(tmp_path / "out")])
    assert told.exit_code == 2
    assert (
        told.output.strip()
        .splitlines()[-1]
        .endswith("rnx2rtkp: not installed (Debian, Ubuntu: apt install rtklib)")
    )
    told = CliRunner().invoke(cli, ["compare", *given[:4], "--rtk", "-o", str(tmp_path / "out")])
    assert told.exit_code == 2 and "--rtk: it needs --truth, --base" in told.output


@needs_rtklib
@pytest.mark.parametrize("systems", ["[GPS]", "[BDS]", "[GPS, BDS]"])
def test_single_points_are_rtklib_s_to_a_millimetre(tmp_path: Path, systems: str) -> None:
    """Orbits, clocks, group delays, Sagnac, masks alike; a car with Doppler to 13 m/s."""
    settings = ("seconds=30", "surroundings=[]", f"streams={_BANDS}")
    air = "atmosphere={ionosphere: false, troposphere: false}"
    _stations(tmp_path, "urban_short", f"satellites.systems={systems}", air, *settings)
    models = PvtParameters(ionosphere="none", troposphere="none")
    found = single_points(tmp_path / "rover.obs", tmp_path / "nav.rnx", models)
    assert found.epochs == found.shared == 31
    assert found.position_m < 1e-3
    assert found.velocity_mps < 0.01  # RTKLIB's has a constant of some mm/s: truth is ours


@needs_rtklib
def test_klobuchar_is_rtklib_s_too(tmp_path: Path) -> None:
    settings = ("seconds=10", "satellites.systems=[GPS]", "surroundings=[]")
    _stations(tmp_path, "urban_short", "atmosphere={troposphere: false}", *settings)
    models = PvtParameters(troposphere="none")
    assert single_points(tmp_path / "rover.obs", tmp_path / "nav.rnx", models).position_m < 1e-3


@needs_rtklib
def test_code_double_differences_are_rtklib_s(tmp_path: Path) -> None:
    """Ten metres apart, where RTKLIB's troposphere is the same at both ends."""
    settings = ("satellites.systems=[GPS, BDS]", f"streams={_BANDS}", "seconds=30")
    simulation = _stations(tmp_path, "static", "base={offset: [5, 8, 0], interval: 1}", *settings)
    scenario = simulation.scenario
    r_e_m = scenario.vehicle.point(np.zeros(1), scenario.antennas[0].lever_b_m).r_m[0]
    base_r_e_m = read_obs(tmp_path / "base.obs").position_e_m
    assert base_r_e_m is not None
    files = (tmp_path / name for name in ("rover.obs", "base.obs", "nav.rnx"))
    found = code_differences(*files, r_e_m, base_r_e_m)
    assert found.pairs == found.shared > 400
    assert found.largest_m < 5e-4
    # the base's 0.3 m in both satellites of a pair
    assert found.sigma_m == pytest.approx(0.3 * np.sqrt(2.0), rel=0.1)
