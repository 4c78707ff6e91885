"""Bad input: one clear line, an exit code that is not zero, nothing that looks whole and is not."""

import csv
import errno
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from deepgnss.cli.main import cli
from deepgnss.core.records import NavData
from deepgnss.deep.outputs import FILES, Outputs
from deepgnss.io.folder import prepare_folder, written
from deepgnss.io.output import OutputFile
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.sim.output import write_simulation
from deepgnss.sim.schema import build, load_scenario

RATE_HZ = 2.6e6
SECONDS = 6.8
STREAM = "recording.streams[0]"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a recording, its config, its truth and its NAV file."""
    folder = tmp_path_factory.mktemp("drive")
    settings = [
        f"seconds={SECONDS}",
        "satellites={systems: [GPS], mask: 10, limit: 9}",
        f"streams=[{{format: bits2, sample_rate: {RATE_HZ}}}]",
        *("imu=null", "odometer=null"),
    ]
    write_simulation(build(load_scenario("open_sky", settings)), folder, threads=2)
    return folder


def process(drive: Path, out: Path, *settings: str, recording: Path | None = None) -> Result:
    chosen = [part for setting in settings for part in ("--set", setting)]
    return CliRunner().invoke(
        cli,
        [
            *("process", str(recording or drive / "rec.bin")),
            *("--config", str(drive / "config.yaml"), *chosen),
            *("--set", "output.report=false", "-o", str(out)),
        ],
    )


def complaints(run: Result) -> list[str]:
    """Lines of error, after a check that they are all there is of it."""
    assert "Traceback" not in run.output and "internal fault" not in run.output, run.output
    return [line for line in run.stderr.splitlines() if line.startswith("error: ")]


def refused(run: Result, *texts: str) -> None:
    """One line with all of these texts, and the exit code of bad input."""
    lines = complaints(run)
    assert run.exit_code == 2, run.output
    assert len(lines) == 1, lines
    for text in texts:
        assert text in lines[0]


# --- the file ------------------------------------------------------------------------------------


def test_recording_that_is_no_file(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    empty = tmp_path / "empty.bin"
    empty.touch()
    missing = tmp_path / "missing.bin"
    refused(process(drive, out, recording=missing), "missing.bin", "no such file")
    refused(process(drive, out, recording=empty), "empty.bin", "empty (0 bytes)")
    refused(process(drive, out, recording=tmp_path), str(tmp_path), "is a directory")
    assert not out.exists()


@pytest.mark.parametrize(
    ("size", "settings", "text"),
    [
        (400_001, ("format=int8",), "1 value(s) left over"),
        (400_001, ("format=int16",), "1 byte(s) left over"),
        (400_002, ("format=int16",), "1 value(s) left over"),
        (100_500, ("format=int8", "block={header: 0, payload: 1000}"), "ends within a block"),
        (3, ("format=float32",), "too few for one sample"),
    ],
)
def test_odd_sized_and_truncated(
    drive: Path, tmp_path: Path, size: int, settings: tuple[str, ...], text: str
) -> None:
    cut = tmp_path / "cut.bin"
    cut.write_bytes(bytes(size))
    out = tmp_path / "out"
    run = process(drive, out, *(f"{STREAM}.{s}" for s in settings), recording=cut)
    refused(run, "cut.bin", text)
    assert not out.exists()


def test_truncated_recording_is_taken_as_far_as_asked(drive: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.bin"
    cut.write_bytes(bytes(1_000_001))
    run = process(
        drive, tmp_path / "out", f"{STREAM}.format=int8", "recording.duration=0.19", recording=cut
    )
    refused(run, "cut.bin", "all samples are zero")
    assert "left over" in run.stderr  # as a note


# --- its description -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (("sample_rate=2.7e6",), "codes repeat every 2600 samples: a sample rate of 2600000 Hz"),
        (("sample_rate=2600026",), "against the carriers: the sample rate is 26000"),
        (("intermediate_frequency=9000",), "the intermediate frequency is "),
        (("iq_order=qi",), "the spectrum is inverted, or I and Q are swapped"),
        (("format=int8",), "read as bits2 iq, not int8 iq"),
    ],
)
def test_wrong_description_is_told_by_the_satellites(
    drive: Path, tmp_path: Path, settings: tuple[str, ...], text: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "solution.csv").write_text("of an earlier run\n")
    (out / "DGNS00XXX_R_20233341010_01M_01S_GO.rnx").write_text("of an earlier run\n")
    (out / "notes.txt").write_text("mine\n")
    run = process(drive, out, "recording.duration=2.6", *(f"{STREAM}.{s}" for s in settings))
    refused(run, "rec.bin", text)
    assert [path.name for path in out.iterdir()] == ["notes.txt"]


def test_small_error_of_the_rate_is_found_by_code_against_carrier(
    drive: Path, tmp_path: Path
) -> None:
    run = process(drive, tmp_path, "nav=nav.rnx", f"{STREAM}.sample_rate={RATE_HZ + 0.26}")
    assert run.exit_code == 1
    (line,) = complaints(run)
    assert "rec.bin: codes run +0." in line and "against the carriers" in line
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["code_minus_carrier_mps"] < -6.0


def test_unknown_key(drive: Path, tmp_path: Path) -> None:
    config = drive / "typo.yaml"
    config.write_text((drive / "config.yaml").read_text() + "trakcing: {}\n")
    run = CliRunner().invoke(cli, ["process", str(drive / "rec.bin"), "--config", str(config)])
    refused(run, "typo.yaml", "trakcing", "tracking")


def test_nav_file_of_another_day(drive: Path, tmp_path: Path) -> None:
    def moved(days: float) -> Path:
        nav = read_nav(drive / "nav.rnx")
        sets = {
            satellite: tuple(
                replace(e, **{
                    name: getattr(e, name).plus(days * 86400.0)
                    for name in ("toe", "toc", "transmitted")
                })
                for e in several
            )
            for satellite, several in nav.ephemerides.items()
        }  # fmt: skip
        path = tmp_path / f"nav{days:+.0f}.rnx"
        write_nav(path, NavData(sets, nav.klobuchar, nav.utc))
        return path

    out = tmp_path / "out"
    refused(process(drive, out, f"nav={moved(-3)}"), "nav-3.rnx", "2.9 days from the recording")
    undated = (f"nav={moved(2)}", "recording.start_time=null")
    refused(process(drive, out, *undated), "nav: the signals say 2023-11-30", "days from that")
    refused(process(drive, out, *undated, "start=causal"), "nav: the signals say 2023-11-30")
    assert written(out, (name for name in FILES if not name.endswith(".part"))) == [
        path for path in sorted(out.iterdir()) if path.suffix == ".part"
    ]


# --- the place of the outputs --------------------------------------------------------------------


@pytest.mark.parametrize("place", ["file/below", "file", "/proc/deepgnss", "/proc"])
def test_place_that_cannot_be_written(drive: Path, tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / place
    refused(process(drive, out), str(out), "cannot")


def test_disk_that_fills_up(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put = OutputFile._put

    def until_full(self: OutputFile, data: bytes) -> None:
        if self.path.name == "channels.csv" and self._end > 10_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        put(self, data)

    monkeypatch.setattr(OutputFile, "_put", until_full)
    run = process(drive, tmp_path, "nav=nav.rnx")
    refused(run, "channels.csv", "No space left on device")
    assert all(path.suffix == ".part" for path in tmp_path.iterdir())
    assert_readable_parts(tmp_path)


def test_only_outputs_of_runs_are_removed(tmp_path: Path) -> None:
    mine = ["rec.bin", "nav.rnx", "config.yaml", "truth.csv", "my solution.csv"]
    ours = ["solution.csv", "track.kml.part", "DGNS00XXX_R_20233341010_01M_GN.rnx"]
    for name in (*mine, *ours):
        (tmp_path / name).touch()
    (tmp_path / "overview.png").mkdir()  # not a file of ours
    prepare_folder(tmp_path, FILES)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*mine, "overview.png"])


# --- interrupts and short recordings -------------------------------------------------------------


def assert_readable_parts(folder: Path) -> None:
    with (folder / "solution.csv.part").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 2 and all(row["valid"] == "1" and row["reason"] == "" for row in rows)
    (obs,) = folder.glob("*_GO.rnx.part")
    text = obs.read_text()
    assert text.count("\n>") >= 2 and text.endswith("\n")
    assert all(len(line) >= 60 for line in text.splitlines()[1:] if line[0] == "G")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupt_leaves_valid_files(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, code: int
) -> None:
    write = Outputs.write

    def until_interrupted(self: Outputs, *result: object) -> None:
        write(self, *result)
        if self.tally.epochs == 3:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Outputs, "write", until_interrupted)
    run = process(drive, tmp_path, "nav=nav.rnx")
    assert run.exit_code == code
    assert complaints(run) == []
    assert run.stderr.splitlines()[-1] == (
        f"interrupted (what was written so far ends in .part in {tmp_path})"
    )
    assert all(path.suffix == ".part" for path in tmp_path.iterdir())
    assert_readable_parts(tmp_path)


def test_recording_that_ends_within_an_epoch(drive: Path, tmp_path: Path) -> None:
    run = process(drive, tmp_path, "nav=nav.rnx", "recording.duration=6.047")
    assert run.exit_code == 0, run.output
    with (tmp_path / "channels.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    assert last["recording_s"] == "6.047000" and last["mode"] == "PLL"
    assert complaints(run) == []


def test_no_position_is_explained_and_not_a_success(drive: Path, tmp_path: Path) -> None:
    run = process(drive, tmp_path, "recording.duration=3.0")
    assert run.exit_code == 1
    (line,) = complaints(run)
    assert "no position: satellites in 3.0 s of recording: 9 acquired, 9 with bit sync" in line
    assert "a NAV file (nav)" in line
    assert "how far each came" in run.stdout and "G14" in run.stdout
    assert max(map(len, run.stdout.splitlines())) <= 110
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["epochs_fixed"], summary["first_fix_s"]) == (0, None)
    assert not list(tmp_path.glob("*.rnx"))


def test_with_a_nav_file_it_is_the_transmit_time_that_is_waited_for(
    drive: Path, tmp_path: Path
) -> None:
    run = process(drive, tmp_path, "nav=nav.rnx", "start=causal", "recording.duration=2.0")
    assert run.exit_code == 1
    (line,) = complaints(run)
    assert "the head of a subframe" in line
    assert "NAV file" not in line
