"""Many drives: each by itself, kept when done, run again when killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from deepgnss.core.errors import ConfigError
from deepgnss.evaluate.batch import RECORD, Drive, earlier, find_drives, run_drive, run_here

_GOOD = "import pathlib, sys; pathlib.Path(sys.argv[1], 'summary.json').write_text('{}')"
_BAD = "print('note: x'); print('error: no samples'); raise SystemExit(2)"
# Kills itself the first time it is run, as the system does when memory runs out.
_KILLED_ONCE = (
    "import os, pathlib, sys; there = pathlib.Path(sys.argv[1]);"
    "first = not (there / 'again').exists(); (there / 'again').touch();"
    "os.kill(os.getpid(), 9) if first else (there / 'summary.json').write_text('{}')"
)
_SLOW = "import time; time.sleep(60)"


def _drives(folder: Path, *names: str) -> list[Drive]:
    for name in names:
        (folder / f"{name}.bin").write_bytes(bytes(64))
        (folder / f"{name}.yaml").write_text(
            f"recording: {{streams: [{{file: {name}.bin, format: int8, sample_rate: 4.0e6}}]}}\n"
            f"output: {{directory: out_{name}}}\n"
        )
    return find_drives([str(folder / "*.yaml")])


def _scripts(**by_name: str) -> object:
    def command(drive: Drive) -> Sequence[str]:
        return [sys.executable, "-c", by_name[drive.name], str(drive.folder)]

    return command


def test_one_that_fails_and_one_that_is_killed_stop_no_other(tmp_path: Path) -> None:
    drives = _drives(tmp_path, "a", "b", "c", "d")
    command = _scripts(a=_GOOD, b=_BAD, c=_KILLED_ONCE, d=_GOOD)
    outcomes = {o.name: o for o in run_here(drives, 2, command)}  # type: ignore[arg-type]
    assert {name: o.code for name, o in outcomes.items()} == {"a": 0, "b": 2, "c": 0, "d": 0}
    assert outcomes["b"].reason == "error: no samples"
    assert [earlier(drive) is not None for drive in drives] == [True, False, True, True]


def test_a_drive_that_is_killed_again_and_again_says_so(tmp_path: Path) -> None:
    (drive,) = _drives(tmp_path, "a")
    kill = "import os; os.kill(os.getpid(), 9)"
    outcome = run_drive(drive, _scripts(a=kill))  # type: ignore[arg-type]
    assert (outcome.code, outcome.done) == (-signal.SIGKILL, False)
    assert outcome.reason == "killed by signal 9 (attempt 2 of 2)"
    assert earlier(drive) is None


def test_what_is_done_is_kept_until_settings_or_files_change(tmp_path: Path) -> None:
    (drive,) = _drives(tmp_path, "a")
    assert earlier(drive) is None
    run_drive(drive, _scripts(a=_GOOD))  # type: ignore[arg-type]
    kept = earlier(*find_drives([str(drive.config)]))
    assert kept is not None and kept.kept and kept.code == 0
    assert earlier(*find_drives([str(drive.config)], settings=("output.interval=0.5",))) is None
    os.utime(drive.recording, (1.0, 1.0))
    assert earlier(*find_drives([str(drive.config)])) is None


def test_a_record_that_was_cut_off_counts_for_nothing(tmp_path: Path) -> None:
    (drive,) = _drives(tmp_path, "a")
    run_drive(drive, _scripts(a=_GOOD))  # type: ignore[arg-type]
    record = drive.folder / RECORD
    assert json.loads(record.read_text())["code"] == 0
    record.write_text(record.read_text()[:20])
    assert earlier(drive) is None


def test_a_run_that_outlived_its_worker_is_waited_for(tmp_path: Path) -> None:
    (drive,) = _drives(tmp_path, "a")
    marks = "p = pathlib.Path(sys.argv[1], 'marks'); f = p.open('a')"
    script = (
        f"import pathlib, sys, time; {marks}; f.write('<'); f.flush(); time.sleep(1.0);"
        "f.write('>'); f.flush()"
    )
    worker = (
        "import sys; from deepgnss.evaluate.batch import find_drives, run_drive;"
        f"run_drive(*find_drives([{str(drive.config)!r}]),"
        f" lambda drive: [sys.executable, '-c', {script!r}, str(drive.folder)])"
    )
    with subprocess.Popen([sys.executable, "-c", worker]) as first:
        while not (drive.folder / "marks").exists():
            time.sleep(0.02)
        first.kill()
    run_drive(drive, _scripts(a=script))  # type: ignore[arg-type]
    assert (drive.folder / "marks").read_text() == "<><>"


def test_leaving_early_stops_the_runs(tmp_path: Path) -> None:
    drives = _drives(tmp_path, "a", "b", "c")
    runs = run_here(drives, 2, _scripts(a=_GOOD, b=_SLOW, c=_SLOW))  # type: ignore[arg-type]
    began = time.monotonic()
    assert next(runs).name == "a"
    runs.close()  # type: ignore[attr-defined]
    assert time.monotonic() - began < 20.0


def test_drives_are_refused_that_cannot_be_told_apart_or_run(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        find_drives([str(tmp_path / "*.yaml")])
    _drives(tmp_path, "a")
    other = tmp_path / "b.yaml"
    other.write_text((tmp_path / "a.yaml").read_text())
    with pytest.raises(ConfigError, match=r"b\.yaml: writes into .*out_a as .*a\.yaml does"):
        find_drives([str(tmp_path / "*.yaml")])
    apart = find_drives([str(tmp_path / "*.yaml")], tmp_path / "all")
    assert [drive.folder.name for drive in apart] == ["a", "b"]
    other.write_text("recording: {streams: [{format: int8, sample_rate: 4.0e6}]}\n")
    with pytest.raises(ConfigError, match=r"b\.yaml: recording\.streams\[0\]\.file: found nothing"):
        find_drives([str(other)])


@pytest.mark.slow
def test_six_drives_survive_the_kill_of_one(tmp_path: Path) -> None:
    program = [sys.executable, "-m", "deepgnss.cli.main"]
    for seed in range(1, 7):
        folder = tmp_path / f"drive{seed}"
        size = ("--seconds", "9", "--seed", str(seed), "--set", "streams[0].sample_rate=2.61e6")
        subprocess.run(
            [*program, "simulate", "static", *size, "-o", str(folder)],
            check=True,
            capture_output=True,
        )
        config = (
            (folder / "config.yaml").read_text().replace("{name: L1,", "{name: L1, file: rec.bin,")
        )
        (folder / f"drive{seed}.yaml").write_text(f"nav: nav.rnx\nstart: causal\n{config}")
    batch = [*program, "batch", str(tmp_path / "drive*/drive*.yaml"), "--jobs", "2"]
    with subprocess.Popen([*batch, "-o", str(tmp_path / "out")], stderr=subprocess.PIPE) as run:
        while not (at_work := _children(run.pid)) and run.poll() is None:
            time.sleep(0.1)
        time.sleep(3.0)  # well into its work
        os.kill(at_work[0], signal.SIGKILL)
        _, said = run.communicate()
    assert run.returncode == 0, said
    for seed in range(1, 7):
        summary = json.loads((tmp_path / f"out/drive{seed}/summary.json").read_text())
        assert summary["epochs_fixed"] > 0
    again = subprocess.run(
        [*batch, "-o", str(tmp_path / "out")], check=True, capture_output=True, text=True
    )
    assert "6 of 6 drives were done before" in again.stderr


def _children(pid: int) -> list[int]:
    """Processes a process has started."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]
