"""FFT-20G: 100 g at 20 dB-Hz, frequency tracked by the spectrum of windows and aided, T 4.6."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import STANDARD_GRAVITY_MPS2
from deepgnss.core.records import Epoch, Event
from deepgnss.evaluate.reproduce.sampled_truth import SampledTruth
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.weak_ranges import CHIP_M
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started, with_unit
from deepgnss.receiver.modes import Mode
from deepgnss.sim.schema import PUBLISHED, load_scenario
from deepgnss.sim.schema.inertial import ImuLogConfig

WINDOW_S: Final = 0.32
OFF_HZ: Final = 0.5 / WINDOW_S  # within the window's line
OFF_CHIPS: Final = 0.1
_SETTINGS: Final = (
    # Aided, what is left of a manoeuvre is a short pulse: order 2 would carry its slope on.
    f"tracking.frequency={{window: {WINDOW_S}, order: 1, gain: 0.7}}",
    "output.interval=0.1",
)
_AFTER_S: Final = 3.0  # windows enough for the watch over false locks, too few for a search
_HARD_MPS2: Final = 40.0  # steps that count
_LIMITS_G: Final = (5, 10, 25, 50, 100)  # at which the lesser unit is tried
_LOST: Final = frozenset({Mode.HOLD.value, Mode.LOST.value, "acquired"})
_MOVED: Final = "false lock"  # a frequency that had gone lines off was put right
_QUICK_S: Final = 49.0


class Manoeuvre(NamedTuple):
    """A step of acceleration and back, s since the scenario's start."""

    begin_s: float
    end_s: float


class Outcome(NamedTuple):
    """One satellite after a manoeuvre."""

    off_hz: float
    off_chips: float
    lost: bool
    moved: bool = False  # shown only

    @property
    def tracked(self) -> bool:
        """Whether frequency and code are still the signal's."""
        return not self.lost and abs(self.off_hz) < OFF_HZ and abs(self.off_chips) < OFF_CHIPS


def manoeuvres(recording: Recording) -> list[Manoeuvre]:
    """The hard ones that the recording goes on after."""
    config = recording.simulation.config
    trajectory = config.trajectory.steps
    if trajectory is None:
        raise ValueError(f"{config.name}: no trajectory by steps of acceleration")
    found = []
    for (begin_s, value), (back_s, _) in zip(trajectory.steps, trajectory.steps[1:], strict=False):
        end_s = back_s + abs(value) / trajectory.jerk
        if abs(value) >= _HARD_MPS2 and end_s + _AFTER_S + 0.5 < config.seconds:
            found.append(Manoeuvre(begin_s, end_s))
    return found


def _alignment(recording: Recording, grade: str) -> str:
    """The attitude the unit is told at the start: the true one and the errors of its grade."""
    config = recording.simulation.config
    trajectory = config.trajectory.steps
    if trajectory is None:
        raise ValueError(f"{config.name}: no trajectory by steps of acceleration")
    unit = ImuLogConfig.model_validate({"grade": grade}).grade
    if unit is None:
        raise ValueError(f"{grade}: no grade of inertial units")
    sigma = unit.build()
    deg = np.degrees(np.random.default_rng(config.seed).standard_normal(3))
    angles = np.array([0.0, trajectory.elevation, trajectory.azimuth])  # forward along the way
    roll, pitch, yaw = angles + deg * [sigma.tilt_rad, sigma.tilt_rad, sigma.heading_rad]
    return f"imu.alignment={{method: config, roll: {roll}, pitch: {pitch}, yaw: {yaw}}}"


def outcomes(recording: Recording, grade: str) -> list[Outcome]:
    """Every satellite after every manoeuvre; what all Dopplers have in common is the clock's."""
    truth = SampledTruth(recording)
    epochs: dict[int, Epoch] = {}
    events: list[Event] = []
    unit = (*with_unit(recording, grade), _alignment(recording, grade))
    with started(recording, *_SETTINGS, *unit) as run:
        for result in run.engine.steps():
            events += result.events
            epochs.update(
                (round(10.0 * fix.epoch.time.since(truth.start)), fix.epoch) for fix in result.fixes
            )
    rate_hz = recording.scenario.streams[0].front_end.sample_rate_hz
    found = []
    for begin_s, end_s in manoeuvres(recording):
        until_s = end_s + _AFTER_S
        epoch = epochs.get(round(10.0 * until_s))
        seen = truth.errors(epoch) if epoch is not None else {}
        drift_hz = statistics.median(error.doppler_hz for error in seen.values()) if seen else 0.0
        during = [event for event in events if begin_s < event.sample / rate_hz < until_s]
        gone = {event.satellite for event in during if event.what in _LOST}
        moved = {event.satellite for event in during if event.what == _MOVED}
        for emitter in recording.scenario.emitters:
            name = emitter.satellite
            error = seen.get(name)
            if error is None:
                found.append(Outcome(0.0, 0.0, lost=True))
                continue
            chips = error.range_m / CHIP_M
            found.append(Outcome(error.doppler_hz - drift_hz, chips, name in gone, name in moved))
    return found


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Shares tracked: FSAS at 100 g is judged, MTi-G's limit shown; quick: one acceleration."""
    chosen = seeds[:1] if quick else seeds
    short = (f"seconds={_QUICK_S}",) if quick else ()
    found: list[Outcome] = []
    for seed in chosen:
        with recorded("hundred_g", seed, *short) as recording:
            found += outcomes(recording, "FSAS")
    figures = [_figure("FSAS", 100, found, judged=True)]
    if quick:
        return figures
    for g in _LIMITS_G:
        with recorded("hundred_g", seeds[0], _scaled(g)) as recording:
            figures.append(_figure("MTi-G", g, outcomes(recording, "MTi-G"), judged=False))
    return figures


def _scaled(g: int) -> str:
    """The scenario's steps with hard ones of so many g instead."""
    trajectory = load_scenario(PUBLISHED + "hundred_g").trajectory.steps
    if trajectory is None:
        raise ValueError("hundred_g: no trajectory by steps of acceleration")
    g_mps2 = g * STANDARD_GRAVITY_MPS2
    steps = [
        [
            second,
            value if abs(value) < _HARD_MPS2 else math.copysign(g_mps2, value),
        ]
        for second, value in trajectory.steps
    ]
    return f"trajectory.steps.steps={steps}"


def _figure(grade: str, g: int, runs: Sequence[Outcome], *, judged: bool) -> Figure:
    held = [run for run in runs if not run.lost]
    tracked, moved = sum(run.tracked for run in runs), sum(run.moved for run in runs)
    hz = max((abs(run.off_hz) for run in held), default=0.0)
    chips = max((abs(run.off_chips) for run in held), default=0.0)
    return Figure(
        f"{grade}: tracked after {g} g",
        f"{tracked} of {len(runs)}; largest {hz:.2f} Hz of {OFF_HZ:.2f}, {chips:.3f} chip;"
        f" {moved} moved back from other lines",
        0 < tracked == len(runs) if judged else None,
    )
