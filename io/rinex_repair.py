"""A copy of a RINEX observation file with phases corrected, everything else as it was.

Signs (SPEC 1): a correction is added to the phase, which grows with range.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from deepgnss.io.output import write_whole
from deepgnss.io.rinex import read_text
from deepgnss.io.rinex_obs_reader import ObsFile

_WIDTH: Final = 14  # of F14.3, loss of lock behind it


class PhaseChange(NamedTuple):
    """What becomes of one phase."""

    row: int  # of ObsFile.frame
    system: str
    code: str  # "L1C", as in ObsFile.codes
    cycles: float  # to add
    lost: bool  # LLI bit 0


def write_changed(path: Path, source: Path, read: ObsFile, changes: Iterable[PhaseChange]) -> None:
    """Write the file `source`, unpacked, with changed phases; `read` is what was read of it.

    Bits of the LLI other than that of lost lock stay as they are, and so does the phase of a field
    that could not hold the corrected one.
    """
    lines = read_text(source).split("\n")
    for change in changes:
        below, column = read.place(change.system, change.code)
        number = int(read.lines[change.row]) + below
        end = column + _WIDTH
        line = lines[number].ljust(end + 1)
        phase = f"{float(line[column:end]) + change.cycles:14.3f}" if change.cycles else ""
        if len(phase) != _WIDTH:
            phase = line[column:end]
        flags = int(line[end]) if line[end].isdigit() else 0
        flags = flags & ~1 | int(change.lost)
        lines[number] = (line[:column] + phase + (str(flags or " ")) + line[end + 1 :]).rstrip()
    write_whole(path, "\n".join(lines))
