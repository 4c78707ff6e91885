"""A batch on a Dask cluster of two workers, one of which is killed at work."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.evaluate.batch import Drive, earlier, find_drives, run_on_cluster

distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")

# The first run kills the worker that runs it (its parent), not itself.
_KILLS_ITS_WORKER = (
    "import os, pathlib, signal, sys; there = pathlib.Path(sys.argv[1]);"
    "first = not (there / 'again').exists(); (there / 'again').touch();"
    "os.kill(os.getppid(), signal.SIGKILL) if first else None;"
    "(there / 'summary.json').write_text('{}')"
)
_GOOD = "import pathlib, sys; pathlib.Path(sys.argv[1], 'summary.json').write_text('{}')"


def _command(drive: Drive) -> Sequence[str]:
    script = _KILLS_ITS_WORKER if drive.name == "c" else _GOOD
    return [sys.executable, "-c", script, str(drive.folder)]


def test_a_worker_killed_at_work_costs_no_drive(tmp_path: Path) -> None:
    for name in "abcdef":
        (tmp_path / f"{name}.bin").write_bytes(bytes(64))
        (tmp_path / f"{name}.yaml").write_text(
            f"recording: {{streams: [{{file: {name}.bin, format: int8, sample_rate: 4.0e6}}]}}\n"
        )
    drives = find_drives([str(tmp_path / "*.yaml")], tmp_path / "out")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        workers = {worker.pid for worker in cluster.workers.values()}
        outcomes = list(run_on_cluster(drives, cluster.scheduler_address, _command))
        now = {worker.pid for worker in cluster.workers.values()}
    assert sorted(outcome.name for outcome in outcomes) == list("abcdef")
    assert all(outcome.done for outcome in outcomes)
    assert all(earlier(drive) is not None for drive in drives)
    assert len(workers - now) == 1  # one was killed indeed, and another took its place
    with pytest.raises(ProcessLookupError):
        os.kill((workers - now).pop(), signal.SIG_DFL)


def test_an_address_without_a_scheduler_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deepgnss.evaluate.batch._ANSWER_S", 1.0)
    (tmp_path / "a.bin").write_bytes(bytes(64))
    (tmp_path / "a.yaml").write_text(
        "recording: {streams: [{file: a.bin, format: int8, sample_rate: 4.0e6}]}\n"
    )
    run = CliRunner().invoke(
        cli, ["batch", str(tmp_path / "a.yaml"), "--scheduler", "tcp://127.0.0.1:9"]
    )
    assert run.exit_code == 2
    assert "no Dask scheduler answers" in run.output
