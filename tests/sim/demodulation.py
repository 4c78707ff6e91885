"""A scenario by its defining formulas, and a correlator that shares nothing with the simulator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import sample_source
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, Scenario

Samples = NDArray[np.int64] | FloatArray


class Truth:
    """One emitter in one stream at sample numbers, for clocks without noise."""

    def __init__(self, scenario: Scenario, emitter: Emitter, stream: int = 0) -> None:
        self.scenario, self.emitter = scenario, emitter
        self.front_end = scenario.streams[stream].front_end
        self.antenna = scenario.streams[stream].antenna
        self.orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)

    def at(self, samples: Samples) -> tuple[FloatArray, FloatArray]:
        """Carrier in cycles, without ambiguity, and satellite time in s since start's second."""
        carrier_hz, clock = self.emitter.signal.id.carrier_hz, self.scenario.clock
        reading_s = samples / self.front_end.sample_rate_hz
        error_s = clock.offset_s + clock.drift_sps * reading_s
        truth = receive(self.scenario, self.emitter, self.orbit, reading_s - error_s, self.antenna)
        shift_hz = self.front_end.intermediate_hz * (-1.0 if self.front_end.inverted else 1.0)
        residual_hz = carrier_hz - self.front_end.centre_hz + shift_hz
        cycles = residual_hz * reading_s - truth.carrier_cycles - carrier_hz * error_s
        sent_s = self.scenario.start.tow_s % 1.0 + reading_s - error_s
        return cycles, sent_s - truth.pseudorange_m / SPEED_OF_LIGHT_MPS

    def between(self, first: int, count: int) -> tuple[FloatArray, FloatArray]:
        """The same at samples [first, first + count): a spline through points 0.1 ms apart."""
        step = self.front_end.sample_rate_hz * 1.0e-4
        knots = first + np.arange(-2, np.ceil(count / step) + 3) * step
        samples = np.arange(first, first + count)
        cycles, sent_s = (CubicSpline(knots, values)(samples) for values in self.at(knots))
        return cycles, sent_s

    def code_at(self, sent_s: FloatArray, shift_chips: float = 0.0) -> NDArray[np.int8]:
        """Primary code at satellite times."""
        signal = self.emitter.signal
        chips = np.floor(sent_s * signal.id.chip_rate_hz + shift_chips).astype(np.int64)
        return signal.primary_code(self.emitter.prn)[chips % signal.id.code_chips]

    def local(self, first: int, count: int) -> ComplexArray:
        """Code × conjugate carrier at samples [first, first + count)."""
        cycles, sent_s = self.between(first, count)
        return np.asarray(self.code_at(sent_s) * np.exp(-2j * np.pi * np.mod(cycles, 1.0)))

    def code_starts(self, first: int, count: int, every_s: float = 1.0e-3) -> FloatArray:
        """Instants, in samples, at which satellite time is a multiple of `every_s`."""
        rate_hz = self.front_end.sample_rate_hz
        instants = first + np.arange(count) * every_s * rate_hz
        wanted = np.ceil(self.at(instants[:1])[1][0] / every_s) * every_s
        for _ in range(3):
            late_s = self.at(instants)[1] - wanted - np.arange(count) * every_s
            instants = instants - late_s * rate_hz
        return instants


def as_complex(samples: NDArray[np.float32]) -> ComplexArray:
    """Rows of I and Q, or a real row, as complex numbers."""
    values = samples.astype(np.float64)
    return values[0] + 1j * values[1] if values.shape[0] == 2 else values[0] + 0j


def demodulate(
    scenario: Scenario, emitter: Emitter, firsts: Samples, count: int, stream: int = 0
) -> ComplexArray:
    """Mean of samples × conj(true signal) over `count` samples from each of `firsts`."""
    source, truth = sample_source(scenario, stream), Truth(scenario, emitter, stream)
    front_end = scenario.streams[stream].front_end
    sums = []
    for first in firsts:
        samples = as_complex(source(int(first), count))
        if front_end.inverted and front_end.is_complex:
            samples = samples.conj()
        sums.append(np.mean(samples * truth.local(int(first), count)))
    return np.array(sums)


def phase_cycles(sums: ComplexArray) -> FloatArray:
    """Phase in (−¼, ¼], data bits removed."""
    return np.asarray(np.angle(sums**2) / (4.0 * np.pi))
