"""From a validated configuration to what receiver and engine are told."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from datetime import datetime
from typing import NamedTuple

from deepgnss.core.errors import ConfigError
from deepgnss.core.frames import ecef
from deepgnss.core.records import NavData, SignalId, StreamInfo
from deepgnss.core.time import from_utc
from deepgnss.deep.consistency import check_nav_date
from deepgnss.deep.differential import DIFFERENTIAL, range_corrections
from deepgnss.io.config import Config
from deepgnss.io.config.receiver import PositioningConfig
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver.acquisition import AcquisitionSettings
from deepgnss.receiver.clock import NS
from deepgnss.receiver.modes import (
    CarrierSettings,
    FrequencySettings,
    KalmanSettings,
    LongUpdateSettings,
    TrackingSettings,
)
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.receiver import Knowledge, ReceiverSettings
from deepgnss.receiver.search import SearchSettings
from deepgnss.receiver.signals import SIGNALS, Signal
from deepgnss.receiver.weak_search import WeakSettings

_SEARCH_MARGIN_S = 0.005  # of an epoch, beyond the sums of a search


class Covered(NamedTuple):
    """A signal of the config (the kinds of it that satellites send) in a stream."""

    kinds: tuple[Signal, ...]
    stream: StreamInfo

    @property
    def id(self) -> SignalId:
        """Name tag the kinds share."""
        return self.kinds[0].id


@dataclass(frozen=True, slots=True)
class RunPlan:
    """What an engine needs beside the samples; samples count in the first signal's stream."""

    covered: tuple[Covered, ...]
    settings: ReceiverSettings
    knowledge: Knowledge
    first: int  # samples [first, end) are processed
    end: int
    epoch_s: float
    scout: bool
    threads: int

    @property
    def stream(self) -> StreamInfo:
        """The stream whose samples are the time axis of the run."""
        return self.covered[0].stream

    @property
    def seconds(self) -> float:
        """Length of what is processed."""
        return (self.end - self.first) / self.stream.sample_rate_hz


def plan_run(
    config: Config, streams: tuple[StreamInfo, ...], start: datetime | None = None
) -> RunPlan:
    """Choose signals and streams, and translate the settings.

    `start`: when the recording began, as its own metadata say; the config's word goes first.

    Raises ConfigError when no stream covers a signal this version tracks, InputFileError when
    the NAV file does not fit the recording's date.
    """
    covered = _covered(config, streams)
    stream = covered[0].stream
    first = round(config.recording.skip * stream.sample_rate_hz)
    lasts_s = min(c.stream.sample_count / c.stream.sample_rate_hz for c in covered)
    end = min(stream.sample_count, math.ceil(lasts_s * stream.sample_rate_hz))
    if config.recording.duration is not None:
        end = min(end, first + round(config.recording.duration * stream.sample_rate_hz))
    if first >= end:
        raise ConfigError(
            f"recording.skip: {config.recording.skip} s, but the recording lasts {lasts_s:.3f} s"
        )
    if config.tracking.code.coherent != config.tracking.carrier.coherent:
        raise ConfigError(
            f"tracking.code.coherent: {config.tracking.code.coherent} s, expected that of the "
            f"carrier loop, {config.tracking.carrier.coherent} s: both share their sums"
        )
    searched_s = config.acquisition.coherent * config.acquisition.noncoherent
    if searched_s > config.deep.epoch - _SEARCH_MARGIN_S:
        raise ConfigError(
            f"acquisition.noncoherent: {config.acquisition.noncoherent} sums of "
            f"{config.acquisition.coherent} s do not fit an epoch (deep.epoch) of "
            f"{config.deep.epoch} s"
        )
    return RunPlan(
        covered=covered,
        settings=receiver_settings(config),
        knowledge=initial_knowledge(config, start),
        first=first,
        end=end,
        epoch_s=config.deep.epoch,
        scout=config.start == "scout",
        threads=config.threads or os.cpu_count() or 1,
    )


def _covered(config: Config, streams: tuple[StreamInfo, ...]) -> tuple[Covered, ...]:
    found = []
    for name in config.signals:
        carrier_hz = SIGNALS[name][0].id.carrier_hz
        for stream in streams:
            place_hz = stream.intermediate_hz + carrier_hz - stream.centre_hz
            if abs(place_hz) <= stream.sample_rate_hz / 2.0:
                found.append(Covered(SIGNALS[name], stream))
                break
    if not found:
        raise ConfigError(f"signals: none of {', '.join(config.signals)} lies in a stream")
    return tuple(found)


