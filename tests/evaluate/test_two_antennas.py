"""The two-antenna method on observation files: simulated, real, and what it writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import State
from deepgnss.evaluate.antenna_pair import AntennaPair, antenna_pair
from deepgnss.evaluate.observations import read_observations
from deepgnss.evaluate.single_point import at_rest, single_point
from deepgnss.evaluate.slip_trials import OURS, Inserted, method_scores, random_slips, with_slips
from deepgnss.evaluate.slips import Expected, find_slips
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.io.rinex_obs_reader import ObsFile, read_obs
from deepgnss.io.truth import Trajectory, read_truth
from deepgnss.sim.motion.vehicle import geographic
from deepgnss.sim.output.columns import time_columns
from deepgnss.sim.output.pair import write_pair
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import build, load_scenario

BASELINE = (-2.535, 0.4, -0.3)
SECONDS = 40
_ANTENNAS = (("a", 0.9, 0.1, -1.2), ("b", -1.635, 0.5, -1.5))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    antennas = (f"{{name: {name}, lever_arm: {list(arm)}}}" for name, *arm in _ANTENNAS)
    arms = f"antennas=[{', '.join(antennas)}]"
    still = "trajectory.street.stops=[]"
    return build(
        load_scenario("reproduce/slips", (f"seconds={SECONDS}", arms, still, "seed=4"))
    ).scenario


@pytest.fixture(scope="module")
def folder(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both receivers' files, NAV, and the true trajectory of the first antenna with attitude."""
    place = tmp_path_factory.mktemp("pair")
    write_pair(place, scenario)
    write_nav(place / "nav.rnx", scenario.nav)
    t_s = np.arange(-1.0, SECONDS + 2.0, 0.2)
    seen = geographic(scenario.vehicle.pose(t_s))
    week, tow_s = time_columns(scenario.start, t_s)
    # The place is the unit's: the way to the antennas is the lever arm.
    pd.DataFrame(
        {
            "week": week,
            "tow_s": tow_s,
            "lat_deg": np.degrees(seen.lat_rad),
            "lon_deg": np.degrees(seen.lon_rad),
            "height_m": seen.height_m,
            **dict(
                zip(
                    ("roll_deg", "pitch_deg", "heading_deg"),
                    np.degrees(seen.euler_rad).T,
                    strict=True,
                )
            ),
        }
    ).to_csv(place / "truth.csv", index=False, float_format="%.12g")
    return place


def pair_of(
    folder: Path,
    arms: tuple[tuple[float, ...], tuple[float, ...]] = ((0.9, 0.1, -1.2), (-1.635, 0.5, -1.5)),
    files: tuple[str, str] = ("first.obs", "second.obs"),
) -> AntennaPair:
    way = read_truth(folder / "truth.csv")
    one, two = (read_obs(folder / name) for name in files)
    return antenna_pair(
        one, two, (way.of_point(arms[0]), way.of_point(arms[1])), read_nav(folder / "nav.rnx")
    )


@pytest.fixture(scope="module")
def pair(folder: Path) -> AntennaPair:
    return pair_of(folder)


def spread_cycles(pair: AntennaPair) -> float:
    """σ of S's triple difference on L1."""
    own = [k for k, signal in enumerate(pair.signals) if signal.band == "1"]
    single = (pair.second.phase_m - pair.first.phase_m)[:, own]
    values = np.diff(single - single[:, :1], axis=0)[:, 1:] / pair.signals[own[0]].wavelength_m
    return float(np.nanstd(values))


def test_geometry_takes_everything_but_noise_off(pair: AntennaPair) -> None:
    """Clocks that jump by milliseconds, tags apart from truth, light time, both places."""
    jumps_m = np.nanmedian(np.diff(pair.second.code_m, axis=0))
    assert abs(jumps_m) < 1.0
    assert len(pair.time_s) >= SECONDS - 1 and len(pair.signals) >= 16
    assert spread_cycles(pair) < 0.025  # eight phases of some 1 to 1.5 mm


def test_wrong_axes_and_signs_show(pair: AntennaPair, folder: Path) -> None:
    """Each axis of the baseline, its direction, and the antennas' order matter."""
    right = spread_cycles(pair)
    first, second = (0.9, 0.1, -1.2), (-1.635, 0.5, -1.5)
    turned = np.add(first, np.subtract(first, second))
    for wrong in (turned, (second[1], second[0], second[2]), (second[0], 3.0, second[2])):
        assert spread_cycles(pair_of(folder, (first, tuple(wrong)))) > 2.0 * right
    swapped = pair_of(folder, (second, first), ("second.obs", "first.obs"))
    assert spread_cycles(swapped) == pytest.approx(right, rel=0.02)
    crossed = pair_of(folder, (first, second), ("second.obs", "first.obs"))
    assert spread_cycles(crossed) > 2.0 * right


