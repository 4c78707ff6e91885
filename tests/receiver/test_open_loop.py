"""Open loop: channels that run on by aiding, put right from outside, and their return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deepgnss.core.records import Event, FloatArray, RunningSums
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.known_symbols import KnownSymbols
from deepgnss.receiver.modes import AidingRate, Coast, Mode, TrackingSettings
from deepgnss.receiver.open_loop import LoopMemory

SETTINGS = TrackingSettings(code_bandwidths_hz=(3.0, 1.0))
STRONG = 47.0
GONE_S, BACK_S = 3.0, 8.0


def blocked(t: float) -> float:
    return -20.0 if GONE_S <= t < BACK_S else STRONG


def exact(model: Model, sample: int, clock_hz: float = 0.0) -> AidingRate:
    """What a navigation without errors predicts: the cycles of both halves of an update."""
    t = np.array([sample, sample + 0.01 * RATE_HZ, sample + 0.02 * RATE_HZ]) / RATE_HZ
    start, middle, end = model.phase_cycles(t)
    rate_hzps = 4.0 * (end - 2.0 * middle + start) / 0.02**2
    mean_hz = (end - start) / 0.02
    return AidingRate(mean_hz - 0.01 * rate_hzps - clock_hz, rate_hzps, clock_hz)


@dataclass
class Seen:
    """What a run showed, command by command."""

    events: list[Event] = field(default_factory=list)
    intervals: list[Interval] = field(default_factory=list)

    def errors_cycles(self, model: Model) -> tuple[FloatArray, FloatArray]:
        """Times, s, and the generators' phase less the true one, from the middle of 2 … 3 s."""
        t = np.array([i.command.sample for i in self.intervals]) / RATE_HZ
        cycles = np.array([i.command.carrier_cycles for i in self.intervals])
        off = cycles - model.phase_cycles(t)
        return t, off - float(np.median(off[(t > 2.0) & (t < GONE_S)]))

    def code_errors_chips(self, model: Model) -> tuple[FloatArray, FloatArray]:
        """Times, s, and the generators' code phase less the true one."""
        t = np.array([i.command.sample for i in self.intervals]) / RATE_HZ
        chips = np.array([i.command.code_chips for i in self.intervals])
        return t, np.mod(chips - model.code_chips(t) + 511.5, 1023.0) - 511.5

    def named(self, what: str) -> Event:
        return next(event for event in self.events if event.what == what)

    def at(self, time_s: float) -> Interval:
        return next(i for i in self.intervals if i.command.sample >= time_s * RATE_HZ)


def run_aided(
    channel: Channel,
    model: Model,
    end_s: float,
    bridge: Callable[[float], Coast | None] | None = None,
    aiding: Callable[[Model, int], AidingRate] = exact,
) -> Seen:
    """Run up to a time; bridge: what is told from outside after every epoch of 0.1 s."""
    t = channel.command.sample / RATE_HZ
    seen = Seen()
    while t < end_s:
        t = min(t + 0.1, end_s)
        channel.begin_epoch()
        sums = cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ)))
        channel.run(sums, lambda sample: aiding(model, sample))
        if bridge is not None:
            channel.coast(bridge(t) if channel.coasting else None)
        seen.events += channel.events
        last = seen.intervals[-1].command.sample if seen.intervals else -1
        seen.intervals += [i for i in channel.history if i.command.sample > last]
    return seen


def sure(_t: float) -> Coast:
    return Coast(0.0, 0.01)


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


def doubt_code(channel: Channel) -> None:
    """Its range was refused."""
    channel.doubt_code()


def put_code_right(channel: Channel) -> None:
    """Its code had left its phase."""
    channel.put_code_right(0.0, reflected=True)


