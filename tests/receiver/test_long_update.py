"""The long-update loop: its filter, its measurements against bounds, and a channel that runs it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deepgnss.core.carrier_model import carrier_covariance, transition
from deepgnss.core.records import GPS_L1CA, FloatArray, Oscillator, RunningSums
from deepgnss.evaluate.reproduce.correlator_model import PHASE_0, RATE_HZ, Model, start
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.long_update import (
    LongUpdateLoop,
    Measured,
    Memory,
    bent,
    filtered,
    measurement_covariance,
)
from deepgnss.receiver.modes import (
    AidingRate,
    AidingSource,
    CarrierSettings,
    LongUpdateSettings,
    Mode,
    TrackingSettings,
    unaided,
)
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.trackers import NcoState, accumulate, advance, corrected
from deepgnss.theory.chirp import tone_bound

TCXO = Oscillator("TCXO", 1e-21, 0.0, 2e-20, 0.0)
OCXO = Oscillator("OCXO", 2e-25, 0.0, 6e-25, 0.0)
UPDATE_S = 0.2
SETTINGS = TrackingSettings(
    CarrierSettings("long_update", oscillator=OCXO, long_update=LongUpdateSettings(UPDATE_S))
)


# --- the filter ----------------------------------------------------------------------------------


def test_filters_like_a_plain_kalman_filter() -> None:
    """Against the textbook's gain and (I − KH)P, L(37–39)."""
    generator = np.random.default_rng(3)
    root = generator.standard_normal((4, 4))
    P, R = root @ root.T, np.diag([0.3, 0.2])
    z = np.array([0.4, -0.7])
    H = np.eye(2, 4)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    x, after, surprise = filtered(P, Measured(z, R))
    assert x == pytest.approx(K @ z)
    assert after == pytest.approx((np.eye(4) - K @ H) @ P)
    assert after == pytest.approx(after.T, abs=1e-12)
    assert surprise == pytest.approx(float(z @ np.linalg.inv(H @ P @ H.T + R) @ z) / 2.0)


def test_measurements_are_as_good_as_their_bounds() -> None:
    """R's diagonal, for phase and frequency alone, is that of theory."""
    R = measurement_covariance(1000.0, 200, 1e-3, 2)
    bound = tone_bound(1.0, 200, 1e-3)
    assert np.sqrt(np.diag(R)) == pytest.approx(bound[:2])
    assert measurement_covariance(1000.0, 200, 1e-3, 3)[0, 0] == pytest.approx(
        2.25 * R[0, 0], rel=1e-3
    )


def test_generator_foresees_the_slope_of_the_rate() -> None:
    """What it then leaves in the next update is `bent`, nothing at both ends."""
    jerk, half = 64.0, 0.5 * UPDATE_S
    loop = LongUpdateLoop(UPDATE_S)
    ahead = loop.foreseen(Memory(jerk, np.eye(4), 3, 1e4), UPDATE_S)
    generator = corrected(advance(NcoState(0.1, 3.0, 50.0), half), ahead, 0.0)  # type: ignore[arg-type]
    t = np.linspace(0.0, UPDATE_S, 9)
    since = t + half
    truth = 0.1 + since * (3.0 + since * (25.0 + since * jerk / 6.0))
    local = np.array([advance(generator, float(s)).phase for s in t])
    assert truth - local == pytest.approx(bent(jerk, UPDATE_S, t), abs=1e-9)
    assert bent(jerk, UPDATE_S, t)[-1] == pytest.approx(0.0, abs=1e-12)


def drawn_clock(
    oscillator: Oscillator | None, count: int, generator: np.random.Generator
) -> FloatArray:
    """Phase and frequency (count + 1, 2) of an oscillator, cycles and Hz, every 0.5 ms."""
    if oscillator is None:
        return np.zeros((count + 1, 2))
    Q = carrier_covariance(2, 0.5e-3, oscillator, GPS_L1CA.carrier_hz, 0.0)
    drawn = generator.standard_normal((count, 2)) @ np.linalg.cholesky(Q).T
    hz = np.concatenate([[0.0], np.cumsum(drawn[:, 1])])
    phase = np.concatenate([[0.0], np.cumsum(0.5e-3 * hz[:-1] + drawn[:, 0])])
    return np.column_stack([phase, hz])


class Track(SimpleNamespace):
    """What a loop made of a carrier: errors in the middles of updates, (n, 4), and P there."""

    errors: FloatArray
    P: FloatArray
    signs: float  # share decided wrong


