"""`deepgnss process`: a recording in; observations, positions and reports out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.cli.screen import (
    RunState,
    RunSummary,
    Screen,
    nearby,
    summary_table,
    why_no_fix_table,
    why_no_position,
)
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import ConfigError, RecordingError
from deepgnss.core.records import STAGES, NavSolution, SatelliteOutcome
from deepgnss.deep.consistency import TOLERATED_MPS, check_agreement, check_week
from deepgnss.deep.coupled import CoupledNavigation, couple
from deepgnss.deep.engine import Engine, ScoutPass, workers
from deepgnss.deep.outputs import FILES, Outputs
from deepgnss.deep.setup import RunPlan, limits, plan_run, receiver_settings
from deepgnss.io.config import Config, load_config, notes
from deepgnss.io.folder import prepare_folder, written
from deepgnss.io.formats import StreamFormat
from deepgnss.io.metadata import open_recording
from deepgnss.io.recording import Recording
from deepgnss.receiver.clock import ReceiverClock
from deepgnss.receiver.receiver import Knowledge, StepResult

if TYPE_CHECKING:  # loaded when it is needed: pandas takes half a second
    from deepgnss.evaluate.errors import Evaluation, Statistics

_NARROWEST = 110  # columns of the tables where there is no terminal


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--config", "config_path", type=click.Path(path_type=Path), help="YAML file.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder of the outputs.")
@click.option("--both", is_flag=True, help="With and without aiding, and what it was worth.")
def process(
    recording: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    output: Path | None,
    both: bool,
) -> None:
    """Process RECORDING: RINEX, NMEA, CSV, tracks, summary and a picture.

    Exit code 0: positions were written. 1: the run ended in order without a position; a table
    says how far each satellite came, and the files hold what was observed. 2: recording,
    configuration or output place cannot be used. 130, 143: interrupted; files then end in .part.
    """
    if output is not None:
        overrides = (*overrides, f"output.directory={output.resolve()}")
    config = load_config(config_path, overrides)
    runs = _aided_and_unaided(config) if both else {"": config}
    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(recording, formats)
    with opened, Screen() as screen:
        for line in (*notes(config), *limits(config), *description.notes, *opened.notes):
            screen.note(f"note: {line}")
        _require_whole(config, opened)
        plan = plan_run(config, opened.streams, description.start)
        forms = {form.name: form for form in description.streams}
        knowledge, usable = None, True
        for name, one in runs.items():
            prepare_folder(one.output.directory, FILES)
            own = replace(plan, settings=receiver_settings(one))
            run = _Run(one, own, recording, forms, opened, screen)
            if name:
                screen.note(f"{name}: {one.output.directory}")
            knowledge = knowledge or run.scouted()
            usable = run.whole(knowledge) and usable
    if both:
        _print_worth(config, {name: one.output.directory for name, one in runs.items()})
    if not usable:
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _aided_and_unaided(config: Config) -> dict[str, Config]:
    """The same run with and without aiding, in folders of their own."""
    if config.imu is None:
        raise ConfigError("imu: found nothing; --both needs the log of an inertial unit")
    if not config.output.csv:
        raise ConfigError("output.csv: found false; --both compares the tables of its two runs")
    folder = Path(config.output.directory)
    runs = {}
    for name, enabled in (("aided", True), ("unaided", False)):
        output = config.output.model_copy(update={"directory": folder / name})
        deep = config.deep.model_copy(update={"enabled": enabled})
        runs[name] = config.model_copy(update={"output": output, "deep": deep})
    return runs


def _print_worth(config: Config, folders: Mapping[str, Path]) -> None:
    from deepgnss.evaluate.sources import read_reference
    from deepgnss.evaluate.worth import worth, write_worth_report

    rows = worth(list(folders.values()))
    table = Table(title="What aiding was worth", title_justify="left")
    table.add_column("")
    for name in folders:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    if config.output.report:
        known = config.truth
        truth = read_reference(known.file, known.format) if known is not None else None
        page = write_worth_report(Path(config.output.directory), folders, rows, truth)
        console.print(f"to look at: {nearby(page)}", markup=False, soft_wrap=True)


def _require_whole(config: Config, recording: Recording) -> None:
    """Refuse a file that breaks off within a sample or block, unless a length was asked for."""
    if recording.notes and config.recording.duration is None:
        lasts = min(s.sample_count / s.sample_rate_hz for s in recording.streams)
        raise RecordingError(
            f"{recording.notes[0]} (recording.duration: {lasts:.6f} takes what is there)"
        )


@dataclass
class _Run:
    """One run: scout, process, report."""

    config: Config
    plan: RunPlan
    path: Path
    forms: Mapping[str, StreamFormat]  # by stream
    recording: Recording
    screen: Screen
    stages_s: dict[str, float] = field(default_factory=dict)
    solution: NavSolution | None = None  # the last one, for the screen

    def scouted(self) -> Knowledge:
        """What is known before the first sample: after a scout pass, where one is asked for."""
        knowledge = self.plan.knowledge
        if not self.plan.scout:
            return knowledge
        with (
            workers(self.plan.threads) as executor,
            self._stage("scout pass"),
            _interruptible("the scout pass; nothing written"),
        ):
            engine = Engine(self.plan, self.recording, knowledge, executor)
            scout = ScoutPass(engine, self.plan)
            for result in self._checked(engine, scout.steps()):
                self._show(result)
            if scout.first_fix is None:
                self._refuse_misdescribed(engine.receiver.accounts.outcomes)
        return scout.knowledge

    def whole(self, knowledge: Knowledge) -> bool:
        """Process and report; True when positions were written."""
        folder = self.config.output.directory
        with (
            workers(self.plan.threads) as executor,
            self._stage("processing"),
            _interruptible(f"what was written so far ends in .part in {folder}"),
        ):
            engine = Engine(self.plan, self.recording, knowledge, executor, couple=self._couple())
            outputs = self._process(engine, knowledge)
        outcomes = engine.receiver.accounts.outcomes
        horizontal = None
        if self.config.output.report and self.config.output.csv and outputs.tally.epochs:
            with self._stage("errors and report"):
                found = _draw(self.config, folder)
                horizontal = found.of("horizontal_m") if found else None
        inertial = engine.coupled.guard.line() if engine.coupled is not None else ""
        self._report(outputs, outcomes, horizontal, inertial)
        if outputs.tally.fixed:
            return self._is_consistent(outputs.code_minus_carrier.drift_mps)
        if not self.plan.scout:
            self._refuse_misdescribed(outcomes)
        given = bool(self.plan.knowledge.nav.ephemerides)
        why = why_no_position(outcomes, self.plan.seconds, orbits_given=given)
        self.screen.note(f"error: {self.path}: no position: {why}")
        return False

    def _couple(self) -> Callable[[ReceiverClock], CoupledNavigation] | None:
        """What joins the inertial navigation to the receiver, None where there is none."""
        if self.config.imu is None or not self.config.deep.enabled:
            return None

        def made(clock: ReceiverClock) -> CoupledNavigation:
            coupled = couple(self.config, self.plan, clock)
            for line in coupled.notes:
                self.screen.note(f"note: {line}")
            return coupled

        return made

    def _process(self, engine: Engine, knowledge: Knowledge) -> Outputs:
        with Outputs(self.config, self.plan, knowledge) as outputs:
            for result in self._checked(engine, engine.steps()):
                outputs.write(result, engine.navigated)
                self._show(result)
            receiver = engine.receiver
            told: dict[str, Any] = {"recording": self.path.name, "config": _echo(self.config)}
            if engine.coupled is not None:
                told["inertial"] = engine.coupled.guard.summary()
                if engine.coupled.screening is not None:
                    told["ranges_refused"] = engine.coupled.screening.refused_tags
            outputs.finish(receiver.nav, receiver.accounts.outcomes, told)
        for line in engine.coupled.guard.warnings() if engine.coupled is not None else ():
            self.screen.note(f"warning: {line}")
        return outputs

    def _checked(self, engine: Engine, steps: Iterator[StepResult]) -> Iterator[StepResult]:
        """Results of an engine as long as its satellites do not contradict date and NAV file."""
        receiver, given = engine.receiver, self.plan.knowledge
        timed = False
        for result in steps:
            if receiver.clock is not None and not timed:
                check_agreement(receiver.clock.time(0), given.nav)
                timed = True
            if receiver.clock is not None and result.subframes:
                check_week(receiver.clock.time(result.end), given.nav, receiver.nav)
            yield result

    def _refuse_misdescribed(self, outcomes: Sequence[SatelliteOutcome]) -> None:
        """Say what is wrong with the description where hardly a satellite could be tracked."""
        from deepgnss.evaluate.diagnosis import diagnose

        timed = [o for o in outcomes if STAGES.index(o.stage) >= STAGES.index("frame sync")]
        if len(timed) >= 4:
            return
        self.screen.phase("looking for what is wrong with the description")
        found = [
            text
            for kinds, stream in self.plan.covered
            for text in diagnose(
                self.path, self.forms[stream.name], kinds[0], self.config.recording.skip
            )
        ]
        if found:
            raise RecordingError("\n".join(f"{self.path}: {text}" for text in found))

    def _is_consistent(self, drift_mps: float | None) -> bool:
        """Whether code and carrier stay together, as they do when rate and IF are right."""
        from deepgnss.evaluate.satellites import rate_finding

        if drift_mps is None or abs(drift_mps) < TOLERATED_MPS:
            return True
        off_ppm = drift_mps / SPEED_OF_LIGHT_MPS * 1e6
        kinds, stream = self.plan.covered[0]
        text = rate_finding(stream, kinds[0], off_ppm)
        self.screen.note(f"error: {self.path}: {text}; observations and positions suffer")
        return False

    def _report(
        self,
        outputs: Outputs,
        outcomes: Sequence[SatelliteOutcome],
        horizontal: Statistics | None,
        inertial: str,
    ) -> None:
        console = Console()
        if not console.is_terminal:
            console.width = max(console.width, _NARROWEST)
        searched = [outcome for outcome in outcomes if outcome.stage != "not searched"]
        console.print(why_no_fix_table(searched))
        tally = outputs.tally
        console.print(
            summary_table(
                RunSummary(
                    recording_s=self.plan.seconds,
                    stages_s=self.stages_s,
                    epochs=tally.epochs,
                    fixed=tally.fixed,
                    first_fix_s=tally.first_fix_s,
                    last=tally.last_valid.solution if tally.last_valid else None,
                    files=written(outputs.folder, FILES),
                    horizontal=horizontal,
                    inertial=inertial,
                )
            )
        )

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        """Name a stage on the screen and take its time."""
        self.screen.phase(name)
        self.solution = None
        began = time.monotonic()
        yield
        self.stages_s[name] = time.monotonic() - began

    def _show(self, result: StepResult) -> None:
        rate = self.plan.stream.sample_rate_hz
        if result.fixes:
            self.solution = result.fixes[-1].solution
        done_s = (result.end - self.plan.first) / rate
        self.screen.update(RunState(done_s, self.plan.seconds, result.reports, self.solution))


@contextmanager
def _interruptible(where: str) -> Iterator[None]:
    """Let an interrupt say what it leaves behind."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise type(stop)(f"({where})") from stop