@pytest.mark.parametrize("told", [doubt_code, put_code_right])
def test_half_cycles_of_a_reflection_s_phase_are_not_put_back(
    told: Callable[[Channel], None],
) -> None:
    """How far it is from the satellite's own depends on a wall."""
    model = Model(lambda _t: STRONG)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 3.0)
    channel.set_polarity(0.0)
    told(channel)
    run_aided(channel, model, 4.5)
    before, slips = channel.command, channel.slips
    channel.mend(0.5, "test", told=True)
    assert channel.command == before
    assert channel.half_cycle is None
    assert channel.slips == slips + 1
    assert channel.events[-1].what == "cycle slip"
    channel.set_polarity(0.0)
    run_aided(channel, model, 6.0)  # not refused any more
    channel.mend(0.5, "test", told=True)
    assert channel.half_cycle == 0.0
    assert channel.events[-1].what == "slip repaired"


def test_no_other_than_half_cycles_are_put_back() -> None:
    with pytest.raises(ValueError, match="no half number"):
        start(Model(lambda _t: STRONG), SETTINGS).mend(0.3, "test", told=False)


# --- through the gap -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_phase_is_carried_through_five_seconds(seed: int) -> None:
    model = Model(blocked, rate_hzps=30.0, seed=seed)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, 2.5, sure)
    channel.set_polarity(0.5)
    arc = channel.slips
    later = run_aided(channel, model, BACK_S + 2.0, sure)
    seen.events += later.events
    seen.intervals += later.intervals
    t, off = seen.errors_cycles(model)
    coasted = (t > GONE_S + 0.2) & (t < BACK_S)
    assert np.abs(off[coasted]).max() < 0.02
    assert all(i.coasting and i.phase_valid for i in later.intervals[40:200])
    assert not any(i.code_valid for i in later.intervals[40:200])
    # The signal is taken up within four symbols, on the same arc, with the same polarity.
    assert [e.what for e in later.events] == ["hold", "PLL", "phase lock", "returned"]
    assert BACK_S < later.named("PLL").sample / RATE_HZ < BACK_S + 0.1
    assert later.named("phase lock").sample / RATE_HZ < BACK_S + 0.4
    assert channel.slips == arc
    assert channel.half_cycle == 0.5
    assert np.abs(off[t > BACK_S + 0.4]).max() < 0.02


def test_a_reflection_s_phase_is_not_carried_through() -> None:
    """What comes back may be the satellite's own, half a cycle off: symbols have to tell."""
    model = Model(blocked, rate_hzps=30.0)
    channel = start(model, SETTINGS)
    run_aided(channel, model, GONE_S - 0.5, sure)
    channel.set_polarity(0.5)
    arc = channel.slips
    channel.doubt_code()  # its range was refused
    seen = run_aided(channel, model, BACK_S + 2.0, sure)
    assert seen.named("hold").reason.endswith("open loop without phase")
    assert not any(i.phase_valid for i in seen.intervals if i.coasting)
    assert channel.mode is Mode.PHASE
    assert channel.half_cycle is None
    assert channel.slips > arc