def tracked(
    cn0_dbhz: float, jerk: float, seed: int, updates: int = 40, oscillator: Oscillator | None = None
) -> Track:
    """A loop alone on prompts of 1 ms with symbols, a steady slope of the rate.

    Begun at 38 dB-Hz at least. oscillator: whose noise is on the carrier, None: none is.
    """
    generator = np.random.default_rng(seed)
    loop, n = LongUpdateLoop(UPDATE_S, 0.75, oscillator or OCXO), round(UPDATE_S * 1e3)
    memory = loop.start()
    clock = drawn_clock(oscillator, 2 * n * updates, generator)  # every half millisecond
    truth = np.array([0.3, 100.0, -200.0, jerk])
    state = NcoState(0.35, 100.5, -190.0)
    t = 1e-3 * (np.arange(n) + 0.5)
    errors, covariances, wrong = [], [], 0.0
    for k in range(updates):
        cn0_hz = 10.0 ** (0.1 * (cn0_dbhz if k > 5 else max(cn0_dbhz, 38.0)))
        phase = truth[0] + t * (truth[1] + t * (truth[2] / 2.0 + t * truth[3] / 6.0))
        phase += clock[2 * k * n + 1 : 2 * (k + 1) * n : 2, 0]
        local = np.array([advance(state, float(s)).phase for s in t])
        sent = np.repeat(generator.choice((-1.0, 1.0), n // 20), 20)
        noise = generator.standard_normal((n, 2)) @ [1.0, 1.0j] / math.sqrt(2.0)
        prompts = math.sqrt(cn0_hz * 1e-3) * sent * np.exp(2j * np.pi * (phase - local)) + noise
        signs = np.repeat(loop.signs(memory, prompts.reshape(-1, 20).sum(axis=1), 0.02), 20)
        taps = np.repeat((prompts * signs)[:, np.newaxis], 3, axis=1)
        seen = accumulate(taps, 1e-3, True, cn0_hz=cn0_hz)
        memory, correction = loop.step(memory, seen)
        middle = transition(4, 0.5 * UPDATE_S) @ truth
        middle[:2] += clock[(2 * k + 1) * n]
        known = corrected(advance(state, 0.5 * UPDATE_S), correction, 0.0)
        errors.append(np.array([*known, memory.jerk_hzps2]) - middle)
        covariances.append(memory.P)
        wrong += float(np.mean(signs != sent))
        end = corrected(advance(state, UPDATE_S), correction, 0.5 * UPDATE_S)
        state = NcoState(*(np.array(end) + loop.foreseen(memory, UPDATE_S)))
        truth = transition(4, UPDATE_S) @ truth
    return Track(errors=np.array(errors), P=np.array(covariances), signs=wrong / updates)


@pytest.mark.parametrize("jerk", [0.0, 80.0])
def test_knows_its_own_errors(jerk: float) -> None:
    """NEES of a steady slope: no more than four, since the filter allows for slopes that change."""
    runs = [tracked(38.0, jerk, seed) for seed in range(4)]
    nees = [
        float(e @ np.linalg.solve(P, e))
        for run in runs
        for e, P in zip(run.errors[10:], run.P[10:], strict=True)
    ]
    assert 1.0 < float(np.mean(nees)) < 4.0
    assert all(run.signs == 0.0 for run in runs)
    first = np.array([run.errors[0, 0] for run in runs])
    assert np.abs(first).max() < 0.03  # a single update settles the phase


@pytest.mark.parametrize("cn0_dbhz", [45.0, 35.0])
def test_knows_what_a_poor_oscillator_does_within_an_update(cn0_dbhz: float) -> None:
    """Left out of R, which L does, NEES at 45 dB-Hz was 60, and a walk of frequency shook it."""
    runs = [tracked(cn0_dbhz, 0.0, seed, 60, TCXO) for seed in range(4)]
    nees = [
        float(e @ np.linalg.solve(P, e))
        for run in runs
        for e, P in zip(run.errors[10:], run.P[10:], strict=True)
    ]
    assert 2.0 < float(np.mean(nees)) < 6.0


def test_slips_nowhere_at_the_published_threshold() -> None:
    """21 dB-Hz, a slope of 64 Hz/s², symbols unknown."""
    assert np.abs(tracked(21.0, 64.0, 5).errors[:, 0]).max() < 0.15


# --- in a channel --------------------------------------------------------------------------------


@dataclass
class Sine(Model):
    """A Doppler that swings: rate to 800 Hz/s, its slope to 64 Hz/s², or as given."""

    largest_hzps: float = 800.0
    slope_hzps2: float = 64.0
    begin: float = 0.3

    def _swing(self, t: FloatArray) -> tuple[float, FloatArray]:
        w = self.slope_hzps2 / self.largest_hzps
        return w, w * t + self.begin

    def phase_cycles(self, t: FloatArray) -> FloatArray:
        """Carrier at seconds since sample 0."""
        w, angle = self._swing(t)
        size = self.largest_hzps / w**2
        swung = -size * (np.sin(angle) - math.sin(self.begin)) + size * w * t * math.cos(self.begin)
        return np.asarray(PHASE_0 + t * self.doppler_hz + swung)

    def doppler_at_hz(self, t: FloatArray) -> FloatArray:
        """Its slope."""
        w, angle = self._swing(t)
        return np.asarray(
            self.doppler_hz - self.largest_hzps / w * (np.cos(angle) - math.cos(self.begin))
        )

    def rate_at_hzps(self, t: FloatArray) -> FloatArray:
        """The slope of that."""
        return np.asarray(self.largest_hzps * np.sin(self._swing(t)[1]))


def go(
    model: Model,
    seconds: float,
    aiding: AidingSource = unaided,
    settings: TrackingSettings = SETTINGS,
    epoch_s: float = 0.1,
) -> tuple[Channel, list[Interval]]:
    """Run a channel; all its intervals as observables see them."""
    channel = start(model, settings, doppler_error_hz=20.0, code_error_chips=0.1)
    seen: dict[int, Interval] = {}
    t = channel.command.sample / RATE_HZ
    while t < seconds:
        t = min(t + epoch_s, seconds)
        channel.begin_epoch()
        channel.run(cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ))), aiding)
        seen |= {interval.command.sample: interval for interval in channel.history}
    return channel, [seen[sample] for sample in sorted(seen)]


