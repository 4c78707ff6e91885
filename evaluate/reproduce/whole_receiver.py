"""From a ready scenario to the observations of the whole receiver: what many rows start with."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.deep.coupled import CoupledNavigation, couple
from deepgnss.deep.engine import Engine, workers
from deepgnss.deep.outputs import FILES, Outputs
from deepgnss.deep.setup import RunPlan, plan_run
from deepgnss.evaluate.observables import range_errors
from deepgnss.evaluate.observations import read_observations, read_ranges
from deepgnss.io.config import Config, load_config
from deepgnss.io.folder import prepare_folder
from deepgnss.io.metadata import open_recording
from deepgnss.receiver.clock import ReceiverClock
from deepgnss.sim.output import Written, write_simulation
from deepgnss.sim.output.inertial import write_imu
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import PUBLISHED, Simulation, build, load_scenario
from deepgnss.sim.schema.inertial import ImuLogConfig

_ASSISTED: Final = ("start=causal", "output.nmea=false", "output.report=false")


class Recording(NamedTuple):
    """A simulated recording in its folder."""

    simulation: Simulation
    written: Written
    place: tuple[float, float, float]  # deg, deg, m

    @property
    def scenario(self) -> Scenario:
        """What was simulated."""
        return self.simulation.scenario

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return self.written.recording.parent


@contextmanager
def recorded(scenario: str, seed: int, *settings: str) -> Iterator[Recording]:
    """A recording of a scenario of `reproduce/` in a folder that lasts as long as the context.

    Parameters: settings: KEY=VALUE over those of the file.
    """
    config = load_scenario(PUBLISHED + scenario, (*settings, f"seed={seed}"))
    simulation = build(config)
    place = (config.place.latitude, config.place.longitude, config.place.height)
    with TemporaryDirectory(prefix="deepgnss-") as folder:
        written = write_simulation(simulation, Path(folder), os.cpu_count() or 1)
        yield Recording(simulation, written, place)


def with_unit(recording: Recording, grade: str) -> tuple[str, ...]:
    """Settings of a run aided by an inertial unit of another grade: its log is written for them.

    The same draws stand behind every grade, each in proportion to its σ; the samples do not
    depend on the unit.
    """
    simulation = recording.simulation
    unit = simulation.config.imu
    if unit is None:
        raise ValueError(f"{simulation.scenario.name}: no inertial unit to be of grade {grade}")
    other = ImuLogConfig.model_validate({**unit.model_dump(by_alias=True), "grade": grade})
    config = simulation.config.model_copy(update={"imu": other})
    folder = recording.folder / grade
    folder.mkdir(exist_ok=True)
    ((log, _), *_) = write_imu(folder, replace(simulation, config=config))
    return f"imu.file={log}", f"imu.grade={grade}"


class Run(NamedTuple):
    """A receiver that has been told all it needs and stands before the first sample."""

    config: Config
    plan: RunPlan
    engine: Engine


@contextmanager
def started(recording: Recording, *settings: str) -> Iterator[Run]:
    """A run of the receiver, to be stepped through.

    It starts once, with the NAV file and the rough place, aided where the recording has an
    inertial log (deep=false: all the same not).

    Parameters: settings: KEY=VALUE of the run.
    """
    given = (f"nav={recording.folder / 'nav.rnx'}", f"position={list(recording.place)}")
    config = load_config(recording.written.config, (*_ASSISTED, *given, *settings))
    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(recording.written.recording, formats)
    with opened:
        plan = plan_run(config, opened.streams, description.start)
        with workers(plan.threads) as executor:
            engine = Engine(plan, opened, plan.knowledge, executor, couple=_couple(config, plan))
            yield Run(config, plan, engine)


def observed(recording: Recording, *settings: str) -> pd.DataFrame:
    """Errors (`range_errors`) of the RINEX observations of a run (`started`) of the receiver.

    Phases count once their half cycle is known.
    """
    out = recording.folder / "out"
    with started(recording, *settings, f"output.directory={out}") as (config, plan, engine):
        prepare_folder(out, FILES)
        with Outputs(config, plan, plan.knowledge) as outputs:
            for result in engine.steps():
                outputs.write(result, engine.navigated)
            accounts = engine.receiver.accounts
            outputs.finish(engine.receiver.nav, accounts.outcomes, {})
    (rinex,) = out.glob("*O.rnx")
    observations = read_observations(rinex)
    whole = observations["carrier_cycles"].where(~observations["half_cycle"])
    ranges = read_ranges(recording.folder / "ranges.csv")
    return range_errors(observations.assign(carrier_cycles=whole), ranges)


def _couple(config: Config, plan: RunPlan) -> Callable[[ReceiverClock], CoupledNavigation] | None:
    if config.imu is None or not config.deep.enabled:
        return None
    return lambda clock: couple(config, plan, clock)


def since(errors: pd.DataFrame, seconds: float) -> pd.DataFrame:
    """Errors from some time after the first observation on."""
    begin_ms = int(errors["time_ms"].min()) + round(1e3 * seconds)
    return errors.loc[errors["time_ms"] >= begin_ms]
