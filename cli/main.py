"""The `deepgnss` command: its subcommands, and how a run that failed says so.

Subcommands are imported when they are called, so that help does not wait for the kernels.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click

from deepgnss import __version__
from deepgnss.core.errors import DeepGnssError

# Set before numpy is loaded: our matrices are small, and threads of the linear algebra library
# would cost several times what they save, whatever `threads` says.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_variable, "1")

EXIT_NOTHING_USABLE = 1
"""The run ended in order but wrote no usable result."""
EXIT_BAD_INPUT = 2
"""Input, configuration or output place that cannot be used."""
EXIT_INTERNAL = 70
"""A fault of the program itself."""
EXIT_INTERRUPTED = 130
"""Ctrl-C."""
EXIT_TERMINATED = 143
"""SIGTERM."""

_COMMANDS = {
    "process": "Process a recording: observations, positions, reports.",
    "info": "Look at a recording: level, spectrum, satellites, what may be wrong.",
    "snapshot": "Position from milliseconds of recording and a NAV file.",
    "ins": "Couple an inertial log and a GNSS solution.",
    "simulate": "Make a recording with known truth.",
    "batch": "Process many drives, side by side.",
    "slips": "Cycle slips between two antennas by an INS: found, repaired.",
    "report": "Write the page of a finished run again.",
    "compare": "Our runs and logs of other receivers side by side.",
    "regress": "Hold the runs of a suite against limits and an earlier summary.",
    "analyze": "Error budgets: loops, open loop, discriminators.",
    "reproduce": "Measure the published figures again.",
    "config": "Check, show or explain a configuration.",
}


class Terminated(KeyboardInterrupt):
    """SIGTERM: outputs are closed as after Ctrl-C."""


class LazyGroup(click.Group):
    """A group that imports `deepgnss.cli.<name>` for the command `name`, which it must define."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands at hand."""
        return [name for name in _COMMANDS if importlib.util.find_spec(_module(name))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command, or None when there is none of this name."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command = getattr(importlib.import_module(_module(cmd_name)), cmd_name)
        return command if isinstance(command, click.Command) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name]) for name in self.list_commands(ctx)])

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; what goes wrong becomes one line and an exit code."""
        try:
            with _terminate_like_interrupt():
                return super().invoke(ctx)
        except (click.exceptions.Exit, click.ClickException, click.Abort, BrokenPipeError):
            raise
        except (Exception, KeyboardInterrupt) as failure:
            lines, code = _diagnosis(failure)
            for line in lines:
                click.echo(line, err=True)
            if ctx.params.get("debug"):
                traceback.print_exception(failure)
            raise click.exceptions.Exit(code) from failure


def _diagnosis(failure: Exception | KeyboardInterrupt) -> tuple[list[str], int]:
    """Lines for the user, and the exit code."""
    match failure:
        case DeepGnssError():
            return [f"error: {line}" for line in str(failure).splitlines()], EXIT_BAD_INPUT
        case KeyboardInterrupt():
            code = EXIT_TERMINATED if isinstance(failure, Terminated) else EXIT_INTERRUPTED
            return [f"interrupted {failure}".strip()], code
        case OSError():
            place = f"{failure.filename}: " if failure.filename else ""
            return [f"error: {place}{failure.strerror or failure}"], EXIT_BAD_INPUT
        case _:
            cause = " ".join(f"{type(failure).__name__}: {failure}".split())
            return [f"error: internal fault, {cause} (--debug shows where)"], EXIT_INTERNAL


def _module(command: str) -> str:
    return f"deepgnss.cli.{command}"


@contextmanager
def _terminate_like_interrupt() -> Iterator[None]:
    """Turn SIGTERM into an exception, so that open outputs are closed on the way out."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise Terminated

    previous = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="deepgnss")
@click.option("--debug", is_flag=True, help="Show where an error arose.")
def cli(debug: bool) -> None:
    """Raw GNSS samples in; RINEX, NMEA, positions and reports out."""


def main() -> None:
    """Entry point of the `deepgnss` command."""
    cli(prog_name="deepgnss")


if __name__ == "__main__":
    main()
