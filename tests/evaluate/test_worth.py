"""Two runs side by side, from the tables they leave."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.evaluate.worth import worth


def _folder(path: Path, lost: int, errors_m: list[str]) -> Path:
    path.mkdir()
    (path / "solution.csv").write_text("tow_s,valid\n1,1\n2,0\n3,1\n4,1\n")
    rows = ["satellite,carrier_valid,slip", "G01,1,1", "G02,1,0", "G01,0,1", "G02,1,1"]
    (path / "observations.csv").write_text("\n".join(rows) + "\n")
    events = ["what", *["lost"] * lost, "PLL"]
    (path / "events.csv").write_text("\n".join(events) + "\n")
    (path / "errors.csv").write_text("\n".join(["horizontal_m", *errors_m]) + "\n")
    head = "quantity,mean,std,rms,p50,p95,max\n"
    (path / "statistics.csv").write_text(head + "horizontal_m,1,1,2.25,1.50,4.75,5\n")
    return path


def test_figures_stand_beside_each_other(tmp_path: Path) -> None:
    aided = _folder(tmp_path / "aided", 1, ["1.0", '""', "2.9", "3.1"])
    unaided = _folder(tmp_path / "unaided", 7, ["3.5", '""', "4.0", "0.5"])
    rows = {name: figures for name, *figures in worth([aided, unaided], True)}
    assert rows["epochs with a fix"] == ["75.00 %", "75.00 %"]
    assert rows["ranges per epoch"] == ["1.00", "1.00"]
    assert rows["phases per epoch"] == ["0.75", "0.75"]
    assert rows["possible slips"] == ["2", "2"]  # a slip counts where there is a phase
    assert rows["satellites lost"] == ["1", "7"]
    assert rows["horizontal error, RMS"] == ["2.25 m", "2.25 m"]
    assert rows["horizontal error, CEP50 / 95"] == ["1.50 / 4.75 m", "1.50 / 4.75 m"]
    assert rows["horizontal errors above 3 m"] == ["33.33 %", "66.67 %"]


def test_without_truth_nothing_is_said_of_errors(tmp_path: Path) -> None:
    rows = worth([_folder(tmp_path / "one", 0, [])], False)
    assert not [name for name, *_ in rows if "error" in name]


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
