"""Position, velocity and clock from one snapshot: milliseconds of samples and a NAV file.

Search, measure, solve; then look for every satellite that should be there where the fix predicts
it, measure again and solve again. Nothing of other snapshots enters but what the caller puts into
the prior.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import Ephemeris, NavData, SampleBlock
from deepgnss.core.time import GpsTime
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.bit_timing import (
    PeriodSums,
    StampClock,
    TimeEstimate,
    TimeEvidence,
    edge_evidence,
    nearest_allowed_s,
)
from deepgnss.receiver.coarse_time import CodePhase, Rough, SnapshotFix, solve
from deepgnss.receiver.mirror import mirror_doppler_hz, sides
from deepgnss.receiver.precise import Measurement, correlate_snapshot, measure
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.snapshot_prediction import predict, usable
from deepgnss.receiver.snapshot_search import (
    SnapshotSettings,
    code_phases,
    look_again,
    search_all,
    search_beside,
)
from deepgnss.receiver.weights import PvtParameters

__all__ = ["Snapshot", "SnapshotSettings", "locate", "locate_series"]

_TIME_GAIN = 0.5  # symbol edges must narrow time to this share to be used
_TIME_FLOOR_S = 1e-4  # of a time known to the millisecond
_STAMPS_KNOWN_S = 0.5  # of a series' time stamps after the first fix
_STRIDE_M = 5e3  # from one snapshot of a series to the next
_DRIFT_CHANGE_SPS = 2e-7


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one snapshot gave."""

    fix: SnapshotFix
    searched: tuple[Acquisition, ...]
    measured: tuple[Measurement, ...]  # those of the fix, Dopplers on their right side


def locate(
    block: SampleBlock,
    signal: Signal,
    nav: NavData,
    rough: Rough,
    settings: SnapshotSettings,
    executor: Executor | None = None,
) -> Snapshot:
    """Fix of one snapshot; its time is that of the first sample.

    An invalid solution says what was lacking.
    """
    single = _single(block, signal, nav, rough, settings, executor)
    if single.evidence is None:
        return Snapshot(single.fix, single.searched, single.measured)
    return _sharpened(single, nav, single.evidence.estimate(), settings.pvt)


class _Single(NamedTuple):
    """A fix with what is needed to repeat it at another time."""

    fix: SnapshotFix
    searched: tuple[Acquisition, ...]
    measured: tuple[Measurement, ...]
    codes: list[CodePhase]
    near: Rough
    evidence: TimeEvidence | None  # None without a fix


def _single(
    block: SampleBlock,
    signal: Signal,
    nav: NavData,
    rough: Rough,
    settings: SnapshotSettings,
    executor: Executor | None,
) -> _Single:
    """Search, measure, solve, look again where the fix predicts, solve again."""
    seconds = len(block.samples) / block.stream.sample_rate_hz
    known = usable(nav, signal, rough)
    mirror_hz = mirror_doppler_hz(block, signal, settings.doppler_max_hz)
    searched = tuple(search_all(block, signal, sorted(known), settings, mirror_hz, executor))
    found = [
        measure(block, signal, one.prn, one.doppler_hz, one.code_chips)
        for one in searched
        if one.found
    ]
    best: tuple[SnapshotFix, list[Measurement]] | None = None
    for measured in sides(found, known, signal, rough, mirror_hz):
        measured += search_beside(block, signal, measured, known, nav, rough, settings)
        fix = solve(
            code_phases(measured, signal, settings, mirror_hz, seconds), nav, rough, settings.pvt
        )
        if best is None or _better(fix, best[0]):
            best = fix, measured
        if fix.solution.valid and rough.r_e_m is not None:
            break
    fix, measured = best if best is not None else (solve([], nav, rough, settings.pvt), [])
    if not fix.solution.valid:
        return _Single(fix, searched, tuple(measured), [], rough, None)
    expected = [
        one
        for one in predict(fix, known, nav, signal, settings.pvt)
        if one.elevation_rad > settings.pvt.elevation_mask_rad
    ]
    again = tuple(seen for one in expected if (seen := look_again(block, signal, one, settings)))
    elevations = {one.prn: one.elevation_rad for one in expected}
    codes = code_phases(again, signal, settings, mirror_hz, seconds, elevations)
    near = replace(rough, r_e_m=fix.solution.r_e_m, position_sigma_m=1000.0)
    second = solve(codes, nav, near, settings.pvt)
    if not second.solution.valid:
        return _Single(fix, searched, tuple(measured), [], rough, None)
    evidence = _time_evidence(block, signal, second, again, known, nav, settings)
    return _Single(second, searched, again, codes, near, evidence)


