"""CP-TURN: what steps of acceleration do to a carrier loop, unaided and aided, T 6.2.2.

The phase error is the discriminator's output, so that of the generator, as in T's figures 6.9 to
6.14: steps come again and again, and their responses are averaged. Each lasts until its peak is
over and no longer: an error of 0.15 cycle that stays is what the lock detector calls lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, Correlations, FloatArray
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started, with_unit
from deepgnss.receiver.discriminators import costas_arctan
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.theory.tracking_error import acceleration_peak_cycles, loop_states

SCENARIO: Final = "turns"
UNITS: Final = ("FSAS", "MTi-G")
TOLERANCE: Final = 0.1  # of the peak by theory
SHARE: Final = 0.1  # of the unaided peak, aided
TWO_G_MPS2: Final = 19.613

_FIRST_S: Final = 14.0  # first step: loops settled, navigation aligned
_EVERY_S: Final = 1.8
_HELD_S: Final = 0.5  # order 2 at 5 Hz has its peak 0.47 s after a step
_STEPS, _QUICK_STEPS = 13, 6  # each seen by four satellites
_BEFORE_S: Final = 0.2  # error taken for that without a step
_BIN_S: Final = 0.005
_SEEN: Final = 0.4  # cosine between motion and line of sight that makes a step count
_ALONG: Final = 0.9598  # that of G11, which is given its steps whole
_SLIP_CYCLES: Final = 0.25
_WAVELENGTH_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz


class Loop(NamedTuple):
    """A carrier loop, and the steps it is put to."""

    order: int
    bandwidth_hz: float
    coherent_s: float
    step_mps2: float  # along the line of sight

    @property
    def settings(self) -> tuple[str, ...]:
        """As the run is told."""
        return (
            f"tracking.carrier={{loop: pll{self.order}, bandwidth: {self.bandwidth_hz:g},"
            f" coherent: {self.coherent_s:g}}}",
            f"tracking.code.coherent={self.coherent_s:g}",
        )

    @property
    def step_hzps(self) -> float:
        """What a step changes in the carrier's rate."""
        return self.step_mps2 / _WAVELENGTH_M

    def __str__(self) -> str:
        step = f"{self.step_mps2:.3g} m/s²"
        return f"order {self.order}, {self.bandwidth_hz:g} Hz, {1e3 * self.coherent_s:g} ms, {step}"


# T table 6.2. Updated every 20 ms, 10 m/s² would drive the discriminator beyond its range.
LOOPS: Final = tuple(
    Loop(order, *rest)
    for rest in ((5.0, 0.001, 2.5), (10.0, 0.001, 10.0), (10.0, 0.020, 2.5))
    for order in (2, 3)
)


class Response(NamedTuple):
    """Mean response to a step, as if all had the loop's own size."""

    time_s: FloatArray  # since the step, middles of bins
    cycles: FloatArray  # phase less generator
    steps: int
    slipped: int  # steps of which a phase was off by more than a discriminator tells

    @property
    def peak_cycles(self) -> float:
        """Largest phase error."""
        return float(np.abs(self.cycles[self.time_s > 0.0]).max())


def step_times_s(count: int) -> FloatArray:
    """Instants of steps since the recording's beginning."""
    return np.asarray(_FIRST_S + _EVERY_S * np.arange(count))


def course(step_mps2: float, count: int) -> tuple[str, ...]:
    """Settings of a recording: up, back to nothing, down, back to nothing …"""
    level = step_mps2 / _ALONG
    steps = []
    for k, begin_s in enumerate(step_times_s(count)):
        steps += [[round(float(begin_s), 3), level * (-1) ** k]]
        steps += [[round(float(begin_s) + _HELD_S, 3), 0.0]]
    seconds = _FIRST_S + _EVERY_S * count
    return f"trajectory.steps.steps={steps}", f"seconds={seconds}"