def test_a_swapped_pair_tells_the_opposite(pair: AntennaPair, folder: Path) -> None:
    slips = random_slips(pair, 20, np.random.default_rng(2), hard=True)
    found = find_slips(with_slips(pair, slips), Expected())
    swapped = pair_of(folder, ((-1.635, 0.5, -1.5), (0.9, 0.1, -1.2)), ("second.obs", "first.obs"))
    back = find_slips(with_slips(swapped, Inserted(slips.second, slips.first)), Expected())
    np.testing.assert_array_equal(found.between.cycles, slips.between)
    np.testing.assert_array_equal(back.between.cycles, -slips.between)
    np.testing.assert_array_equal(back.shares.first, found.shares.second)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_random_slips_all_found_none_false(pair: AntennaPair, seed: int) -> None:
    slips = random_slips(pair, 60, np.random.default_rng(seed), hard=True)
    found = find_slips(with_slips(pair, slips), Expected())
    ours = method_scores(found, slips)[OURS]
    assert (ours.inserted, ours.found, ours.false) == (60, 60, 0)
    assert np.nanmax(np.abs(found.between.check_m)) < 0.025


def test_tags_that_differ_are_matched(folder: Path, scenario: Scenario) -> None:
    """A second receiver that tags each epoch by its own clock, off by milliseconds."""
    way = read_truth(folder / "truth.csv")
    places = way.of_point((0.9, 0.1, -1.2)), way.of_point((-1.635, 0.5, -1.5))
    one, two = (read_obs(folder / name) for name in ("first.obs", "second.obs"))
    nav = read_nav(folder / "nav.rnx")
    late_s = 0.003
    frame = two.frame.copy()
    # The same instants read on a clock 3 ms ahead: tag, range and phase all move with it.
    frame["tow_s"] += late_s
    for code in ("C1C", "C2W"):
        frame[code] += 299_792_458.0 * late_s
    frame["L1C"] += 1575.42e6 * late_s
    frame["L2W"] += 1227.60e6 * late_s
    moved = ObsFile(frame, two.version, two.position_e_m, two.interval_s, two.codes, two.lines)
    assert spread_cycles(antenna_pair(one, moved, places, nav)) < 0.025


# --- what it writes ------------------------------------------------------------------------------


def _options(folder: Path, out: Path) -> list[str]:
    return [
        *("slips", "--rover", str(folder / "first.obs"), "--second", str(folder / "second.obs")),
        *("--nav", str(folder / "nav.rnx"), "--attitude", str(folder / "truth.csv")),
        *("--baseline", *map(str, BASELINE), "--lever-arm", "0.9", "0.1", "-1.2", "-o", str(out)),
    ]


def _with_slip(source: Path, target: Path, satellite: str, code: str, tow_s: float) -> None:
    """A copy whose phase jumps by +2 cycles at an epoch, its LLI left alone."""
    read = read_obs(source)
    lines = source.read_text().split("\n")
    below, column = read.place(satellite[0], code)
    for row, line in zip(read.frame.itertuples(), read.lines, strict=True):
        if row.satellite == satellite and row.tow_s >= tow_s:
            text = lines[line + below]
            value = float(text[column : column + 14]) + 2.0
            lines[line + below] = text[:column] + f"{value:14.3f}" + text[column + 14 :]
    target.write_text("\n".join(lines))


def test_command_repairs_rinex(folder: Path, tmp_path: Path) -> None:
    truth = read_obs(folder / "second.obs")
    satellite, tow_s = "G14", float(truth.frame["tow_s"].unique()[25])
    _with_slip(folder / "second.obs", tmp_path / "second.obs", satellite, "L2W", tow_s)
    options = _options(folder, tmp_path / "out")
    options[4] = str(tmp_path / "second.obs")
    result = CliRunner().invoke(cli, [*options, "--no-figures"])
    assert result.exit_code == 0, result.output
    table = pd.read_csv(tmp_path / "out" / "slips.csv")
    assert table[["satellite", "band", "cycles", "antenna"]].to_numpy().tolist() == [
        [satellite, 2, 2.0, "second"]
    ]
    assert table["tow_s"].iloc[0] == pytest.approx(tow_s)
    fixed = read_obs(tmp_path / "out" / "second_repaired.rnx")
    np.testing.assert_allclose(fixed.frame["L2W"], truth.frame["L2W"], atol=1e-9)
    np.testing.assert_array_equal(fixed.frame["L1C"], truth.frame["L1C"])
    np.testing.assert_array_equal(fixed.frame["C1C"], truth.frame["C1C"])
    assert (tmp_path / "out" / "first_repaired.rnx").read_text() == (
        folder / "first.obs"
    ).read_text()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["slips"] == 1 and summary["phases"]["undecided"] == 0