def _sharpened(
    single: _Single, nav: NavData, estimate: TimeEstimate, pvt: PvtParameters
) -> Snapshot:
    """The fix at a time the symbol edges have narrowed, if they have."""
    fix = single.fix
    if estimate.sigma_s < _TIME_GAIN * fix.time_sigma_s:
        rough = replace(
            single.near,
            time=fix.solution.time.plus(estimate.correction_s),
            time_sigma_s=max(estimate.sigma_s, _TIME_FLOOR_S),
        )
        sharp = solve(single.codes, nav, rough, pvt)
        if sharp.solution.valid:
            fix = sharp
    return Snapshot(fix, single.searched, single.measured)


def locate_series(
    snapshots: Iterable[tuple[GpsTime, SampleBlock]],
    signal: Signal,
    nav: NavData,
    rough: Rough,
    settings: SnapshotSettings,
    executor: Executor | None = None,
) -> Iterator[Snapshot]:
    """Fixes of snapshots with time stamps of one clock, e.g. a logger's; each by its own samples.

    Of earlier fixes only this enters: the place to some kilometres and the oscillator to 0.2 ppm,
    which say where to search and which whole milliseconds are meant, and how wrong the time stamps
    were, which names the one of the instants, 20 ms apart, that symbol edges leave open. No
    position or velocity is carried on.

    Parameters: rough, what is known before the first fix; its time is not used.
    """
    prior, clock = rough, StampClock()
    for stamp, block in snapshots:
        start = stamp.plus(clock.offset_s)
        single = _single(block, signal, nav, replace(prior, time=start), settings, executor)
        solution = single.fix.solution
        if not solution.valid or single.evidence is None:
            yield Snapshot(single.fix, single.searched, single.measured)
            continue
        clock, estimate = clock.after(stamp, solution.time, single.evidence)
        yield _sharpened(single, nav, estimate, settings.pvt)
        prior = replace(
            rough,
            time_sigma_s=min(_STAMPS_KNOWN_S, rough.time_sigma_s),
            r_e_m=solution.r_e_m,
            position_sigma_m=_STRIDE_M,
            drift_sps=solution.drift_sps,
            drift_sigma_sps=_DRIFT_CHANGE_SPS,
        )


def _time_evidence(
    block: SampleBlock,
    signal: Signal,
    fix: SnapshotFix,
    measured: Sequence[Measurement],
    known: dict[int, Ephemeris],
    nav: NavData,
    settings: SnapshotSettings,
) -> TimeEvidence:
    """What a fix and the symbol edges of its satellites say of the time."""
    solution = fix.solution
    time_s = solution.time.tow_s
    nearest_s = nearest_allowed_s(time_s, solution.clock_s, signal.period_s)
    expected = {one.prn: one for one in predict(fix, known, nav, signal, settings.pvt)}
    satellites = []
    for one in measured:
        if one.satellite not in solution.used:
            continue
        seen = expected[one.prn]
        c = correlate_snapshot(block, signal, one.prn, seen.doppler_hz, one.code_chips, np.zeros(1))
        whole = time_s + nearest_s - seen.travel_s - one.code_chips / signal.id.chip_rate_hz
        satellites.append(
            PeriodSums(c.sums[:, 0], c.times_s, c.noise, round(whole / signal.period_s))
        )
    return TimeEvidence(
        nearest_s=nearest_s,
        sigma_s=fix.time_sigma_s,
        period_s=signal.period_s,
        edges=edge_evidence(satellites, signal.symbol_periods),
    )


def _better(fix: SnapshotFix, other: SnapshotFix) -> bool:
    if fix.solution.valid != other.solution.valid:
        return fix.solution.valid
    used, others = len(fix.solution.used), len(other.solution.used)
    return fix.solution.valid and (used > others or (used == others and fix.cost < other.cost))
