"""The configuration with which `deepgnss process` takes a simulated recording as it is."""

from __future__ import annotations

from typing import Any

from deepgnss.io.formats import StreamFormat
from deepgnss.sim.output.inertial import imu_settings, odometer_settings
from deepgnss.sim.output.sections import NAME as SECTIONS_FILE
from deepgnss.sim.output.sections import passages
from deepgnss.sim.scenario import Stream
from deepgnss.sim.schema.build import Simulation


def recording_name(simulation: Simulation, stream: Stream | None = None) -> str:
    """Name of the file of a stream (the first one)."""
    if simulation.config.container:
        return "rec.h5"
    streams = simulation.scenario.streams
    return "rec.bin" if len(streams) == 1 else f"rec_{(stream or streams[0]).name}.bin"


def stream_format(stream: Stream) -> StreamFormat:
    """How the samples of a stream lie in its file."""
    front_end = stream.front_end
    return StreamFormat(
        name=stream.name,
        format=front_end.format,
        samples="iq" if front_end.is_complex else "real",
        sample_rate_hz=front_end.sample_rate_hz,
        centre_hz=front_end.centre_hz,
        intermediate_hz=front_end.intermediate_hz,
        spectrum="inverted" if front_end.inverted else "upright",
    )


def config_of(simulation: Simulation) -> dict[str, Any]:
    """The configuration, as plain data."""
    config, scenario = simulation.config, simulation.scenario
    start = scenario.start.utc().isoformat(timespec="seconds").replace("+00:00", "Z")
    recording: dict[str, Any] = {"start_time": start}
    if not config.container:
        recording["streams"] = [_stream(simulation, stream) for stream in scenario.streams]
    settings: dict[str, Any] = {
        "recording": recording,
        "signals": sorted({emitter.signal.id.name for emitter in scenario.emitters}, reverse=True),
    }
    if config.imu is not None:
        settings["imu"] = imu_settings(simulation)
    if config.odometer is not None and scenario.vehicle.road is not None:
        settings |= odometer_settings()
    settings["truth"] = {"file": "truth.csv", "format": "csv"}
    if any(passages(simulation)):
        settings["truth"]["sections"] = SECTIONS_FILE
    if config.oscillator is not None:
        settings["oscillator"] = config.oscillator.model_dump(by_alias=True)
    return settings


def _stream(simulation: Simulation, stream: Stream) -> dict[str, Any]:
    form = stream_format(stream)
    several = len(simulation.scenario.streams) > 1
    return {
        "name": form.name,
        **({"file": recording_name(simulation, stream)} if several else {}),
        "format": form.format,
        "samples": form.samples,
        "sample_rate": form.sample_rate_hz,
        "centre_frequency": form.centre_hz,
        "intermediate_frequency": form.intermediate_hz,
        **({"spectrum": form.spectrum} if form.spectrum != "upright" else {}),
    }
