"""The files of a simulated recording, read back by the readers that process uses."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.core.errors import ConfigError, OutputError
from deepgnss.io.config import load_config
from deepgnss.io.formats import ValueFormat
from deepgnss.io.recording import Recording
from deepgnss.io.rinex_nav import read_nav
from deepgnss.sim.converter import convert, step_over_sigma
from deepgnss.sim.output import write_simulation
from deepgnss.sim.output.settings import config_of
from deepgnss.sim.scenario import Emitter, FrontEnd, Stream
from deepgnss.sim.schema import Simulation, build, load_scenario

SETTINGS = (
    "satellites={systems: [GPS], mask: 10, limit: 9}",
    "streams=[{format: bits2, sample_rate: 4e6}]",
)


def _simulation() -> Simulation:
    return build(load_scenario("open_sky", ["seconds=0.5", *SETTINGS]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo")
    chosen = [part for setting in SETTINGS for part in ("--set", setting)]
    arguments = ["simulate", "open_sky", *chosen, "--seconds", "0.5", "-o", str(path)]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    return path


def test_config_describes_the_recording(folder: Path) -> None:
    config = load_config(folder / "config.yaml")
    formats = [stream.stream_format() for stream in config.recording.streams]
    with Recording(formats, folder / "rec.bin") as recording:
        assert recording.notes == ()
        stream = recording.streams[0]
        assert stream.sample_count == 2_000_000
        samples = recording.read(0, 0, 1_000_000).samples
    values, counts = np.unique(samples, return_counts=True)
    assert values.tolist() == [-3, -1, 1, 3]
    # two bits at Max's step of 0.9957 σ: a third lies beyond one step
    assert counts / counts.sum() == pytest.approx([0.160, 0.340, 0.340, 0.160], abs=0.005)
    assert not list(folder.glob("*.part"))


def test_navigation_file_holds_the_true_orbits(folder: Path) -> None:
    """To the digits of a RINEX file: 13 for the orbits, 11 and 10 for UTC."""
    truth, nav = _simulation().scenario.nav, read_nav(folder / "nav.rnx")
    assert truth.utc is not None and nav.utc is not None
    assert nav.utc.a0_s == pytest.approx(truth.utc.a0_s, rel=1e-10)
    assert nav.utc.a1_sps == pytest.approx(truth.utc.a1_sps, rel=1e-9)
    assert nav.utc[2:] == truth.utc[2:]
    assert set(nav.ephemerides) == set(truth.ephemerides)
    for satellite, (ephemeris,) in truth.ephemerides.items():
        (read,) = nav.ephemerides[satellite]
        for field in fields(ephemeris):
            value = getattr(ephemeris, field.name)
            same = pytest.approx(value, rel=1e-12) if field.type == "float" else value
            assert getattr(read, field.name) == same, field.name


@pytest.mark.parametrize(
    ("container", "bits"),
    [("bits1", None), ("bits2", None), ("bits4", None), ("int8", 2), ("int8", 8), ("int16", None)],
)
def test_readers_see_the_levels(tmp_path: Path, container: ValueFormat, bits: int | None) -> None:
    """Float samples through converter, file and reader come out as the nearest level."""
    front_end = FrontEnd(4.0e6, container, bits)
    samples = np.random.default_rng(8).standard_normal((2, 4096)).astype(np.float32) * 7.0
    path = tmp_path / "rec.bin"
    path.write_bytes(convert(samples, 7.0, front_end))
    simulation = _simulation()
    scenario = replace(simulation.scenario, streams=(Stream("L1", front_end),))
    stream = config_of(replace(simulation, scenario=scenario))["recording"]["streams"][0]
    settings = [f"recording.streams=[{{{', '.join(f'{k}: {v}' for k, v in stream.items())}}}]"]
    config = load_config(None, settings)
    with Recording([s.stream_format() for s in config.recording.streams], path) as recording:
        read = recording.read(0, 0, 4096).samples.T.astype(np.float64)
    resolution = front_end.converter_bits
    steps = samples.astype(np.float64) / 7.0 / step_over_sigma(resolution)
    if resolution <= 4:
        levels = np.arange(1 - 2**resolution, 2**resolution, 2)
        nearest = levels[np.abs(2.0 * steps[..., None] - levels).argmin(axis=2)]
    else:
        top = 2 ** (resolution - 1) - 1
        nearest = np.clip(np.round(steps), -top, top)
    assert np.mean(read != nearest) < 1e-3  # ties of float32


def test_impossible_scenarios_are_refused_in_one_line() -> None:
    scenario = _simulation().scenario
    bad = [
        lambda: replace(scenario, emitters=(Emitter("G32", ((0.0, 45.0),)),)),
        lambda: replace(scenario, seconds=-1.0),
        lambda: FrontEnd(4.0e6, bits=12),
        lambda: FrontEnd(4.0e6, bandwidth_hz=5.0e6),
        lambda: FrontEnd(4.0e6, is_complex=False, intermediate_hz=3.0e6),
        lambda: FrontEnd(1.0),
        lambda: Emitter("G01", ((1.0, 45.0),)),
    ]
    for make in bad:
        with pytest.raises(ConfigError) as error:
            make()
        assert "\n" not in str(error.value)
        assert ": " in str(error.value)


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(OutputError, match="taken"):
        write_simulation(_simulation(), tmp_path / "taken")