def phase_errors(intervals: list[Interval], model: Model, since_s: float = 0.0) -> FloatArray:
    """Of valid phases, all over the intervals, up to the half cycle they have in common."""
    errors = []
    for interval, later in pairwise(intervals):
        command = interval.command
        if not interval.phase_valid or command.sample < since_s * RATE_HZ:
            continue
        length_s = (later.command.sample - command.sample) / RATE_HZ
        for at_s in length_s * (np.arange(10) + 0.5) / 10:
            state = NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps)
            told = corrected(
                advance(state, float(at_s)), interval.correction, float(at_s) - interval.middle_s
            )
            truth = model.phase_cycles(np.array([command.sample / RATE_HZ + at_s]))[0]
            errors.append(told.phase - truth)
    found = np.array(errors)
    return np.asarray(found - np.round(2.0 * np.mean(found)) / 2.0)


@pytest.mark.parametrize("signal", [GPS_L1CA_SIGNAL, BDS_B1I_D1, BDS_B1I_D2])
def test_hard_motion_unaided(signal: Signal) -> None:
    """15 g along the line of sight from the first sample: phase after one update, no slip."""
    model = Sine(lambda _t: 42.0, signal=signal, slope_hzps2=80.0)
    channel, intervals = go(model, 5.0)
    errors = phase_errors(intervals, model)
    assert channel.mode is Mode.PHASE
    assert errors.size > 200
    assert np.abs(errors).max() < 0.04
    begun = next(i for i in intervals if i.phase_valid)
    locked_s = begun.command.sample / RATE_HZ
    assert locked_s < 1.3
    at_s = np.array([channel.command.sample / RATE_HZ])
    period = round(
        (float(model.code_chips(at_s)[0]) - channel.command.code_chips) / signal.id.code_chips
    )
    first = channel.symbols_first + period - channel.periods - model.period_shift
    sent = model.symbols[first // signal.symbol_periods + 1 :][: len(channel.symbols)]
    decided = 1.0 - 2.0 * np.frombuffer(bytes(channel.symbols), dtype=np.uint8)
    late = round(1.5 / signal.symbol_s)
    assert abs(float(np.mean((decided * sent)[late:]))) == 1.0


def test_aided_it_sees_the_rest_only() -> None:
    """Motion that 200 ms of constant rate miss by a cycle: predicted every 20 ms of an update."""
    model = Sine(lambda _t: 42.0, largest_hzps=300.0, slope_hzps2=1500.0)

    def told(sample: int) -> AidingRate:
        t = np.array([sample / RATE_HZ])
        off_hz, off_hzps = 3.0 + 0.5 * t[0], 0.5
        return AidingRate(
            float(model.doppler_at_hz(t)[0]) + off_hz, float(model.rate_at_hzps(t)[0]) + off_hzps
        )

    channel, intervals = go(model, 5.0, told)
    assert channel.mode is Mode.PHASE
    assert np.abs(phase_errors(intervals, model)).max() < 0.04
    assert len({i.middle_s for i in intervals if i.phase_valid}) > 10  # commands within updates


def test_epochs_do_not_matter() -> None:
    """However the samples come, the same commands."""
    ends = {go(Sine(lambda _t: 42.0), 3.0, epoch_s=e)[0].command for e in (0.1, 0.05, 0.37)}
    assert len(ends) == 1


def test_falls_to_the_published_threshold() -> None:
    """23 dB-Hz at 64 Hz/s²."""
    thresholds = replace(SETTINGS, phase_threshold_dbhz=21.0, frequency_threshold_dbhz=17.0)
    model = Sine(lambda t: 42.0 if t < 2.5 else 23.0)
    channel, intervals = go(model, 10.0, settings=thresholds)
    errors = phase_errors(intervals, model)
    assert channel.mode is Mode.PHASE
    assert channel.slips == 0
    assert np.abs(errors).max() < 0.15


def test_a_blockage_is_seen() -> None:
    """Phases within the update in which the signal goes are not told."""
    model = Model(lambda t: 45.0 if t < 3.1 else 0.0)
    channel, intervals = go(model, 4.5)
    assert channel.mode in (Mode.HOLD, Mode.FREQUENCY, Mode.WEAK)
    dark = [i for i in intervals if i.command.sample > 3.0 * RATE_HZ]
    assert not any(i.phase_valid for i in dark)
