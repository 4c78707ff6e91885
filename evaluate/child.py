"""Child processes with what they took."""

from __future__ import annotations

import json
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


# A child counts the memory of whoever started it as its own peak: a small process does, not this.
_METER = """
import json, os, resource, subprocess, sys
code = subprocess.run(sys.argv[2:]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
told = [code, used.ru_utime + used.ru_stime, used.ru_maxrss]
os.write(int(sys.argv[1]), json.dumps(told).encode())
"""


def run(command: list[str], folder: Path | None = None) -> Ran:
    """Run a child process to its end.

    Raises DeepGnssError when it does not succeed.
    """
    reading, writing = os.pipe()
    began = time.monotonic()
    with os.fdopen(reading) as meter:
        child = subprocess.Popen(
            [sys.executable, "-c", _METER, str(writing), *command],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            pass_fds=[writing],
        )
        os.close(writing)
        output, _ = child.communicate()
        wall_s = time.monotonic() - began
        code, cpu_s, peak = json.loads(meter.read() or "[-1, 0.0, 0]")
    if code:
        last = output.strip().rpartition("\n")[2]
        raise DeepGnssError(f"{' '.join(command)}: exit code {code}: {last}")
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return Ran(output, wall_s, cpu_s, peak * unit / 1e6)