def receiver_settings(config: Config) -> ReceiverSettings:
    """Settings of the receiver from the config's tracking, acquisition, positioning, output."""
    tracking, positioning, acquisition = config.tracking, config.positioning, config.acquisition
    frequency, kalman = tracking.frequency, tracking.carrier.kalman
    long_update = tracking.carrier.long_update
    return ReceiverSettings(
        tracking=TrackingSettings(
            carrier=CarrierSettings(
                loop=tracking.carrier.loop,
                bandwidth_hz=tracking.carrier.bandwidth,
                coherent_s=tracking.carrier.coherent,
                oscillator=config.oscillator.oscillator(),
                kalman=KalmanSettings(
                    dynamics_mps2=kalman.dynamics,
                    adaptive=kalman.adaptive,
                    memory_s=kalman.memory,
                    fading=kalman.fading,
                    square_root=kalman.square_root,
                ),
                long_update=LongUpdateSettings(long_update.update, long_update.dynamics),
            ),
            code_order=tracking.code.order,
            code_bandwidths_hz=tuple(tracking.code.bandwidth),
            spacing_chips=tracking.code.spacing,
            phase_threshold_dbhz=tracking.thresholds.phase,
            frequency_threshold_dbhz=tracking.thresholds.frequency,
            lost_after_s=tracking.thresholds.lost_after,
            open_loop_s=tracking.thresholds.open_loop,
            record_correlations=config.output.correlations,
            frequency=FrequencySettings(
                discriminator=frequency.discriminator,
                bins=frequency.bins,
                window_s=frequency.window,
                order=frequency.order,
                gain=frequency.gain,
                phase=frequency.phase,
            ),
        ),
        acquisition=AcquisitionSettings(
            doppler_max_hz=acquisition.doppler_max,
            coherent_s=acquisition.coherent,
            noncoherent=acquisition.noncoherent,
            false_alarm=acquisition.false_alarm,
        ),
        searching=SearchSettings(
            weak=WeakSettings(
                acquisition.weak_length, acquisition.false_alarm, acquisition.weak_doppler_rate
            )
            if acquisition.weak
            else None,
            weak_every_s=acquisition.weak_interval,
        ),
        pvt=_pvt(positioning),
        smoothing=positioning.smoothing,
        solve_between_outputs=config.imu is not None and config.deep.enabled,
        output_ns=round(config.output.interval * NS),
        solution_ns=round(config.deep.epoch * NS),
    )


def _pvt(positioning: PositioningConfig) -> PvtParameters:
    own = PvtParameters(
        elevation_mask_rad=math.radians(positioning.elevation_mask),
        ionosphere=positioning.ionosphere,
        troposphere=positioning.troposphere,
        raim=positioning.raim,
    )
    if positioning.base is None:
        return own
    return replace(DIFFERENTIAL, elevation_mask_rad=own.elevation_mask_rad, raim=positioning.raim)


def limits(config: Config) -> tuple[str, ...]:
    """Lines to print before a run: settings that this receiver cannot follow to the letter."""
    lines = []
    positioning = config.positioning
    aided = config.imu is not None and config.deep.enabled
    if positioning.outliers.enabled and "outliers" in positioning.model_fields_set and not aided:
        lines.append("positioning.outliers: needs inertial aiding; this run relies on RAIM")
    return tuple(lines)


def initial_knowledge(config: Config, start: datetime | None) -> Knowledge:
    """What the config says of date, place and orbits."""
    start = config.recording.start_time or start
    told = near = from_utc(start) if start is not None else None
    nav = NavData()
    if config.nav is not None:
        nav = read_nav(config.nav)
        near = check_nav_date(nav, near, config.nav)
    base = config.positioning.base
    if base is not None and config.nav is None:
        raise ConfigError("positioning.base: needs the orbits of a NAV file (nav)")
    if base is not None:
        nav = replace(nav, corrections=range_corrections(base, nav))
    place = config.position
    position_e_m = ecef(math.radians(place[0]), math.radians(place[1]), place[2]) if place else None
    return Knowledge(nav=nav, near=near, start=told, position_e_m=position_e_m)
