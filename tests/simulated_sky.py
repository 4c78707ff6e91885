"""A simulated sky in memory, channels run over it, and the truth they are held against."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import (
    GPS_L1CA,
    Event,
    FloatArray,
    SampleBlock,
    StreamInfo,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver.baseband import RunningSumBuffer
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL
from deepgnss.sim.constellation import nominal_gps
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import recording
from deepgnss.sim.motion.paths import Path, Static
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.navbits import sent_symbols
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, FrontEnd, ReceiverClock, Scenario, Stream
from deepgnss.sim.sky import elevations

CHIP_HZ, CARRIER_HZ, CODE_CHIPS = GPS_L1CA.chip_rate_hz, GPS_L1CA.carrier_hz, 1023
EPOCH_S = 0.1
START = GpsTime(2290, 382_256.0)  # two seconds into a subframe
Steps = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Sky:
    """A scenario (of a clock without noise) and its samples."""

    scenario: Scenario
    samples: NDArray[np.int8]  # (n, 2)

    @property
    def rate_hz(self) -> float:
        return self.scenario.streams[0].front_end.sample_rate_hz

    @cached_property
    def stream(self) -> StreamInfo:
        end = self.scenario.streams[0].front_end
        return StreamInfo(
            "L1", self.rate_hz, end.centre_hz, end.intermediate_hz, True, len(self.samples)
        )

    def read(self, stream: str, first: int, count: int) -> SampleBlock:
        """As a recording."""
        return SampleBlock(self.stream, first, self.samples[first : first + count])

    def emitter(self, satellite: str) -> Emitter:
        return next(e for e in self.scenario.emitters if e.satellite == satellite)

    def truth(self, satellite: str, samples: NDArray[np.int64] | FloatArray) -> Truth:
        """What a satellite's signal does at samples (n,), by the simulator's own definitions."""
        emitter = self.emitter(satellite)
        orbit = orbit_of(self.scenario.orbit_set(satellite), self.scenario.start)
        t_s = np.asarray(samples) / self.rate_hz
        error_s = self.scenario.clock.offset_s + self.scenario.clock.drift_sps * t_s
        seen = receive(self.scenario, emitter, orbit, t_s - error_s)
        whole_s = np.floor(self.scenario.start.tow_s)
        read_s = self.scenario.start.tow_s - whole_s + t_s
        return Truth(
            -seen.carrier_cycles - CARRIER_HZ * error_s,
            read_s - error_s - seen.pseudorange_m / SPEED_OF_LIGHT_MPS,
            int(whole_s),
        )

    def symbols(self, satellite: str, sent_s: FloatArray) -> NDArray[np.int8]:
        """Bits (0, 1) on the air at satellite times, s since the start's whole second."""
        orbit_set = self.scenario.orbit_set(satellite)
        start = self.scenario.start
        bits = sent_symbols(
            GPS_L1CA_SIGNAL, self.scenario.nav, orbit_set, start, self.scenario.seconds
        )
        number = np.floor((sent_s + np.floor(start.tow_s)) * 50.0).astype(np.int64) - bits.first
        return ((1 - bits.values[number]) // 2).astype(np.int8)


@dataclass(frozen=True)
class Truth:
    """At samples of the receiver's clock; sent_s: satellite time since second `whole_s` of week.

    carrier_cycles grow with Doppler, as the generators' do.
    """

    carrier_cycles: FloatArray
    sent_s: FloatArray
    whole_s: int

    @property
    def code_chips(self) -> FloatArray:
        return np.asarray(np.mod(self.sent_s * CHIP_HZ, CODE_CHIPS))


def make_sky(
    cn0_dbhz: Sequence[float | Steps],
    seconds: float,
    *,
    rate_hz: float = 2.6e6,
    path: Path | None = None,
    clock: ReceiverClock | None = None,
    start: GpsTime = START,
    seed: int = 5,
) -> Sky:
    """The highest satellites over a place, each with its C/N0 (or steps of it)."""
    nav = nominal_gps(start, seconds)
    place = Vehicle(0.91, 0.18, 120.0, path or Static())
    seen = elevations(nav, start, place)
    highest = sorted(seen, key=lambda satellite: -seen[satellite])
    emitters = tuple(
        Emitter(satellite, value if isinstance(value, tuple) else ((0.0, value),))
        for satellite, value in zip(highest, cn0_dbhz, strict=False)
    )
    scenario = Scenario(
        "test",
        start,
        seconds,
        place,
        emitters,
        nav,
        (Stream("L1", FrontEnd(rate_hz)),),
        clock=clock or ReceiverClock(),
        seed=seed,
    )
    data = b"".join(recording(scenario))
    return Sky(scenario, np.frombuffer(data, dtype=np.int8).reshape(-1, 2))


STEADY_DBHZ = (44.0, 42.0, 40.0, 38.0, 36.0, 34.0, 32.0, 30.0)
BLOCKED_1_S: Steps = ((0.0, 42.0), (4.0, 0.0), (5.0, 42.0))
BLOCKED_5_S: Steps = ((0.0, 42.0), (4.0, 0.0), (9.0, 42.0))


@cache
def shared_sky() -> Sky:
    """Ten seconds that many tests look at: eight steady satellites, two blocked for a while."""
    clock = ReceiverClock(offset_s=2.0e-4, drift_sps=1.5e-7)
    return make_sky((*STEADY_DBHZ, BLOCKED_1_S, BLOCKED_5_S), 10.0, clock=clock)


def effective_cn0_dbhz(sky: Sky, satellite: str) -> float:
    """C/N0 at the start over noise and the other satellites, each 2/3 chip of its power."""
    others = [e for e in sky.scenario.emitters if e.satellite != satellite]
    density = sum(10.0 ** (0.1 * e.cn0_dbhz[0][1]) for e in others) * 2.0 / 3.0 / CHIP_HZ
    return float(sky.emitter(satellite).cn0_dbhz[0][1] - 10.0 * np.log10(1.0 + density))


@dataclass
class Track:
    """What a channel went through: its intervals and events in order."""

    channel: Channel
    intervals: list[Interval]
    events: list[Event]

    @property
    def samples(self) -> NDArray[np.int64]:
        return np.array([i.command.sample for i in self.intervals])

    def event(self, what: str) -> Event:
        return next(event for event in self.events if event.what == what)


def start_channel(
    sky: Sky,
    satellite: str,
    settings: TrackingSettings,
    *,
    sample: int = 1234,
    code_error_chips: float = 0.0,
    doppler_error_hz: float = 0.0,
) -> Channel:
    """A channel as acquisition starts it, with errors as acquisition leaves them."""
    near = sky.truth(satellite, np.array([sample - 1000, sample, sample + 1000]))
    doppler_hz = (near.carrier_cycles[2] - near.carrier_cycles[0]) * sky.rate_hz / 2000
    return Channel(
        GPS_L1CA_SIGNAL,
        int(satellite[1:]),
        settings,
        sample_rate_hz=sky.rate_hz,
        sample=sample,
        code_chips=float(near.code_chips[1] + code_error_chips) % CODE_CHIPS,
        doppler_hz=float(doppler_hz) + doppler_error_hz,
    )


def track(
    sky: Sky,
    channels: Iterable[Channel],
    end_s: float | None = None,
    epoch_s: float = EPOCH_S,
    start_s: float = 0.0,
) -> dict[str, Track]:
    """Run channels over the sky, epoch by epoch; `start_s`: where they stand by now."""
    tracks = {c.satellite: Track(c, list(c.history), []) for c in channels}
    rate = sky.rate_hz
    history = int(0.07 * rate)
    buffer = RunningSumBuffer(sky.stream, CARRIER_HZ, int(epoch_s * rate) + 3 * history)
    total = len(sky.samples) if end_s is None else int(end_s * rate)
    until = int(start_s * rate)
    buffer.restart(max(0, until - history))
    while until < total:
        until = min(until + int(epoch_s * rate), total)
        buffer.keep_from(buffer.end - history)
        buffer.append(sky.read("L1", buffer.end, until - buffer.end))
        for one in tracks.values():
            one.channel.begin_epoch()
            one.channel.run(buffer.sums)
            known = one.intervals[-1].command.sample
            # The last interval known got its correction only now.
            one.intervals[-1:] = [i for i in one.channel.history if i.command.sample >= known]
            one.events += one.channel.events
    return tracks
