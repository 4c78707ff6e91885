"""Acquisition (SPEC 5): FFT parallel code search, cold or in a predicted window.

`acquisition_grid` finds the highest cell; here it is judged, refined to a fraction of a Doppler
bin and of a chip, and compared with what stronger satellites leave in other satellites' codes.

Code phase runs forward with time and is that at the sample named `first`; Doppler is positive
when range shrinks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.fft

from deepgnss.core.jit import kernel
from deepgnss.core.records import ComplexArray, FloatArray, RunningSums
from deepgnss.receiver.acquisition_grid import (
    Complex64Array,
    GridSearch,
    Peak,
    Periods,
    Rows,
    SearchWindow,
    code_spectrum,
    cut,
    detection_threshold,
    doppler_groups,
    doppler_rows,
    period_cells,
    replica_cells,
)
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.symbols import fit_symbols

__all__ = [
    "Acquisition",
    "AcquisitionSettings",
    "SearchWindow",
    "cold_search",
    "cross_power",
    "search",
    "search_windows",
]

_LEAK_AMPLITUDE = 3.0  # over noise, of what a signal of 52 dB-Hz leaves in other codes …
_LEAK_S = 0.01  # … in a coherent block of this length
_RELATIVE_FALSE_ALARM = 1e-6  # noise must not explain satellites away
_CALM_S = 0.01  # length of a symbol that two coherent blocks may straddle
_TAP_CELLS = 2.0  # early and late, half a chip off


@dataclass(frozen=True, slots=True)
class AcquisitionSettings:
    """What to search and how long.

    false_alarm: probability that the search of one absent satellite reports it found.
    """

    doppler_max_hz: float = 6000.0  # either side of the centre
    doppler_centre_hz: float = 0.0
    coherent_s: float = 0.010  # two blocks of 10 ms: at most one holds a bit edge
    noncoherent: int = 2
    false_alarm: float = 1e-3


@dataclass(frozen=True, slots=True)
class Acquisition:
    """Outcome of one satellite's search; of one not found, Doppler and code of its highest cell."""

    satellite: str
    prn: int
    first: int  # sample the code phase belongs to
    doppler_hz: float
    code_chips: float  # in [0, code length)
    peak_ratio: float  # power of the highest cell over the mean of noise
    threshold: float  # least ratio for `found`
    cn0_dbhz: float
    found: bool
    reason: str = ""  # why it is not found


# --- refinement ----------------------------------------------------------------------------------


@kernel
def steer(
    spectra: Complex64Array,
    code: Complex64Array,
    start: float,
    drift: float,
    offset: float,
    out: ComplexArray,
) -> None:
    """Correlations (periods, 3) at fractional cells: start + period·drift − offset, +0, +offset.

    The inverse transform of spectra (periods, cells) times code at three points only.
    """
    periods, cells = spectra.shape
    half = cells // 2
    unit = -2j * np.pi / cells
    lean = np.exp(unit * offset)
    for period in range(periods):
        at = start + period * drift
        turn = np.exp(unit * at)
        phase = np.exp(-unit * half * at)
        tilt = np.exp(-unit * half * offset)
        early = 0.0j
        prompt = 0.0j
        late = 0.0j
        for n in range(cells):
            k = n + cells - half if n < half else n - half
            value = spectra[period, k] * code[k] * phase
            prompt += value
            late += value * tilt
            early += value * tilt.conjugate()
            phase *= turn
            tilt *= lean
        out[period, 0] = early
        out[period, 1] = prompt
        out[period, 2] = late


