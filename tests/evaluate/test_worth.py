"""Two runs side by side, from the tables they leave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.evaluate.metrics import metrics
from deepgnss.evaluate.worth import worth


def _folder(path: Path, lost: int, errors_m: list[str]) -> Path:
    """Twelve epochs of five seconds: a minute, of which one epoch in four has no position."""
    path.mkdir()
    times = [f"2290,{5 * k}" for k in range(12)]
    solution = ["week,tow_s,valid", *(f"{t},{int(k % 4 != 1)}" for k, t in enumerate(times))]
    (path / "solution.csv").write_text("\n".join(solution) + "\n")
    rows = ["week,tow_s,satellite,carrier_valid,slip"]
    for k, t in enumerate(times):
        rows += [f"{t},G01,1,{int(k == 3)}", f"{t},G02,{int(k < 6)},{int(k > 8)}"]
    (path / "observations.csv").write_text("\n".join(rows) + "\n")
    events = ["recording_s,what", *["7,lost"] * lost, "8,PLL"]
    (path / "events.csv").write_text("\n".join(events) + "\n")
    if errors_m:
        head = "week,tow_s,horizontal_m,down_m,v_north_mps,v_east_mps"
        found = [f"{t},{e},2.0,0,0" for t, e in zip(times, errors_m, strict=True)]
        (path / "errors.csv").write_text("\n".join([head, *found]) + "\n")
    (path / "summary.json").write_text('{"first_fix_s": 0.2}')
    return path


def test_figures_stand_beside_each_other(tmp_path: Path) -> None:
    aided = _folder(tmp_path / "aided", 1, ["1.0", "", "2.9", "3.1"] * 3)
    unaided = _folder(tmp_path / "unaided", 7, ["3.5", "", "4.0", "0.5"] * 3)
    rows = {name: figures for name, *figures in worth([aided, unaided])}
    assert rows["epochs with a fix"] == ["75.00 %", "75.00 %"]
    assert rows["ranges per epoch"] == ["2.00", "2.00"]
    assert rows["phases per epoch"] == ["1.50", "1.50"]
    assert rows["possible slips per minute"] == ["1.0", "1.0"]  # counted where there is a phase
    assert rows["satellites lost per minute"] == ["1.0", "7.0"]
    assert rows["horizontal error, RMS"] == ["2.52 m", "3.08 m"]
    assert rows["horizontal error, CEP50"] == ["2.90 m", "3.50 m"]
    assert rows["horizontal errors above 3 m"] == ["33.33 %", "66.67 %"]


def test_without_truth_nothing_is_said_of_errors(tmp_path: Path) -> None:
    rows = worth([_folder(tmp_path / "one", 0, [])])
    assert rows and not [name for name, *_ in rows if "error" in name]


def test_noise_is_that_of_the_mean_for_independent_errors(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "run", 0, [])
    generator = np.random.default_rng(5)
    found = []
    for _ in range(80):
        sizes = np.abs(generator.normal(0.0, 2.0, 64))
        rows = [f"2290,{k},{size:.6f},0,0,0" for k, size in enumerate(sizes)]
        head = "week,tow_s,horizontal_m,down_m,v_north_mps,v_east_mps"
        (folder / "errors.csv").write_text("\n".join([head, *rows]) + "\n")
        solution = ["week,tow_s,valid", *(f"2290,{k},1" for k in range(64))]
        (folder / "solution.csv").write_text("\n".join(solution) + "\n")
        found.append(metrics(folder)["horizontal_rms_m"])
    spread = float(np.std([metric.value for metric in found]))
    told = float(np.sqrt(np.mean([metric.noise**2 for metric in found])))
    assert 0.8 < told / spread < 1.25


def test_both_needs_an_inertial_log_and_tables(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").touch()
    config = tmp_path / "car.yaml"
    config.write_text("recording: {streams: [{format: int8, sample_rate: 4e6}]}\n")
    arguments = ["process", "rec.bin", "--config", str(config), "--both"]
    run = CliRunner().invoke(cli, arguments)
    assert run.exit_code == 2 and "--both needs the log of an inertial unit" in run.stderr
    config.write_text(config.read_text() + "imu: {file: imu.csv}\noutput: {csv: false}\n")
    run = CliRunner().invoke(cli, arguments)
    assert run.exit_code == 2 and "output.csv: found false" in run.stderr
