"""Tracking stays scalar: what one channel is made to believe does not reach the others' phases."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.records import Event
from deepgnss.evaluate.reproduce.whole_receiver import Recording, started
from deepgnss.receiver.clock import NS, to_ns
from deepgnss.receiver.receiver import Fix
from deepgnss.sim.clock import clock_error
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.output import write_simulation
from deepgnss.sim.scenario import Arrivals, View
from deepgnss.sim.schema import build, load_scenario

FROM_S = 8.0
SPEED_MPS, JUMP_M, JUMP_AFTER_S = 1.0, 30.0, 2.5
SECONDS = 13.0
DRIVE = f"""
name: spoofed
start: 2023-11-30T10:10:40.5Z           # 1.5 s before a subframe of GPS
seconds: {SECONDS}
seed: 4
trajectory:
  street: {{waypoints: [[0, 0], [400, 0], [400, 300]], radius: 40, speed: 15, stops: []}}
antennas:
  - {{name: main, lever_arm: [0.40, 0.10, -1.20]}}
satellites: {{systems: [GPS], mask: 15, limit: 6, cn0: 45}}
oscillator: OCXO
clock: {{offset: -4.1e-5, drift: 2.0e-8}}
streams:
  - {{name: L1, format: bits2, sample_rate: 2.61e+6}}
imu: {{rate: 200, grade: FSAS}}
"""


@dataclass(frozen=True)
class Spoofer:
    """Takes a satellite's place from a time on, with an extra way that grows, and then jumps."""

    satellite: str

    @property
    def rays(self) -> int:
        return 1

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        later_s = view.t_s - FROM_S
        heard = (later_s > 0.0) & (view.satellite == self.satellite)
        excess_m = np.where(heard, SPEED_MPS * later_s + JUMP_M * (later_s > JUMP_AFTER_S), 0.0)
        return Arrivals(1.0 * ~heard, 1.0 * heard[np.newaxis], excess_m[np.newaxis])


@contextmanager
def _recorded(folder: Path, spoofer: Spoofer) -> Iterator[Recording]:
    folder.mkdir()
    path = folder / "spoofed.yaml"
    path.write_text(DRIVE, encoding="utf-8")
    config = load_scenario(path)
    simulation = build(config)
    scenario = replace(simulation.scenario, surroundings=spoofer)
    simulation = replace(simulation, scenario=scenario)
    place = (config.place.latitude, config.place.longitude, config.place.height)
    yield Recording(simulation, write_simulation(simulation, folder, 2), place)


def _errors(recording: Recording, fix: Fix, rate_hz: float) -> dict[str, float]:
    """Phases of a tag less the simulator's: what is left are noise and ambiguities."""
    scenario = recording.scenario
    instant = fix.epoch.instant
    read_s = (instant.sample + instant.fraction) / rate_hz
    whole = int(read_s)
    nodes = np.concatenate(
        [
            clock_error(scenario.clock, scenario.seed, scenario.vehicle)(k)
            for k in (whole, whole + 1)
        ]
    )
    error_s = float(np.interp(read_s, whole + np.arange(nodes.size) * 1e-3, nodes))
    tag_s = (to_ns(fix.epoch.time) - to_ns(scenario.start)) / NS
    found = {}
    for emitter in scenario.emitters:
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        truth = receive(scenario, emitter, orbit, np.array([read_s - error_s]))
        lag_s = tag_s - read_s + error_s
        cycles = float(truth.carrier_cycles[0]) + emitter.signal.id.carrier_hz * lag_s
        for one in fix.epoch.observations:
            if one.satellite == emitter.satellite and one.carrier_valid:
                found[one.satellite] = one.carrier_cycles - cycles
    return found


def _run(folder: Path, spoofer: Spoofer) -> tuple[dict[tuple[int, str], float], list[Event]]:
    """Errors of phase by tag and satellite, and all events."""
    errors: dict[tuple[int, str], float] = {}
    events: list[Event] = []
    settings = ("threads=1", "output.interval=0.1")
    with _recorded(folder, spoofer) as recording, started(recording, *settings) as run:
        for result in run.engine.steps():
            events += result.events
            for fix in result.fixes:
                tag = to_ns(fix.epoch.time)
                for satellite, error in _errors(
                    recording, fix, run.plan.stream.sample_rate_hz
                ).items():
                    errors[tag, satellite] = error
    return errors, events


@pytest.mark.slow
def test_one_spoofed_channel_leaves_the_others_phases_alone(tmp_path: Path) -> None:
    sound, before = _run(tmp_path / "sound", Spoofer("nobody"))
    satellites = sorted({satellite for _, satellite in sound})
    assert len(satellites) == 6
    assert "started" in {event.what for event in before if event.satellite == "INS"}
    spoofed = satellites[2]
    wrong, events = _run(tmp_path / "spoofed", Spoofer(spoofed))
    told = [event for event in events if event.what in ("cycle slip", "slip repaired")]
    assert {event.satellite for event in told} == {spoofed}
    last = max(tag for tag, _ in sound)
    tags = sorted({tag for tag, _ in sound if tag > last - 6 * NS})
    for satellite in set(satellites) - {spoofed}:
        off = np.array([wrong[tag, satellite] - sound[tag, satellite] for tag in tags])
        assert np.abs(off - off[0]).max() < 0.02, satellite
