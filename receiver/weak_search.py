"""Search of predicted satellites too weak for the usual one: seconds of samples, symbol by symbol.

Where time and place are known, so are symbol edges, secondary code, and Doppler and code phase but
for a small window. So the code is correlated period by period, and only cells of the window are
kept; whole symbols of them add up coherently at every Doppler of the window, and the symbols as
powers, over as many seconds as it takes. Samples are resampled at the pace of the predicted code,
which stands still then; a Doppler rate is taken off on the way.

The search goes back from a sample: it uses what went by before, and says what is there now.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.special
from numpy.typing import NDArray

from deepgnss.core.records import ComplexArray, FloatArray, RunningSums
from deepgnss.receiver.acquisition import Acquisition, cross_power
from deepgnss.receiver.acquisition_grid import (
    LEAK_PEAK,
    Complex64Array,
    SearchWindow,
    code_spectrum,
    detection_threshold,
    line_weights,
    mirror_frequency_hz,
    period_cells,
)
from deepgnss.receiver.baseband import resample
from deepgnss.receiver.signals import Signal

_CHUNK_S = 0.1  # of samples at a time: memory does not grow with the search
_MARGIN_S = 0.002  # of samples on both sides of a chunk
_REFERENCES = 256  # cells outside the window that tell the noise
_DRIFT_CHIPS = 0.25  # of the code over a search, at the edge of the Dopplers resampled as one
_WIDEST_HZ = 250.0  # … and where a code period loses 1 dB
_TAP_CELLS = 2
_SPREAD_CELLS = 4.0  # cells of one peak: neighbours are not independent
_FINE = 8  # steps within a row to refine the Doppler in


@dataclass(frozen=True, slots=True)
class WeakSettings:
    """How long, and what motion may do meanwhile."""

    length_s: float = 1.0
    false_alarm: float = 1e-3
    rate_hzps: float = 0.0  # Dopplers may change by up to this beside what is predicted


class Aim(NamedTuple):
    """Where a satellite is predicted, at the sample the search goes back from."""

    window: SearchWindow
    period: int  # number of the code period going by at the window's centre; symbols start at 0
    rate_hzps: float = 0.0  # of Doppler


ReadSums = Callable[[int, int], RunningSums]
"""Running sums of samples [first, first + count)."""


def needed_samples(signal: Signal, settings: WeakSettings, sample_rate_hz: float) -> int:
    """Samples before the present one that a search reads at most."""
    seconds = settings.length_s + signal.symbol_s + 2.0 * _MARGIN_S
    return math.ceil(seconds * sample_rate_hz) + 2


def weak_search(
    read: ReadSums,
    now: int,
    signal: Signal,
    prn: int,
    aim: Aim,
    settings: WeakSettings,
    sample_rate_hz: float,
    strong: Sequence[Acquisition] = (),
    executor: Executor | None = None,
) -> Acquisition:
    """Search a satellite on the samples before `now`; code phase and Doppler are those at `now`.

    Parameters: strong, satellites tracked at `now`, `peak_ratio` being what they have in one code
    period: what their codes leave in the searched one's is no detection.
    """
    best: _Peak | None = None
    rows = cells = 0
    for centre_hz, row_hz in _bands(signal, aim.window, settings):
        strip = _correlate(
            read, now, signal, prn, aim, settings, sample_rate_hz, centre_hz, executor
        )
        for rate_hzps in _rates(signal, aim, settings):
            peak = _highest(strip, signal, row_hz, rate_hzps)
            rows, cells = rows + row_hz.size, strip.window_cells.size
            if best is None or peak.ratio > best.ratio:
                best = peak
    if best is None:
        raise ValueError(f"a search of {settings.length_s} s holds no symbol")
    threshold = detection_threshold(settings.false_alarm, rows * cells, best.blocks)
    place = _refined(best, signal)
    seen = Acquisition(
        satellite=signal.satellite(prn),
        prn=prn,
        first=now,
        doppler_hz=place.doppler_hz,
        code_chips=(aim.window.code_chips + place.offset_chips) % signal.id.code_chips,
        peak_ratio=best.ratio,
        threshold=threshold,
        cn0_dbhz=place.cn0_dbhz,
        found=best.ratio > threshold,
        reason=""
        if best.ratio > threshold
        else f"peak {best.ratio:.2f} × noise, {threshold:.2f} needed",
    )
    return _unless_leak(seen, signal, strong) if seen.found else seen


def _bands(
    signal: Signal, window: SearchWindow, settings: WeakSettings
) -> Iterator[tuple[float, FloatArray]]:
    """Dopplers that are resampled as one: their middle, and the rows half a bin apart."""
    drift_hz = 0.5 * _DRIFT_CHIPS * signal.carrier_to_code / settings.length_s
    half_hz = min(_WIDEST_HZ, drift_hz)
    step_hz = 0.5 / signal.symbol_s
    count = 2 * math.ceil(window.doppler_half_hz / step_hz) + 1
    rows_hz = window.doppler_hz + step_hz * (np.arange(count) - count // 2)
    bands = min(count, math.ceil(count * step_hz / (2.0 * half_hz)))
    for band in np.array_split(rows_hz, bands):
        yield 0.5 * float(band[0] + band[-1]), band


def _rates(signal: Signal, aim: Aim, settings: WeakSettings) -> FloatArray:
    """Doppler rates to try: a row blurs by no more than half a bin over the search."""
    step_hzps = 1.0 / (signal.symbol_s * settings.length_s)
    each_side = math.ceil(settings.rate_hzps / step_hzps - 0.5) if settings.rate_hzps else 0
    return np.asarray(aim.rate_hzps + step_hzps * np.arange(-each_side, each_side + 1))


# --- correlations --------------------------------------------------------------------------------


class _Strip(NamedTuple):
    """Correlations of all code periods in the window's cells, and in others for the noise."""

    window: ComplexArray  # (periods, window cells), the secondary code and the centre taken off
    others: ComplexArray  # (periods, cells)
    times_s: FloatArray  # middles of the periods, from `now` on: negative
    window_cells: NDArray[np.int64]  # code phase beyond the predicted one
    chip_cells: float
    centre_hz: float
    code_hz: float  # Doppler whose code stands still
    mirror_hz: float | None


