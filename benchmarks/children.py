"""Child processes with what they took."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

DEEPGNSS = (sys.executable, "-m", "deepgnss.cli.main")


class Ran(NamedTuple):
    """A child process that ended well."""

    output: str  # what it said, both ways
    cpu_s: float
    resident_mb: float  # at its peak


def run(command: list[str], folder: Path | None = None) -> Ran:
    """Run a child process to its end; it must succeed."""
    child = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert child.stdout is not None
    output = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    child.stdout.close()
    if child.returncode:
        raise SystemExit(f"{' '.join(command)}: exit code {child.returncode}\n{output[-2000:]}")
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return Ran(output, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)
