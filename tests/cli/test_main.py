"""The command line: lazy commands, one line per error, exit codes, signals."""

import os
import signal
import subprocess
import sys
import types
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from deepgnss import __version__
from deepgnss.cli import main as main_module
from deepgnss.cli.main import cli
from deepgnss.core.errors import ConfigError, RecordingError

EXAMPLE = Path(__file__).resolve().parents[2] / "configs" / "car.yaml"


@pytest.fixture
def failing(monkeypatch):
    """Install a command `info` that raises what the test asks for."""

    def install(failure: BaseException | None, name: str = "info") -> None:
        @click.command()
        def command() -> None:
            if failure:
                raise failure

        module = types.SimpleNamespace(**{name: command})
        monkeypatch.setattr(main_module.LazyGroup, "list_commands", lambda self, ctx: [name])
        monkeypatch.setattr(main_module.importlib, "import_module", lambda path: module)

    return install


def test_help_lists_commands_without_loading_the_kernels():
    script = (
        "import sys\n"
        "from deepgnss.cli.main import cli\n"
        "cli(['--help'], standalone_mode=False)\n"
        "print('loaded:', sorted({'numba', 'numpy', 'pydantic', 'rich'} & set(sys.modules)))\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "config" in run.stdout and "loaded: []" in run.stdout


def test_version():
    assert __version__ in CliRunner().invoke(cli, ["--version"]).stdout


def test_every_listed_command_can_be_called():
    context = click.Context(cli)
    for name in cli.list_commands(context):
        run = CliRunner().invoke(cli, [name, "--help"])
        assert run.exit_code == 0, run.output
        assert f"Usage: cli {name}" in run.output or f"{name} [OPTIONS]" in run.output


def test_unknown_command_is_a_usage_error():
    run = CliRunner().invoke(cli, ["cnfig"])
    assert run.exit_code == 2 and "cnfig" in run.stderr


@pytest.mark.parametrize(
    ("failure", "code", "text"),
    [
        (RecordingError("rec.bin: is empty"), 2, "error: rec.bin: is empty\n"),
        (ConfigError("a: bad\nb: worse"), 2, "error: a: bad\nerror: b: worse\n"),
        (OSError(28, "No space left on device", "out/x.obs"), 2,
         "error: out/x.obs: No space left on device\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (ValueError("two\nlines"), 70, "error: internal fault, ValueError: two lines (--debug"),
    ],
)  # fmt: skip
def test_failures_are_one_line_and_an_exit_code(failing, failure, code, text):
    failing(failure)
    run = CliRunner().invoke(cli, ["info"])
    assert run.exit_code == code
    assert run.stderr.startswith(text) and run.stdout == ""
    assert "Traceback" not in run.stderr


def test_debug_shows_the_place(failing):
    failing(RecordingError("rec.bin: is empty"))
    run = CliRunner().invoke(cli, ["--debug", "info"])
    assert run.exit_code == 2
    assert run.stderr.startswith("error: rec.bin: is empty\n") and "Traceback" in run.stderr


def test_success_is_zero(failing):
    failing(None)
    assert CliRunner().invoke(cli, ["info"]).exit_code == 0


def test_termination_unwinds_like_an_interrupt(failing, monkeypatch):

    @click.command()
    def info() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            signal.sigtimedwait([], 1.0)
        finally:
            click.echo("closed")

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(main_module.LazyGroup, "list_commands", lambda self, ctx: ["info"])
    monkeypatch.setattr(
        main_module.importlib, "import_module", lambda path: types.SimpleNamespace(info=info)
    )
    run = CliRunner().invoke(cli, ["info"])
    assert run.exit_code == 143
    assert run.stdout == "closed\n" and run.stderr == "interrupted\n"
    assert signal.getsignal(signal.SIGTERM) is before


# --- config --------------------------------------------------------------------------------------


def test_config_check(tmp_path):
    good = tmp_path / "good.yaml"
    good.write_text("recording: {streams: [{format: int8, sample_rate: 4e6}]}\n")
    run = CliRunner().invoke(cli, ["config", str(good)])
    assert (run.exit_code, run.stderr) == (0, "") and run.stdout.endswith("good.yaml: valid\n")
    run = CliRunner().invoke(cli, ["config", str(good), "--check", "--set", "threads=0"])
    assert run.exit_code == 2 and run.stdout == ""
    assert run.stderr == "error: --set: threads: found 0; expected 1 to 1024 threads\n"


def test_config_check_misses_files_and_show_does_not():
    run = CliRunner().invoke(cli, ["config", str(EXAMPLE), "--check"])
    assert run.exit_code == 2 and "imu.file" in run.stderr and "truth.file" in run.stderr
    run = CliRunner().invoke(cli, ["config", str(EXAMPLE), "--show"])
    assert run.exit_code == 0 and "sample_rate: 4000000.0" in run.stdout
    assert "note: signals: BDS_B1I lies outside of every stream" in run.stderr


def test_config_schema_is_pure_json():
    import json

    run = CliRunner().invoke(cli, ["config", "--schema"])
    assert json.loads(run.stdout)["title"] == "Config"
