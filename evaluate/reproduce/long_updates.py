"""LU-DYN, LU-SENS, LU-PHASE: the long-update loop on hard motion, from samples, L 2.2.

A receiver swings along the line of sight to its satellite, which it acquires and tracks unaided,
symbols unknown (L: known). The phase error is that of the loop's estimate, from which observables
are made, at ten instants in each update, against the true phase at the true instant of the sample;
nothing is taken off but the half cycles it begins with. L's 8 Hz/s² with 800 Hz/s would be swings
of 1500 km at 15 km/s; here they come with 320 Hz/s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray
from deepgnss.evaluate.reproduce.carried_phase import TrueTime
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.trackers import NcoState, advance, corrected
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.schema import PUBLISHED, build, load_scenario

SCENARIO: Final = "long_update"
UPDATE_S: Final = 0.2
SIGMA_CYCLES: Final = 0.01
_RUN: Final = (
    f"tracking.carrier={{loop: long_update, long_update: {{update: {UPDATE_S}}}}}",
    # Where the loop lets go is looked for, before the receiver gives up.
    "tracking.thresholds={phase: 18, frequency: 12}",
    "acquisition.doppler_max=16.0e+3",
    "acquisition.weak=false",
)
_RATES_HZPS: Final = {8.0: 320.0}  # by slope, others 800
_GENTLE: Final = "tracking.carrier.long_update.dynamics=0.1"  # told of 8 Hz/s²
_INSTANTS: Final = 10  # of an update
_SLIP_CYCLES: Final = 0.25
_STRONG_DBHZ: Final = 45.0
# From strong to the level of LU-SENS: slower than the C/N0 of the last second, which falls by
# 4.3 dB/s at most. A signal that is well below it is taken for one about to be lost.
_FALL_S: Final = 1.5
_FALL_DBPS: Final = 2.0
_KNOWN_S: Final = 2.0  # after the fall
_HELD_S: Final = 17.0
_QUICK_HELD_S: Final = 3.0
_LEVELS: Final = ((0.0, 7.0, 40.0), (7.0, 14.0, 35.0), (14.0, 24.0, 30.0))  # LU-PHASE: s, dB-Hz
_SETTLED_S: Final = 2.0  # of each before it counts
_PUBLISHED_DBHZ: Final = {64.0: 23.0, 8.0: 21.0}
_BELOW_DB: Final = 1.5  # shown beside it
_QUICK_S: Final = 9.0
_STEP_S: Final = 0.5
_LOCKED_S: Final = 1.5  # of a recording: by then there is a valid phase
_UNDER_WAY_S: Final = 3.0 * UPDATE_S


class Heard(NamedTuple):
    """Phase of a run's valid observables, at instants of the recording."""

    time_s: FloatArray  # since its beginning
    error_cycles: FloatArray  # less the half cycles of the first update
    middle: FloatArray  # whether near an update's middle
    updates_to_lock: float  # from phase loop to valid phase
    lost: bool  # other than on the way to phase lock
    slope_hzps2: float  # largest one in truth
    length_s: float  # of the recording

    @property
    def slipped(self) -> bool:
        """Whether an update's mean has left the first one's half cycle."""
        means = self.error_cycles[: self.error_cycles.size // _INSTANTS * _INSTANTS]
        off = np.abs(means.reshape(-1, _INSTANTS).mean(axis=1))
        return bool(off.max(initial=0.0) > _SLIP_CYCLES)

    def within(self, begin_s: float, end_s: float) -> NDArray[np.bool_]:
        """Which of the instants lie in a stretch of the recording."""
        return (self.time_s > begin_s) & (self.time_s < end_s)

    def seconds(self, begin_s: float, end_s: float) -> float:
        """For how much of a stretch of the recording there is a valid phase."""
        return float(self.within(begin_s, end_s).sum()) / _INSTANTS * UPDATE_S

    def covers(self, begin_s: float, end_s: float) -> bool:
        """Whether that is all of it: the end's updates are still under way."""
        end_s = min(end_s, self.length_s - _UNDER_WAY_S)
        return end_s > begin_s and self.seconds(begin_s, end_s) > end_s - begin_s - UPDATE_S

    def held(self, begin_s: float) -> bool:
        """Whether there is one phase from some time on to the end."""
        return not self.lost and not self.slipped and self.covers(begin_s, self.length_s)


def motion(slope_hzps2: float) -> str:
    """KEY=VALUE of the scenario's swings."""
    rate_hzps = _RATES_HZPS.get(slope_hzps2, 800.0)
    w = slope_hzps2 / rate_hzps
    amplitude_m = rate_hzps * SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz / w**2
    trajectory = load_scenario(PUBLISHED + SCENARIO).trajectory.sine
    if trajectory is None:
        raise ValueError(f"{SCENARIO}: no sine")
    along = f"azimuth: {trajectory.azimuth}, elevation: {trajectory.elevation}"
    swing = f"amplitude: {amplitude_m:.3f}, frequency: {w / math.tau:.8f}"
    return f"trajectory.sine={{{along}, {swing}}}"


def levels(*points: tuple[float, float]) -> str:
    """KEY=VALUE of C/N0 behind the converter over time: (s, dB-Hz)."""
    front_end = build(load_scenario(PUBLISHED + SCENARIO)).scenario.streams[0].front_end
    lost = loss_db(front_end)
    return f"satellites.schedule={{all: {[[s, round(level + lost, 3)] for s, level in points]}}}"


def falling(dbhz: float) -> list[tuple[float, float]]:
    """Levels over time of LU-SENS: strong, then down to one in steps of about 1 dB."""
    steps = round(_STRONG_DBHZ - dbhz)
    down = np.linspace(_STRONG_DBHZ, dbhz, steps + 1)[1:]
    times_s = _FALL_S + (_STRONG_DBHZ - down) / _FALL_DBPS
    return [(0.0, _STRONG_DBHZ), *zip(times_s.round(3).tolist(), down.tolist(), strict=True)]


def heard(recording: Recording, *settings: str) -> Heard:
    """Run the receiver; the phase of its only satellite against the truth."""
    length_s = recording.scenario.seconds
    seen: dict[int, Interval] = {}
    modes: list[tuple[int, str]] = []
    with started(recording, *_RUN, *settings) as (_, plan, engine):
        rate_hz = plan.stream.sample_rate_hz
        for result in engine.steps():
            modes += [(event.sample, event.what) for event in result.events]
            for channel in engine.receiver.channels:
                seen |= {one.command.sample: one for one in channel.history}
    intervals = [seen[sample] for sample in sorted(seen)]
    valid = [
        (one, (later.command.sample - one.command.sample) / rate_hz)
        for one, later in pairwise(intervals)
        if one.phase_valid
    ]
    begun = [sample for sample, what in modes if what == "PLL"]
    locked = [sample for sample, what in modes if what == "phase lock"]
    lost = [
        s
        for s, what in modes
        if what in ("lost", "hold", "FLL", "FFT") and s > min(locked, default=0)
    ]
    if not valid or not locked:
        empty = np.empty(0)
        return Heard(empty, empty, empty, math.inf, True, 0.0, length_s)
    shares = (np.arange(_INSTANTS) + 0.5) / _INSTANTS
    at_s = np.array([length_s * shares for _, length_s in valid])
    told = np.array([_cycles(one, own) for (one, _), own in zip(valid, at_s, strict=True)])
    reading_s = at_s + np.array([[one.command.sample / rate_hz] for one, _ in valid])
    error = told - _true_cycles(recording, reading_s.ravel()).reshape(told.shape)
    error -= np.round(2.0 * error[0].mean()) / 2.0
    near = np.tile(np.abs(shares - 0.5) < 1.0 / _INSTANTS, len(valid)).astype(np.float64)
    updates = (locked[0] - begun[0]) / rate_hz / UPDATE_S
    true_cycles = _true_cycles(recording, np.arange(0.0, reading_s.max(), _STEP_S))
    slope = float(np.abs(np.diff(true_cycles, n=3)).max()) / _STEP_S**3
    return Heard(reading_s.ravel(), error.ravel(), near, updates, bool(lost), slope, length_s)


def _cycles(interval: Interval, at_s: FloatArray) -> FloatArray:
    """Carrier as the loop estimates it, s after the command, cycles at +Doppler."""
    command = interval.command
    generator = NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps)
    states = [
        corrected(advance(generator, t), interval.correction, t - interval.middle_s)
        for t in at_s.tolist()
    ]
    return np.array([state.phase for state in states])