def _taps(
    periods: Periods, blocks: Complex64Array, prn: int, doppler_hz: float, cell: float
) -> ComplexArray:
    """Early, prompt and late correlations of every period at exact Doppler, (periods, 3).

    The carrier is wiped off with its phase running on from period to period.
    """
    count, cells = blocks.shape
    turns = doppler_hz * periods.signal.period_s
    wipe = np.exp(-2j * np.pi * turns * np.arange(cells) / cells).astype(np.complex64)
    spectra = scipy.fft.fft(blocks * wipe)
    drift = turns * periods.cells_per_hz_s
    out = np.empty((count, 3), dtype=np.complex128)
    # The code stands half a drift further on in the middle of the first period.
    code = code_spectrum(periods.signal.id.name, prn, cells, cells)
    steer(spectra, code, cell + 0.5 * drift, drift, _TAP_CELLS, out)
    out *= np.exp(-2j * np.pi * turns * np.arange(count))[:, np.newaxis]
    return out


class _Refined(NamedTuple):
    """Where a peak stands."""

    doppler_hz: float
    code_chips: float
    cn0_dbhz: float


def _refine(periods: Periods, prn: int, peak: Peak, coherent: int) -> _Refined:
    """Fractions of Doppler bin and chip, and the strength, from the highest cell on."""
    signal = periods.signal
    chip = periods.cells / signal.id.code_chips
    blocks, start = periods.aligned(peak.cell)
    doppler_hz, cell = peak.doppler_hz, float(peak.cell + start)
    # A change of sign in a block moves the highest row; from period to period Doppler is known
    # modulo 1 kHz only.
    span_hz = min(0.75 / coherent, 0.35) / signal.period_s
    times_s = np.arange(float(len(blocks))) * signal.period_s
    for _ in range(2):
        taps = _taps(periods, blocks, prn, doppler_hz, cell)
        fit = fit_symbols(taps[:, 1], times_s, signal.secondary, span_hz)
        symbols = np.add.reduceat(fit.strip(taps, times_s), fit.starts, axis=0)
        early, _, late = (symbols * symbols[:, 1:2].conj()).real.sum(axis=0)
        cell += float(np.clip((late - early) / (late + early) * (chip - _TAP_CELLS), -1.0, 1.0))
        doppler_hz += fit.doppler_hz
        span_hz = 0.125 / signal.symbol_s
    lengths = np.diff(np.append(fit.starts, len(taps)))
    noise = peak.noise / len(taps)  # of one period
    power = float(np.vdot(symbols[:, 1], symbols[:, 1]).real)
    snr = max(power / noise - len(taps), 1e-3) / float(lengths @ lengths)
    cell -= start * (1.0 + doppler_hz / signal.id.carrier_hz)
    return _Refined(doppler_hz, _code_chips(periods, cell), 10.0 * np.log10(snr / signal.period_s))


def _unrefined(periods: Periods, peak: Peak, coherent: int) -> _Refined:
    """The highest cell as it stands, good enough for what is not found."""
    snr = max(peak.ratio - 1.0, 1e-3) / (coherent * periods.signal.period_s)
    return _Refined(peak.doppler_hz, _code_chips(periods, peak.cell), 10.0 * np.log10(snr))


def _code_chips(periods: Periods, cell: float) -> float:
    length = periods.signal.id.code_chips
    return (cell * length / periods.cells + periods.half_sample_chips) % length


# --- searches ------------------------------------------------------------------------------------


def _grid_hz(settings: AcquisitionSettings, window: SearchWindow | None) -> FloatArray:
    step_hz = 0.5 / settings.coherent_s
    centre_hz = settings.doppler_centre_hz if window is None else window.doppler_hz
    half_hz = settings.doppler_max_hz if window is None else window.doppler_half_hz
    # On whole steps: within a code period only half bins are mixed exactly.
    low, high = (centre_hz - half_hz) / step_hz, (centre_hz + half_hz) / step_hz
    steps = np.arange(np.floor(low + 1e-9), np.ceil(high - 1e-9) + 1)
    return np.asarray(steps * step_hz, dtype=np.float64)