def step_rates_hzps(recording: Recording, times_s: FloatArray) -> Mapping[str, FloatArray]:
    """By how much each step truly changes each satellite's Doppler rate."""
    scenario, spans_s = recording.scenario, np.array([-0.6, -0.4, -0.2, 0.1, 0.3, 0.5])
    rates = {}
    for emitter in scenario.emitters:
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        at_s = times_s[:, np.newaxis] + spans_s
        cycles = receive(scenario, emitter, orbit, at_s.ravel()).carrier_cycles.reshape(at_s.shape)
        before, after = np.diff(cycles[:, :3], n=2), np.diff(cycles[:, 3:], n=2)
        rates[emitter.satellite] = (before - after)[:, 0] / 0.2**2
    return rates


class Heard(NamedTuple):
    """What the discriminator of a channel said."""

    time_s: FloatArray  # middles of intervals, since the recording's beginning
    cycles: FloatArray


def discriminated(recording: Recording, *settings: str) -> Mapping[str, Heard]:
    """Discriminator outputs of a run, by satellite."""
    heard: dict[str, list[tuple[float, float]]] = {}
    with started(recording, *settings, "output.correlations=true") as (_, plan, engine):
        rate_hz = plan.stream.sample_rate_hz
        for result in engine.steps():
            for satellite, taken in result.correlations.items():
                heard.setdefault(satellite, []).extend(_told(one, rate_hz) for one in taken)
    return {satellite: Heard(*np.array(told).T) for satellite, told in heard.items()}


def _told(taken: Correlations, rate_hz: float) -> tuple[float, float]:
    prompts = taken.taps[:, 1]
    middle_s = taken.first / rate_hz + 0.5 * prompts.size * taken.seconds
    return middle_s, costas_arctan(complex(prompts.sum()))


def response(recording: Recording, loop: Loop, steps: int, heard: Mapping[str, Heard]) -> Response:
    """Mean of the responses to all steps, each weighed by its size.

    Averages of bins: an interval counts in that of its middle.
    """
    times_s = step_times_s(steps)
    edges_s = np.arange(-_BEFORE_S, _HELD_S + _BIN_S / 2.0, _BIN_S)
    middles_s = 0.5 * (edges_s[1:] + edges_s[:-1])
    weighed, weights = np.zeros(middles_s.size), np.zeros(middles_s.size)
    counted = slipped = 0
    for satellite, rates_hzps in step_rates_hzps(recording, times_s).items():
        told = heard.get(satellite)
        for time_s, rate_hzps in zip(times_s, rates_hzps, strict=True):
            if told is None or abs(rate_hzps) < _SEEN / _ALONG * loop.step_hzps:
                continue
            since_s = told.time_s - time_s
            own = (since_s >= edges_s[0]) & (since_s < edges_s[-1])
            cycles = told.cycles[own] - told.cycles[own & (since_s < 0.0)].mean()
            place = np.digitize(since_s[own], edges_s) - 1
            np.add.at(weighed, place, rate_hzps * cycles)
            np.add.at(weights, place, rate_hzps**2)
            counted += 1
            slipped += int(np.abs(told.cycles[own]).max() > _SLIP_CYCLES - 0.01)
    filled = weights > 0.0
    cycles = loop.step_hzps * weighed[filled] / weights[filled]
    return Response(middles_s[filled], cycles, counted, slipped)


def integrated_peak_cycles(loop: Loop) -> float:
    """Largest discriminator output of the loop itself, run on a step without noise.

    Averaged over where in an interval the step falls.
    """
    T, count = loop.coherent_s, round(2.0 / loop.coherent_s)
    forward = np.array([1.0, T, 0.5 * T * T])
    bins = np.arange(0.0, _HELD_S, _BIN_S)
    total, number = np.zeros(bins.size), np.zeros(bins.size)
    for share in (np.arange(20) + 0.5) / 20.0:
        edges_s = T * (np.arange(count + 1) - 10 + share)
        cubes = np.maximum(edges_s, 0.0) ** 3 * loop.step_hzps / 6.0
        means = np.diff(cubes) / T
        states = loop_states(means, loop.order, loop.bandwidth_hz, T)
        errors = means[1:] - states[:-1] @ forward
        since_s = edges_s[1:-1] + 0.5 * T
        inside = (since_s > 0.0) & (since_s < _HELD_S)
        place = np.digitize(since_s[inside], bins) - 1
        np.add.at(total, place, errors[inside])
        np.add.at(number, place, 1.0)
    filled = number > 0.0
    return float(np.abs(total[filled] / number[filled]).max())


