"""Loops with a memory, and with updates longer than a symbol, in a channel that knows neither."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from deepgnss.core.loops import loop_gains
from deepgnss.core.records import ComplexArray
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.receiver import carrier_loops
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import CarrierSettings, Mode, TrackingSettings
from deepgnss.receiver.phase_loops import PhaseLoop, PlainLoop, Settled
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    NcoState,
    advance,
)

BANDWIDTH_HZ = 3.0


class Collected(NamedTuple):
    """Prompts of an update under way."""

    prompts: tuple[ComplexArray, ...] = ()
    turned_cycles: float = 0.0
    starts: int = 0


@dataclass(frozen=True)
class Collecting(PlainLoop):
    """A PLL of order 3 on the squares of several symbols, whose sums it keeps until then."""

    interval_s: float
    update_s: float
    symbol_periods: int

    @property
    def settled(self) -> Settled:
        return Settled(3, BANDWIDTH_HZ, self.interval_s)

    def start(self) -> Collected:
        return Collected()

    def step(self, memory: Collected, seen: Accumulated) -> tuple[Collected, Correction]:
        prompts = (*memory.prompts, seen.periods[:, 1])
        together = np.concatenate(prompts)
        if together.size * seen.period_s < self.update_s - 1e-9:
            return memory._replace(prompts=prompts), NO_CORRECTION
        symbols = together[together.size % self.symbol_periods :]
        sums = symbols.reshape(-1, self.symbol_periods).sum(axis=1)
        error = 0.5 * cmath.phase(complex((sums * sums).sum())) / (2.0 * np.pi)
        gains = loop_gains(3, BANDWIDTH_HZ, self.update_s)
        since_s = 0.5 * (together.size * seen.period_s - seen.seconds)
        correction = advance(NcoState(*(np.array(gains) * error)), since_s)
        return memory._replace(prompts=()), Correction(*correction)

    def turned(self, memory: Collected, cycles: float) -> Collected:
        turn = np.exp(-2j * np.pi * cycles)
        return memory._replace(
            prompts=tuple(one * turn for one in memory.prompts),
            turned_cycles=memory.turned_cycles + cycles,
        )

    def bandwidth_hz(self, memory: Collected) -> float:
        return BANDWIDTH_HZ


def plugged(
    monkeypatch: pytest.MonkeyPatch, interval_s: float, signal: Signal = GPS_L1CA_SIGNAL
) -> TrackingSettings:
    """Settings of a channel with a loop of the test's own."""

    def build(_: CarrierSettings) -> PhaseLoop[Any]:
        return Collecting(interval_s, 0.1, signal.symbol_periods)

    monkeypatch.setitem(carrier_loops._LOOPS, "collecting", build)  # type: ignore[arg-type]
    return TrackingSettings(CarrierSettings("collecting"))


def phase_error_cycles(channel: Channel, model: Model) -> float:
    """Of the generator against the truth, modulo a half cycle."""
    command = channel.command
    truth = float(model.phase_cycles(np.array([command.sample / RATE_HZ]))[0])
    return float((command.carrier_cycles - truth + 0.25) % 0.5 - 0.25)


@pytest.mark.parametrize("signal", [GPS_L1CA_SIGNAL, BDS_B1I_D1, BDS_B1I_D2])
@pytest.mark.parametrize("interval_s", [0.02, 0.1], ids=["collects", "long"])
def test_updates_longer_than_a_symbol(
    interval_s: float, signal: Signal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Either way of 100 ms updates holds a phase that accelerates steadily."""
    model = Model(lambda _t: 45.0, rate_hzps=0.7, signal=signal)
    channel = start(model, plugged(monkeypatch, interval_s, signal))
    errors = run(channel, 8.0, lambda one: phase_error_cycles(one, model))
    assert channel.mode is Mode.PHASE
    assert channel.phase_valid
    assert np.abs(errors[50:]).max() < 0.03
    assert channel.command.carrier_hzps == pytest.approx(0.7, abs=0.3)
    assert channel.at(channel.command.sample - 1).command.sample < channel.command.sample


def test_a_memory_begins_with_the_lock_and_turns_with_the_generator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = plugged(monkeypatch, 0.02)
    starts: list[Mode] = []
    channel: Channel | None = None

    def counted(self: Collecting) -> Collected:
        starts.append(channel.mode if channel is not None else Mode.LOST)
        return Collected()

    monkeypatch.setattr(Collecting, "start", counted)
    model = Model(lambda t: 45.0 if not 4.0 < t < 4.5 else 0.0, jump=(3.0, 25.0))
    channel = start(model, settings)
    run(channel, 2.53)
    assert starts == [Mode.LOST, Mode.FREQUENCY]  # made, then phase lock

    memory = channel.carriers._memory  # in the middle of an update
    assert memory.prompts
    channel.mend(0.5, "test", told=True)  # RINEX grows with range
    assert channel.carriers._memory.turned_cycles == -0.5
    np.testing.assert_allclose(channel.carriers._memory.prompts[0], -memory.prompts[0])
    run(channel, 2.9)
    assert abs(phase_error_cycles(channel, model)) < 0.05

    run(channel, 3.9)  # the carrier jumps by half a symbol's rate
    assert [event.what for event in channel.events if event.what == "false lock"] or len(starts) > 2
    before = len(starts)
    run(channel, 7.0)  # the signal falls and comes back
    assert channel.mode is Mode.PHASE
    assert len(starts) > before
