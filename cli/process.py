"""`deepgnss process`: a recording in; observations, positions and reports out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.cli.screen import RunState, RunSummary, Screen, summary_table, why_no_fix_table
from deepgnss.core.errors import ConfigError
from deepgnss.deep.engine import Engine, ScoutPass, workers
from deepgnss.deep.outputs import Outputs
from deepgnss.deep.setup import RunPlan, plan_run
from deepgnss.io.config import Config, load_config, notes
from deepgnss.io.recording import Recording
from deepgnss.receiver.receiver import StepResult


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--config", "config_path", type=click.Path(path_type=Path), help="YAML file.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder of the outputs.")
def process(
    recording: Path, config_path: Path | None, overrides: tuple[str, ...], output: Path | None
) -> None:
    """Process RECORDING: RINEX, NMEA, CSV, tracks, summary and a picture.

    Exit code 0 only when a usable result was written.
    """
    if output is not None:
        overrides = (*overrides, f"output.directory={output.resolve()}")
    config = load_config(config_path, overrides)
    formats = [stream.stream_format() for stream in config.recording.streams]
    if not formats:
        raise ConfigError("recording.streams: say what the samples are (see configs/car.yaml)")
    with Recording(formats, recording) as opened, Screen() as screen:
        for line in (*notes(config), *opened.notes):
            screen.note(f"note: {line}")
        usable = _run(config, plan_run(config, opened.streams), opened, recording.name, screen)
    if not usable:
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


def _run(config: Config, plan: RunPlan, recording: Recording, name: str, screen: Screen) -> bool:
    """Scout, process, report; True when positions or observations were written."""
    stages_s: dict[str, float] = {}
    with workers(plan.threads) as executor:
        knowledge, began = plan.knowledge, time.monotonic()
        if plan.scout:
            screen.phase("scout pass")
            scout = ScoutPass(Engine(plan, recording, knowledge, executor), plan)
            for result in scout.steps():
                _show(screen, plan, result)
            knowledge = scout.knowledge
            stages_s["scout pass"] = time.monotonic() - began
        screen.phase("processing")
        began = time.monotonic()
        engine = Engine(plan, recording, knowledge, executor)
        with Outputs(config, plan, knowledge) as outputs:
            for result in engine.steps():
                outputs.write(result)
                _show(screen, plan, result)
            receiver = engine.receiver
            outcomes = receiver.accounts.outcomes
            outputs.finish(receiver.nav, outcomes, {"config": _echo(config)})
    stages_s["processing"] = time.monotonic() - began
    tally = outputs.tally
    if config.output.report and config.output.csv and tally.epochs:
        began = time.monotonic()
        _draw(config, outputs.folder, name)
        stages_s["picture"] = time.monotonic() - began
    seconds = (plan.end - plan.first) / plan.stream.sample_rate_hz
    console = Console()
    searched = [outcome for outcome in outcomes if outcome.stage != "not searched"]
    console.print(why_no_fix_table(searched))
    console.print(
        summary_table(
            RunSummary(
                recording_s=seconds,
                stages_s=stages_s,
                epochs=tally.epochs,
                fixed=tally.fixed,
                first_fix_s=tally.first_fix_s,
                last=tally.last_valid.solution if tally.last_valid else None,
                files=sorted(path for path in outputs.folder.iterdir() if path.is_file()),
            )
        )
    )
    return tally.epochs > 0


def _echo(config: Config) -> dict[str, Any]:
    """The settings that shaped the result: neither threads nor the folder do."""
    return config.model_dump(mode="json", exclude={"threads": True, "output": {"directory"}})


def _show(screen: Screen, plan: RunPlan, result: StepResult) -> None:
    rate = plan.stream.sample_rate_hz
    solution = result.fixes[-1].solution if result.fixes else None
    screen.update(
        RunState(
            (result.end - plan.first) / rate,
            (plan.end - plan.first) / rate,
            result.reports,
            solution,
        )
    )


def _draw(config: Config, folder: Path, name: str) -> None:
    """Overview picture, and errors where there is a truth."""
    from deepgnss.evaluate.errors import errors, evaluate, write_errors, write_statistics
    from deepgnss.evaluate.overview import draw_overview, read_run
    from deepgnss.io.truth import read_truth

    run = read_run(folder, name)
    truth = None
    if config.truth is not None:
        truth = read_truth(config.truth.file, config.truth.format)
        found = errors(run.solution, truth)
        write_errors(folder / "errors.csv", found)
        write_statistics(folder / "statistics.csv", evaluate(found))
    draw_overview(folder / "overview.png", run, truth)
