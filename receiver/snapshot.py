"""Position, velocity and clock from one snapshot: milliseconds of samples and a NAV file.

Search, measure, solve; then look for every satellite that should be there where the fix predicts
it, measure again and solve again. Nothing of other snapshots enters but what the caller puts into
the prior.

Real samples at (nearly) zero IF hold every signal at its Doppler and at the mirror image of it.
Which of the two is found out from the Dopplers themselves: all share one offset of the oscillator.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import ecef
from deepgnss.core.records import Ephemeris, FloatArray, NavData, SampleBlock
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    cold_search,
    search,
)
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.bit_timing import (
    PeriodSums,
    StampClock,
    TimeEstimate,
    TimeEvidence,
    edge_evidence,
    nearest_allowed_s,
)
from deepgnss.receiver.coarse_time import CodePhase, Rough, SnapshotFix, solve
from deepgnss.receiver.precise import Measurement, correlate_snapshot, look, measure
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.weights import PvtParameters, delays

_TIME_GAIN = 0.5  # symbol edges must narrow time to this share to be used
_TIME_FLOOR_S = 1e-4  # of a time known to the millisecond
_STAMPS_KNOWN_S = 0.5  # of a series' time stamps after the first fix
_STRIDE_M = 5e3  # from one snapshot of a series to the next
_DRIFT_CHANGE_SPS = 2e-7
_RANGE_RATE_MPS = 1000.0  # fastest change of a range, of a wrong time
_WIDEST_WINDOW = 0.2  # of the code's length, for searches beside satellites found
_BESIDE_HZ = 60.0
_LOWEST_RAD = math.radians(3.0)
_BELOW_HORIZON_RAD = math.radians(-10.0)
_KNOWN_PLACE_M = 500e3  # a prior this good says which satellites are below the horizon
_PLACES = 800  # on earth, tried where mirrored Dopplers meet an unknown place
_SIGN_SETS = 12  # of them handed on to the solver


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


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What one snapshot gave."""

    fix: SnapshotFix
    searched: tuple[Acquisition, ...]
    measured: tuple[Measurement, ...]  # those of the fix, Dopplers on their right side


