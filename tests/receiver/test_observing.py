"""Observations of a channel made by hand: formulas of the interface documents, signs, flags."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import cast

import numpy as np
import pytest
from sampled_code import CARRIER_HZ, CHIP_HZ, signal_command

from deepgnss.core.constants import SECONDS_PER_WEEK, SPEED_OF_LIGHT_MPS
from deepgnss.core.records import SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.clock import NS, ReceiverClock, from_ns, to_ns
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.observables import Observed, PhaseMemory, observe, tag_of
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.trackers import Correction

RATE = Fraction(4_000_000)
RATE_HZ = float(RATE)


@dataclass
class _Channel:
    """What observables look at."""

    interval: Interval
    anchor: int | None
    satellite: str = "G05"
    signal: Signal = field(default=GPS_L1CA_SIGNAL)

    def at(self, sample: int) -> Interval:
        return self.interval


def _interval(
    sample: int, periods: int, chips: float, doppler_hz: float, cycles: float
) -> Interval:
    command = signal_command(sample, doppler_hz=doppler_hz, code_chips=chips, carrier_cycles=cycles)
    return Interval(command, periods, True, True, 3, 0, 45.0, 0.0)


def _observe(
    channel: _Channel,
    clock: ReceiverClock,
    tag_ns: int,
    memory: PhaseMemory = PhaseMemory(),  # noqa: B008  (immutable)
    instant: SampleInstant | None = None,
) -> Observed:
    tag = tag_of(clock, tag_ns)
    if instant is not None:
        tag = tag._replace(instant=instant, lag_s=clock.lag_s(tag_ns, instant))
    seen = observe(cast(Channel, channel), tag, memory)
    assert seen is not None
    return seen


@pytest.mark.parametrize("tow_s", [5000.0, 604_799.95, 0.05])
def test_pseudorange_is_tag_minus_transmit_time(tow_s: float) -> None:
    """Also where the week turned while the signal travelled."""
    start = to_ns(GpsTime(2200, 0.0)) + round(tow_s * NS)
    clock = ReceiverClock(RATE, start)
    sent_ms = (start + NS // 10) // 1_000_000 - 72  # a code epoch of the satellite's clock
    chips = 100.25
    channel = _Channel(_interval(400_000, 40, chips, 0.0, 0.0), sent_ms - 40)
    seen = _observe(channel, clock, start + NS // 10).observation
    travel_s = 0.072 - chips / CHIP_HZ
    assert seen.pseudorange_m == pytest.approx(travel_s * SPEED_OF_LIGHT_MPS, abs=1e-5)
    assert seen.transmit.since(from_ns(start + NS // 10)) == pytest.approx(-travel_s, abs=1e-9)
    assert 0.0 <= seen.transmit.tow_s < SECONDS_PER_WEEK


def test_phase_starts_near_the_pseudorange_and_grows_with_range() -> None:
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)))
    doppler_hz = -2500.0  # going away
    channel = _Channel(_interval(0, 0, 0.0, doppler_hz, 0.3), 2200 * 604_800_000 + 1_000_000 - 80)
    memory, phases, ranges = PhaseMemory(), [], []
    for k in (1, 5, 17):
        seen = _observe(channel, clock, clock.origin_ns + k * NS // 1000, memory)
        memory = seen.memory
        phases.append(seen.observation.carrier_cycles)
        ranges.append(seen.observation.pseudorange_m * CARRIER_HZ / SPEED_OF_LIGHT_MPS)
    assert abs(phases[0] - ranges[0]) <= 0.5
    # Code and carrier run together: no drift between them.
    np.testing.assert_allclose(np.diff(phases), np.diff(ranges), atol=1e-4)
    np.testing.assert_allclose(np.diff(phases), [2500.0 * 0.004, 2500.0 * 0.012], atol=1e-6)


@pytest.mark.parametrize("drift_sps", [0.0, 2.0e-6, -3.0e-6])
def test_doppler_is_minus_the_phase_s_rate_also_with_a_drifting_clock(drift_sps: float) -> None:
    """One clock for tag, range and phase; Doppler is on GPST's scale."""
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)), 1e-4, drift_sps, 0.0)
    channel = _Channel(_interval(0, 0, 0.0, 1234.5, 0.0), 2200 * 604_800_000 + 1_000_000 - 80)
    seen = [
        _observe(channel, clock, clock.origin_ns + ms * 1_000_000, PhaseMemory(7, 3)).observation
        for ms in (10, 1010)
    ]
    rate_hz = seen[1].carrier_cycles - seen[0].carrier_cycles
    assert rate_hz == pytest.approx(-seen[0].doppler_hz, abs=1e-5)
    range_rate = (seen[1].pseudorange_m - seen[0].pseudorange_m) * CARRIER_HZ / SPEED_OF_LIGHT_MPS
    assert range_rate == pytest.approx(-seen[0].doppler_hz, abs=1e-3)
    received_hz = CARRIER_HZ + seen[0].doppler_hz
    assert received_hz * (1.0 - drift_sps) - CARRIER_HZ == pytest.approx(1234.5, abs=1e-5)


