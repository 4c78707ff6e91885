"""Many drives, side by side, each in a process of its own: one that fails stops no other.

A drive is a configuration that names its recording. What it came to stands in `batch.json` beside
its outputs; a later batch leaves alone what was done with the same settings on the same files by
the same version.
"""

from __future__ import annotations

import fcntl
import glob
import hashlib
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, Protocol

from deepgnss import __version__
from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.io.config import Config, load_config
from deepgnss.io.output import reporting
from deepgnss.io.summary import write_summary

RECORD: Final = "batch.json"
"""What a drive came to, in its folder of outputs."""
LOG: Final = "batch.log"
"""What its run printed."""

_ATTEMPTS: Final = 2  # of a run that somebody or the system's memory killed
_ANSWER_S: Final = 10.0  # within which a scheduler must answer
_PATIENCE_S: Final = 0.3  # between looks whether a run shall stop
_SETTLED: Final = (0, 1)  # exit codes of a run that ended in order


class Drive(NamedTuple):
    """One run of the batch."""

    name: str
    config: Path
    recording: Path
    folder: Path  # of its outputs
    settings: tuple[str, ...]  # KEY=VALUE over those of the file
    stamp: str  # of everything the outcome depends on


class Outcome(NamedTuple):
    """What a drive came to."""

    name: str
    folder: Path
    code: int  # exit code of `deepgnss process`; negative: the signal that killed it
    seconds: float
    reason: str  # why there is no result
    kept: bool = False  # of an earlier batch

    @property
    def done(self) -> bool:
        """Whether positions were written."""
        return self.code == 0


class Command(Protocol):
    """Makes the command line of a drive."""

    def __call__(self, drive: Drive) -> Sequence[str]:
        """Program and arguments."""
        ...


def process_command(drive: Drive) -> list[str]:
    """`deepgnss process` on a drive, on one thread: the drives share the cores."""
    settings = [part for setting in drive.settings for part in ("--set", setting)]
    return [
        *(sys.executable, "-m", "deepgnss.cli.main", "process", str(drive.recording)),
        *("--config", str(drive.config), *settings, "--output", str(drive.folder)),
    ]


def find_drives(
    patterns: Sequence[str], root: Path | None = None, settings: Sequence[str] = ()
) -> list[Drive]:
    """Drives by the patterns of their configurations, in the order of their paths.

    Parameters: root: outputs go to a folder in it named as the configuration, instead of to
    `output.directory`; settings: KEY=VALUE for all of them.

    Raises ConfigError: a pattern finds nothing, a configuration is faulty or names no recording,
    or two drives would write into one folder.
    """
    paths: dict[Path, None] = {}
    for pattern in patterns:
        # Path.glob refuses absolute patterns
        found = sorted(Path(p) for p in glob.glob(pattern, recursive=True))  # noqa: PTH207
        if not found:
            raise ConfigError(f"{pattern}: no such file; expected configurations of drives")
        paths.update(dict.fromkeys(path.resolve() for path in found))
    drives = [_drive(path, root, ("threads=1", *settings)) for path in paths]
    writers: dict[Path, Path] = {}
    for drive in drives:
        other = writers.setdefault(drive.folder, drive.config)
        if other is not drive.config:
            raise ConfigError(
                f"{drive.config}: writes into {drive.folder} as {other} does; "
                "other names, or another output.directory, keep them apart"
            )
    return drives


def _drive(path: Path, root: Path | None, settings: tuple[str, ...]) -> Drive:
    config = load_config(path, settings)
    streams = config.recording.streams
    if not streams or streams[0].file is None:
        raise ConfigError(
            f"{path}: recording.streams[0].file: found nothing; a batch has no RECORDING argument"
        )
    folder = root.resolve() / path.stem if root is not None else Path(config.output.directory)
    stamp = _stamp(config)
    return Drive(path.stem, path, Path(streams[0].file), folder, settings, stamp)


def _stamp(config: Config) -> str:
    """Settings, version, and size and age of every file the settings name."""
    settings = config.model_dump(mode="json", exclude={"output": {"directory"}})
    files = []
    for text in _texts(settings):
        path = Path(text)
        if path.is_absolute() and path.is_file():
            state = path.stat()
            files.append((text, state.st_size, state.st_mtime_ns))
    known = json.dumps([__version__, settings, sorted(files)], sort_keys=True)
    return hashlib.sha256(known.encode()).hexdigest()


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)