def _echo(config: Config) -> dict[str, Any]:
    """The settings that shaped the result: neither threads nor the folder do."""
    return config.model_dump(mode="json", exclude={"threads": True, "output": {"directory"}})


def _draw(config: Config, folder: Path) -> Evaluation | None:
    """Overview picture and report, and errors where there is a truth."""
    from deepgnss.evaluate.errors import (
        errors,
        evaluate,
        read_solution,
        write_errors,
        write_statistics,
    )
    from deepgnss.evaluate.overview import draw_overview
    from deepgnss.evaluate.positions import read_sections
    from deepgnss.evaluate.report.run import read_run_files, with_sections, write_run_report
    from deepgnss.io.truth import read_truth

    truth, evaluation, sections = None, None, None
    if config.truth is not None:
        truth, sections = read_truth(config.truth.file, config.truth.format), config.truth.sections
        found = errors(read_solution(folder / "solution.csv"), truth)
        evaluation = evaluate(found)
        write_errors(folder / "errors.csv", found)
        write_statistics(folder / "statistics.csv", evaluation)
    run = read_run_files(folder)
    if sections is not None:
        run = with_sections(run, folder, read_sections(sections))
    draw_overview(folder / "overview.png", run.overview, truth)
    write_run_report(folder, run)
    return evaluation
