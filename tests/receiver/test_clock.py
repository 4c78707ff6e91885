"""Receiver time: exact instants, the sign of bias and drift, steering that settles."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.time import GpsTime
from deepgnss.receiver.clock import NS, ReceiverClock, from_ns, to_ns

ORIGIN_NS = to_ns(GpsTime(2290, 604_795.25))  # the week ends soon

rates = st.sampled_from([2_600_000, 4_000_000, 5_115_000, 16_368_000, Fraction(20_480_000, 3)])


@given(week=st.integers(0, 4000), tow_ns=st.integers(0, SECONDS_PER_WEEK * NS - 1))
@settings(deadline=None, derandomize=True)
def test_nanoseconds_and_back(week: int, tow_ns: int) -> None:
    count = week * SECONDS_PER_WEEK * NS + tow_ns
    time = from_ns(count)
    assert time.week == week
    assert abs(to_ns(time) - count) <= 1  # seconds of week are good for 0.1 ns
    assert 0.0 <= time.tow_s < SECONDS_PER_WEEK


@given(rate=rates, tenths=st.integers(0, 10 * 86_400))
@settings(deadline=None, derandomize=True)
def test_instants_of_a_perfect_clock_are_exact_for_a_day(rate: Fraction, tenths: int) -> None:
    clock = ReceiverClock(Fraction(rate), ORIGIN_NS)
    tag_ns = ORIGIN_NS + tenths * NS // 10
    instant = clock.instant(tag_ns)
    exact = Fraction(tenths, 10) * rate
    assert instant.sample == exact // 1
    assert instant.fraction == pytest.approx(float(exact % 1), abs=1e-9)
    assert 0.0 <= instant.fraction < 1.0
    assert clock.lag_s(tag_ns, instant) == pytest.approx(0.0, abs=1e-16)


@given(
    rate=rates,
    tenths=st.integers(0, 10 * 36_000),
    bias_s=st.floats(-1e-2, 1e-2),
    drift_sps=st.floats(-3e-6, 3e-6),
    since_s=st.floats(0.0, 36_000.0),
)
@settings(deadline=None, derandomize=True)
def test_tag_and_instant_are_one(
    rate: Fraction, tenths: int, bias_s: float, drift_sps: float, since_s: float
) -> None:
    """GPST of the instant is the tag, to a picosecond of what floats of hours can say."""
    clock = ReceiverClock(Fraction(rate), ORIGIN_NS, bias_s, drift_sps, since_s)
    tag_ns = ORIGIN_NS + tenths * NS // 10
    instant = clock.instant(tag_ns)
    elapsed_s = instant.sample / clock.sample_rate_hz
    error_s = clock.error_s(float(elapsed_s) + instant.fraction / float(rate))
    left_s = float(Fraction(tenths, 10) - elapsed_s) - instant.fraction / float(rate) + error_s
    assert left_s == pytest.approx(0.0, abs=1e-12)
    assert clock.lag_s(tag_ns, instant) == pytest.approx(-error_s, abs=1e-12)


def test_a_fast_counter_reaches_a_tag_at_a_later_sample() -> None:
    """Error is the counter's advance on GPST."""
    clock = ReceiverClock(Fraction(1_000_000), ORIGIN_NS, bias_s=3e-6)
    assert clock.instant(ORIGIN_NS + NS).sample == 1_000_003
    assert clock.gpst_ns(1_000_003) == pytest.approx(NS, abs=1e-3)
    assert clock.time(1_000_003).since(from_ns(ORIGIN_NS)) == pytest.approx(1.0, abs=1e-9)


def test_time_passes_the_week() -> None:
    clock = ReceiverClock(Fraction(1_000_000), ORIGIN_NS)
    assert clock.time(4_000_000) == GpsTime(2290, 604_799.25)
    assert clock.time(5_000_000) == GpsTime(2291, 0.25)


@pytest.mark.parametrize("interval_s", [0.1, 1.0])
def test_steering_finds_the_true_clock(interval_s: float) -> None:
    """Solutions with noise of 10 ns and 1e-10; the tag's error stays in their noise."""
    generator = np.random.default_rng(4)
    bias_s, drift_sps = -2.3e-4, 7.0e-7  # counter − GPST at sample 0 and its slope
    clock = ReceiverClock(Fraction(2_600_000), ORIGIN_NS)
    errors_s = []
    for k in range(1, 301):
        tag_ns = ORIGIN_NS + round(k * interval_s * NS)
        instant = clock.instant(tag_ns)
        read_s = (instant.sample + instant.fraction) / 2.6e6
        error_s = k * interval_s - (read_s - bias_s) / (1.0 + drift_sps)  # of the tag
        errors_s.append(error_s)
        noise = generator.standard_normal(2)
        before, clock = (
            clock,
            clock.steered(
                tag_ns,
                error_s + 1e-8 * noise[0],
                drift_sps - clock.drift_sps + 1e-10 * noise[1],
                first=k == 1,
            ),
        )
        if k > 1:  # phases must not jump
            here_s = k * interval_s
            assert clock.error_s(here_s) == pytest.approx(before.error_s(here_s), abs=1e-15)
    assert np.max(np.abs(errors_s[1:])) < 1e-7  # the first solution is taken whole
    assert np.std(errors_s[-50:]) < 1e-8
    assert clock.oscillator_sps == pytest.approx(drift_sps, abs=1e-10)
    # What steering adds to all Dopplers alike, m/s.
    assert abs(clock.drift_sps - drift_sps) * 3e8 < 0.5


def test_a_model_of_later_times_is_not_spoilt_by_the_first_solution() -> None:
    """After a scout pass the processing starts again at sample 0 with what was learnt."""
    scouted = ReceiverClock(Fraction(2_600_000), ORIGIN_NS, 1e-3, 2e-7, 2e-7, since_s=30.0)
    start = scouted.steered(ORIGIN_NS + NS // 10, 1e-8, 3e-9, first=False)
    assert start.oscillator_sps == 2e-7
    assert start.error_s(0.1) == pytest.approx(scouted.error_s(0.1), abs=1e-15)
    later = start.steered(ORIGIN_NS + NS // 5, 0.0, 3e-9, first=False)
    assert 2e-7 < later.oscillator_sps < 2.005e-7


def test_solution_without_velocity_leaves_the_drift() -> None:
    clock = ReceiverClock(Fraction(4_000_000), ORIGIN_NS).steered(
        ORIGIN_NS + NS, 2e-6, 3e-7, first=True
    )
    later_ns = ORIGIN_NS + 2 * NS
    without = clock.steered(later_ns, 1e-8, math.nan, first=False)
    agreeing = clock.steered(later_ns, 1e-8, clock.oscillator_sps - clock.drift_sps, first=False)
    assert without == agreeing
    first = ReceiverClock(Fraction(4_000_000), ORIGIN_NS).steered(
        ORIGIN_NS + NS, 2e-6, math.nan, first=True
    )
    assert (first.drift_sps, first.bias_s) == (0.0, 2e-6)