def _search_all(
    periods: Periods,
    prns: Sequence[int],
    settings: AcquisitionSettings,
    dopplers_hz: FloatArray,
    window: SearchWindow | None,
    executor: Executor | None,
) -> list[Acquisition]:
    signal = periods.signal
    coherent = round(settings.coherent_s / signal.period_s)
    searches = [
        GridSearch(periods, prn, dopplers_hz.size, settings.coherent_s, window) for prn in prns
    ]
    apply = map if executor is None else executor.map
    groups_hz = doppler_groups(periods, dopplers_hz)
    blocks = periods.samples.shape[0] // coherent
    largest = blocks * max(group_hz.size for group_hz in groups_hz) * periods.window
    spare: list[Complex64Array] = []  # to work in: pages let go and asked for anew take their time

    def through(group_hz: FloatArray) -> list[Rows]:
        try:
            whole = spare.pop()
        except IndexError:
            whole = np.empty(2 * largest, dtype=np.complex64)
        shape = (2, blocks, group_hz.size, periods.window)
        space = whole[: math.prod(shape)].reshape(shape)
        rows = doppler_rows(periods, group_hz, coherent, space)
        found = [search.through(group_hz, rows, space[1]) for search in searches]
        spare.append(whole)
        return found

    groups = list(apply(through, groups_hz))

    def conclude(search: GridSearch, rows: Sequence[Rows]) -> Acquisition:
        peak = search.peak(rows, settings.noncoherent)
        threshold = detection_threshold(settings.false_alarm, peak.cells, settings.noncoherent)
        found = peak.ratio > threshold
        place = (
            _refine(periods, search.prn, peak, coherent)
            if found
            else _unrefined(periods, peak, coherent)
        )
        return Acquisition(
            satellite=signal.satellite(search.prn),
            prn=search.prn,
            first=periods.first,
            doppler_hz=place.doppler_hz,
            code_chips=place.code_chips,
            peak_ratio=peak.ratio,
            threshold=threshold,
            cn0_dbhz=place.cn0_dbhz,
            found=found,
            reason="" if found else f"peak {peak.ratio:.2f} × noise, {threshold:.2f} needed",
        )

    return list(apply(conclude, searches, zip(*groups, strict=True)))


def _cut(sums: RunningSums, first: int, signal: Signal, settings: AcquisitionSettings) -> Periods:
    coherent = round(settings.coherent_s / signal.period_s)
    padded = changes_often(signal)
    return cut(sums, first, signal, coherent * settings.noncoherent, padded=padded)


def changes_often(signal: Signal) -> bool:
    """Whether the sign changes too often for two blocks of which one is free of it."""
    return bool(signal.secondary_code) or signal.symbol_s < _CALM_S


def _suited(settings: AcquisitionSettings, signal: Signal) -> AcquisitionSettings:
    """The settings, with as long sums over single code periods where signs change often."""
    if not changes_often(signal):
        return settings
    seconds = settings.coherent_s * settings.noncoherent
    return replace(
        settings, coherent_s=signal.period_s, noncoherent=round(seconds / signal.period_s)
    )


def search(
    sums: RunningSums,
    first: int,
    signal: Signal,
    prn: int,
    settings: AcquisitionSettings,
    window: SearchWindow | None = None,
    executor: Executor | None = None,
) -> Acquisition:
    """Search one satellite from sample `first` on, everywhere or in a predicted window only.

    Raises ValueError when the sums do not cover coherent × non-coherent time from `first` on.
    """
    settings = _suited(settings, signal)
    periods = _cut(sums, first, signal, settings)
    return _search_all(periods, [prn], settings, _grid_hz(settings, window), window, executor)[0]


def search_windows(
    sums: RunningSums,
    first: int,
    signal: Signal,
    windows: Mapping[int, SearchWindow],
    settings: AcquisitionSettings,
    executor: Executor | None = None,
) -> list[Acquisition]:
    """Search satellites from sample `first` on, each in its window, in the order of `windows`.

    The samples' spectra are made once for all.
    """
    if not windows:
        return []
    settings = _suited(settings, signal)
    periods = _cut(sums, first, signal, settings)

    def one(prn: int) -> Acquisition:
        window = windows[prn]
        (seen,) = _search_all(periods, [prn], settings, _grid_hz(settings, window), window, None)
        return seen

    return list(map(one, windows) if executor is None else executor.map(one, windows))


