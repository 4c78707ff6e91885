"""Finding and measuring the satellites of a snapshot: cold, beside others, where a fix predicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import Ephemeris, NavData, SampleBlock
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    cold_search,
    search_windows,
)
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.coarse_time import CodePhase, Rough
from deepgnss.receiver.precise import Measurement, look, measure
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.snapshot_prediction import LOWEST_RAD, Predicted, expect
from deepgnss.receiver.weights import PvtParameters

_RANGE_RATE_MPS = 1000.0  # fastest change of a range, of a wrong time
_WIDEST_WINDOW = 0.2  # of the code's length, for searches beside satellites found
_BESIDE_HZ = 60.0


@dataclass(frozen=True, slots=True)
class SnapshotSettings:
    """How snapshots are searched and believed.

    code_floor_m, doppler_floor_hz: standard deviations of what noise does not explain (multipath,
    orbit, atmosphere, in the zenith; oscillator), added to what it does.
    """

    doppler_max_hz: float = 6000.0
    doppler_centre_hz: float = 0.0
    false_alarm: float = 1e-3
    code_floor_m: float = 3.0
    doppler_floor_hz: float = 1.0
    look_chips: float = 1.5  # half width of the window around the first fix
    look_hz: float = 15.0
    pvt: PvtParameters = field(default_factory=PvtParameters)


def search_all(
    block: SampleBlock,
    signal: Signal,
    prns: Sequence[int],
    settings: SnapshotSettings,
    mirror_hz: float | None,
    executor: Executor | None,
) -> list[Acquisition]:
    """Cold search; of Dopplers that a mirror doubles one side is enough."""
    acquisition = acquisition_of(block, signal, settings)
    if acquisition.noncoherent == 0 or not prns:
        return []
    if mirror_hz is not None:
        low_hz = settings.doppler_centre_hz - settings.doppler_max_hz
        high_hz = settings.doppler_centre_hz + settings.doppler_max_hz
        high_hz = max(high_hz, 2.0 * mirror_hz - low_hz)
        acquisition = replace(
            acquisition,
            doppler_max_hz=0.5 * (high_hz - mirror_hz),
            doppler_centre_hz=0.5 * (high_hz + mirror_hz),
        )
    sums = running_sums(block, signal.id.carrier_hz)
    return cold_search(sums, block.first, signal, acquisition, prns, executor)


def search_beside(
    block: SampleBlock,
    signal: Signal,
    found: Sequence[Measurement],
    known: dict[int, Ephemeris],
    nav: NavData,
    rough: Rough,
    settings: SnapshotSettings,
) -> list[Measurement]:
    """Further satellites, sought where a known place lets them be expected beside those found."""
    if rough.r_e_m is None or not found:
        return []
    apart_m = 2.0 * rough.position_sigma_m + _RANGE_RATE_MPS * rough.time_sigma_s
    half_chips = apart_m / SPEED_OF_LIGHT_MPS * signal.id.chip_rate_hz
    if half_chips > _WIDEST_WINDOW * signal.id.code_chips:
        return []
    expected = expect(known, nav, signal, settings.pvt, rough.time, rough.r_e_m)
    here = {one.prn: one for one in expected}
    first = max(found, key=lambda one: one.cn0_dbhz)
    offset_hz = float(np.median([one.doppler_hz - here[one.prn].doppler_hz for one in found]))
    offset_chips = first.code_chips - here[first.prn].code_s * signal.id.chip_rate_hz
    windows = {
        one.prn: SearchWindow(
            one.doppler_hz + offset_hz,
            _BESIDE_HZ,
            (one.code_s * signal.id.chip_rate_hz + offset_chips) % signal.id.code_chips,
            half_chips,
        )
        for one in expected
        if one.elevation_rad > settings.pvt.elevation_mask_rad
        and one.prn not in {other.prn for other in found}
    }
    sums = running_sums(block, signal.id.carrier_hz)
    acquisition = acquisition_of(block, signal, settings)
    searched = search_windows(sums, block.first, signal, windows, acquisition)
    return [
        measure(block, signal, one.prn, one.doppler_hz, one.code_chips)
        for one in searched
        if one.found
    ]


def acquisition_of(
    block: SampleBlock, signal: Signal, settings: SnapshotSettings
) -> AcquisitionSettings:
    """Search with all of the data: half of it coherently, half a symbol at most."""
    seconds = len(block.samples) / block.stream.sample_rate_hz
    periods = int(seconds / signal.period_s + 1e-6)
    coherent = max(1, min(max(1, signal.symbol_periods // 2), periods // 2))
    return AcquisitionSettings(
        doppler_max_hz=settings.doppler_max_hz,
        doppler_centre_hz=settings.doppler_centre_hz,
        coherent_s=coherent * signal.period_s,
        noncoherent=periods // coherent,
        false_alarm=settings.false_alarm,
    )


def code_phases(
    measured: Sequence[Measurement],
    signal: Signal,
    settings: SnapshotSettings,
    mirror_hz: float | None,
    seconds: float,
    elevation_rad: Mapping[int, float] | None = None,
) -> list[CodePhase]:
    """Measurements as the solver takes them, with what they err beyond noise.

    Parameters: seconds of the snapshot; elevations by PRN where they are known.
    """
    chip_m = SPEED_OF_LIGHT_MPS / signal.id.chip_rate_hz
    codes = []
    for one in measured:
        # Closer to the mirror than the snapshot resolves, signal and image draw each other there.
        drawn_hz = 0.0
        if mirror_hz is not None and abs(one.doppler_hz - mirror_hz) < 1.5 / seconds:
            drawn_hz = 1.0 / seconds
        sine = 1.0
        if elevation_rad is not None:
            sine = math.sin(max(elevation_rad[one.prn], LOWEST_RAD))
        codes.append(
            CodePhase(
                satellite=one.satellite,
                signal=signal.id.name,
                code_s=one.code_chips / signal.id.chip_rate_hz,
                doppler_hz=one.doppler_hz,
                cn0_dbhz=one.cn0_dbhz,
                code_sigma_m=math.hypot(
                    settings.code_floor_m / sine, chip_m * one.code_sigma_chips
                ),
                doppler_sigma_hz=math.hypot(
                    settings.doppler_floor_hz, one.doppler_sigma_hz, drawn_hz
                ),
            )
        )
    return codes


def look_again(
    block: SampleBlock, signal: Signal, expected: Predicted, settings: SnapshotSettings
) -> Measurement | None:
    """Measure a satellite close to where a fix predicts it, if it is there."""
    return look(
        block,
        signal,
        expected.prn,
        expected.doppler_hz,
        expected.code_s * signal.id.chip_rate_hz,
        settings.look_hz,
        settings.look_chips,
        settings.false_alarm,
    )
