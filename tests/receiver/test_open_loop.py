"""Open loop: channels that run on by aiding, put right from outside, and their return."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from deepgnss.core.records import RunningSums
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import AidingRate, Coast, Mode, TrackingSettings

SETTINGS = TrackingSettings(code_bandwidths_hz=(3.0, 1.0))
STRONG = 47.0
GONE_S, BACK_S = 3.0, 8.0


def blocked(t: float) -> float:
    return -20.0 if GONE_S <= t < BACK_S else STRONG


def exact(model: Model, sample: int) -> AidingRate:
    """What a navigation without errors predicts."""
    return AidingRate(model.doppler_hz + sample / RATE_HZ * model.rate_hzps, model.rate_hzps)


def run_aided(channel: Channel, model: Model, end_s: float, epoch_s: float = 0.1) -> None:
    t = channel.command.sample / RATE_HZ
    while t < end_s:
        t = min(t + epoch_s, end_s)
        channel.begin_epoch()
        sums = cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ)))
        channel.run(sums, lambda sample: exact(model, sample))


def coasting_channel() -> Channel:
    model = Model(blocked)
    channel = start(model, SETTINGS)
    run_aided(channel, model, GONE_S + 1.0)
    return channel


# --- told from outside ---------------------------------------------------------------------------


def test_only_aided_channels_without_a_signal_coast() -> None:
    model = Model(blocked)
    channel = start(model, SETTINGS)
    run_aided(channel, model, GONE_S - 0.1)
    assert channel.mode is Mode.PHASE
    assert not channel.coasting
    run_aided(channel, model, GONE_S + 1.0)
    assert channel.mode is Mode.HOLD
    assert channel.coasting
    assert channel.history[-1].coasting
    alone = start(Model(blocked), SETTINGS)
    run(alone, GONE_S + 1.0)
    assert alone.mode is Mode.HOLD
    assert not alone.coasting
    assert not alone.history[-1].coasting


def test_a_coast_of_growing_range_turns_the_carrier_back_and_the_code_with_it() -> None:
    channel = coasting_channel()
    before, history = channel.command, channel.history
    channel.coast(Coast(154.0, 0.01))
    assert channel.command.carrier_cycles - before.carrier_cycles == pytest.approx(-154.0)
    assert channel.command.code_chips - before.code_chips == pytest.approx(-0.1)
    for then, now in zip(history, channel.history, strict=True):
        moved = now.command.carrier_cycles - then.command.carrier_cycles
        assert moved == pytest.approx(-154.0 if then.coasting else 0.0)
    # What follows starts from there.
    model = Model(blocked)
    run_aided(channel, model, GONE_S + 1.5)
    other = coasting_channel()
    run_aided(other, model, GONE_S + 1.5)
    moved = channel.command.carrier_cycles - other.command.carrier_cycles
    assert moved == pytest.approx(-154.0, abs=1e-3)  # code epochs fall on other samples


def test_a_closed_loop_does_not_heed_a_coast() -> None:
    model = Model(lambda _t: STRONG)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 2.0)
    before = channel.command
    channel.coast(Coast(5.0, 0.01))
    assert channel.command == before


@pytest.mark.parametrize("cycles", [3.0, -2.5])
@pytest.mark.parametrize("told", [False, True])
def test_a_slip_mended_moves_the_phase_and_only_it(cycles: float, told: bool) -> None:
    model = Model(lambda _t: STRONG)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 3.0)
    channel.set_polarity(0.0)
    before, slips, symbols = channel.command, channel.slips, len(channel.symbols)
    channel.mend(cycles, "test", told=told)
    assert channel.command.carrier_cycles - before.carrier_cycles == pytest.approx(-cycles)
    assert channel.command.code_chips == before.code_chips
    assert channel.half_cycle == 0.0
    assert channel.slips == slips + told
    assert channel.history[-1].slips == channel.slips
    assert len(channel.symbols) == (symbols if cycles == 3.0 else 0)
    assert channel.events[-1].what == "slip repaired"
    run_aided(channel, model, 4.0)
    # Nothing is left to pull in where whole cycles were put back; half a cycle is a lock as well.
    assert channel.locks.phase > 0.95
    assert channel.mode is Mode.PHASE


def test_a_slip_of_unknown_size_begins_a_new_arc_of_unknown_polarity() -> None:
    model = Model(lambda _t: STRONG)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 3.0)
    channel.set_polarity(0.0)
    before, slips = channel.command, channel.slips
    channel.mend(None, "test", told=False)
    assert channel.command == before
    assert channel.slips == slips + 1
    assert all(i.half_cycle is None for i in channel.history if i.slips == channel.slips)
    assert channel.history[-1].slips == channel.slips
    assert channel.events[-1].what == "cycle slip"
    run_aided(channel, model, 3.5)
    assert channel.edge is not None
    assert (channel.symbols_first - channel.edge) % 20 == 0
    assert 20 * len(channel.symbols) == channel.periods - channel.symbols_first


def test_no_other_than_half_cycles_are_put_back() -> None:
    with pytest.raises(ValueError, match="no half number"):
        start(Model(lambda _t: STRONG), SETTINGS).mend(0.3, "test", told=False)
