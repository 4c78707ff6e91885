"""Reading files that others wrote: whatever goes wrong becomes one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepgnss.core.errors import InputFileError


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what the system or a parser says about a file into a one-line InputFileError."""
    try:
        yield
    except OSError as error:
        cause = error.strerror or "damaged"
        raise InputFileError(f"{path}: cannot read: {cause}") from error
    except (ValueError, EOFError) as error:  # the parsers of pandas raise ValueErrors too
        cause = next(iter(str(error).strip().splitlines()), "damaged")
        raise InputFileError(f"{path}: cannot read: {cause}") from error
