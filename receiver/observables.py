"""Observables of a channel at an instant: one receiver clock for tag, range and phase.

The generators' carrier runs at +Doppler; RINEX phase grows with range, φ = f·(tag − t_transmit),
hence the turned sign here and nowhere else. With the received carrier mixed down by a local
oscillator of f·n/rate cycles at sample n, f·t_transmit = carrier_cycles + f·n/rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from deepgnss.core.constants import SECONDS_PER_WEEK, SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Observation, SampleInstant
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.clock import NS, ReceiverClock, from_ns
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.trackers import NcoState, advance, corrected


class Tag(NamedTuple):
    """An instant at which the channels of a stream are observed."""

    ns: int  # GPST since the GPS epoch
    instant: SampleInstant
    rate_hz: float  # samples
    lag_s: float  # tag less the time the sample counter tells
    drift_sps: float  # of the clock's model


def tag_of(clock: ReceiverClock, tag_ns: int) -> Tag:
    """A GPST tag on the stream of a clock."""
    instant = clock.instant(tag_ns)
    lag_s = clock.lag_s(tag_ns, instant)
    return Tag(tag_ns, instant, float(clock.sample_rate_hz), lag_s, clock.drift_sps)


class PhaseMemory(NamedTuple):
    """What must survive between outputs of one channel."""

    ambiguity: int | None = None  # whole cycles that bring the first phase near the pseudorange
    slips: int = -1  # the channel's count at the last output


class Observed(NamedTuple):
    """An observation and the memory after it."""

    observation: Observation
    memory: PhaseMemory
    coasting: bool


def _at(interval: Interval, instant: SampleInstant, rate_hz: float) -> tuple[NcoState, NcoState]:
    """Carrier (as the loop estimates it) and code at an instant: cycles, chips."""
    command = interval.command
    seconds = (instant.sample - command.sample + instant.fraction) / rate_hz
    carrier = NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps)
    code = NcoState(command.code_chips, command.code_hz, command.code_hzps)
    estimated = corrected(
        advance(carrier, seconds), interval.correction, seconds - interval.middle_s
    )
    return estimated, advance(code, seconds)


def transmit_ns(channel: Channel, interval: Interval, code_chips: float) -> tuple[int, float]:
    """Satellite clock reading as whole ns of code periods since the GPS epoch, and the rest in s.

    The channel's anchor counts code periods since the GPS epoch at its period 0.
    """
    if channel.anchor is None:
        raise ValueError(f"{channel.satellite}: transmit time is not known")
    period_ns = round(channel.signal.period_s * NS)
    whole = (channel.anchor + interval.periods) * period_ns
    return whole, code_chips / channel.signal.id.chip_rate_hz


def observe(channel: Channel, tag: Tag, memory: PhaseMemory) -> Observed | None:
    """Observation of a channel at a tag, None while it has no pseudorange.

    In open loop it is what the generators say, and nobody has measured it.
    `memory` is that of the last output; keep the returned one only when this epoch is put out.
    """
    instant, rate_hz, drift_sps = tag.instant, tag.rate_hz, tag.drift_sps
    interval = channel.at(instant.sample)
    if channel.anchor is None or not (interval.code_valid or interval.coasting):
        return None
    carrier, code = _at(interval, instant, rate_hz)
    sent_ns, rest_s = transmit_ns(channel, interval, code.phase)
    half_week_ns = SECONDS_PER_WEEK * NS // 2
    travel_ns = (tag.ns - sent_ns + half_week_ns) % (2 * half_week_ns) - half_week_ns
    pseudorange_m = (travel_ns / NS - rest_s) * SPEED_OF_LIGHT_MPS

    frequency_hz = channel.signal.id.carrier_hz
    phase = frequency_hz * tag.lag_s - carrier.phase
    ambiguity = memory.ambiguity
    if ambiguity is None:
        ambiguity = round(pseudorange_m * frequency_hz / SPEED_OF_LIGHT_MPS - phase)
    valid = interval.phase_valid
    return Observed(
        Observation(
            satellite=channel.satellite,
            signal=channel.signal.id.name,
            pseudorange_m=pseudorange_m,
            carrier_cycles=phase + ambiguity + (interval.half_cycle or 0.0),
            # The clock model's drift is per second of the sample counter, Doppler per GPST's.
            doppler_hz=(
                carrier.frequency + interval.window.unfollowed_hz + frequency_hz * drift_sps
            )
            / (1.0 - drift_sps)
            if interval.frequency_valid
            else math.nan,
            cn0_dbhz=interval.cn0_dbhz,
            lock_time_s=(instant.sample - interval.phase_since) / rate_hz if valid else 0.0,
            slip=interval.slips != memory.slips,
            half_cycle=valid and interval.half_cycle is None,
            carrier_valid=valid,
            transmit=from_ns(sent_ns).plus(rest_s),
            arc=interval.slips,
            doppler_sigma_hz=interval.window.sigma_hz,
            doppler_s=interval.window.seconds,
        ),
        PhaseMemory(ambiguity, interval.slips if valid else memory.slips),
        interval.coasting,
    )