def test_a_loop_goes_back_to_before_its_signal_fell(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has followed noise for 0.1 s when it notices."""

    def errors_cycles(cn0_dbhz: float) -> FloatArray:
        found = []
        for seed in range(6):
            model = Model(lambda t: -20.0 if t >= GONE_S else cn0_dbhz, seed=seed)
            seen = run_aided(start(model, SETTINGS), model, GONE_S + 0.5, sure)
            found.append(seen.errors_cycles(model)[1][-1])
        return np.array(found)

    assert np.abs(errors_cycles(47.0)).max() < 0.01
    assert np.abs(errors_cycles(36.0)).max() < 0.04
    monkeypatch.setattr(LoopMemory, "before_fall", lambda self, _power: len(self._passed) - 1)
    assert np.abs(errors_cycles(47.0)).max() > 0.1


def test_what_was_noise_is_observed_by_nobody() -> None:
    model = Model(blocked)
    channel = start(model, SETTINGS)
    t = 0.0
    while channel.mode is not Mode.HOLD:
        t += 0.02
        channel.begin_epoch()
        sums = cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ)))
        channel.run(sums, lambda sample: exact(model, sample))
    late = [i for i in channel.history if i.command.sample > (GONE_S + 0.02) * RATE_HZ]
    assert len(late) > 2
    for i in late:
        assert i.coasting
        assert not i.code_valid
        true_cycles = model.phase_cycles(np.array([i.command.sample / RATE_HZ]))[0]
        assert abs((2.0 * (i.command.carrier_cycles - true_cycles) + 0.5) % 1.0 - 0.5) < 0.03


@pytest.mark.parametrize("cn0_dbhz", [47.0, 33.0])
def test_until_the_fall_is_noticed_the_phase_is_not_put_out(cn0_dbhz: float) -> None:
    model = Model(lambda t: -20.0 if t >= GONE_S else cn0_dbhz)
    channel = start(model, SETTINGS)
    seen: dict[int, bool] = {}
    t = 0.0
    while channel.mode is not Mode.HOLD:
        t += 0.02
        channel.begin_epoch()
        channel.run(cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ))))
        for i in channel.history[:-1]:
            seen.setdefault(i.command.sample, i.phase_valid)
    dark = [valid for sample, valid in seen.items() if sample > GONE_S * RATE_HZ]
    light = [valid for sample, valid in seen.items() if 1.5 < sample / RATE_HZ < GONE_S - 0.02]
    assert len(dark) >= 4
    assert not any(dark)
    assert all(light)


def vague(t: float) -> Coast:
    return Coast(0.0, 0.01 if t < GONE_S + 3.0 else 0.2)


def silent(t: float) -> Coast | None:
    return Coast(0.0, 0.01) if t < GONE_S + 3.0 else None


@pytest.mark.parametrize("bridge", [vague, silent, None])
def test_a_phase_nobody_vouches_for_begins_a_new_arc(
    bridge: Callable[[float], Coast | None] | None,
) -> None:
    model = Model(blocked)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 2.5, bridge)
    channel.set_polarity(0.0)
    seen = run_aided(channel, model, BACK_S + 2.0, bridge)
    assert seen.at(GONE_S + 2.0).phase_valid == (bridge is not None)
    assert not seen.at(GONE_S + 4.0).phase_valid
    assert seen.intervals[-1].slips > seen.intervals[0].slips
    assert channel.half_cycle is None
    assert [e.what for e in seen.events] == ["hold", "FLL", "PLL", "phase lock", "returned"]
    # The way over frequency lock is short too.
    assert seen.named("phase lock").sample / RATE_HZ < BACK_S + 0.7
    assert "new phase" in seen.named("returned").reason


def test_what_is_told_in_the_gap_arrives_in_the_phase_that_comes_out() -> None:
    """A prediction 0.3 Hz off, put right from outside: growing range, falling phase here."""
    off_hz = 0.3

    def wrong(model: Model, sample: int) -> AidingRate:
        true = exact(model, sample)
        off = off_hz if sample > GONE_S * RATE_HZ else 0.0
        return true._replace(frequency_hz=true.frequency_hz + off)

    def bridge(t: float) -> Coast:
        return Coast(off_hz * 0.1 if t > GONE_S + 0.25 else off_hz * 0.2, 0.02)

    model = Model(blocked)
    seen = run_aided(start(model, SETTINGS), model, BACK_S + 2.0, bridge, wrong)
    t, off = seen.errors_cycles(model)
    assert np.abs(off[(t > GONE_S + 0.5) & (t < BACK_S)]).max() < 0.06
    assert np.abs(off[t > BACK_S + 0.5]).max() < 0.02
    assert seen.intervals[-1].slips == seen.intervals[100].slips
    without = run_aided(start(model := Model(blocked), SETTINGS), model, BACK_S, sure, wrong)
    assert without.errors_cycles(model)[1][-1] == pytest.approx(off_hz * 5.0, abs=0.05)


def test_a_short_shadow_leaves_no_trace() -> None:
    model = Model(lambda t: -20.0 if GONE_S <= t < GONE_S + 0.25 else STRONG)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, GONE_S + 1.0, sure)
    assert [e.what for e in seen.events][-3:] == ["hold", "PLL", "phase lock"]
    t, off = seen.errors_cycles(model)
    assert channel.slips == 0
    assert np.abs(off[t > GONE_S + 0.6]).max() < 0.02


def test_a_flash_of_signal_does_not_spoil_the_phase_carried_on() -> None:
    """Back for 70 ms only: what the loop did then and after is gone back on."""

    def cn0_dbhz(t: float) -> float:
        return STRONG if t < GONE_S or 5.0 <= t < 5.07 or t >= BACK_S else -20.0

    model = Model(cn0_dbhz)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, BACK_S + 1.5, sure)
    assert [e.what for e in seen.events][-5:] == ["PLL", "hold", "PLL", "phase lock", "returned"]
    t, off = seen.errors_cycles(model)
    assert channel.slips == 0
    assert np.abs(off[(t > 5.3) & (t < BACK_S)]).max() < 0.02
    assert seen.named("returned").reason.startswith("after 5.")


def test_a_hundred_g_in_open_loop() -> None:
    """Half a second of it up and down again: 5155 Hz/s."""
    rate_hzps = 100.0 * 9.80665 / 0.190294

    def jolt(t: FloatArray) -> FloatArray:
        up, down = np.clip(t - 4.0, 0.0, 0.5), np.clip(t - 5.0, 0.0, 0.5)
        after = np.clip(t - 4.5, 0.0, None), np.clip(t - 5.5, 0.0, None)
        total = 0.5 * up**2 + 0.5 * after[0] - 0.5 * down**2 - 0.5 * after[1]
        return np.asarray(rate_hzps * total)

    class Jolted(Model):
        def doppler_at_hz(self, t: FloatArray) -> FloatArray:
            speed = np.clip(t - 4.0, 0.0, 0.5) - np.clip(t - 5.0, 0.0, 0.5)
            return np.asarray(super().doppler_at_hz(t) + rate_hzps * speed)

    model = Jolted(blocked, clock_cycles=jolt)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, BACK_S + 1.5, sure)
    t, off = seen.errors_cycles(model)
    assert np.abs(off[(t > 5.6) & (t < BACK_S)]).max() < 0.05
    assert np.abs(off[t > BACK_S + 0.5]).max() < 0.02
    assert channel.slips == 0
    assert np.abs(seen.code_errors_chips(model)[1][-1]) < 0.02


def test_the_receiver_s_clock_goes_on_as_foretold() -> None:
    """It has drifted by 20 Hz when the signal returns, and the aiding knows."""

    def drift(t: FloatArray) -> FloatArray:
        return np.asarray(2.0 * np.clip(t - GONE_S, 0.0, None) ** 2)

    def aiding(model: Model, sample: int) -> AidingRate:
        return exact(model, sample, 4.0 * max(0.0, sample / RATE_HZ + 0.01 - GONE_S))

    class Drifting(Model):
        def doppler_at_hz(self, t: FloatArray) -> FloatArray:
            return np.asarray(super().doppler_at_hz(t) + 4.0 * np.clip(t - GONE_S, 0.0, None))

    model = Drifting(blocked, clock_cycles=drift)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, BACK_S, sure, aiding)
    assert abs(seen.errors_cycles(model)[1][-1]) < 0.05


# --- what the return shows -----------------------------------------------------------------------


def told_symbols(model: Model) -> KnownSymbols:
    """Every symbol of the model, upright, by the count of a channel started just before period 1.

    The channel's period 0 is the satellite's period 1 …: anchor 1.
    """
    bits = (model.symbols[1:20_000] < 0.0).astype(np.uint8)
    return KnownSymbols(model.period_shift, bits.tobytes())


@pytest.mark.parametrize("known", [False, True])
def test_known_symbols_tell_whole_cycles(known: bool) -> None:
    """A phase carried on 0.4 cycles wrong with a 1σ of 0.12: to be had by signs alone."""

    def bridge(t: float) -> Coast:
        return Coast(-0.4 if 5.05 < t < 5.15 else 0.0, 0.12)

    model = Model(blocked)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 2.5, bridge)
    chips = model.code_chips(np.array([channel.command.sample / RATE_HZ]))[0]
    channel.anchor = round(chips / 1023.0) - channel.periods
    signs = np.where(np.frombuffer(bytes(channel.symbols), np.int8) > 0, -1.0, 1.0)
    number = (channel.anchor + channel.symbols_first - model.period_shift) // 20 + 1
    agree = float(np.mean(signs[-50:] == model.symbols[number : number + signs.size][-50:]))
    assert agree in (0.0, 1.0)
    channel.set_polarity(0.0 if agree else 0.5)
    arc = channel.slips
    if known:
        channel.known = told_symbols(model)
    seen = run_aided(channel, model, BACK_S + 2.0, bridge)
    assert (channel.slips == arc) == known
    assert [e.what for e in seen.events][1] == ("PLL" if known else "FLL")
    if known:
        told = float(seen.named("returned").reason.split("error ")[1].split(" ")[0])
        assert told == pytest.approx(-0.4, abs=0.03)


def test_errors_at_the_return_are_told_with_the_sign_of_what_was_carried_on() -> None:
    """Told 77.15 cycles too much of range: the loop sees 0.15 of them, the code 0.05 chips."""

    def bridge(t: float) -> Coast:
        return Coast(77.15 if 5.05 < t < 5.15 else 0.0, 0.02)

    model = Model(blocked)
    seen = run_aided(start(model, SETTINGS), model, BACK_S + 2.0, bridge)
    words = seen.named("returned").reason
    assert words.startswith("after 5.")
    phase = float(words.split("error ")[1].split(" ")[0])
    code_m = float(words.split("error ")[-1].split(" ")[0])
    assert phase == pytest.approx(0.15, abs=0.03)
    assert code_m == pytest.approx(77.15 / 1540.0 * 293.05, abs=3.0)


@pytest.mark.parametrize("contradicted", [False, True])
def test_symbols_that_contradict_the_polarity_carried_through_begin_a_new_arc(
    contradicted: bool,
) -> None:
    model = Model(blocked)
    channel = start(model, SETTINGS)
    run_aided(channel, model, 2.5, sure)
    channel.set_polarity(0.0)
    arc = channel.slips
    run_aided(channel, model, BACK_S + 1.0, sure)
    assert channel.unproven
    channel.set_polarity(0.5 if contradicted else 0.0)
    assert channel.slips == arc + contradicted
    assert channel.history[-1].slips == channel.slips
    assert channel.half_cycle == (0.5 if contradicted else 0.0)
    assert ("cycle slip" in [e.what for e in channel.events]) == contradicted
    channel.set_polarity(0.0)  # proven now: told once
    assert channel.half_cycle == (0.5 if contradicted else 0.0)


# --- without a phase -----------------------------------------------------------------------------


def nobody(_t: float) -> Coast | None:
    return None


def test_a_signal_that_comes_up_slowly_is_not_taken_for_a_faint_one() -> None:
    """Around a tunnel's mouth it takes half a second from nothing to all of it."""

    def cn0_dbhz(t: float) -> float:
        return STRONG if t < 3.0 else min(STRONG, -10.0 + 80.0 * max(0.0, t - 6.0))

    risen_s = 6.0 + 41.0 / 80.0  # at the threshold of phase lock and 3 dB
    for seed in range(4):
        model = Model(cn0_dbhz, seed=seed)
        channel = start(model, SETTINGS)
        seen = run_aided(channel, model, 8.0, nobody)
        back = [e for e in seen.events if e.sample > 6.0 * RATE_HZ]
        assert channel.mode is Mode.PHASE and channel.phase_valid
        locked = next(e for e in back if e.what == "PLL").sample / RATE_HZ
        assert locked < risen_s + 0.3


@pytest.mark.parametrize("off_hz", [-45.0, 30.0, 50.0])
def test_a_signal_that_comes_back_far_off_in_frequency_is_seen(off_hz: float) -> None:
    """After a long gap with a poor unit whole symbols of it add up to little, or to nothing."""

    def drifted(model: Model, sample: int) -> AidingRate:
        t = sample / RATE_HZ
        share = min(1.0, max(0.0, (t - GONE_S) / (BACK_S - GONE_S)))
        return exact(model, sample)._replace(
            frequency_hz=exact(model, sample).frequency_hz + share * off_hz
        )

    for seed in range(3):
        model = Model(blocked, seed=seed)
        channel = start(model, SETTINGS)
        seen = run_aided(channel, model, BACK_S + 1.0, nobody, drifted)
        back = [e for e in seen.events if e.sample > (BACK_S - 0.1) * RATE_HZ]
        assert [e.what for e in back][:3] == ["FLL", "PLL", "phase lock"]
        assert "false lock" not in [e.what for e in seen.events]
        assert back[0].sample / RATE_HZ < BACK_S + 0.15
        t = channel.command.sample / RATE_HZ
        true_hz = (model.phase_cycles(np.array([t + 0.01, t]))).tolist()
        assert abs(channel.command.carrier_hz - (true_hz[0] - true_hz[1]) / 0.01) < 3.0


def test_no_range_is_told_from_windows_without_a_signal() -> None:
    model = Model(lambda t: 45.0 if t < 2.0 else 22.0 if t < 6.0 else -20.0)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, 9.0, nobody)
    assert seen.at(5.5).code_valid
    gone = [i for i in seen.intervals if 6.75 < i.command.sample / RATE_HZ < 9.0]
    assert gone and not any(i.code_valid for i in gone)