def earlier(drive: Drive) -> Outcome | None:
    """Outcome of an earlier batch that still holds; None where the drive is to be run."""
    try:
        record = json.loads((drive.folder / RECORD).read_text(encoding="utf-8"))
        if record["stamp"] != drive.stamp or record["code"] not in _SETTLED:
            return None
        if not (drive.folder / "summary.json").is_file():
            return None
        seconds, reason = float(record["seconds"]), str(record["reason"])
        return Outcome(drive.name, drive.folder, record["code"], seconds, reason, kept=True)
    except (OSError, ValueError, KeyError, TypeError):
        return None  # none, or one that was cut off: the drive is run


def never() -> bool:
    """Nobody asks a run to stop."""
    return False


def run_drive(
    drive: Drive, command: Command = process_command, stopped: Callable[[], bool] = never
) -> Outcome:
    """Run a drive in a process of its own and keep what it came to; a killed one is run again."""
    began = time.monotonic()
    attempts, code = 0, -signal.SIGTERM
    while code < 0 and attempts < _ATTEMPTS and not stopped():
        attempts += 1
        code, said = _run(command(drive), drive.folder, stopped)
    if stopped():
        reason = "stopped"
    elif code < 0:
        reason = f"killed by signal {-code} (attempt {attempts} of {_ATTEMPTS})"
    else:
        reason = "" if code == 0 else next(iter(said), f"exit code {code}")
    outcome = Outcome(drive.name, drive.folder, code, time.monotonic() - began, reason)
    write_summary(
        drive.folder / RECORD,
        {"stamp": drive.stamp, "code": code, "seconds": outcome.seconds, "reason": reason},
    )
    return outcome


def _run(
    command: Sequence[str], folder: Path, stopped: Callable[[], bool]
) -> tuple[int, list[str]]:
    """Exit code and the lines in which it says what is wrong."""
    with reporting(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with _alone_in(folder, stopped) as log:
        process = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, pass_fds=[log.fileno()]
        )
        while True:
            try:
                code = process.wait(timeout=_PATIENCE_S)
                break
            except subprocess.TimeoutExpired:
                if stopped():
                    process.terminate()  # it closes its outputs on the way out
    lines = (folder / LOG).read_text(encoding="utf-8", errors="replace").splitlines()
    return code, [line for line in lines if line.startswith("error:")]


@contextmanager
def _alone_in(folder: Path, stopped: Callable[[], bool]) -> Iterator[IO[str]]:
    """The empty log of a folder no other run is at work in.

    A run outlives the worker that started it and was killed. It inherits the log's lock, so that
    whoever runs the drive again waits for its end.
    """
    with reporting(folder / LOG), (folder / LOG).open("a", encoding="utf-8") as log:
        while not stopped():
            try:
                fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(_PATIENCE_S)
        log.truncate(0)
        yield log


def run_here(
    drives: Iterable[Drive], jobs: int, command: Command = process_command
) -> Iterator[Outcome]:
    """Run drives on this machine, `jobs` at a time; outcomes as they come.

    Left early (an interrupt), it stops the runs and waits until they have closed their outputs.
    """
    leaving = threading.Event()
    pool = ThreadPoolExecutor(jobs)  # a thread only waits for its process
    try:
        runs = [pool.submit(run_drive, drive, command, leaving.is_set) for drive in drives]
        for run in as_completed(runs):
            yield run.result()
    finally:
        leaving.set()
        pool.shutdown(cancel_futures=True)


def run_on_cluster(
    drives: Sequence[Drive], scheduler: str, command: Command = process_command
) -> Iterator[Outcome]:
    """Run drives on the workers of a Dask scheduler, which must see the same files.

    A drive whose worker dies goes to another one.

    Raises InputFileError: Dask is not installed, or no scheduler answers.
    """
    try:
        from dask import distributed
    except ImportError as error:
        raise InputFileError("--scheduler: needs Dask: pip install 'deepgnss[cluster]'") from error
    try:
        client = distributed.Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputFileError(f"--scheduler {scheduler}: no Dask scheduler answers") from error
    with client:
        runs = client.map(run_drive, drives, command=command, pure=False)
        for run in distributed.as_completed(runs, loop=client.loop):
            yield run.result()