def cold_search(
    sums: RunningSums,
    first: int,
    signal: Signal,
    settings: AcquisitionSettings,
    prns: Sequence[int] | None = None,
    executor: Executor | None = None,
) -> list[Acquisition]:
    """Search satellites (default: all of the signal) from sample `first` on, in PRN order.

    Peaks that are cross-correlations of stronger satellites are not reported found. The result
    is the same with or without an executor.
    """
    settings = _suited(settings, signal)
    periods = _cut(sums, first, signal, settings)
    dopplers_hz = _grid_hz(settings, None)
    wanted = prns or signal.prns
    results = _search_all(periods, wanted, settings, dopplers_hz, None, executor)
    screened = _screen(results, signal, settings)
    rows_hz = _suspicious_rows(screened, signal, settings, dopplers_hz)
    if rows_hz.size == 0 or not signal.relatives:
        return screened
    clear = replace(settings, false_alarm=_RELATIVE_FALSE_ALARM)
    relatives = _search_all(periods, signal.relatives, clear, rows_hz, None, executor)
    return _screen([*results, *relatives], signal, settings)[: len(results)]


# --- cross-correlation ---------------------------------------------------------------------------


def cross_power(signal: Signal, strong: Acquisition, weak: Acquisition, coherent_s: float) -> float:
    """Power a strong satellite leaves in the cell of another, relative to its own peak.

    Large only where the Dopplers agree modulo the code repetition rate, 1 kHz for C/A.
    """
    cells = period_cells(signal)
    turns = (strong.doppler_hz - weak.doppler_hz) * signal.period_s
    replicas = [
        np.roll(
            replica_cells(signal.id.name, one.prn, cells),
            -round(one.code_chips * cells / signal.id.code_chips),
        )
        for one in (strong, weak)
    ]
    turning = np.exp(2j * np.pi * turns * np.arange(cells) / cells)
    within = np.mean(replicas[0] * replicas[1] * turning)
    coherent = round(coherent_s / signal.period_s)
    between = np.mean(np.exp(2j * np.pi * turns * np.arange(coherent)))
    return float(abs(within * between) ** 2)


def _suspicious_rows(
    results: Sequence[Acquisition],
    signal: Signal,
    settings: AcquisitionSettings,
    dopplers_hz: FloatArray,
) -> FloatArray:
    """Dopplers at which another code could cause the weak ones of the satellites found."""
    leak = _LEAK_AMPLITUDE * np.sqrt(settings.coherent_s / _LEAK_S)
    step_hz = dopplers_hz[1] - dopplers_hz[0] if dopplers_hz.size > 1 else 0.0
    chosen = np.zeros(dopplers_hz.size, dtype=bool)
    for one in results:
        if one.found and np.sqrt(one.peak_ratio) < np.sqrt(one.threshold) + leak:
            apart = (dopplers_hz - one.doppler_hz) * signal.period_s
            chosen |= np.abs(apart - np.rint(apart)) < 1.01 * step_hz * signal.period_s
    return dopplers_hz[chosen]


def _screen(
    results: Sequence[Acquisition], signal: Signal, settings: AcquisitionSettings
) -> list[Acquisition]:
    """Reject what stronger satellites explain: the rest of the amplitude must pass by itself."""
    real: list[Acquisition] = []
    rejected: dict[int, Acquisition] = {}
    for one in sorted(results, key=lambda one: -one.peak_ratio):
        if not one.found:
            continue
        leaks = [
            strong.peak_ratio * cross_power(signal, strong, one, settings.coherent_s)
            for strong in real
        ]
        own = max(np.sqrt(one.peak_ratio) - np.sqrt(sum(leaks)), 0.0) ** 2
        if own > one.threshold:
            real.append(one)
        else:
            source = real[int(np.argmax(leaks))].satellite
            reason = f"cross-correlation of {source}"
            rejected[one.prn] = replace(one, found=False, reason=reason)
    return [rejected.get(one.prn, one) for one in results]
