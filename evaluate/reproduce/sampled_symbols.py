"""Correlator outputs of weak signals the long way: samples simulated, correlated where they are.

The generators follow the truth but for a residual frequency, new with every symbol-long interval,
so that what is tested behind them is symbol sync and not the loops.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import ComplexArray, NcoCommand, SampleBlock, StreamInfo
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.reproduce.weak_symbols import CN0_DBHZ, Residual
from deepgnss.receiver.baseband import RunningSumBuffer, correlate
from deepgnss.receiver.signals import Signal, code_runs
from deepgnss.sim.constellation import nominal
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import recording
from deepgnss.sim.motion.paths import Static
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, FrontEnd, Scenario, Stream
from deepgnss.sim.sky import elevations

_START = GpsTime(2290, 382_256.0)
_SAMPLES_PER_CHIP = 2.6  # not in step with the chips
_SATELLITES = 8
_INTERVAL = 20  # code periods of a generator's command
_BLOCK_S = 0.1
_HISTORY_S = 0.03
_NEVER = 1 << 62


class Sampled(NamedTuple):
    """Prompts of one satellite, of about unit amplitude."""

    satellite: str
    prompts: ComplexArray
    edge: int  # period at which a symbol starts
    noise: float  # mean power in a prompt of unit amplitude


def sampled_prompts(
    signal: Signal, seconds: float, seed: int, cn0_dbhz: float = CN0_DBHZ
) -> Iterator[Sampled]:
    """Prompts of the highest satellites over a static receiver."""
    system, rate_hz = signal.id.system, _SAMPLES_PER_CHIP * signal.id.chip_rate_hz
    nav = nominal(_START, seconds, system)
    place = Vehicle(0.53, 1.99, 30.0, Static())
    seen = elevations(nav, _START, place)
    satellites = sorted((s for s in seen if int(s[1:]) in signal.prns), key=lambda s: -seen[s])[
        :_SATELLITES
    ]
    front_end = FrontEnd(rate_hz, centre_hz=signal.id.carrier_hz)
    scenario = Scenario(
        "weak",
        _START,
        seconds,
        place,
        tuple(Emitter(satellite, ((0.0, cn0_dbhz),), signal) for satellite in satellites),
        nav,
        (Stream("one", front_end),),
        seed=seed,
    )
    data = b"".join(recording(scenario))
    samples = np.frombuffer(data, dtype=np.int8).reshape(-1, 2)
    stream = StreamInfo("one", rate_hz, front_end.centre_hz, 0.0, True, len(samples))
    block = round(_BLOCK_S * rate_hz)
    buffer = RunningSumBuffer(
        stream, signal.id.carrier_hz, block + round(2.0 * _HISTORY_S * rate_hz)
    )
    buffer.restart(0)
    rng = np.random.default_rng([seed, 20])
    tracks = [_Track(signal, scenario, emitter, rate_hz, rng) for emitter in scenario.emitters]
    for first in range(0, len(samples), block):
        buffer.keep_from(max(0, first - round(_HISTORY_S * rate_hz)))
        buffer.append(SampleBlock(stream, first, samples[first : first + block]))
        for track in tracks:
            while track.end + 8 < buffer.end:
                track.prompts.append(
                    correlate(buffer.sums, track.command, track.runs, np.zeros(1), _INTERVAL)[:, 0]
                )
                track.go_on()
    noise = 1.0 / (10.0 ** (0.1 * cn0_dbhz) * signal.period_s)
    for emitter, track in zip(scenario.emitters, tracks, strict=True):
        prompts = np.concatenate(track.prompts)
        # Amplitude by what the prompts' power, noise all but a part, must be.
        prompts *= np.sqrt((1.0 + noise) / np.mean(np.abs(prompts) ** 2))
        yield Sampled(emitter.satellite, prompts, track.edge, noise)


class _Track:
    """The generators' commands for one satellite, one after the other."""

    def __init__(
        self,
        signal: Signal,
        scenario: Scenario,
        emitter: Emitter,
        rate_hz: float,
        rng: np.random.Generator,
    ) -> None:
        self.runs = code_runs(signal.id.name, emitter.prn)
        self.prompts: list[ComplexArray] = []
        self._signal, self._rate_hz = signal, rate_hz
        t_s = np.arange(0.0, scenario.seconds + 0.02, 0.02)
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        seen = receive(scenario, emitter, orbit, t_s)
        periods = (scenario.start.tow_s % 1.0 + t_s - seen.pseudorange_m / SPEED_OF_LIGHT_MPS) / (
            signal.period_s
        )
        self._t_s, self._periods, self._cycles = t_s, periods, -seen.carrier_cycles
        self._period = int(np.ceil(periods[0])) + 1
        self.edge = -self._period % signal.symbol_periods
        count = int((scenario.seconds / signal.period_s) // _INTERVAL) + 1
        self._residual = np.append(
            0.0, Residual(noise_hz=1.0).cycles(count, _INTERVAL * signal.period_s, rng)
        )
        self._number = 0
        self._plan()

    def _plan(self) -> None:
        starts_s = np.interp([self._period, self._period + _INTERVAL], self._periods, self._t_s)
        sample = int(np.floor(starts_s[0] * self._rate_hz))
        span_s = starts_s[1] - starts_s[0]
        cycles = np.interp(starts_s, self._t_s, self._cycles)
        code_hz = _INTERVAL * self._signal.id.code_chips / span_s
        late_s = sample / self._rate_hz - starts_s[0]
        off = self._residual[self._number : self._number + 2]
        carrier_hz = float((cycles[1] - cycles[0] + off[1] - off[0]) / span_s)
        self.command = NcoCommand(
            sample,
            float(np.mod(cycles[0] + off[0] + carrier_hz * late_s, 1.0)),
            carrier_hz,
            0.0,
            float(late_s * code_hz),
            float(code_hz),
            0.0,
        )
        over = starts_s[1] >= self._t_s[-1]
        self.end = _NEVER if over else int(np.ceil(starts_s[1] * self._rate_hz))

    def go_on(self) -> None:
        """To the next interval."""
        self._period += _INTERVAL
        self._number += 1
        self._plan()
