"""Channels side by side, steady ones in their kernel, against each by itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from sampled_code import CARRIER_HZ, sampled, signal_command, stream

from deepgnss.core.records import (
    ComplexArray,
    FloatArray,
    NcoCommand,
    RunningSums,
    SampleBlock,
    StreamInfo,
)
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ as MODEL_HZ
from deepgnss.evaluate.reproduce.correlator_model import Model, start
from deepgnss.receiver.baseband import (
    NOTHING_SHARED,
    RunningSumBuffer,
    correlate,
    running_sums,
)
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.leading import Grid, Profile
from deepgnss.receiver.locks import half_shifts
from deepgnss.receiver.modes import AidingSource, CarrierSettings, Mode, TrackingSettings, unaided
from deepgnss.receiver.rack import Rack, correlate_all, run_epoch, run_together
from deepgnss.receiver.signals import (
    BDS_B1I_D1,
    BDS_B1I_D2,
    GPS_L1CA_SIGNAL,
    Signal,
    code_runs,
    code_table,
)
from deepgnss.receiver.steady import Side, State, records, run_steady
from deepgnss.receiver.steady_group import loops_of, state_of, take_back
from deepgnss.receiver.updates import Update

RATE_HZ = 2.61e6
TRUTH = {
    3: signal_command(0, doppler_hz=1200.0, code_chips=17.0),
    31: signal_command(0, doppler_hz=-900.0, code_chips=801.5, carrier_cycles=0.3),
}


def _samples(count: int) -> SampleBlock:
    """Two satellites and noise."""
    info = stream(RATE_HZ)
    noise = 40.0 * np.random.default_rng(3).standard_normal((count, 2))
    for prn, command in TRUTH.items():
        noise += sampled(info, prn, command, 0, count, 4.0).samples
    return SampleBlock(info, 0, np.clip(np.rint(noise), -127, 127).astype(np.int8))


def _channels() -> list[Channel]:
    return [
        Channel(
            GPS_L1CA_SIGNAL,
            prn,
            TrackingSettings(),
            sample_rate_hz=RATE_HZ,
            sample=500,
            code_chips=command.code_chips + 500.0 / RATE_HZ * command.code_hz,
            doppler_hz=command.carrier_hz + 4.0,
        )
        for prn, command in TRUTH.items()
    ]


def test_together_is_bit_by_bit_what_each_does_alone() -> None:
    block = _samples(int(0.5 * RATE_HZ))
    alone, together = _channels(), _channels()
    buffer = RunningSumBuffer(block.stream, CARRIER_HZ, 30_000)
    for first in range(0, block.samples.shape[0], 11_001):
        buffer.keep_from(max(0, first - 5000))
        piece = block.samples[first : first + 11_001]
        buffer.append(SampleBlock(block.stream, first, piece))
        for channel in alone:
            channel.run(buffer.sums)
        run_together(together, buffer.sums, {})
    for one, other in zip(alone, together, strict=True):
        assert len(one.history) > 20
        assert one.history == other.history
        assert one.filled == other.filled > 0


@pytest.mark.kernel
def test_every_channel_has_its_own_code_command_and_periods() -> None:
    sums = running_sums(_samples(30_000), CARRIER_HZ)
    taps = np.array([0.25, 0.0, -0.25])
    table = code_table("GPS_L1CA")
    commands = {
        31: NcoCommand(700, 0.1, -850.0, 3.0, 0.25, 1.0229e6, 0.01),
        3: NcoCommand(61, 0.4, 1250.0, 0.0, -0.5, 1.0231e6, 0.0),
    }
    due = np.array([(table.rows[31], 2, 5), (table.rows[3], 0, 7)])
    out = np.zeros((2, 7, 3), dtype=np.complex128)
    correlate_all(
        sums.packed,
        sums.first,
        sums.step,
        sums.sample_rate_hz,
        np.column_stack([list(commands.values()), due]),
        table.edges,
        table.signs,
        table.runs,
        taps,
        out,
    )
    for row, (prn, command) in enumerate(commands.items()):
        _, skip, periods = due[row]
        wanted = correlate(sums, command, code_runs("GPS_L1CA", prn), taps, periods, skip)
        assert np.array_equal(out[row, :periods], wanted)
    assert not out[0, 5:].any()


# --- through epochs, steady ----------------------------------------------------------------------

EPOCH_S = 0.1
BLOCKS = (29_001, 200_003)  # samples: less and more than the kernel goes over at a time
_EDGES_AT = 7  # code periods


@dataclass(frozen=True)
class _Sent:
    """A satellite with random symbols, silent for a while."""

    signal: Signal
    prn: int
    doppler_hz: float
    rate_hzps: float
    silent_s: tuple[float, float] = (0.0, 0.0)

    @property
    def satellite(self) -> str:
        return self.signal.satellite(self.prn)

    def cycles(self, t: FloatArray) -> FloatArray:
        return np.asarray(t * (self.doppler_hz + 0.5 * t * self.rate_hzps))

    def samples(self, t: FloatArray) -> FloatArray:
        """Complex, of unit power, at seconds (n,)."""
        signal, cycles = self.signal, self.cycles(t)
        chips = 100.0 * self.prn + t * signal.id.chip_rate_hz + cycles / signal.carrier_to_code
        period, chip = np.divmod(np.floor(chips).astype(np.int64), signal.id.code_chips)
        symbol, within = np.divmod(period - _EDGES_AT, signal.symbol_periods)
        signs = np.random.default_rng(self.prn).choice((-1.0, 1.0), 4096)
        wave = signal.primary_code(self.prn)[chip] * signal.secondary[within] * signs[symbol]
        heard = (t < self.silent_s[0]) | (t >= self.silent_s[1])
        return np.asarray(wave * heard * np.exp(2j * np.pi * cycles))

    def foretold(self, epoch: int, rate_hz: float) -> Profile:
        """What a navigation says of an epoch: a little wrong, and otherwise than before."""
        t = EPOCH_S * epoch - 0.04 + 1e-3 * np.arange(200)
        wrong = 0.2 * t * (-1.0) ** epoch
        return Profile(
            Grid(float(t[0]) * rate_hz, 1e-3 * rate_hz, 20.0, 0.02), self.cycles(t) + wrong, 7.0
        )

    def channel(self, settings: TrackingSettings, rate_hz: float) -> Channel:
        chips = 100.0 * self.prn % self.signal.id.code_chips
        return Channel(
            self.signal,
            self.prn,
            settings,
            sample_rate_hz=rate_hz,
            sample=0,
            code_chips=chips,
            doppler_hz=self.doppler_hz + 3.0,
        )


GPS = [
    _Sent(GPS_L1CA_SIGNAL, 3, 1200.0, 4.0),
    _Sent(GPS_L1CA_SIGNAL, 17, -2300.0, 0.5),
    _Sent(GPS_L1CA_SIGNAL, 31, 200.0, -7.0, (2.13, 2.5)),
]
BDS = [_Sent(BDS_B1I_D1, 11, 900.0, 2.0), _Sent(BDS_B1I_D2, 3, -150.0, -3.0)]


def _alike(one: object, other: object) -> bool:
    """The same to rounding: sums in kernels may be made in any order, so others where inlined."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        both_nothing = math.isnan(one) and math.isnan(other)
        return both_nothing or math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-9)
    return one == other


