"""Loop gains by what they do: the recursion the channel runs, fed with impulses and steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.loops import LoopGains, loop_gains, settling_time_s
from deepgnss.core.records import FloatArray
from deepgnss.receiver.trackers import Correction, NcoState, advance, corrected

loops = pytest.mark.parametrize(
    ("order", "bandwidth_hz", "interval_s"),
    [
        (order, bandwidth_hz, interval_s)
        for order in (1, 2, 3)
        for bandwidth_hz, interval_s in [
            (0.1, 0.02),
            (1.0, 0.02),
            (7.0, 0.02),
            (15.0, 0.02),
            (20.0, 0.02),  # bandwidth × interval 0.4, the most a config may ask for
            (18.0, 0.001),
            (40.0, 0.01),
        ]
    ],
)


def _run(
    gains: LoopGains, interval_s: float, true_cycles: FloatArray, noise: FloatArray
) -> FloatArray:
    """Error of the generator (local − received) in the middle of each interval, from rest.

    true_cycles: received phase at the middles. The discriminator is ideal plus noise.
    """
    state = NcoState(0.0, 0.0, 0.0)
    errors = np.empty(true_cycles.size)
    for k, (truth, extra) in enumerate(zip(true_cycles, noise, strict=True)):
        local = advance(state, 0.5 * interval_s).phase
        errors[k] = local - truth
        seen = truth + extra - local
        correction = Correction(gains.phase * seen, gains.frequency * seen, gains.rate * seen)
        state = corrected(advance(state, interval_s), correction, 0.5 * interval_s)
    return errors


def _middles(count: int, interval_s: float) -> FloatArray:
    return (np.arange(count) + 0.5) * interval_s


@loops
def test_noise_bandwidth_is_the_one_asked_for(
    order: int, bandwidth_hz: float, interval_s: float
) -> None:
    """By the sum of the squared impulse response: one-sided B = Σ h² / 2T."""
    count = int(40.0 / (bandwidth_hz * interval_s))
    impulse = np.zeros(count)
    impulse[0] = 1.0
    response = _run(loop_gains(order, bandwidth_hz, interval_s), interval_s, 0 * impulse, impulse)
    assert np.sum(response**2) / (2.0 * interval_s) == pytest.approx(bandwidth_hz, rel=1e-6)
    assert abs(response[-1]) < 1e-6


@pytest.mark.parametrize("order", [1, 2, 3])
def test_white_noise_comes_out_with_its_share(order: int) -> None:
    """Variance of the phase is 2·B·T times that of the discriminator, mean zero."""
    noise = np.random.default_rng(order).standard_normal(40_000)
    errors = _run(loop_gains(order, 7.0, 0.02), 0.02, np.zeros(noise.size), noise)[200:]
    assert np.var(errors) == pytest.approx(2.0 * 7.0 * 0.02, rel=0.03)
    assert abs(np.mean(errors)) < 0.01


@loops
def test_steps_of_what_the_order_follows_die_away(
    order: int, bandwidth_hz: float, interval_s: float
) -> None:
    """Phase for all orders, frequency from order 2 on, frequency rate with order 3."""
    gains = loop_gains(order, bandwidth_hz, interval_s)
    t = _middles(int(40.0 / (bandwidth_hz * interval_s)), interval_s)
    steps = (np.ones(t.size), bandwidth_hz * t, 0.5 * bandwidth_hz**2 * t**2)
    for step in steps[:order]:
        errors = _run(gains, interval_s, step, np.zeros(t.size))
        assert abs(errors[-1]) < 1e-5
        assert np.max(np.abs(errors)) < 4.0
    if order < 3:  # the next higher step leaves the constant error of the text books
        held = _run(gains, interval_s, steps[order], np.zeros(t.size))[-1]
        last = (gains.phase, gains.frequency)[order - 1]
        assert held == pytest.approx(-(bandwidth_hz**order) * interval_s / last, rel=1e-3)


def test_static_errors_match_the_analogue_loop_at_small_products() -> None:
    """Acceleration error of order 2, rate / ω² with ω = B / 0.53 (T table 2.4)."""
    rate_hzps, bandwidth_hz, interval_s = 3.0, 2.0, 0.001
    t = _middles(5000, interval_s)
    gains = loop_gains(2, bandwidth_hz, interval_s)
    errors = _run(gains, interval_s, 0.5 * rate_hzps * t**2, np.zeros(t.size))
    assert -errors[-1] == pytest.approx(rate_hzps / (bandwidth_hz / 0.53) ** 2, rel=0.02)


@given(
    order=st.integers(1, 3),
    product=st.floats(1e-5, 0.4),
    interval_s=st.sampled_from([0.001, 0.002, 0.004, 0.005, 0.01, 0.02]),
)
@settings(deadline=None, derandomize=True, max_examples=60)
def test_stable_and_true_over_the_whole_range_of_the_config(
    order: int, product: float, interval_s: float
) -> None:
    """Poles of the recursion itself, and its bandwidth from the Lyapunov sum of its powers."""
    gains = loop_gains(order, product / interval_s, interval_s)
    columns = []
    for unit in np.eye(3)[:order]:  # phase, frequency, rate
        state = NcoState(*unit.tolist())
        seen = -advance(state, 0.5 * interval_s).phase
        correction = Correction(gains.phase * seen, gains.frequency * seen, gains.rate * seen)
        columns.append(corrected(advance(state, interval_s), correction, 0.5 * interval_s)[:order])
    assert np.max(np.abs(np.linalg.eigvals(np.column_stack(columns)))) < 1.0
    assert min(gains[:order]) > 0.0
    assert all(gain == 0.0 for gain in gains[order:])


def test_gains_of_a_slow_loop_are_the_continuous_ones() -> None:
    """B·T → 0: K1 = √2·ω·T, K2 = ω²·T with ω = B / 0.53 for order 2; K1 = 4·B·T for order 1."""
    slow = loop_gains(2, 0.1, 0.001)
    natural = 0.1 / 0.5303
    assert slow.phase == pytest.approx(np.sqrt(2.0) * natural * 0.001, rel=1e-3)
    assert slow.frequency == pytest.approx(natural**2 * 0.001, rel=1e-3)
    assert loop_gains(1, 0.1, 0.001).phase == pytest.approx(4.0 * 0.1 * 0.001, rel=1e-3)


@pytest.mark.parametrize(
    ("order", "bandwidth_hz", "interval_s"),
    [(0, 1.0, 0.02), (4, 1.0, 0.02), (2, 0.0, 0.02), (2, -1.0, 0.02), (3, 1e4, 0.02)],
)
def test_impossible_loops_are_refused(order: int, bandwidth_hz: float, interval_s: float) -> None:
    with pytest.raises(ValueError, match=r"loop order|bandwidth"):
        loop_gains(order, bandwidth_hz, interval_s)


def test_settling_time_of_the_code_schedule() -> None:
    """T(5.22): 0.196 s at 3 Hz, 0.589 s at 1 Hz."""
    assert settling_time_s(3.0) == pytest.approx(0.196, abs=5e-4)
    assert settling_time_s(1.0) == pytest.approx(0.589, abs=5e-4)


def test_settling_time_is_where_the_step_response_crosses_zero() -> None:
    interval_s = 0.001
    t = _middles(1000, interval_s)
    step = np.ones(t.size)
    errors = _run(loop_gains(2, 3.0, interval_s), interval_s, step, np.zeros(t.size))
    crossing = t[np.argmax(errors > 0.0)]
    assert crossing == pytest.approx(settling_time_s(3.0), abs=0.003)