def theory_cycles(loop: Loop) -> tuple[float, str]:
    """Largest phase error to be expected unaided, and whose word that is.

    T's formula is that of a loop updated without end; with 20 ms the discriminator sees what an
    update could not yet know.
    """
    if loop.order == 2 and loop.bandwidth_hz * loop.coherent_s <= 0.01:
        return acceleration_peak_cycles(loop.step_hzps, 2, loop.bandwidth_hz), "T(4.47)"
    return integrated_peak_cycles(loop), "the loop integrated"


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Peaks of all loops, unaided and aided; quick: the longest of order 3, 6 steps, one unit."""
    loops = LOOPS[-1:] if quick else LOOPS
    units = UNITS[:1] if quick else UNITS
    figures: list[Figure] = []
    for step_mps2 in sorted({loop.step_mps2 for loop in loops}):
        own = [loop for loop in loops if loop.step_mps2 == step_mps2]
        with _stepped(step_mps2, quick, seeds[0]) as recording:
            for loop in own:
                figures += _compared(recording, loop, quick, units)
    if not quick:
        with _stepped(TWO_G_MPS2, quick, seeds[0]) as recording:
            for order in (2, 3):
                loop = Loop(order, 5.0, 0.001, TWO_G_MPS2)
                figures += [_alone(recording, loop, quick, unit) for unit in units]
    return figures


def _count(quick: bool) -> int:
    return _QUICK_STEPS if quick else _STEPS


def _stepped(step_mps2: float, quick: bool, seed: int) -> AbstractContextManager[Recording]:
    return recorded(SCENARIO, seed, *course(step_mps2, _count(quick)))


def _heard(recording: Recording, loop: Loop, quick: bool, unit: str | None) -> Response:
    """Response of a run aided by a unit, or of an unaided one."""
    aiding = ("deep=false",) if unit is None else with_unit(recording, unit)
    heard = discriminated(recording, *loop.settings, *aiding)
    return response(recording, loop, _count(quick), heard)


def _compared(
    recording: Recording, loop: Loop, quick: bool, units: Sequence[str]
) -> Iterator[Figure]:
    alone = _heard(recording, loop, quick, None)
    expected, source = theory_cycles(loop)
    share = alone.peak_cycles / expected
    yield Figure(
        f"unaided, {loop}",
        f"{alone.peak_cycles:.4f} cycle = {share:.3f} of {source} ({alone.steps} steps)",
        abs(share - 1.0) <= TOLERANCE,
    )
    for unit in units:
        aided = _heard(recording, loop, quick, unit)
        left = aided.peak_cycles / alone.peak_cycles
        yield Figure(
            f"{unit}, {loop}",
            f"{aided.peak_cycles:.4f} cycle = {left:.3f} of unaided",
            left <= SHARE,
        )


def _alone(recording: Recording, loop: Loop, quick: bool, unit: str) -> Figure:
    """Where an unaided loop is lost: what theory says of one must be beaten all the same."""
    aided = _heard(recording, loop, quick, unit)
    expected, _ = theory_cycles(loop)
    left = aided.peak_cycles / expected
    return Figure(
        f"{unit}, {loop}",
        f"{aided.peak_cycles:.4f} cycle = {left:.3f} of {expected:.2f} unaided by theory,"
        f" {aided.slipped} of {aided.steps} steps beyond the discriminator",
        left <= SHARE and aided.slipped == 0,
    )