def _correlate(
    read: ReadSums,
    now: int,
    signal: Signal,
    prn: int,
    aim: Aim,
    settings: WeakSettings,
    sample_rate_hz: float,
    centre_hz: float,
    executor: Executor | None,
) -> _Strip:
    length, cells, size = signal.id.code_chips, period_cells(signal), signal.symbol_periods
    middle_hz = centre_hz - 0.5 * aim.rate_hzps * settings.length_s
    stretch = 1.0 + middle_hz / signal.id.carrier_hz
    period_s = signal.period_s / stretch
    # From `now` back to the end of the last whole symbol, and on to the start of the first.
    behind = aim.period % size + aim.window.code_chips % length / length
    periods = max(0, math.floor(settings.length_s / signal.symbol_s)) * size
    start_s = -(behind + periods) * period_s
    # Output m of the resampling begins half a sample before the one it is asked for.
    start = now + start_s * sample_rate_hz + 0.5
    code = code_spectrum(signal.id.name, prn, cells, cells)
    chip_cells = cells / length
    half = min(math.ceil(aim.window.code_half_chips * chip_cells), (cells - 1) // 2)
    offsets = np.arange(-half, half + 1)
    free = np.setdiff1d(np.arange(cells), np.arange(-half - 8, half + 9) % cells)
    others = free[:: max(1, free.size // _REFERENCES)]
    columns = np.concatenate([offsets % cells, others])
    wipe = np.exp(
        -2j * np.pi * centre_hz * period_s * ((np.arange(cells) + 0.5) / cells - 0.5)
    ).astype(np.complex64)
    rate_hz = cells / period_s
    per_chunk = max(1, round(_CHUNK_S / signal.period_s))

    def chunk(first: int) -> tuple[Complex64Array, float | None]:
        """Correlations of the periods from `first` on; the first chunk tells of the mirror."""
        count = min(per_chunk, periods - first)
        begin = start + first * period_s * sample_rate_hz
        low = math.floor(begin - _MARGIN_S * sample_rate_hz)
        high = math.ceil(begin + (count * period_s + _MARGIN_S) * sample_rate_hz)
        sums = read(max(low, 0), min(high, now) - max(low, 0))
        flat = resample(sums, begin, rate_hz, count * cells).reshape(count, cells)
        mirror_hz = mirror_frequency_hz(flat.ravel(), rate_hz) if first == 0 else None
        flat *= wipe
        spectra: Complex64Array = scipy.fft.fft(flat, overwrite_x=True)
        spectra *= line_weights(spectra)
        spectra *= code
        return scipy.fft.fft(spectra, overwrite_x=True)[:, columns], mirror_hz

    firsts = range(0, periods, per_chunk)
    chunks = list(map(chunk, firsts) if executor is None else executor.map(chunk, firsts))
    taken = np.concatenate([values for values, _ in chunks], dtype=np.complex128)
    times_s: FloatArray = start_s + (np.arange(periods, dtype=np.float64) + 0.5) * period_s
    signs = np.tile(signal.secondary, periods // size)
    taken *= (np.exp(-2j * np.pi * np.mod(centre_hz * times_s, 1.0)) * signs)[:, np.newaxis]
    return _Strip(
        taken[:, : offsets.size],
        taken[:, offsets.size :],
        times_s,
        offsets,
        chip_cells,
        centre_hz,
        middle_hz,
        chunks[0][1],
    )


# --- the peak ------------------------------------------------------------------------------------


class _Peak(NamedTuple):
    """The highest cell of one strip at one Doppler rate."""

    strip: _Strip
    rate_hzps: float
    doppler_hz: float
    column: int
    ratio: float  # power over noise, less what other signals in its row may have added
    noise: float  # mean power of a symbol's sum
    blocks: int


def _powers(
    values: ComplexArray,
    times_s: FloatArray,
    symbol_periods: int,
    turn_hz: FloatArray,
    rate_hzps: float,
) -> FloatArray:
    """Powers of whole symbols summed up, (Dopplers, cells); turn_hz counts from the centre."""
    chirp = np.exp(-1j * np.pi * rate_hzps * times_s**2)
    blocks = (values * chirp[:, np.newaxis]).reshape(-1, symbol_periods, values.shape[1])
    weights = np.exp(-2j * np.pi * np.outer(turn_hz, times_s[:symbol_periods] - times_s[0]))
    sums = weights @ blocks
    return np.asarray((sums.real**2 + sums.imag**2).sum(axis=0), dtype=np.float64)


def _highest(strip: _Strip, signal: Signal, row_hz: FloatArray, rate_hzps: float) -> _Peak:
    size = signal.symbol_periods
    blocks = strip.times_s.size // size
    turn_hz = row_hz - strip.centre_hz
    outside = _powers(strip.others, strip.times_s, size, turn_hz, rate_hzps)
    noise = float(np.median(outside)) / float(scipy.special.gammaincinv(blocks, 0.5))
    noise = max(noise, float(np.finfo(np.float64).tiny))  # a recording of zeros
    power = _powers(strip.window, strip.times_s, size, turn_hz, rate_hzps) / (noise * blocks)
    # As in the usual search: signals with like codes raise a whole row.
    excess = outside.mean(axis=1) / (noise * blocks) - 1.0
    excess -= 3.0 * math.sqrt(_SPREAD_CELLS / (outside.shape[1] * blocks))
    leaks = LEAK_PEAK * np.maximum(excess, 0.0)[:, np.newaxis]
    ratios = np.maximum(np.sqrt(power) - np.sqrt(leaks), 0.0) ** 2
    if strip.mirror_hz is not None:
        ratios[abs(row_hz - strip.mirror_hz) < 0.6 / signal.symbol_s] *= 0.5
    row, column = np.unravel_index(int(ratios.argmax()), ratios.shape)
    return _Peak(
        strip, rate_hzps, float(row_hz[row]), int(column), float(ratios[row, column]), noise, blocks
    )


class _Refined(NamedTuple):
    """Where a peak stands."""

    doppler_hz: float
    offset_chips: float  # beyond the window's centre
    cn0_dbhz: float


def _refined(peak: _Peak, signal: Signal) -> _Refined:
    """Fractions of row and cell, and the strength."""
    strip, size = peak.strip, signal.symbol_periods
    column = min(max(peak.column, _TAP_CELLS), strip.window_cells.size - 1 - _TAP_CELLS)
    taps = strip.window[:, [column - _TAP_CELLS, column, column + _TAP_CELLS]]
    step_hz = 0.5 / signal.symbol_s / _FINE
    dopplers_hz: FloatArray = peak.doppler_hz + step_hz * np.arange(-_FINE, _FINE + 1.0)
    power = _powers(taps, strip.times_s, size, dopplers_hz - strip.centre_hz, peak.rate_hzps)
    row = int(np.clip(power[:, 1].argmax(), 1, dopplers_hz.size - 2))
    left, mid, right = power[row - 1 : row + 2, 1]
    curvature = left - 2.0 * mid + right
    lean = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    own = np.sqrt(np.maximum(power[row] - peak.noise * peak.blocks, 0.0))
    late, prompt, early = own
    offset = 0.0
    if early + late > 0.0:
        offset = (early - late) / (early + late) * (strip.chip_cells - _TAP_CELLS)
    offset = min(max(offset, -float(_TAP_CELLS)), float(_TAP_CELLS))
    amplitude = prompt / (1.0 - abs(offset) / strip.chip_cells)
    snr = max(amplitude**2 / (peak.noise * peak.blocks), 1e-3)
    doppler_hz = float(dopplers_hz[row]) + min(max(lean, -1.0), 1.0) * step_hz
    # The samples tell the code phase in the middle; the code moves on against the resampled one.
    since_s = -0.5 * float(strip.times_s[0] + strip.times_s[-1])
    moving_hz = doppler_hz - peak.rate_hzps * since_s - strip.code_hz
    return _Refined(
        float(doppler_hz),
        (float(strip.window_cells[column]) + offset) / strip.chip_cells
        + moving_hz * since_s / signal.carrier_to_code,
        10.0 * math.log10(snr / signal.symbol_s),
    )


def _unless_leak(seen: Acquisition, signal: Signal, strong: Sequence[Acquisition]) -> Acquisition:
    """The detection, unless stronger satellites' codes explain it."""
    others = [one for one in strong if one.prn != seen.prn]
    leaks = [
        one.peak_ratio * signal.symbol_periods * cross_power(signal, one, seen, signal.symbol_s)
        for one in others
    ]
    own = max(math.sqrt(seen.peak_ratio) - math.sqrt(sum(leaks)), 0.0) ** 2
    if own > seen.threshold:
        return seen
    source = others[int(np.argmax(leaks))].satellite
    return replace(seen, found=False, reason=f"cross-correlation of {source}")
