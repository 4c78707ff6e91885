"""The folder a run writes into: there, writable, and empty of what earlier runs left."""

from __future__ import annotations

import fnmatch
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from deepgnss.core.errors import OutputError
from deepgnss.io.output import part_path, reporting


def prepare_folder(folder: Path, names: Iterable[str]) -> None:
    """Make the folder, prove that files can be written there, and remove earlier outputs.

    Parameters
    ----------
    names: of the files a run writes, as shell patterns. Only these, whole or `.part`, are removed,
        so that what an earlier run left cannot be mistaken for a result of this one.

    Raises
    ------
    OutputError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
    with reporting(folder):
        handle, probe = tempfile.mkstemp(dir=folder, suffix=".part")
        os.close(handle)
        Path(probe).unlink()
        for path in written(folder, names):
            path.unlink()


def written(folder: Path, names: Iterable[str]) -> list[Path]:
    """Files of these names (shell patterns) in a folder, whole or still `.part`, sorted."""
    patterns = [pattern for name in names for pattern in (name, part_path(Path(name)).name)]
    return sorted(
        path
        for path in folder.iterdir()
        if path.is_file() and any(fnmatch.fnmatchcase(path.name, p) for p in patterns)
    )