def _true_cycles(recording: Recording, reading_s: FloatArray) -> FloatArray:
    """The same in truth: the range's cycles, and those the receiver's clock is off."""
    scenario = recording.scenario
    true_time = TrueTime(scenario)
    true_s = np.array([true_time(float(t)) for t in reading_s])
    (emitter,) = scenario.emitters
    orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
    range_cycles = receive(scenario, emitter, orbit, true_s).carrier_cycles
    return np.asarray(emitter.signal.id.carrier_hz * (true_s - reading_s) - range_cycles)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.inf


def measure_dynamics(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """LU-DYN: held without slip, phase from the first update; quick: 9 s of one seed, 80 Hz/s²."""
    figures = []
    for slope in (80.0,) if quick else (64.0, 80.0):
        runs = []
        for seed in seeds[:1] if quick else seeds:
            short = (f"seconds={_QUICK_S}",) if quick else ()
            with recorded(SCENARIO, seed, motion(slope), levels((0.0, 40.0)), *short) as recording:
                runs.append(heard(recording))
        held = sum(run.held(_LOCKED_S) for run in runs)
        errors = np.concatenate([run.error_cycles for run in runs])
        updates = max(run.updates_to_lock for run in runs)
        seconds = sum(run.seconds(0.0, run.length_s) for run in runs)
        figures.append(
            Figure(
                f"{slope:g} Hz/s², 40 dB-Hz: held without a slip",
                f"{held} of {len(runs)} runs, {seconds:.0f} s; phase error {_rms(errors):.4f} cycle"
                f" RMS, {float(np.abs(errors).max(initial=0.0)):.3f} at most;"
                f" true slope to {max(run.slope_hzps2 for run in runs):.0f} Hz/s²",
                held == len(runs),
            )
        )
        text = f"{updates:.1f} updates after phase lock began, at most"
        figures.append(Figure(f"{slope:g} Hz/s²: phase valid", text, updates < 1.5))
    return figures


def measure_sensitivity(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """LU-SENS: held at the published thresholds, and somewhat below; quick: 64 Hz/s², one seed."""
    figures = []
    for slope, level in _PUBLISHED_DBHZ.items():
        if quick and slope != 64.0:
            continue
        for dbhz in (level,) if quick else (level, level - _BELOW_DB):
            runs = []
            for seed in seeds[:1] if quick else seeds:
                schedule = falling(dbhz)
                weak_s = schedule[-1][0] + _KNOWN_S
                seconds = weak_s + (_QUICK_HELD_S if quick else _HELD_S)
                told = (motion(slope), levels(*schedule), f"seconds={seconds}")
                with recorded(SCENARIO, seed, *told) as recording:
                    runs.append(heard(recording, *((_GENTLE,) if slope in _RATES_HZPS else ())))
            held = sum(run.held(weak_s) for run in runs)
            weak = [run.error_cycles[run.within(weak_s, run.length_s)] for run in runs]
            seconds = sum(run.seconds(weak_s, run.length_s) for run in runs)
            figures.append(
                Figure(
                    f"{slope:g} Hz/s², {dbhz:g} dB-Hz: held without a slip",
                    f"{held} of {len(runs)} runs, {seconds:.0f} s; phase error"
                    f" {_rms(np.concatenate(weak)):.4f} cycle RMS",
                    held == len(runs) if dbhz == level else None,
                )
            )
    return figures


def measure_phase(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """LU-PHASE: σ at all instants, and in the middles of updates; quick: 40 dB-Hz of one seed."""
    points = [(begin_s, dbhz) for begin_s, _, dbhz in _LEVELS]
    short = (f"seconds={_QUICK_S}",) if quick else ()
    runs = []
    for seed in seeds[:1] if quick else seeds:
        with recorded(SCENARIO, seed, motion(64.0), levels(*points), *short) as recording:
            runs.append(heard(recording))
    figures = []
    for begin_s, end_s, dbhz in _LEVELS[:1] if quick else _LEVELS:
        begin_s += _SETTLED_S
        own = [run.within(begin_s, end_s) for run in runs]
        every = np.concatenate([r.error_cycles[k] for r, k in zip(runs, own, strict=True)])
        middles = np.concatenate(
            [r.error_cycles[k & (r.middle > 0)] for r, k in zip(runs, own, strict=True)]
        )
        sigma = _rms(every)
        figures.append(
            Figure(
                f"64 Hz/s², {dbhz:g} dB-Hz",
                f"{sigma:.4f} cycle at all instants, {_rms(middles):.4f} in the middles of"
                f" updates ({every.size / _INSTANTS:.0f} updates)",
                sigma < SIGMA_CYCLES and all(run.covers(begin_s, end_s) for run in runs),
            )
        )
    return figures
