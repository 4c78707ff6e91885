"""CPU time of a run by stage: the functions that begin a stage are timed, each less its callees."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from time import process_time
from typing import Any
from unittest import mock

from click.testing import CliRunner

from deepgnss.cli import process as process_module
from deepgnss.cli.main import cli
from deepgnss.deep.engine import ScoutPass
from deepgnss.deep.outputs import Outputs
from deepgnss.io.recording import Recording
from deepgnss.receiver import pvt
from deepgnss.receiver.baseband import RunningSumBuffer
from deepgnss.receiver.receiver import Receiver

STAGES: tuple[tuple[str, Any, str], ...] = (
    ("reading samples", Recording, "read"),
    ("running sums", RunningSumBuffer, "append"),
    ("running sums", RunningSumBuffer, "keep_from"),
    ("acquisition", Receiver, "_search"),
    ("tracking", Receiver, "_track"),
    ("decoding", Receiver, "_read_messages"),
    ("observables", Receiver, "_observe"),
    ("pvt", pvt, "solve"),
    ("outputs", Outputs, "write"),
    ("outputs", Outputs, "finish"),
    ("picture", process_module, "_draw"),
)


class Stopwatch:
    """CPU seconds by stage; time in an inner stage does not count for the outer one."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = {}
        self.within = ""  # a pass whose stages count together under this name
        self._open: list[str] = []
        self._since = process_time()

    def _turn(self) -> None:
        now = process_time()
        stage = self.within or (self._open[-1] if self._open else "the rest")
        self.spent_s[stage] = self.spent_s.get(stage, 0.0) + now - self._since
        self._since = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self._turn()
        self._open.append(name)
        try:
            yield
        finally:
            self._turn()
            self._open.pop()

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            with self.stage(name):
                return function(*args, **kwargs)

        return call

    def whole_pass(self, name: str, steps: Callable[..., Any]) -> Callable[..., Any]:
        """A generator method whose run counts under one name, whatever stages it goes through."""

        def run(*args: Any) -> Iterator[Any]:
            self._turn()
            self.within = name
            try:
                yield from steps(*args)
            finally:
                self._turn()
                self.within = ""

        return run


def stages_s(arguments: list[str]) -> dict[str, float]:
    """Run `deepgnss process` in this process; CPU seconds by stage, in the order of the work."""
    watch = Stopwatch()
    with ExitStack() as patches:
        for name, owner, function in STAGES:
            timed = watch.timed(name, getattr(owner, function))
            patches.enter_context(mock.patch.object(owner, function, timed))
        scout = watch.whole_pass("scout pass", ScoutPass.steps)
        patches.enter_context(mock.patch.object(ScoutPass, "steps", scout))
        with watch.stage("the rest"):
            run = CliRunner().invoke(cli, ["process", *arguments])
    if run.exit_code:
        raise SystemExit(run.output)
    order = ["scout pass", *dict.fromkeys(name for name, _, _ in STAGES), "the rest"]
    return {name: watch.spent_s[name] for name in order if name in watch.spent_s}