class Predicted(NamedTuple):
    """A satellite as a fix lets it be expected at the first sample."""

    prn: int
    code_s: float  # modulo the code period
    doppler_hz: float
    elevation_rad: float
    travel_s: float  # time of reception minus satellite clock reading


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
    known = _usable(nav, signal, rough)
    mirror_hz = mirror_doppler_hz(block, signal, settings.doppler_max_hz)
    searched = tuple(_search(block, signal, sorted(known), settings, mirror_hz, executor))
    found = [
        measure(block, signal, one.prn, one.doppler_hz, one.code_chips)
        for one in searched
        if one.found
    ]
    best: tuple[SnapshotFix, list[Measurement]] | None = None
    for measured in _sides(found, known, signal, rough, mirror_hz):
        measured += _beside(block, signal, measured, known, nav, rough, settings)
        fix = solve(
            _codes(measured, signal, settings, mirror_hz, seconds), nav, rough, settings.pvt
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
    again = tuple(seen for one in expected if (seen := _look(block, signal, one, settings)))
    elevations = {one.prn: one.elevation_rad for one in expected}
    codes = _codes(again, signal, settings, mirror_hz, seconds, elevations)
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


def predict(
    fix: SnapshotFix,
    known: dict[int, Ephemeris],
    nav: NavData,
    signal: Signal,
    parameters: PvtParameters,
) -> list[Predicted]:
    """Code phase and Doppler of satellites at the instant of a fix."""
    solution = fix.solution
    return _expect(
        known,
        nav,
        signal,
        parameters,
        solution.time,
        solution.r_e_m,
        solution.v_e_mps,
        solution.clock_s,
        solution.drift_sps,
    )


def _expect(
    known: dict[int, Ephemeris],
    nav: NavData,
    signal: Signal,
    parameters: PvtParameters,
    time: GpsTime,
    r_e_m: FloatArray,
    v_e_mps: FloatArray | None = None,
    clock_s: float = 0.0,
    drift_sps: float = 0.0,
) -> list[Predicted]:
    prns = sorted(known)
    ephemerides = [known[prn] for prn in prns]
    at = orbits.predict(ephemerides, time, r_e_m, np.zeros(3) if v_e_mps is None else v_e_mps)
    carriers_hz = np.full(len(prns), signal.id.carrier_hz)
    elevation_rad = np.maximum(at.elevation_rad, _LOWEST_RAD)
    delay_m, _ = delays(nav, parameters, time, r_e_m, at.azimuth_rad, elevation_rad, carriers_hz)
    travel_s = (at.pseudorange_m + delay_m) / SPEED_OF_LIGHT_MPS
    code_s = (-travel_s - clock_s) % signal.period_s
    doppler_hz = _dopplers(at.pseudorange_rate_mps, drift_sps, signal)
    columns = (prns, code_s, doppler_hz, at.elevation_rad, travel_s)
    return [Predicted(int(prn), *map(float, rest)) for prn, *rest in zip(*columns, strict=True)]


def mirror_doppler_hz(block: SampleBlock, signal: Signal, reach_hz: float) -> float | None:
    """Doppler about which real samples mirror the signals within ± reach, if there is one."""
    if block.samples.ndim == 2:
        return None
    stream = block.stream
    mix_hz = stream.intermediate_hz + signal.id.carrier_hz - stream.centre_hz
    mirror_hz = math.remainder(-2.0 * mix_hz, stream.sample_rate_hz) / 2.0
    return mirror_hz if abs(mirror_hz) < reach_hz else None


def _look(
    block: SampleBlock, signal: Signal, expected: Predicted, settings: SnapshotSettings
) -> Measurement | None:
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


# --- search --------------------------------------------------------------------------------------


def _usable(nav: NavData, signal: Signal, rough: Rough) -> dict[int, Ephemeris]:
    """Healthy satellites with an ephemeris that may be above the horizon, by PRN."""
    chosen = {}
    for prn in signal.prns:
        ephemeris = orbits.select(nav, signal.satellite(prn), rough.time)
        if ephemeris is not None and ephemeris.health == 0:
            chosen[prn] = ephemeris
    if chosen and rough.r_e_m is not None and rough.position_sigma_m <= _KNOWN_PLACE_M:
        at = orbits.predict(list(chosen.values()), rough.time, rough.r_e_m, np.zeros(3))
        up = at.elevation_rad > _BELOW_HORIZON_RAD
        chosen = {prn: chosen[prn] for prn, above in zip(list(chosen), up, strict=True) if above}
    return chosen


def _search(
    block: SampleBlock,
    signal: Signal,
    prns: Sequence[int],
    settings: SnapshotSettings,
    mirror_hz: float | None,
    executor: Executor | None,
) -> list[Acquisition]:
    """Cold search; of Dopplers that a mirror doubles one side is enough."""
    acquisition = _acquisition(block, signal, settings)
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


def _beside(
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
    expected = _expect(known, nav, signal, settings.pvt, rough.time, rough.r_e_m)
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
    acquisition = _acquisition(block, signal, settings)
    searched = [
        search(sums, block.first, signal, prn, acquisition, window)
        for prn, window in windows.items()
    ]
    return [
        measure(block, signal, one.prn, one.doppler_hz, one.code_chips)
        for one in searched
        if one.found
    ]


def _acquisition(
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


def _codes(
    measured: Sequence[Measurement],
    signal: Signal,
    settings: SnapshotSettings,
    mirror_hz: float | None,
    seconds: float,
    elevation_rad: Mapping[int, float] | None = None,
) -> list[CodePhase]:
    chip_m = SPEED_OF_LIGHT_MPS / signal.id.chip_rate_hz
    codes = []
    for one in measured:
        # Closer to the mirror than the snapshot resolves, signal and image draw each other there.
        drawn_hz = 0.0
        if mirror_hz is not None and abs(one.doppler_hz - mirror_hz) < 1.5 / seconds:
            drawn_hz = 1.0 / seconds
        sine = 1.0
        if elevation_rad is not None:
            sine = math.sin(max(elevation_rad[one.prn], _LOWEST_RAD))
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


def _better(fix: SnapshotFix, other: SnapshotFix) -> bool:
    if fix.solution.valid != other.solution.valid:
        return fix.solution.valid
    used, others = len(fix.solution.used), len(other.solution.used)
    return fix.solution.valid and (used > others or (used == others and fix.cost < other.cost))


# --- mirrored Dopplers ---------------------------------------------------------------------------


def _dopplers(rates_mps: FloatArray, drift_sps: float, signal: Signal) -> FloatArray:
    """Dopplers against a sample clock that drifts, from pseudorange rates."""
    received = -rates_mps / SPEED_OF_LIGHT_MPS - drift_sps
    return np.asarray(received * signal.id.carrier_hz / (1.0 + drift_sps))


def _sides(
    found: Sequence[Measurement],
    known: dict[int, Ephemeris],
    signal: Signal,
    rough: Rough,
    mirror_hz: float | None,
) -> Iterator[list[Measurement]]:
    """Measurements with each Doppler on its likely side of the mirror, likeliest first."""
    if mirror_hz is None or len(found) < 2:
        yield list(found)
        return
    doppler_hz = np.array([one.doppler_hz for one in found])
    both = np.stack([doppler_hz, 2.0 * mirror_hz - doppler_hz])
    ephemerides = [known[one.prn] for one in found]
    ranked = []
    for place in _places(rough):
        expected_hz = _expected(ephemerides, rough.time, place, signal)
        tolerance_hz = 1000.0 if rough.r_e_m is None else 50.0 + rough.position_sigma_m * 1e-3
        ranked.append(_choose(both, expected_hz, tolerance_hz, rough, signal))
    ranked.sort(key=lambda entry: entry[0])
    seen: set[tuple[int, ...]] = set()
    for _, side in ranked:
        if side not in seen:
            seen.add(side)
            chosen = both[list(side), np.arange(len(found))]
            yield [
                replace(one, doppler_hz=float(hz)) for one, hz in zip(found, chosen, strict=True)
            ]
        if len(seen) >= _SIGN_SETS:
            return


def _places(rough: Rough) -> Iterator[FloatArray]:
    if rough.r_e_m is not None:
        yield rough.r_e_m
        return
    golden = math.pi * (3.0 - math.sqrt(5.0))
    for n in range(_PLACES):
        yield ecef(math.asin(1.0 - (2 * n + 1) / _PLACES), n * golden, 0.0)


def _expected(
    ephemerides: Sequence[Ephemeris], time: GpsTime, place: FloatArray, signal: Signal
) -> FloatArray:
    at = orbits.predict(ephemerides, time, place, np.zeros(3))
    doppler_hz = _dopplers(at.pseudorange_rate_mps, 0.0, signal)
    doppler_hz[at.elevation_rad < _BELOW_HORIZON_RAD] = np.nan
    return doppler_hz


def _choose(
    both: FloatArray, expected_hz: FloatArray, tolerance_hz: float, rough: Rough, signal: Signal
) -> tuple[float, tuple[int, ...]]:
    """Sides that agree best on one offset of the oscillator, with their cost."""
    offsets = both - expected_hz
    centre_hz = -rough.drift_sps * signal.id.carrier_hz
    reach_hz = 4.0 * rough.drift_sigma_sps * signal.id.carrier_hz
    trials = offsets[np.isfinite(offsets) & (np.abs(offsets - centre_hz) < reach_hz)]
    if trials.size == 0:
        return math.inf, (0,) * both.shape[1]
    misfit = np.abs(offsets[np.newaxis] - trials[:, np.newaxis, np.newaxis]) / tolerance_hz
    misfit = np.where(np.isfinite(misfit), misfit, 10.0)  # below the horizon
    cost = (np.minimum(misfit.min(axis=1), 3.0) ** 2).sum(axis=1)
    best = int(cost.argmin())
    return float(cost[best]), tuple(int(side) for side in misfit[best].argmin(axis=0))
