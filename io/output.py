"""Files that are `<name>.part` until they are whole, and readable at every flush before that.

Every writer is a context manager with `write(…)`, `flush()` and `close()`. Left in good order it
renames its file to the final name; left by an exception it keeps the `.part` file, which then
holds whole records up to the last flush. The same input gives the same bytes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from deepgnss.core.errors import OutputError

_FLUSH_CHARACTERS = 1 << 16


@contextmanager
def reporting(path: Path) -> Iterator[None]:
    """Turn what the operating system says about a file into a one-line OutputError."""
    try:
        yield
    except OSError as error:
        cause = error.strerror or str(error).splitlines()[0]
        raise OutputError(f"{path}: cannot write: {cause}") from error


def part_path(path: Path) -> Path:
    """Name of a file while it is not yet whole."""
    return path.with_name(path.name + ".part")


class OutputFile:
    """A text file (UTF-8, \\n) that grows by whole records.

    Parameters
    ----------
    path: final name; missing folders are made, an older file of this name goes away at once, so
        that a failed run does not leave it looking like its own result.
    tail: what closes the document after the records written so far (an XML end tag); it is
        written at every flush and overwritten by the next one.

    Raises
    ------
    OutputError: here and in every method: the file or its folder cannot be written.
    """

    def __init__(self, path: Path, tail: Callable[[], str] | None = None) -> None:
        self.path = path
        self._tail = tail
        self._pending: list[str] = []
        self._pending_characters = 0
        self._end = 0  # bytes of whole records in the file, without the tail
        with reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            self._handle = part_path(path).open("wb", buffering=0)

    def write(self, record: str) -> None:
        """Append one or more whole records."""
        self._pending.append(record)
        self._pending_characters += len(record)
        if self._pending_characters > _FLUSH_CHARACTERS:
            self.flush()

    def flush(self) -> None:
        """Bring everything to disk, closed by the tail."""
        if self._handle.closed:
            return
        body = "".join(self._pending).encode()
        tail = self._tail().encode() if self._tail else b""
        self._pending, self._pending_characters = [], 0
        with reporting(self.path):
            try:
                self._put(body + tail)
            except OSError:
                self._put_back(tail)
                raise
        self._end += len(body)

    def _put(self, data: bytes) -> None:
        self._handle.seek(self._end)
        rest = memoryview(data)
        while rest:
            rest = rest[self._handle.write(rest) :]
        if self._tail:
            self._handle.truncate()

    def _put_back(self, tail: bytes) -> None:
        # A disk that filled up in the middle of a record: end after the last whole one.
        try:
            self._handle.truncate(self._end)
            self._put(tail)
        except OSError:
            pass  # a device that cannot be truncated; the first error is the one to report

    def close(self) -> None:
        """Finish and give the file its final name."""
        if self._handle.closed:
            return
        self.abandon()
        with reporting(self.path):
            part_path(self.path).replace(self.path)

    def abandon(self) -> None:
        """Stop here: what was written stays readable under its `.part` name."""
        try:
            self.flush()
        finally:
            self._handle.close()


class Closing(ABC):
    """A `with` statement that closes what ended in order and abandons what did not."""

    @abstractmethod
    def flush(self) -> None:
        """Bring everything written so far to disk."""

    @abstractmethod
    def close(self) -> None:
        """Finish and give the file its final name."""

    @abstractmethod
    def abandon(self) -> None:
        """Stop here: what was written stays readable under its `.part` name."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()


class Writer(Closing):
    """What the writers of records share: one OutputFile, and how it ends."""

    _file: OutputFile | None = None  # None: not yet opened, no record so far

    @property
    def path(self) -> Path | None:
        """Final name of the file; None as long as there is nothing to write."""
        return self._file.path if self._file else None

    def flush(self) -> None:
        """Bring everything written so far to disk."""
        if self._file:
            self._file.flush()

    def close(self) -> None:
        """Finish and give the file its final name."""
        if self._file:
            self._file.close()

    def abandon(self) -> None:
        """Stop here: what was written stays readable under its `.part` name."""
        if self._file:
            self._file.abandon()


def write_whole(path: Path, text: str) -> None:
    """Write a small file at one go, `.part` and rename included."""
    file = OutputFile(path)
    file.write(text)
    file.close()
