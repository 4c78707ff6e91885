"""The folder of a simulation: samples, what processes them, and every truth about them."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.errors import OutputError
from deepgnss.io.config import resolved_yaml
from deepgnss.io.config.text import write
from deepgnss.io.container import ContainerWriter
from deepgnss.io.folder import prepare_folder, written
from deepgnss.io.output import part_path, reporting, write_whole
from deepgnss.io.rinex_nav import write_nav
from deepgnss.sim.generator import pieces
from deepgnss.sim.output.clock import write_clock
from deepgnss.sim.output.inertial import (
    INERTIAL_FILES,
    ODOMETER_FILE,
    imu_name,
    write_imu,
    write_odometer,
)
from deepgnss.sim.output.navbits import write_navbits
from deepgnss.sim.output.sections import NAME as SECTIONS_FILE
from deepgnss.sim.output.sections import write_sections
from deepgnss.sim.output.settings import config_of, recording_name, stream_format
from deepgnss.sim.output.stations import base_station, perfect_rover, write_observations
from deepgnss.sim.output.truth import write_ranges, write_truth
from deepgnss.sim.quantization import quantization_loss_db
from deepgnss.sim.scenario import Scenario, Stream
from deepgnss.sim.schema.build import Simulation

FILES: Final = (
    *("rec*.bin", "rec.h5", "config.yaml", "scenario.yaml", "nav.rnx", "base.obs", "rover.obs"),
    *("truth.csv", "clock.csv", "ranges.csv", "navbits.csv", SECTIONS_FILE, ODOMETER_FILE),
    *INERTIAL_FILES,
)
"""Names, as shell patterns, of all that is written."""

_ROW_BYTES: Final = 170  # about that of a row of the truth
_DTYPES: Final = {"int8": "i1", "int16": "<i2", "float32": "<f4"}

Progress = Callable[[float], None]


class File(NamedTuple):
    """A file written, and what it holds."""

    path: Path
    holds: str


class Written(NamedTuple):
    """What a simulation left: all files, and the two that `deepgnss process` starts from."""

    files: tuple[File, ...]
    recording: Path
    config: Path


def write_simulation(
    simulation: Simulation,
    folder: Path,
    threads: int = 1,
    progress: Progress = lambda seconds: None,
) -> Written:
    """Fill a folder; each file has its final name only once it is whole.

    Parameters
    ----------
    progress: told the seconds of recording written so far.

    Raises
    ------
    OutputError: the folder or a file cannot be written, the disk is too small for them, or an
        output would replace a file that the scenario reads.
    """
    folder = folder.resolve()
    _require_space(simulation, folder)
    _spare_inputs(simulation, folder)
    prepare_folder(folder, FILES)
    files = [*_small_files(simulation, folder), *_truths(simulation, folder)]
    files += _samples(simulation, folder, threads, progress)
    return Written(tuple(files), folder / recording_name(simulation), folder / "config.yaml")


def _require_space(simulation: Simulation, folder: Path) -> None:
    scenario, config = simulation.scenario, simulation.config
    samples = sum(s.front_end.bytes_per_second for s in scenario.streams) * scenario.seconds
    rows = config.truth.rate * 2 + len(scenario.emitters) / config.truth.ranges
    if config.imu is not None:
        rows += 3.0 * config.imu.rate
    needed = samples + rows * scenario.seconds * _ROW_BYTES
    there = next(path for path in (folder, *folder.parents) if path.exists())
    with reporting(folder):
        free = shutil.disk_usage(there).free
    if needed > free:
        raise OutputError(
            f"{folder}: the recording needs {math.ceil(needed)} bytes, the disk has {free} free"
        )


def _spare_inputs(simulation: Simulation, folder: Path) -> None:
    outputs = written(folder, FILES) if folder.is_dir() else []
    for path in (simulation.config.satellites.nav, simulation.config.trajectory.file):
        if path is not None and path.resolve() in outputs:
            raise OutputError(f"{path}: read by the scenario, and an output would replace it")


def _small_files(simulation: Simulation, folder: Path) -> Iterator[File]:
    scenario = simulation.scenario
    head = (
        f"# Made by deepgnss {version('deepgnss')}; `deepgnss simulate` makes it again from this.\n"
    )
    write_whole(folder / "scenario.yaml", head + resolved_yaml(simulation.config))
    yield File(folder / "scenario.yaml", f"the scenario {scenario.name}, seed {scenario.seed}")
    write_whole(folder / "config.yaml", write(config_of(simulation)))
    yield File(folder / "config.yaml", "configuration that processes the recording")
    write_nav(folder / "nav.rnx", scenario.nav)
    yield File(folder / "nav.rnx", f"RINEX NAV, {len(scenario.nav.ephemerides)} satellites")


def _truths(simulation: Simulation, folder: Path) -> Iterator[File]:
    scenario, config = simulation.scenario, simulation.config
    write_truth(folder / "truth.csv", scenario, config.truth.rate)
    yield File(folder / "truth.csv", f"antenna and attitude, {config.truth.rate:g} Hz")
    write_clock(folder / "clock.csv", scenario, config.truth.rate)
    yield File(folder / "clock.csv", "receiver clock against GPST")
    write_ranges(folder / "ranges.csv", scenario, config.truth.ranges)
    yield File(folder / "ranges.csv", f"each satellite every {config.truth.ranges:g} s")
    write_navbits(folder / "navbits.csv", scenario)
    yield File(folder / "navbits.csv", "navigation symbols sent")
    if write_sections(folder / SECTIONS_FILE, simulation):
        yield File(folder / SECTIONS_FILE, "when it passes what stands along the road")
    write_observations(folder, perfect_rover(config.rover), scenario)
    yield File(folder / "rover.obs", f"RINEX of a perfect rover, {config.rover.interval:g} s")
    if config.base is not None:
        write_observations(folder, *base_station(config.base, scenario, simulation.unblocked))
        yield File(folder / "base.obs", f"RINEX of the base station, {config.base.interval:g} s")
    if config.imu is not None and imu_name(simulation) is not None:
        yield from (File(*one) for one in write_imu(folder, simulation))
    if config.odometer is not None:
        yield File(*write_odometer(folder, simulation))


def _samples(
    simulation: Simulation, folder: Path, threads: int, progress: Progress
) -> Iterator[File]:
    """Write all streams abreast."""
    scenario = simulation.scenario
    if simulation.config.container:
        path = folder / recording_name(simulation)
        with ContainerWriter(path, scenario.start.utc()) as container:
            if simulation.config.imu is not None and imu_name(simulation) is None:
                yield from (File(*one) for one in write_imu(folder, simulation, container))
            for stream in scenario.streams:
                container.add_stream(stream_format(stream))
            for piece in pieces(scenario, threads):
                stream = scenario.streams[piece.stream]
                dtype = _DTYPES.get(stream.front_end.format, "u1")
                container.append(stream.name, np.frombuffer(piece.data, dtype))
                progress(piece.end / stream.front_end.sample_rate_hz)
        yield File(path, "; ".join(describe(scenario, stream) for stream in scenario.streams))
        return
    paths = [folder / recording_name(simulation, stream) for stream in scenario.streams]
    with ExitStack() as stack:
        files = []
        for path in paths:
            with reporting(path):
                files.append(stack.enter_context(part_path(path).open("wb")))
        for piece in pieces(scenario, threads):
            with reporting(paths[piece.stream]):
                files[piece.stream].write(piece.data)
            progress(piece.end / scenario.streams[piece.stream].front_end.sample_rate_hz)
    for path, stream in zip(paths, scenario.streams, strict=True):
        with reporting(path):
            part_path(path).replace(path)
        yield File(path, describe(scenario, stream))


def describe(scenario: Scenario, stream: Stream) -> str:
    """What a stream holds, in a line: satellites, strengths, what the converter loses."""
    front_end = stream.front_end
    heard = [e for e in scenario.emitters if front_end.hears(e.signal.id)]
    systems = sorted({e.satellite[0] for e in heard}, key="GC".index)
    counts = " + ".join(
        f"{sum(e.satellite[0] == letter for e in heard)} {_SYSTEM_NAMES[letter]}"
        for letter in systems
    )
    levels = [level for e in heard for _, level in e.cn0_dbhz if math.isfinite(level)]
    strength = f", {min(levels):.0f} to {max(levels):.0f} dB-Hz" if levels else ""
    losses = [quantization_loss_db(front_end, signal) for signal in {e.signal.id for e in heard}]
    lost = f", quantization loses {max(losses):.2f} dB" if losses else ""
    return (
        f"{stream.name}: {front_end.sample_rate_hz / 1e6:g} Msps, {counts or 'no satellites'}"
        f"{strength}{lost}"
    )


_SYSTEM_NAMES: Final = {"G": "GPS", "C": "BeiDou"}