def test_frequency_and_code_of_a_faint_signal_go_on() -> None:
    def cn0_dbhz(t: float) -> float:
        return 45.0 if t < 2.0 else -20.0 if 8.0 <= t < 28.0 else 23.0

    model = Model(cn0_dbhz, rate_hzps=5.0)
    channel = start(model, SETTINGS)
    seen = run_aided(channel, model, 27.9, nobody)
    modes = [e.what for e in seen.events if e.sample > 1.9 * RATE_HZ and e.what != "returned"]
    assert modes == ["hold", "FFT", "hold"]
    assert channel.mode is Mode.HOLD
    t = channel.command.sample / RATE_HZ
    assert abs(channel.command.carrier_hz - model.doppler_hz - 5.0 * t) < 0.25
    assert abs(seen.code_errors_chips(model)[1][-1]) < 0.06
    seen = run_aided(channel, model, 31.0, nobody)
    assert [e.what for e in seen.events] == ["FFT", "returned"]
    assert seen.named("FFT").sample / RATE_HZ < 28.8


def test_a_faint_phase_that_falls_is_held_and_not_tracked_as_noise() -> None:
    for seed in range(4):
        model = Model(lambda t: -20.0 if GONE_S <= t < BACK_S else 31.0, seed=seed)
        channel = start(model, SETTINGS)
        seen = run_aided(channel, model, BACK_S + 1.5, sure)
        assert "hold" in [e.what for e in seen.events]
        assert seen.named("hold").sample / RATE_HZ < GONE_S + 0.4
        held = [e.what for e in seen.events if e.sample > GONE_S * RATE_HZ]
        assert held[:3] == ["hold", "PLL", "phase lock"]


def test_a_ghost_of_strong_neighbours_ends_no_phase_that_is_vouched_for() -> None:
    """Cross-correlation stands some 24 dB below them; once nobody vouches, it is looked into."""
    model = Model(lambda t: STRONG if t < GONE_S else -20.0 if t < GONE_S + 1.0 else 22.0)
    kept = start(model, SETTINGS)
    run_aided(kept, model, GONE_S + 5.0, sure)
    assert kept.mode is Mode.HOLD
    given_up = start(model, SETTINGS)
    run_aided(given_up, model, GONE_S + 5.0, silent)
    assert given_up.mode is Mode.WEAK
