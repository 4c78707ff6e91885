"""Child processes with what they took."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from deepgnss.core.errors import DeepGnssError

DEEPGNSS = (sys.executable, "-m", "deepgnss.cli.main")


class Ran(NamedTuple):
    """A child process that ended well."""

    output: str  # what it said, both ways
    wall_s: float
    cpu_s: float
    resident_mb: float  # at its peak


def run(command: list[str], folder: Path | None = None) -> Ran:
    """Run a child process to its end.

    Raises DeepGnssError when it does not succeed.
    """
    began = time.monotonic()
    child = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    output = child.stdout.read() if child.stdout is not None else ""
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    wall_s = time.monotonic() - began
    if child.stdout is not None:
        child.stdout.close()
    if child.returncode:
        last = output.strip().rpartition("\n")[2]
        raise DeepGnssError(f"{' '.join(command)}: exit code {child.returncode}: {last}")
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return Ran(output, wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)
