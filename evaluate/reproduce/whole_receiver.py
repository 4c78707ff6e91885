"""From a ready scenario to the observations of the whole receiver: what many rows start with."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.deep.engine import Engine, workers
from deepgnss.deep.outputs import FILES, Outputs
from deepgnss.deep.setup import plan_run
from deepgnss.evaluate.observables import range_errors
from deepgnss.evaluate.observations import read_observations, read_ranges
from deepgnss.io.config import load_config
from deepgnss.io.folder import prepare_folder
from deepgnss.io.metadata import open_recording
from deepgnss.sim.output import Written, write_simulation
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import PUBLISHED, build, load_scenario

_ASSISTED: Final = ("start=causal", "output.nmea=false", "output.report=false")


class Recording(NamedTuple):
    """A simulated recording in its folder."""

    scenario: Scenario
    written: Written
    place: tuple[float, float, float]  # deg, deg, m

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
        yield Recording(simulation.scenario, written, place)


def observed(recording: Recording, *settings: str) -> pd.DataFrame:
    """Errors (`range_errors`) of the RINEX observations that the receiver makes of a recording.

    It starts once, with the NAV file and the rough place; phases count once their half cycle is
    known. settings: KEY=VALUE of the run.
    """
    out = recording.folder / "out"
    given = (f"nav={recording.folder / 'nav.rnx'}", f"position={list(recording.place)}")
    config = load_config(
        recording.written.config, (*_ASSISTED, *given, *settings, f"output.directory={out}")
    )
    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(recording.written.recording, formats)
    with opened:
        plan = plan_run(config, opened.streams, description.start)
        prepare_folder(out, FILES)
        with workers(plan.threads) as executor:
            engine = Engine(plan, opened, plan.knowledge, executor)
            with Outputs(config, plan, plan.knowledge) as outputs:
                for result in engine.steps():
                    outputs.write(result)
                accounts = engine.receiver.accounts
                outputs.finish(engine.receiver.nav, accounts.outcomes, {})
    (rinex,) = out.glob("*O.rnx")
    observations = read_observations(rinex)
    whole = observations["carrier_cycles"].where(~observations["half_cycle"])
    ranges = read_ranges(recording.folder / "ranges.csv")
    return range_errors(observations.assign(carrier_cycles=whole), ranges)


def since(errors: pd.DataFrame, seconds: float) -> pd.DataFrame:
    """Errors from some time after the first observation on."""
    begin_ms = int(errors["time_ms"].min()) + round(1e3 * seconds)
    return errors.loc[errors["time_ms"] >= begin_ms]