def test_a_moved_instant_moves_code_and_phase_alike() -> None:
    """The same tag taken at a wrong sample: a clock error, common to both."""
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)))
    channel = _Channel(_interval(0, 0, 0.0, 800.0, 0.0), 2200 * 604_800_000 + 1_000_000 - 80)
    tag_ns = clock.origin_ns + NS // 100
    right = _observe(channel, clock, tag_ns, PhaseMemory(0, 3)).observation
    late = SampleInstant(clock.instant(tag_ns).sample + 400, 0.0)  # 0.1 ms
    wrong = _observe(channel, clock, tag_ns, PhaseMemory(0, 3), late).observation
    wavelength_m = SPEED_OF_LIGHT_MPS / CARRIER_HZ
    by_code_m = wrong.pseudorange_m - right.pseudorange_m
    by_phase_m = (wrong.carrier_cycles - right.carrier_cycles) * wavelength_m
    assert by_code_m == pytest.approx(-1e-4 * SPEED_OF_LIGHT_MPS * (1 + 800 / CARRIER_HZ), abs=1e-3)
    assert by_phase_m == pytest.approx(by_code_m, abs=1e-3)


def test_phase_does_not_lose_digits_in_long_recordings() -> None:
    """Ten hours in, at samples beyond 1e11: a thousandth of a cycle."""
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)), 3e-4, 1e-7)
    tag_ns = clock.origin_ns + 36_000 * NS
    sample = clock.instant(tag_ns).sample - 12_345
    base = _interval(sample, 36_000_000, 0.0, 1500.0, 0.0)
    channel = _Channel(base, 2200 * 604_800_000 + 1_000_000 - 80)
    one = _observe(channel, clock, tag_ns, PhaseMemory(0, 3)).observation
    other = _observe(channel, clock, tag_ns + 1_000_000, PhaseMemory(0, 3)).observation
    step = other.carrier_cycles - one.carrier_cycles
    assert step == pytest.approx(-one.doppler_hz * 1e-3, abs=1e-3)


def test_what_the_interval_s_own_correlations_said_is_taken_in() -> None:
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)))
    plain = _interval(0, 0, 0.0, 100.0, 0.0)
    corrected = plain._replace(correction=Correction(0.02, 1.5, 0.0), middle_s=0.01)
    tag_ns = clock.origin_ns + 12_000_000
    anchor = 2200 * 604_800_000 + 1_000_000 - 80
    one, other = (
        _observe(_Channel(i, anchor), clock, tag_ns, PhaseMemory(0, 3)).observation
        for i in (plain, corrected)
    )
    turned = -(0.02 + 1.5 * 0.002)
    assert other.carrier_cycles - one.carrier_cycles == pytest.approx(turned, abs=1e-6)
    assert other.doppler_hz - one.doppler_hz == pytest.approx(1.5, abs=1e-9)
    assert other.pseudorange_m == one.pseudorange_m


def test_flags() -> None:
    clock = ReceiverClock(RATE, to_ns(GpsTime(2200, 1000.0)))
    tag_ns, anchor = clock.origin_ns + 5_000_000, 2200 * 604_800_000 + 1_000_000 - 80
    base = _interval(0, 0, 0.0, 100.0, 0.0)

    def seen(interval: Interval, memory: PhaseMemory) -> Observed:
        return _observe(_Channel(interval, anchor), clock, tag_ns, memory)

    first = seen(base, PhaseMemory())
    assert first.observation.slip  # nothing to continue
    again = seen(base, first.memory)
    assert not again.observation.slip
    unknown = seen(base._replace(half_cycle=None), first.memory).observation
    assert unknown.half_cycle
    half = seen(base._replace(half_cycle=0.5, slips=4), first.memory)
    assert half.observation.slip
    assert not half.observation.half_cycle
    turned = half.observation.carrier_cycles - again.observation.carrier_cycles
    assert turned == pytest.approx(0.5, abs=1e-9)
    # Without valid phase the slip is remembered until there is a phase to flag.
    gone = seen(base._replace(slips=5, phase_valid=False, half_cycle=None), half.memory)
    assert not gone.observation.carrier_valid
    assert not gone.observation.half_cycle
    assert gone.observation.lock_time_s == 0.0
    assert seen(base._replace(slips=5), gone.memory).observation.slip


def test_no_range_without_transmit_time_or_code_lock() -> None:
    clock = ReceiverClock(RATE, 0)
    base = _interval(0, 0, 0.0, 0.0, 0.0)
    for channel in (_Channel(base, None), _Channel(base._replace(code_valid=False), 5)):
        assert observe(cast(Channel, channel), tag_of(clock, NS), PhaseMemory()) is None
    assert replace(_Channel(base, None)).anchor is None