def _state(channel: Channel) -> dict[str, object]:
    """All that tells one channel from another."""
    return {
        "history": channel.history,
        "symbols": bytes(channel.symbols),
        "locks": channel.locks,
        "mode": channel.mode,
        "events": list(channel.events),
        "error": channel.frequency_error_hz,
        "taken": channel.filled,
        "report": tuple(channel.report("")),
        "arc": (channel.slips, channel.phase_valid, channel.phase_kept),
    }


@pytest.mark.parametrize(
    ("sky", "order", "aided_from"),
    [(GPS, 3, 12), (GPS, 2, 12), (GPS, 3, 99), (BDS, 3, 12)],
    ids=["aided", "of order 2", "unaided", "BeiDou"],
)
def test_an_epoch_is_what_each_does_alone(
    sky: list[_Sent], order: int, aided_from: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rate_hz = 2.61e6 if sky is GPS else 5.3e6
    settings = TrackingSettings(CarrierSettings(f"pll{order}"), code_bandwidths_hz=(3.0, 1.0))
    id_ = sky[0].signal.id
    info = StreamInfo("S", rate_hz, id_.carrier_hz, 0.0, True, 1 << 40)
    alone = {one.satellite: one.channel(settings, rate_hz) for one in sky}
    racked, summing = (
        {one.satellite: one.channel(settings, rate_hz) for one in sky} for _ in range(2)
    )
    made = np.zeros((0, 2), dtype=np.int8)
    feed = SumFeed(
        lambda first, count: SampleBlock(info, first, made[first : first + count]),
        info,
        id_.carrier_hz,
        0,
    )
    concluded: Counter[int] = Counter()
    conclude = Channel.conclude

    def counted(channel: Channel, aiding: AidingSource) -> None:
        concluded[id(channel)] += 1
        conclude(channel, aiding)

    monkeypatch.setattr(Channel, "conclude", counted)
    buffer = RunningSumBuffer(info, id_.carrier_hz, 2 * max(BLOCKS))
    rng = np.random.default_rng(5)
    for epoch in range(42):
        aiding: Mapping[str, AidingSource] = (
            {one.satellite: one.foretold(epoch, rate_hz) for one in sky}
            if epoch >= aided_from
            else {}
        )
        for channel in (*alone.values(), *racked.values(), *summing.values()):
            channel.begin_epoch()
        end = round((epoch + 1) * EPOCH_S * rate_hz)
        rack = Rack([*racked.values()], aiding, end)
        while buffer.end < end:
            count = min(BLOCKS[epoch % 2], end - buffer.end)
            t = (buffer.end + np.arange(count)) / rate_hz
            values = sum(8.0 * one.samples(t) for one in sky)
            noise = 20.0 * rng.standard_normal((count, 2))
            pairs = np.column_stack([values.real, values.imag]) + noise
            samples = np.clip(np.rint(pairs), -127, 127).astype(np.int8)
            buffer.keep_from(buffer.end - round(0.0025 * rate_hz))
            buffer.append(SampleBlock(info, buffer.end, samples))
            made = np.concatenate([made, samples])
            for satellite, channel in alone.items():
                channel.run(buffer.sums, aiding.get(satellite, unaided))
            rack.advance(buffer.sums)
        rack.finish()
        run_epoch([Rack([*summing.values()], aiding, end)], feed, end)
        for satellite, channel in alone.items():
            for other in (racked, summing):
                assert _alike(_state(other[satellite]), _state(channel)), (epoch, satellite)
    for one in sky:
        channel = alone[one.satellite]
        for other in (racked[one.satellite], summing[one.satellite]):
            if one.silent_s[1] == 0.0:
                assert channel.mode is Mode.PHASE
                assert concluded[id(other)] < 0.6 * concluded[id(channel)]
            else:
                assert concluded[id(other)] < concluded[id(channel)]


@pytest.mark.kernel
@pytest.mark.parametrize(
    "signal", [GPS_L1CA_SIGNAL, BDS_B1I_D1, BDS_B1I_D2], ids=["C/A", "D1", "D2"]
)
def test_an_update_is_what_the_channel_concludes(signal: Signal) -> None:
    """Correlations are there: nothing is left but the loops."""
    model = Model(lambda _t: 45.0, signal=signal)
    channel = start(model, TrackingSettings(code_bandwidths_hz=(3.0, 1.0)))
    channel.begin_epoch()
    for end_s in np.arange(0.1, 2.5, 0.1):
        channel.run(cast(RunningSums, SimpleNamespace(end=round(end_s * MODEL_HZ))))
    loops = loops_of(channel)
    periods = loops.periods

    def correlated(skip: int) -> ComplexArray:
        taps, nothing = channel.taps_chips, cast(RunningSums, None)
        return model(nothing, channel.command, None, taps, periods - skip, skip)

    channel.take(correlated(channel.skip))  # to an update's beginning
    channel.conclude(unaided)
    correlations = correlated(0)
    recent = np.array(channel.locks.recent)
    table = code_table(signal.id.name)
    states = np.zeros(1, records(State))
    states[0] = state_of(channel, unaided, table.rows[channel.prn])
    states["filled"] = periods
    told = np.zeros((1, 2), records(Update))
    symbols = np.zeros((1, 2, periods // signal.symbol_periods), dtype=np.uint8)
    side = Side(
        loops,
        table.edges,
        table.signs,
        table.runs,
        channel.taps_chips,
        channel.stream.over(symbols.shape[2]),
        half_shifts(signal.symbol_periods),
        states.view(np.recarray),
        recent[np.newaxis],
        correlations[np.newaxis],
        np.zeros((1, 0)),
        np.zeros((1, 4, table.edges.shape[1])),
        np.full(1, NOTHING_SHARED),
        told.view(np.recarray),
        symbols,
    )
    run_steady(np.zeros(2, dtype=np.int64), 0, 1, 1.0, side)
    state = State(*states[0].item())
    other = deepcopy(channel)
    assert (state.updates, state.stopped, state.filled) == (1, 0, 0)
    take_back(channel, state, recent, told[0, :1].tolist(), symbols[0, 0].tobytes(), unaided)
    other.take(correlations)
    other.conclude(unaided)
    assert _alike(_state(channel), _state(other))
