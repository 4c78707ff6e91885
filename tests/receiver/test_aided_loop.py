"""Closed loops fed forward: motions reach them, corrections of the navigation do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import RunningSums
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, start
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.interval import Interval, turned
from deepgnss.receiver.modes import (
    AidingRate,
    AidingSource,
    CarrierSettings,
    Mode,
    TrackingSettings,
)

START_S = 4.0


def locked(model: Model, order: int) -> Channel:
    """A phase lock on a strong signal, aided all along by what truly moves."""
    channel = start(model, TrackingSettings(CarrierSettings(f"pll{order}")))
    go_on(channel, START_S, told(model))
    assert channel.mode is Mode.PHASE
    return channel


def told(model: Model, off_hz: float = 0.0, off_hzps: float = 0.0) -> AidingSource:
    """A prediction that is off by a frequency, and more so with every second."""

    def at(sample: int) -> AidingRate:
        t = sample / RATE_HZ
        rate_hzps = model.rate_hzps + off_hzps
        return AidingRate(model.doppler_hz + t * rate_hzps + off_hz, rate_hzps)

    return at


def go_on(channel: Channel, end_s: float, aiding: AidingSource) -> None:
    channel.begin_epoch()
    channel.run(cast(RunningSums, SimpleNamespace(end=round(end_s * RATE_HZ))), aiding)


@pytest.mark.parametrize("order", [2, 3])
def test_what_a_fix_corrects_does_not_shake_the_loop(order: int) -> None:
    model = Model(lambda _t: 70.0, rate_hzps=8.0)
    channel = locked(model, order)
    for k in range(20):  # a velocity jumps by 2 m/s from epoch to epoch
        go_on(channel, START_S + 0.1 * (k + 1), told(model, 10.0 * (-1) ** k))
        sample = channel.command.sample
        true_hz = model.doppler_hz + sample / RATE_HZ * model.rate_hzps
        assert channel.command.carrier_hz == pytest.approx(true_hz, abs=0.1)
        assert abs(channel.history[-2].correction.phase) < 2e-3


def test_a_loop_without_a_rate_of_its_own_runs_at_the_rate_it_is_told() -> None:
    """An acceleration 2 Hz/s off leaves 2/ω² cycles behind, whatever was told before."""
    model = Model(lambda _t: 70.0, rate_hzps=8.0)
    channel = locked(model, 2)
    for k in range(30):
        go_on(channel, START_S + 0.1 * (k + 1), told(model, 5.0 * (-1) ** k, 2.0))
        assert channel.command.carrier_hzps == pytest.approx(10.0, abs=1e-6)
    natural = 7.0 / 0.53
    left = channel.history[-2].correction.phase
    assert 0.2 * 2.0 / natural**2 < -left < 2.0 / natural**2


def test_what_a_fix_corrects_does_not_shake_frequency_tracking() -> None:
    """The same noise, once with corrections of 2 m/s from epoch to epoch and once without."""
    ends = []
    for off_hz in (0.0, 10.0):
        model = Model(lambda t: 45.0 if t < 2.0 else 22.0, rate_hzps=8.0)
        channel = start(model, TrackingSettings())
        for k in range(90):
            go_on(channel, 0.1 * (k + 1), told(model, off_hz * (-1) ** k if k > 70 else 0.0))
        assert channel.mode is Mode.WEAK
        ends.append(channel.command)
    assert ends[0].carrier_hz == pytest.approx(ends[1].carrier_hz, abs=0.05)
    assert ends[0].carrier_hz == pytest.approx(model.doppler_hz + 9.0 * 8.0, abs=1.0)


def test_a_weak_signal_s_code_loop_stays_as_it_is_when_its_range_is_refused() -> None:
    """At 20 dB-Hz a wide loop on windows has 12 m of noise: refused for that, it stays refused."""
    model = Model(lambda t: 45.0 if t < 6.0 else 20.0, rate_hzps=8.0)
    channel = start(model, TrackingSettings())
    for k in range(180):
        if k > 120:
            channel.doubt_code()
        go_on(channel, 0.1 * (k + 1), told(model))
        if k > 120:
            assert abs(code_error_m(model, channel.history[-1])) < 10.0
    assert channel.mode is Mode.WEAK
    assert channel.report("").code_bandwidth_hz == pytest.approx(0.1)


REFLECTED_CHIPS = -0.045  # 13 m behind
REFLECTED_M = -REFLECTED_CHIPS * SPEED_OF_LIGHT_MPS / 1.023e6


@pytest.mark.parametrize("doubted", [False, True])
def test_a_code_loop_that_is_told_of_a_reflection_leaves_it_at_once(doubted: bool) -> None:
    """A narrow loop sits on a reflection that is gone; told so at every tag, it does not stay."""
    model = Model(lambda _t: 65.0, rate_hzps=8.0)
    channel = locked(model, 3)
    go_on(channel, 10.0, told(model))
    assert channel.report("").code_bandwidth_hz == pytest.approx(0.1)
    nco = channel.nco
    nco.command = turned(nco.command, 0.0, REFLECTED_CHIPS)
    off_m = []
    for k in range(30):
        if doubted and (k == 0 or abs(off_m[-1]) > 1.5):  # refused until half of 3 m
            channel.doubt_code()
        go_on(channel, 10.1 + 0.1 * k, told(model))
        interval = channel.history[-1]
        assert interval.code_valid  # ranges go on, for whoever wants them
        off_m.append(code_error_m(model, interval))
    if doubted:
        assert max(map(abs, off_m[3:])) < 0.7  # neither late nor too far
        assert channel.report("").code_bandwidth_hz < 0.5
    else:
        assert off_m[5] < -8.0


def test_a_code_that_is_put_right_stays_there_and_narrow() -> None:
    """Its loop was just told of a reflection, and is as wide as it gets."""
    model = Model(lambda _t: 65.0, rate_hzps=8.0)
    channel = locked(model, 3)
    nco = channel.nco
    nco.command = turned(nco.command, 0.0, REFLECTED_CHIPS)
    channel.doubt_code()
    channel.put_code_right(REFLECTED_M, reflected=False)
    for k in range(10):
        go_on(channel, START_S + 0.1 * (k + 1), told(model))
        interval = channel.history[-1]
        assert interval.code_valid
        assert abs(code_error_m(model, interval)) < 0.1
    assert channel.report("").code_bandwidth_hz == pytest.approx(0.1)


def code_error_m(model: Model, interval: Interval) -> float:
    """Of the generator at a command's beginning, against what is simulated."""
    command = interval.command
    true_chips = float(model.code_chips(np.array([command.sample / RATE_HZ]))[0])
    off_chips = (command.code_chips - true_chips + 511.5) % 1023.0 - 511.5
    return off_chips * SPEED_OF_LIGHT_MPS / 1.023e6
