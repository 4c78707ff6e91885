"""`deepgnss snapshot`: fixes, files, and one clear line for what is lacking."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

from deepgnss.cli.main import cli

CONFIG = """
recording:
  start_time: 2012-01-26T12:45:30Z
  duration: 0.012
  streams:
    - name: L1
      format: bits2
      samples: real
      packing: {order: lsb_first, code: levels, levels: [1, 3, -3, -1]}
      sample_rate: 20.48e6
      centre_frequency: 1575.42e6
      intermediate_frequency: 5499998.474
position: [52.0, 10.0, 500.0]
"""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["snapshot", *map(str, arguments)])


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "flight.yaml"
    path.write_text(CONFIG)
    return path


def test_aircraft(shared_data: Path, config: Path, tmp_path: Path) -> None:
    folder = shared_data / "real" / "if" / "iotgnss-flight"
    recording, nav = (folder / f"sxnsr_test_data_flight.{end}" for end in ("stream", "12n"))
    out = tmp_path / "out"
    result = run(recording, "--config", config, "--nav", nav, "-o", out)
    assert result.exit_code == 0, result.output
    table = pd.read_csv(out / "solution.csv")
    place = table.loc[0, ["x_e_m", "y_e_m", "z_e_m"]].to_numpy(float)
    assert np.linalg.norm(place - [3839479.7, 721777.3, 5025349.9]) < 40.0
    assert "velocity" in result.output
    track = json.loads((out / "track.geojson").read_text())
    lon, lat = track["features"][0]["geometry"]["coordinates"][0][:2]
    assert (lat, lon) == (pytest.approx(52.32, abs=0.02), pytest.approx(10.65, abs=0.02))
    assert sorted(path.name for path in out.iterdir()) == [
        "satellites.csv",
        "solution.csv",
        "track.geojson",
    ]
    nobody = run(recording, "--config", config)
    assert (nobody.exit_code, nobody.output.count("\n")) == (2, 1)
    assert "nav:" in nobody.output
    other_day = shared_data / "real" / "nav" / "brdc0010.22n"
    wrong = run(recording, "--config", config, "--nav", other_day)
    assert (wrong.exit_code, wrong.output.count("\n")) == (2, 1)
    assert "no ephemeris for 2012-01-26" in wrong.output
    timeless = run(
        recording, "--config", config, "--nav", nav, "--set", "recording.start_time=null"
    )
    assert timeless.exit_code == 2
    assert "recording.start_time" in timeless.output


def test_logger_file(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "real" / "if" / "snappergps" / "snapshots" / "w00.json"
    content = json.loads(source.read_text())
    content["snapshots"] = content["snapshots"][200:203]
    recording = tmp_path / "walk.json"
    recording.write_text(json.dumps(content))
    nav = shared_data / "real" / "gnss" / "snapper-ubx" / "w00_f9p.nav"
    result = run(recording, "--nav", nav, "--velocity", 10)
    assert result.exit_code == 0, result.output
    assert "3 of 3 snapshots fixed" in result.output
