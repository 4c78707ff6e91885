"""Frequency tracking: its trackers on tones by hand, its channel on correlations by theory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.frequency_tracking import (
    LockWatch,
    SpectralLock,
    spectral_lock,
    window_of,
)
from deepgnss.receiver.known_symbols import KnownSymbols, signs
from deepgnss.receiver.modes import FrequencySettings, Mode, TrackingSettings
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2
from deepgnss.receiver.spectral import fft_tone
from deepgnss.receiver.trackers import Accumulated
from deepgnss.theory.tracking_error import dll_thermal_sigma_chips

SYMBOL_S, COUNT = 0.02, 16
WEAK_AT_S = 3.0
SETTINGS = TrackingSettings()


# --- trackers ------------------------------------------------------------------------------------


def _symbols(off_hz: float, bits: np.ndarray, phase_cycles: float = 0.0) -> ComplexArray:
    t = SYMBOL_S * (np.arange(COUNT) - 0.5 * (COUNT - 1))
    prompt = 5.0 * bits * np.exp(2j * np.pi * (off_hz * t + phase_cycles))
    return np.column_stack([0.9 * prompt, prompt, 0.8 * prompt])


BITS = np.random.default_rng(4).choice((-1.0, 1.0), COUNT)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("name", ["fft", "sfft", "pfft", "psfft", "early_late", "two_stage"])
def test_every_discriminator_corrects_what_it_sees(name: str, known: bool) -> None:
    lock = spectral_lock(FrequencySettings(name, order=1, gain=1.0, phase=True))
    for off_hz in (-0.2, 0.0, 0.15):
        seen = window_of(_symbols(off_hz, BITS, 0.1), SYMBOL_S, BITS if known else None)
        assert seen.coherent == known
        correction = lock.correct(seen)
        assert correction.frequency == pytest.approx(off_hz, rel=0.1, abs=1e-9)
        assert correction.phase == pytest.approx(0.1, abs=1e-6)
        assert correction.rate == 0.0


def test_gains_of_order_two() -> None:
    lock = SpectralLock(fft_tone, order=2, gain=0.5)
    found = lock.correct(window_of(_symbols(2.0, BITS), SYMBOL_S, BITS))
    assert found.phase == 0.0
    assert found.frequency == pytest.approx(1.0)
    assert found.rate == pytest.approx(2.0 * 0.25 / 1.5 / 0.32)


def test_known_symbols_add_up_to_one_sum_at_the_tone() -> None:
    seen = window_of(_symbols(1.3, BITS), SYMBOL_S, BITS)
    straight = spectral_lock(FrequencySettings()).straightened(seen)
    assert abs(straight.early) == pytest.approx(0.9 * 5.0 * COUNT)
    assert abs(straight.late) == pytest.approx(0.8 * 5.0 * COUNT)
    assert abs(seen.prompt) < 0.9 * abs(straight.prompt)
    unknown: Accumulated = window_of(_symbols(1.3, BITS), SYMBOL_S, None)
    assert spectral_lock(FrequencySettings()).straightened(unknown) is unknown


def test_known_symbols_are_told_only_where_all_are() -> None:
    known = KnownSymbols(1000, bytes([0, 1, 1, 0, 1]))
    told = signs(known, 1020, 3, 20)
    assert told is not None
    assert told.tolist() == [-1.0, -1.0, 1.0]
    assert signs(known, 980, 2, 20) is None
    assert signs(known, 1060, 3, 20) is None


@pytest.mark.parametrize("known", [False, True])
def test_doppler_of_a_window_errs_as_it_says(known: bool) -> None:
    """Each window speaks for itself, whatever the loop has followed of it: independent, no lag."""
    model = Model(_falls_to(23.0), rate_hzps=0.4, seed=7)
    channel = start(model, SETTINGS)
    if known:
        _tell(channel, model, model.symbols)
    errors, sigmas = [], []

    def windows(one: Channel) -> None:
        for interval in one.history:
            t = interval.command.sample / RATE_HZ
            if t > 10.0 and interval.correction.frequency and not (errors and t <= last[0]):
                last[0] = t
                seen_hz = interval.command.carrier_hz + interval.correction.frequency
                errors.append(
                    seen_hz + interval.window.unfollowed_hz - model.doppler_hz - model.rate_hzps * t
                )
                sigmas.append(interval.window.sigma_hz)

    last = [0.0]
    run(channel, 60.0, windows)
    found = np.array(errors)
    assert found.size > 150
    assert found.std() == pytest.approx(np.mean(sigmas), rel=0.25)
    assert abs(found.mean()) < 4.0 * found.std() / np.sqrt(found.size)
    alike = np.corrcoef(found[:-1], found[1:])[0, 1]
    assert abs(alike) < 3.0 / np.sqrt(found.size)


@pytest.mark.parametrize("off_hz", [25.0, -25.0, 9.375, -6.25, 0.0])
def test_watch_finds_a_lock_that_is_off(off_hz: float) -> None:
    watch = LockWatch(SYMBOL_S, 0.32, 3)
    generator = np.random.default_rng(8)
    t = 1e-3 * np.arange(COUNT * 20)
    amplitude = np.sqrt(10.0**2.4 * 1e-3)
    for _ in range(5):
        noise = generator.standard_normal((2, t.size)) / np.sqrt(2.0)
        prompts = amplitude * np.repeat(BITS, 20) * np.exp(2j * np.pi * off_hz * t)
        prompts = prompts + noise[0] + 1j * noise[1]
        found = watch.off_hz(prompts.reshape(-1, 20), 700.0)
        if found:
            break
    assert found == pytest.approx(off_hz, abs=0.8)


def test_watch_follows_what_the_generator_was_moved_by() -> None:
    """The tone stays while the generator moves: its lines are laid upon each other."""
    watch = LockWatch(SYMBOL_S, 0.32, 3)
    generator = np.random.default_rng(9)
    t = 1e-3 * np.arange(COUNT * 20)
    for k in range(5):
        at_hz = 100.0 + 1.5625 * k
        noise = generator.standard_normal((2, t.size)) / np.sqrt(2.0)
        tone = np.sqrt(0.12) * np.exp(2j * np.pi * (110.9 - at_hz) * t)
        found = watch.off_hz((tone + noise[0] + 1j * noise[1]).reshape(-1, 20), at_hz)
        if found:
            break
    assert found == pytest.approx(110.9 - at_hz, abs=0.8)


# --- the channel ---------------------------------------------------------------------------------


class Moment(NamedTuple):
    t: float
    mode: Mode
    cn0_dbhz: float
    off_hz: float  # generator − truth
    code_chips: float  # generator − truth
    code_valid: bool
    phase_valid: bool


def _falls_to(cn0_dbhz: float) -> Callable[[float], float]:
    return lambda t: 45.0 if t < WEAK_AT_S else cn0_dbhz


def _follow(
    model: Model, settings: TrackingSettings, end_s: float, channel: Channel | None = None
) -> tuple[Channel, list[Moment], list[tuple[float, str]]]:
    channel = channel or start(model, settings, doppler_error_hz=3.0, code_error_chips=0.1)
    events: list[tuple[float, str]] = []

    def moment(one: Channel) -> Moment:
        events.extend((event.sample / RATE_HZ, event.what) for event in one.events)
        last = one.history[-1]
        t = last.command.sample / RATE_HZ
        length = one.signal.id.code_chips
        code = last.command.code_chips - model.code_chips(np.array([t]))[0]
        return Moment(
            t,
            one.mode,
            last.cn0_dbhz,
            last.command.carrier_hz - model.doppler_hz - model.rate_hzps * t,
            (code + length / 2) % length - length / 2,
            last.code_valid,
            last.phase_valid,
        )

    return channel, run(channel, end_s, moment), events


def test_20_dbhz_are_tracked_with_their_doppler_rate_and_no_bias() -> None:
    model = Model(_falls_to(20.0), rate_hzps=0.6, seed=2)
    channel, moments, events = _follow(model, SETTINGS, 43.0)
    assert [what for t, what in events if t > 4.0] == []
    weak = [m for m in moments if m.t > 8.0]
    assert all(m.mode is Mode.WEAK and m.code_valid and not m.phase_valid for m in weak)
    off_hz = np.array([m.off_hz for m in weak])
    assert abs(off_hz.mean()) < 0.1
    assert off_hz.std() < 0.4
    cn0 = np.array([m.cn0_dbhz for m in weak])
    assert abs(cn0.mean() - 20.0) < 0.3
    assert np.abs(cn0 - 20.0).max() < 1.3
    assert channel.report("").mode == "FFT"


def _tell(channel: Channel, model: Model, symbols: FloatArray) -> None:
    """Make symbols known to a channel that has not run yet, and the time they belong to."""
    chips = model.code_chips(np.array([channel.command.sample / RATE_HZ]))[0]
    channel.anchor = round(chips / 1023.0) - model.period_shift
    bits = ((1.0 - symbols) / 2.0).astype(np.int8)
    channel.known = KnownSymbols(-20, bits.tobytes())


def test_wrong_symbols_are_not_believed() -> None:
    model = Model(_falls_to(21.0), seed=5)
    channel = start(model, SETTINGS)
    _tell(channel, model, np.roll(model.symbols, 3))
    _, moments, events = _follow(model, SETTINGS, 40.0, channel)
    assert [what for t, what in events if t > 4.5] == []
    assert np.std([m.off_hz for m in moments if m.t > 8.0]) < 0.4


@pytest.mark.parametrize("known", [False, True])
def test_code_noise_is_that_of_the_loop(known: bool) -> None:
    """T(2.25) with sums of a symbol; of the whole window where its symbols are known."""
    settings = replace(SETTINGS, code_bandwidths_hz=(3.0, 1.0))
    model = Model(_falls_to(24.0), seed=5)
    channel = start(model, settings)
    if known:
        _tell(channel, model, model.symbols)
    _, moments, _ = _follow(model, settings, 72.0, channel)
    code = np.array([m.code_chips for m in moments if m.t > 12.0])
    coherent_s = 0.32 if known else 0.02
    sigma = dll_thermal_sigma_chips(24.0, 1.0, coherent_s, 0.25, np.inf, 1.023e6)
    assert code.std() == pytest.approx(sigma, rel=0.2)  # 120 independent ones
    assert abs(code.mean()) < 0.3 * sigma
    off_hz = np.array([m.off_hz for m in moments if m.t > 12.0])
    assert off_hz.std() < (0.13 if known else 0.3)


@pytest.mark.parametrize("cn0_dbhz", [20.0, 24.0, 36.0])
def test_false_lock_at_25_hz_is_left_within_two_seconds(cn0_dbhz: float) -> None:
    settings = replace(SETTINGS, phase_threshold_dbhz=60.0)
    for seed, off_hz in enumerate((25.0, -25.0) * 3):
        at_s = 6.0 + 0.09 * seed
        jump = (at_s, -off_hz)  # the generator stays where a false lock has it
        model = Model(_falls_to(cn0_dbhz), rate_hzps=0.5, seed=40 + seed, jump=jump)
        channel, _, _ = _follow(model, settings, at_s)
        assert channel.mode is Mode.WEAK
        _, moments, events = _follow(model, settings, at_s + 2.1, channel)
        assert "false lock" in [what for _, what in events]
        assert abs(moments[-1].off_hz + off_hz) < 5.0  # from a Doppler that does not jump


def test_modes_follow_the_power_down_and_up() -> None:
    steps = ((0.0, 44.0), (4.0, 23.0), (12.0, -30.0), (14.0, 23.0), (20.0, 44.0))
    model = Model(lambda t: [level for at, level in steps if t >= at][-1], seed=3)
    channel, moments, events = _follow(model, SETTINGS, 26.0)
    assert [what for _, what in events] == [
        *("FLL", "bit sync", "PLL", "phase lock"),
        *("FFT", "hold", "FFT", "PLL", "phase lock"),
    ]
    times = {what: t for t, what in events}
    assert 12.3 < times["hold"] < 13.0
    assert 20.3 < times["PLL"] < 22.0
    blocked = [m for m in moments if 13.0 < m.t < 14.0]
    assert not any(m.code_valid for m in blocked)
    assert abs(moments[-1].off_hz) < 1.0
    # What it decided while weak is not lost: the symbols go on from there.
    assert len(channel.symbols) > 50 * 6


def test_a_satellite_found_weak_goes_to_frequency_tracking() -> None:
    model = Model(lambda _: 28.0, seed=6)
    settings = replace(SETTINGS, phase_threshold_dbhz=31.0)
    channel, moments, events = _follow(model, settings, 12.0)
    assert [what for _, what in events][:3] == ["FLL", "bit sync", "FFT"]
    assert channel.mode is Mode.WEAK
    assert abs(moments[-1].off_hz) < 0.6


def test_secondary_codes_are_stripped() -> None:
    model = Model(_falls_to(21.0), seed=7, signal=BDS_B1I_D1)
    channel, moments, events = _follow(model, SETTINGS, 30.0)
    assert channel.mode is Mode.WEAK
    assert [what for t, what in events if t > 4.0] == []
    assert np.std([m.off_hz for m in moments if m.t > 8.0]) < 0.4


def test_geostationary_satellites_are_held_and_come_back() -> None:
    """Symbols of 2 ms: noise must not look like a signal where their signs are guessed."""
    steps = ((0.0, 45.0), (4.0, 26.0), (9.0, -30.0), (11.5, 26.0))
    model = Model(
        lambda t: [level for at, level in steps if t >= at][-1],
        seed=3,
        signal=BDS_B1I_D2,
        period_shift=1,
    )
    _, moments, events = _follow(model, SETTINGS, 16.0)
    late = [(what, t) for t, what in events if t > 4.0]
    assert [what for what, _ in late] == ["FFT", "hold", "FFT"]
    assert 9.3 < late[1][1] < 10.8
    assert 11.5 < late[2][1] < 12.5
    assert abs(moments[-1].off_hz) < 0.5


@pytest.mark.parametrize(
    "frequency",
    [
        FrequencySettings("psfft", order=1, gain=1.0),
        FrequencySettings("sfft", window_s=0.5),
        FrequencySettings("pfft", bins=5, window_s=0.064),
        FrequencySettings("two_stage"),
        FrequencySettings("early_late"),
        FrequencySettings("refinement", phase=True),
    ],
)
def test_every_setting_tracks_25_dbhz(frequency: FrequencySettings) -> None:
    model = Model(_falls_to(25.0), rate_hzps=0.3, seed=9)
    settings = replace(SETTINGS, frequency=frequency)
    channel, moments, events = _follow(model, settings, 24.0)
    assert channel.mode is Mode.WEAK
    assert [what for t, what in events if t > 8.0] == []
    limit_hz = 0.35 if frequency.window_s > 0.3 else 2.0
    assert np.sqrt(np.mean([m.off_hz**2 for m in moments if m.t > 8.0])) < limit_hz


@pytest.mark.slow
def test_ten_minutes_at_20_dbhz_without_loss() -> None:
    for seed in range(6):
        model = Model(_falls_to(20.0), rate_hzps=0.6, seed=20 + seed)
        _, moments, events = _follow(model, SETTINGS, 603.0)
        assert [what for t, what in events if t > 4.5] == []
        assert all(m.mode is Mode.WEAK for m in moments if m.t > 4.5)


@pytest.mark.slow
def test_ten_minutes_of_phase_at_26_dbhz_without_loss() -> None:
    """PLL of order 3, 7 Hz, 20 ms."""
    settings = replace(SETTINGS, phase_threshold_dbhz=24.0)
    for seed in range(3):
        model = Model(_falls_to(26.0), rate_hzps=0.6, seed=30 + seed)
        _, moments, events = _follow(model, settings, 603.0)
        assert [what for t, what in events if t > 4.5] == []
        assert all(m.phase_valid for m in moments if m.t > 4.5)


@pytest.mark.parametrize("cn0_dbhz", [22.0, 27.0])
def test_a_satellite_found_weak_where_predicted_starts_in_frequency_tracking(
    cn0_dbhz: float,
) -> None:
    model = Model(lambda _: cn0_dbhz, seed=12)
    channel = start(model, SETTINGS, doppler_error_hz=2.0, code_error_chips=0.05)
    chips = model.code_chips(np.array([channel.command.sample / RATE_HZ]))[0]
    begun = round(chips / channel.signal.id.code_chips)  # code periods before the channel's first
    channel.set_edge(model.period_shift - begun, "predicted travel time")
    channel.begin_weak(cn0_dbhz)
    _, moments, events = _follow(model, SETTINGS, 20.0, channel)
    assert not {"hold", "lost"} & {what for _, what in events}
    late = [m for m in moments if m.t > 5.0]
    assert all(m.mode is Mode.WEAK and m.code_valid for m in late)
    assert max(abs(m.off_hz) for m in late) < 2.0
    assert abs(np.mean([m.cn0_dbhz for m in late]) - cn0_dbhz) < 0.7
