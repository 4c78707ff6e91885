"""Scenario files: what they refuse, what they make, and that they make it again."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.core.errors import ConfigError, OutputError
from deepgnss.io.config import load_config, notes, resolved_yaml
from deepgnss.io.metadata import open_recording
from deepgnss.sim.output import write_simulation
from deepgnss.sim.output.settings import config_of
from deepgnss.sim.schema import build, load_scenario, ready_scenarios

REDUCED_HZ = 2.6e6
NAMES = [ready.name for ready in ready_scenarios()]


def reduced(name: str, seconds: float, *settings: str) -> list[str]:
    """Settings that make a ready scenario short and small."""
    streams = load_scenario(name).streams
    rates = [f"streams[{k}].sample_rate={REDUCED_HZ}" for k in range(len(streams))]
    return [f"seconds={seconds}", *rates, *settings]


@pytest.mark.parametrize("name", NAMES)
def test_ready_scenarios_make_what_their_config_describes(name: str, tmp_path: Path) -> None:
    simulation = build(load_scenario(name, reduced(name, 0.2)))
    assert simulation.scenario.name == name
    written = write_simulation(simulation, tmp_path)
    assert {file.path.name for file in written.files} == {p.name for p in tmp_path.iterdir()}
    config = load_config(written.config)
    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, _ = open_recording(written.recording, formats)
    with opened:
        assert opened.notes == ()
        assert len(opened.streams) == len(simulation.scenario.streams)
        for stream in opened.streams:
            assert stream.sample_count == pytest.approx(0.2 * stream.sample_rate_hz, abs=8)


def test_wheels_are_used_on_a_road_and_only_there(tmp_path: Path) -> None:
    """The unit rides on the axle that rolls; a swing is no road, its wheel speed stays a file."""
    written = write_simulation(
        build(load_scenario("urban_short", reduced("urban_short", 0.2))), tmp_path
    )
    config = load_config(written.config)
    assert config.odometer is not None
    assert config.ins.vehicle is not None
    assert config.ins.vehicle.axle == (0.0, 0.0, 0.0)
    assert not [line for line in notes(config) if line.startswith("odometer")]
    swing = load_scenario("acceleration_100g", ["odometer={rate: 10}", "seconds=0.2"])
    assert not {"odometer", "ins"} & config_of(build(swing)).keys()


def test_ready_scenarios_are_listed_with_what_they_are_for() -> None:
    wanted = "open_sky static acceleration_100g urban urban_short weak blockage_20s two_antennas"
    assert set(wanted.split()) <= set(NAMES)
    listed = CliRunner().invoke(cli, ["simulate", "--list"])
    assert listed.exit_code == 0
    for ready in ready_scenarios():
        assert ready.about
        assert ready.name in listed.output


def test_resolved_scenario_makes_the_same_bytes_again(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    settings = reduced("urban_short", 0.3, "seed=7")
    write_simulation(build(load_scenario("urban_short", settings)), first, threads=2)
    again = load_scenario(first / "scenario.yaml")
    write_simulation(build(again), second, threads=1)
    names = sorted(path.name for path in first.iterdir())
    assert names == sorted(path.name for path in second.iterdir())
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def test_another_seed_makes_other_samples_of_the_same_drive(tmp_path: Path) -> None:
    for seed in (1, 2):
        settings = reduced("urban_short", 0.1, f"seed={seed}")
        write_simulation(build(load_scenario("urban_short", settings)), tmp_path / str(seed))
    one, two = tmp_path / "1", tmp_path / "2"
    assert (one / "truth.csv").read_bytes() == (two / "truth.csv").read_bytes()
    assert (one / "rec_L1.bin").read_bytes() != (two / "rec_L1.bin").read_bytes()


@pytest.mark.parametrize(
    ("settings", "key", "hint"),
    [
        (["satellites.only=[G05, G01]"], "satellites.only", "below the horizon"),
        (["satellites.only=[G32]"], "satellites.only", "no ephemeris"),
        (["satellites.only=[E05]"], "satellites.only[0]", "G01 to G32"),
        (["satellites.mask=89"], "satellites.mask", "no satellite"),
        (["streams[0].intermediate_frequency=9e6"], "streams[0].intermediate_frequency", "±"),
        (["streams[0].samples=real"], "streams[0].intermediate_frequency", "half"),
        (["streams[0].bits=12"], "streams[0].bits", "8"),
        (["streams[0].bandwidth=8e6"], "streams[0].bandwidth", "below 4000000"),
        (["streams[0].centre_frequency=1.2e9"], "streams", "none samples"),
        (["streams[0].antenna=roof"], "streams[0].antenna", "main"),
        (["base={offset: [500, 800, -3]}"], "base.interval", "missing"),
        (["imu={rate: 20}"], "imu.rate", "50 to 2000"),
        (["seconds=-1"], "seconds", "above 0"),
        (["oscillator=XO"], "oscillator", "OCXO"),
        (["satelites={}"], "satelites", "did you mean 'satellites'"),
        (["satellites.schedule={G05: [[1, 45]]}"], "satellites.schedule.G05", "start at 0"),
        (["satellites.blocked={all: [[30, 20]]}"], "satellites.blocked.all[0]", "before"),
    ],
)
def test_impossible_scenarios_are_refused_in_one_line(
    settings: list[str], key: str, hint: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        build(load_scenario("static", settings))
    (line,) = str(caught.value).splitlines()
    assert key in line
    assert hint in line


def test_errors_name_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text("name: drive\nsatellites:\n  mask: 99\n")
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}:3: satellites.mask: found 99; expected 0 to 90")


def test_command_ends_with_files_and_what_to_do_next(tmp_path: Path) -> None:
    chosen = [part for setting in reduced("static", 0.1) for part in ("--set", setting)]
    place = tmp_path / "made"
    run = CliRunner().invoke(cli, ["simulate", "static", *chosen, "--seed", "4", "-o", str(place)])
    assert run.exit_code == 0, run.output
    assert f"deepgnss process {place}/rec.bin --config {place}/config.yaml" in run.output
    for path in place.iterdir():
        assert f"\n{path.name} " in run.output
    assert load_scenario(place / "scenario.yaml").seed == 4
    for missing in (["simulate"], ["simulate", "static"]):
        refused = CliRunner().invoke(cli, missing)
        assert refused.exit_code == 2
        assert "Missing" in refused.stderr


def test_an_unknown_name_lists_the_ready_ones() -> None:
    run = CliRunner().invoke(cli, ["simulate", "moon", "-o", "moon"])
    assert run.exit_code == 2
    (line,) = run.stderr.splitlines()
    assert "moon" in line and "open_sky" in line


def test_a_disk_too_small_is_told_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = build(load_scenario("static", ["seconds=10"]))
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=79_999_999))
    with pytest.raises(OutputError, match=r"needs 8\d{7} bytes, the disk has 79999999 free"):
        write_simulation(simulation, tmp_path / "big")
    assert not (tmp_path / "big").exists()


def test_what_the_scenario_reads_is_not_replaced(tmp_path: Path) -> None:
    settings = reduced("static", 0.1)
    written = write_simulation(build(load_scenario("static", settings)), tmp_path)
    before = (tmp_path / "nav.rnx").read_bytes()
    simulation = build(load_scenario("static", [*settings, f"satellites.nav={tmp_path}/nav.rnx"]))
    with pytest.raises(OutputError, match=r"nav\.rnx: read by the scenario"):
        write_simulation(simulation, tmp_path)
    assert (tmp_path / "nav.rnx").read_bytes() == before
    # from that file comes the same sky, to its digits (five of the ionosphere: some 10 µm)
    again = write_simulation(simulation, tmp_path / "again")
    one, two = (np.fromfile(made.recording, np.int8) for made in (written, again))
    assert np.mean(one != two) < 0.01
    assert np.abs(one.astype(int) - two).max() <= 1


def test_show_prints_what_reads_back_the_same(tmp_path: Path) -> None:
    for name in NAMES:
        shown = CliRunner().invoke(cli, ["simulate", name, "--show", "--seed", "5"])
        assert shown.exit_code == 0
        path = tmp_path / "shown.yaml"
        path.write_text(shown.output)
        again = load_scenario(path)
        assert again.seed == 5
        assert resolved_yaml(again) == shown.output


def test_an_interrupt_leaves_whole_files_and_parts(tmp_path: Path) -> None:
    simulation = build(load_scenario("static", reduced("static", 2.0)))

    def interrupt(done_s: float) -> None:
        if done_s > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_simulation(simulation, tmp_path, progress=interrupt)
    left = {path.name for path in tmp_path.iterdir()}
    assert "rec.bin" not in left
    assert (tmp_path / "rec.bin.part").stat().st_size % 8192 == 0
    assert "truth.csv" in left and "truth.csv.part" not in left