def test_command_draws_and_scores_inserted_slips(folder: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        cli, [*_options(folder, tmp_path), "--insert", "40", "--hard", "--seed", "5"]
    )
    assert result.exit_code == 0, result.output
    assert "40 of 40" in result.output
    for name in ("detection.png", "residual.png", "check.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    assert not list(tmp_path.glob("*_repaired.rnx"))


@pytest.mark.parametrize(
    ("left_out", "words"),
    [
        ("--rover", "--rover: found nothing"),
        ("--attitude", "--attitude, --at-rest: expected one"),
        ("--baseline", "--baseline: found nothing"),
        ("--nav", "--nav: found nothing"),
    ],
)
def test_what_is_missing_is_named(folder: Path, tmp_path: Path, left_out: str, words: str) -> None:
    options = _options(folder, tmp_path)
    at = options.index(left_out)
    del options[at : at + (4 if left_out == "--baseline" else 2)]
    result = CliRunner().invoke(cli, options)
    assert result.exit_code == 2
    assert words in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_truth_without_attitude_is_refused(folder: Path, tmp_path: Path) -> None:
    way = pd.read_csv(folder / "truth.csv").drop(columns=["roll_deg"])
    way.to_csv(tmp_path / "way.csv", index=False)
    options = _options(folder, tmp_path / "out")
    options[options.index("--attitude") + 1] = str(tmp_path / "way.csv")
    result = CliRunner().invoke(cli, options)
    assert result.exit_code == 2
    assert "no attitude in it" in result.output


def test_attitude_that_covers_nothing_gives_1(folder: Path, tmp_path: Path) -> None:
    way = pd.read_csv(folder / "truth.csv")
    way.assign(tow_s=way["tow_s"] + 5000.0).to_csv(tmp_path / "way.csv", index=False)
    options = _options(folder, tmp_path / "out")
    options[options.index("--attitude") + 1] = str(tmp_path / "way.csv")
    result = CliRunner().invoke(cli, [*options, "--no-figures"])
    assert result.exit_code == 1
    assert "no phase could be tested" in result.output


# --- real receivers ------------------------------------------------------------------------------


def test_static_baseline_of_survey_receivers(shared_data: Path) -> None:
    """3.3 km apart, 30 s apart: nothing is told, not even where a low satellite is flagged."""
    folder = shared_data / "real/gnss/rtklib-2005"
    files = [read_obs(folder / name) for name in ("07590920.05o", "30400920.05o")]
    places = [file.position_e_m for file in files]
    assert places[0] is not None and places[1] is not None
    nav = read_nav(folder / "07590920.05n")
    pair = antenna_pair(files[0], files[1], (places[0], places[1]), nav)
    expected = Expected(attitude_radps=0.0, longest_s=90.0)
    found = find_slips(pair, expected)
    assert not found.between.cycles.any()
    assert (found.between.state == State.UNDECIDED).sum() <= 2
    flagged = pair.first.lost | pair.second.lost
    assert flagged[1:].sum() == 5 and (found.between.state[flagged] == State.CONTINUOUS).all()
    slips = random_slips(pair, 95, np.random.default_rng(1))
    ours = method_scores(find_slips(with_slips(pair, slips), expected), slips)[OURS]
    print(ours)
    assert ours.inserted == 95 and ours.found >= 94 and ours.false <= 3


@pytest.mark.parametrize(
    "chain", ["5m8", *(pytest.param(name, marks=pytest.mark.slow) for name in ("0m", "2m", "4m"))]
)
def test_two_chains_at_one_antenna(shared_data: Path, chain: str) -> None:
    """What does not go on as before is what the chains' raw phases differ by, orbits or not."""
    folder = shared_data / "real/gnss/jmfriedt-dualchain"
    files = [read_obs(folder / f"{chain}_gps_{k}.25O") for k in (1, 2)]
    nav = read_nav(folder / f"{chain}_gps_1.25N")
    place = at_rest(single_point(read_observations(folder / f"{chain}_gps_1.25O"), nav))
    assert place is not None
    pair = antenna_pair(files[0], files[1], (place, place), nav)
    state = find_slips(pair, Expected(attitude_radps=0.0)).between.state
    raw = _raw_steps(files, pair)
    known = np.isfinite(raw) & (state[1:] >= State.CONTINUOUS)
    jumps = np.abs(raw) > 0.25
    odd = (state == State.SLIPPED) | (state == State.UNDECIDED)
    print(chain, int(jumps[known].sum()), int(odd[1:][known].sum()), int(known.sum()))
    assert known.sum() > 150
    np.testing.assert_array_equal(odd[1:][known], jumps[known])


def _raw_steps(files: list[ObsFile], pair: AntennaPair) -> FloatArray:
    """Change of chain 2 less chain 1, cycles, against the median satellite; no orbits in it."""
    tables = [
        file.frame.pivot(index="tow_s", columns="satellite", values="L1C").reindex(
            index=pair.tow_s, columns=[signal.satellite for signal in pair.signals]
        )
        for file in files
    ]
    steps = np.diff((tables[1] - tables[0]).to_numpy(), axis=0)
    return np.asarray(steps - np.nanmedian(steps, axis=1, keepdims=True))


def test_of_point_keeps_distance_between_samples(folder: Path) -> None:
    way = read_truth(folder / "truth.csv")
    assert isinstance(way, Trajectory)
    one, two = way.of_point((0.0, 0.0, 0.0)), way.of_point(BASELINE)
    at_s = way.tow_s[5] + np.arange(0.0, 20.0, 0.03)
    week = int(way.week[0])
    apart_m = np.linalg.norm(two.at(week, at_s)[0] - one.at(week, at_s)[0], axis=1)
    np.testing.assert_allclose(apart_m, np.linalg.norm(BASELINE), atol=1e-3)
