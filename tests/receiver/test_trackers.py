"""Trackers: corrections from correlations, in size and sign; and their schedule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.loops import loop_gains, settling_time_s
from deepgnss.core.records import ComplexArray
from deepgnss.receiver.phase_loops import CostasLoop
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    DelayLock,
    FrequencyLock,
    NcoState,
    advance,
    corrected,
    scheduled_bandwidth_hz,
)

PERIOD_S = 1e-3
finite = st.floats(-1e3, 1e3)
quick = settings(deadline=None, derandomize=True, max_examples=50)


def _seen(taps: ComplexArray, coherent: bool = True) -> Accumulated:
    early, prompt, late = taps.sum(axis=0).tolist()
    return Accumulated(taps, early, prompt, late, len(taps) * PERIOD_S, PERIOD_S, coherent)


def _prompts(off_hz: float, bits: np.ndarray | float = 1.0, count: int = 20) -> Accumulated:
    t = PERIOD_S * (np.arange(count) + 0.5 - count / 2)
    prompt = bits * 3.0 * np.exp(2j * np.pi * off_hz * t)
    return _seen(np.column_stack([0.875 * prompt, prompt, 0.875 * prompt]))


# --- generators ----------------------------------------------------------------------------------


@given(phase=finite, frequency=finite, rate=finite, first=st.floats(0, 1), second=st.floats(0, 1))
@quick
def test_advancing_twice_is_advancing_once(
    phase: float, frequency: float, rate: float, first: float, second: float
) -> None:
    state = NcoState(phase, frequency, rate)
    twice = advance(advance(state, first), second)
    np.testing.assert_allclose(twice, advance(state, first + second), atol=1e-9)


@given(correction=st.tuples(finite, finite, finite), since=st.floats(0.0, 0.02))
@quick
def test_a_late_correction_is_one_made_in_time(
    correction: tuple[float, float, float], since: float
) -> None:
    """Made at the middle and run on, or made at the end for the middle: the same."""
    middle = NcoState(5.0, 100.0, 3.0)
    in_time = advance(NcoState(*np.add(middle, correction)), since)
    late = corrected(advance(middle, since), Correction(*correction), since)
    np.testing.assert_allclose(late, in_time, atol=1e-9)
    assert corrected(middle, NO_CORRECTION, since) == middle


# --- carrier -------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 3])
def test_phase_lock_corrects_what_it_sees(order: int) -> None:
    error = 0.03
    turned = _seen(np.full((20, 3), -np.exp(2j * np.pi * error)))
    gains = loop_gains(order, 7.0, 0.02)
    _, found = CostasLoop(order, 7.0).step(None, turned)
    np.testing.assert_allclose(found, np.array(gains) * error, rtol=1e-9)
    assert (found.rate > 0.0) == (order == 3)


@pytest.mark.parametrize("sum_periods", [1, 5])
@pytest.mark.parametrize("off_hz", [-40.0, -2.0, 0.0, 11.0])
def test_frequency_lock_bears_a_bit_edge(sum_periods: int, off_hz: float) -> None:
    """Right without an edge; with one it pulls the right way and is zero at zero."""
    lock = FrequencyLock(8.0, sum_periods)
    gain = loop_gains(1, 8.0, 0.02).phase
    assert lock.correct(_prompts(off_hz)).frequency == pytest.approx(gain * off_hz, abs=1e-9)
    for edge in (5, 10, 13):
        bits = np.where(np.arange(20) < edge, 1.0, -1.0)
        seen = lock.correct(_prompts(off_hz, bits)).frequency
        assert seen == pytest.approx(gain * off_hz, abs=0.01 + 0.5 * gain * abs(off_hz))
        assert seen * off_hz >= 0.0


def test_squared_frequency_lock_bears_any_code() -> None:
    bits = np.random.default_rng(0).choice([-1.0, 1.0], 20)
    seen = FrequencyLock(8.0, squared=True).correct(_prompts(30.0, bits))
    assert seen.frequency == pytest.approx(loop_gains(1, 8.0, 0.02).phase * 30.0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_intervals_are_borne(count: int) -> None:
    found = FrequencyLock(8.0, 5).correct(_prompts(20.0, count=count))
    wanted = 0.0 if count == 1 else loop_gains(1, 8.0, count * PERIOD_S).phase * 20.0
    assert found == Correction(0.0, pytest.approx(wanted), 0.0)


# --- code ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("coherent", [True, False])
def test_delay_lock_corrects_what_it_sees(order: int, coherent: bool) -> None:
    """Received ahead by 0.02 chip: early stands higher, the generator goes forward."""
    error, spacing = 0.02, 0.5
    bits = np.ones(20) if coherent else np.random.default_rng(1).choice([-1.0, 1.0], 20)
    offsets = np.array([0.25, 0.0, -0.25])
    taps = np.outer(bits, 1.0 - np.abs(error - offsets)).astype(np.complex128)
    found = DelayLock(order, 1.0, spacing, 0.25).correct(_seen(taps, coherent))
    gains = loop_gains(order, 1.0, 0.02)
    assert found.phase == pytest.approx(gains.phase * error, rel=0.02)
    assert found.frequency == pytest.approx(gains.frequency * error, rel=0.02)
    assert (found.frequency > 0.0) == (order == 2)


def test_bandwidth_schedule() -> None:
    """T(5.22): each until its step response crosses zero; down to the last, never up."""
    schedule = (3.0, 1.0, 0.1)
    first, second = settling_time_s(3.0), settling_time_s(1.0)
    assert scheduled_bandwidth_hz(schedule, 0.0) == 3.0
    assert scheduled_bandwidth_hz(schedule, first - 1e-6) == 3.0
    assert scheduled_bandwidth_hz(schedule, first + 1e-6) == 1.0
    assert scheduled_bandwidth_hz(schedule, first + second - 1e-6) == 1.0
    seen = [scheduled_bandwidth_hz(schedule, t) for t in np.arange(0.0, 30.0, 0.02)]
    assert np.all(np.diff(seen) <= 0.0)
    assert seen[-1] == 0.1
    assert scheduled_bandwidth_hz((0.5,), 0.0) == scheduled_bandwidth_hz((0.5,), 99.0) == 0.5
