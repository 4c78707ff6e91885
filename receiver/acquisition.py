"""Acquisition (SPEC 5): FFT parallel code search, cold or in a predicted window.

Samples are resampled to about four per chip from the running sum, so that the cost does not
depend on the sampling rate, and cut into code periods whose spectra serve all satellites. A
Doppler row is their phase-aligned sum over one coherent block: whole kHz by shifting the spectra,
half a kHz by a rotated second set, the rest by the phase from period to period (the slow-time
transform, taken before the inverse FFT because both are linear: once for all satellites). Rows of
several blocks are aligned for code Doppler and add up in power.

Code phase runs forward with time and is that at the sample named `first`; Doppler is positive
when range shrinks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.special
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import ComplexArray, FloatArray, RunningSums
from deepgnss.receiver.baseband import resample
from deepgnss.receiver.signals import SIGNALS, Signal

Complex64Array = NDArray[np.complex64]

_CELLS_PER_CHIP = 4
_NOISE_CELLS = 2**15  # cells whose median gives the noise floor
# Neighbouring cells of the grid (quarter chip, half a Doppler bin) share noise: as far as high
# maxima go, this share of them counts as independent (measured; the tests hold it).
_INDEPENDENT_SHARE = 0.6
_LINE_STRETCH = 64  # cells of spectrum a carrier is compared with
_LINE_CHANCE = 1e-4  # share of the spectrum given up where there is none
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


class SearchWindow(NamedTuple):
    """Where a satellite is predicted: centre and half width of Doppler and code phase."""

    doppler_hz: float
    doppler_half_hz: float
    code_chips: float  # at the first sample of the search
    code_half_chips: float


@dataclass(frozen=True, slots=True)
class Acquisition:
    """Outcome of one satellite's search."""

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


class _Peak(NamedTuple):
    """Highest cell of a search; powers are sums over all blocks."""

    doppler_hz: float
    cell: int
    ratio: float  # power over the noise of its Doppler row
    noise: float  # mean power of a cell of all rows without signal
    cells: int  # searched


# --- spectra shared by all satellites ------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Periods:
    """The samples of a search, cut into code periods of `cells` each.

    samples: (periods, cells); spectra: (2, periods, cells), the second after mixing by half a bin.
    """

    signal: Signal
    first: int
    half_sample_chips: float
    samples: Complex64Array
    spectra: Complex64Array

    @property
    def cells(self) -> int:
        return self.samples.shape[1]

    @property
    def cells_per_hz_s(self) -> float:
        """Code drift per Hz of Doppler and second, cells."""
        return self.cells / (self.signal.id.code_chips * self.signal.carrier_to_code)


def _cells(signal: Signal) -> int:
    return scipy.fft.next_fast_len(_CELLS_PER_CHIP * signal.id.code_chips)  # type: ignore[no-any-return]


def _cut(sums: RunningSums, first: int, signal: Signal, periods: int) -> _Periods:
    cells = _cells(signal)
    rate_hz = cells / signal.period_s
    entries_per_cell = sums.sample_rate_hz / (rate_hz * sums.step)
    start = (first - sums.first) / sums.step
    there = int((sums.packed.size - 2 - start) / entries_per_cell)
    lacking = periods * cells - there
    # The last few cells of a recording may lack the entry behind them: they count as zero.
    if start < 0 or lacking > _CELLS_PER_CHIP:
        raise ValueError(
            f"search of {periods} code periods from sample {first} on exceeds the samples at hand "
            f"({sums.first} to {sums.first + (sums.packed.size - 1) * sums.step})"
        )
    flat = np.zeros(periods * cells, dtype=np.complex64)
    count = min(there, flat.size)
    flat[:count] = resample(sums, first, rate_hz, count)
    spectra = scipy.fft.fft(flat.reshape(periods, cells))
    spectra *= _line_weights(spectra)
    samples = np.asarray(scipy.fft.ifft(spectra))
    half_bin = np.exp(-1j * np.pi * np.arange(cells) / cells).astype(np.complex64)
    spectra = np.stack([spectra, scipy.fft.fft(samples * half_bin)])
    half_sample_chips = 0.5 * signal.id.chip_rate_hz / sums.sample_rate_hz
    return _Periods(signal, first, half_sample_chips, samples, spectra)


def _line_weights(spectra: Complex64Array) -> NDArray[np.float32]:
    """Weights over frequency that take out carriers: DC offset, spurs of the receiver, jammers.

    Lines stand far above the noise around them once all periods are summed; satellites do not.
    """
    periods, cells = spectra.shape
    power = (spectra.real**2 + spectra.imag**2).sum(axis=0)
    stretches = cells // _LINE_STRETCH
    levels = np.median(power[: stretches * _LINE_STRETCH].reshape(stretches, -1), axis=1)
    levels *= periods / scipy.special.gammaincinv(periods, 0.5)
    centres = (np.arange(stretches) + 0.5) * _LINE_STRETCH
    floor = np.interp(np.arange(cells), centres, levels, period=cells)
    limit = scipy.special.gammainccinv(periods, _LINE_CHANCE) / periods
    weights = np.where(power > limit * floor, floor / power, 1.0)
    return weights.astype(np.float32)


@cache
def _replica(signal_name: str, prn: int, cells: int) -> FloatArray:
    """One code period in cells, each the mean of the chips it covers."""
    code = SIGNALS[signal_name].primary_code(prn).astype(np.float64)
    integral = np.concatenate([[0.0], np.cumsum(code)])
    edges = np.linspace(0.0, code.size, cells + 1)
    replica: FloatArray = np.diff(np.interp(edges, np.arange(code.size + 1), integral))
    replica *= cells / code.size
    replica.flags.writeable = False
    return replica


@cache
def _code_spectrum(signal_name: str, prn: int, cells: int) -> Complex64Array:
    """Conjugate spectrum of the replica.

    The forward FFT of a data spectrum times this has the correlation at code phase s in cell s.
    """
    spectrum = np.conj(scipy.fft.fft(_replica(signal_name, prn, cells))).astype(np.complex64)
    spectrum.flags.writeable = False
    return spectrum


def _doppler_rows(
    periods: _Periods, dopplers_hz: FloatArray, coherent: int
) -> Iterator[tuple[FloatArray, Complex64Array]]:
    """Spectra of coherent blocks, (blocks, rows, cells), one group of Dopplers after another."""
    period_s = periods.signal.period_s
    blocks = periods.samples.shape[0] // coherent
    wavenumber = scipy.fft.fftfreq(periods.cells)
    half_bins = np.rint(2.0 * period_s * dopplers_hz).astype(np.int64)
    within = np.arange(coherent) * period_s
    middles = (np.arange(blocks) + 0.5) * coherent * period_s
    for half_bin in np.unique(half_bins):
        group = dopplers_hz[half_bins == half_bin]
        shift, half = divmod(int(half_bin), 2)
        source = periods.spectra[half].reshape(blocks, coherent, periods.cells)
        weights = np.exp(-2j * np.pi * group[:, np.newaxis] * within).astype(np.complex64)
        rows = np.roll(weights @ source, -shift, axis=2)
        # Where the code stands in the middle of each block, against that at the start.
        drift = middles * (0.5 * half_bin / period_s) * periods.cells_per_hz_s
        rows *= np.exp(-2j * np.pi * drift[:, np.newaxis] * wavenumber).astype(np.complex64)[
            :, np.newaxis
        ]
        yield group, rows


# --- the grid ------------------------------------------------------------------------------------


@kernel
def sum_power(correlations: Complex64Array, power: NDArray[np.float32], totals: FloatArray) -> None:
    """Power of (blocks, rows, cells) summed over blocks into (rows, cells), and over cells."""
    for row in range(power.shape[0]):
        for cell in range(power.shape[1]):
            value = correlations[0, row, cell]
            power[row, cell] = value.real * value.real + value.imag * value.imag
        for block in range(1, correlations.shape[0]):
            for cell in range(power.shape[1]):
                value = correlations[block, row, cell]
                power[row, cell] += value.real * value.real + value.imag * value.imag
        total = 0.0
        for cell in range(power.shape[1]):
            total += power[row, cell]
        totals[row] = total


class _GridSearch:
    """Highest cells and noise of one satellite's Doppler rows while they pass by."""

    def __init__(self, periods: _Periods, prn: int, rows: int, window: SearchWindow | None) -> None:
        self.prn = prn
        self._code = _code_spectrum(periods.signal.id.name, prn, periods.cells)
        self._stride = max(1, rows * periods.cells // _NOISE_CELLS) | 1
        self._noise: list[NDArray[np.float32]] = []
        self._allowed = np.arange(periods.cells)
        if window is not None:
            per_chip = periods.cells / periods.signal.id.code_chips
            centre = round((window.code_chips - periods.half_sample_chips) * per_chip)
            half = min(int(window.code_half_chips * per_chip) + 1, (periods.cells - 1) // 2)
            self._allowed = (centre + np.arange(-half, half + 1)) % periods.cells
        self._dopplers_hz: list[FloatArray] = []
        self._cells: list[NDArray[np.int64]] = []
        self._highest: list[NDArray[np.float32]] = []  # within the window
        self._means: list[FloatArray] = []  # of whole rows, without the share of their peak

    def add(self, dopplers_hz: FloatArray, rows: Complex64Array) -> None:
        """Search one group of Doppler rows."""
        correlations = scipy.fft.fft(rows * self._code, overwrite_x=True)
        power = np.empty(rows.shape[1:], dtype=np.float32)
        totals = np.empty(dopplers_hz.size)
        sum_power(correlations, power, totals)
        self._noise.append(power.reshape(-1)[:: self._stride].copy())
        searched = power
        if self._allowed.size < power.shape[1]:
            searched = np.ascontiguousarray(power[:, self._allowed])
        columns = searched.argmax(axis=1)
        self._dopplers_hz.append(dopplers_hz)
        self._cells.append(self._allowed[columns])
        self._highest.append(searched[np.arange(columns.size), columns])
        # Spectrum of |code|² by Parseval: a peak's triangle and side lobes, as cells of its height.
        spectrum = np.abs(self._code.astype(np.complex128)) ** 2
        own = spectrum.size * (spectrum**2).sum() / spectrum.sum() ** 2
        self._means.append((totals - own * power.max(axis=1)) / (power.shape[1] - own))

    def peak(self, blocks: int) -> _Peak:
        """The cell highest above the noise of its row.

        The noise floor is the median of all cells. Rows at whole kHz collect interference that
        repeats with the code, such as carriers: their own mean counts where it is higher.
        """
        median = float(np.median(np.concatenate(self._noise)))
        noise = median * blocks / float(scipy.special.gammaincinv(blocks, 0.5))
        ratios = np.concatenate(self._highest) / np.maximum(np.concatenate(self._means), noise)
        best = int(ratios.argmax())
        return _Peak(
            doppler_hz=float(np.concatenate(self._dopplers_hz)[best]),
            cell=int(np.concatenate(self._cells)[best]),
            ratio=float(ratios[best]),
            noise=noise,
            cells=ratios.size * self._allowed.size,
        )


def detection_threshold(false_alarm: float, cells: int, blocks: int) -> float:
    """Least ratio of a cell's power to the mean of noise for a detection.

    The sum of `blocks` powers of complex Gaussian noise follows a gamma distribution; the highest
    of `cells` cells exceeds the threshold with probability `false_alarm`.
    """
    independent = max(1.0, _INDEPENDENT_SHARE * cells)
    per_cell = -np.expm1(np.log1p(-false_alarm) / independent)
    return float(scipy.special.gammainccinv(blocks, per_cell)) / blocks


# --- refinement ----------------------------------------------------------------------------------


def _taps(
    periods: _Periods, prn: int, doppler_hz: float, cell: float, offsets: FloatArray
) -> ComplexArray:
    """Correlations of every period at exact Doppler and fractional cells, (periods, offsets).

    The carrier is wiped off with its phase running on from period to period.
    """
    count, cells = periods.samples.shape
    period_s = periods.signal.period_s
    turn = np.exp(-2j * np.pi * doppler_hz * period_s * np.arange(cells) / cells)
    spectra = scipy.fft.fft(periods.samples * turn.astype(np.complex64))
    spectra *= _code_spectrum(periods.signal.id.name, prn, cells)
    wavenumber = scipy.fft.fftfreq(cells)
    drift = doppler_hz * period_s * periods.cells_per_hz_s
    start = cell + 0.5 * drift  # where the code stands in the middle of the first period
    align = np.exp(-2j * np.pi * wavenumber * start)
    step = np.exp(-2j * np.pi * wavenumber * drift)
    taps = np.exp(-2j * np.pi * wavenumber[:, np.newaxis] * offsets).astype(np.complex64)
    aligned = np.empty_like(spectra)
    for n in range(count):
        aligned[n] = spectra[n] * align
        align *= step
    wipe = np.exp(-2j * np.pi * doppler_hz * period_s * np.arange(count))
    out: ComplexArray = (aligned @ taps) * wipe[:, np.newaxis]
    return out


class _Fit(NamedTuple):
    """Most likely Doppler and division of the periods into symbols."""

    power: float  # sum over symbols
    doppler_hz: float  # against the one wiped off
    starts: NDArray[np.int64]  # first period of every symbol


def _fit_doppler(prompt: ComplexArray, signal: Signal, span_hz: float) -> _Fit:
    """Most likely Doppler over all places the symbol edges may have.

    Symbols have unknown signs: each adds up coherently, their powers add.
    """
    count = prompt.size
    longest = min(count, signal.symbol_periods)
    step_hz = 0.125 / (longest * signal.period_s)
    reach = int(np.ceil(span_hz / step_hz)) + 1
    dopplers = np.arange(-reach, reach + 1) * step_hz
    turned = prompt * np.exp(
        -2j * np.pi * dopplers[:, np.newaxis] * signal.period_s * np.arange(count)
    )
    fits = []
    for edge in range(longest):
        starts = np.arange(edge, count, signal.symbol_periods)
        starts = np.union1d([0], starts)
        symbols = np.add.reduceat(turned, starts, axis=1)
        power = (symbols.real**2 + symbols.imag**2).sum(axis=1)
        top = int(power[1:-1].argmax()) + 1
        left, mid, right = power[top - 1 : top + 2]
        curvature = left - 2.0 * mid + right
        offset = 0.5 * (left - right) / curvature if curvature < 0.0 and mid >= left else 0.0
        doppler_hz = float(dopplers[top] + np.clip(offset, -1.0, 1.0) * step_hz)
        fits.append(_Fit(float(mid), doppler_hz, starts))
    return max(fits, key=lambda fit: fit.power)


def _refine(periods: _Periods, prn: int, peak: _Peak, coherent: int) -> tuple[float, float, float]:
    """Doppler in Hz, code phase in chips and C/N0 in dB-Hz from the highest cell on."""
    signal = periods.signal
    chip = periods.cells / signal.id.code_chips
    offsets = np.array([-_TAP_CELLS, 0.0, _TAP_CELLS])
    doppler_hz, cell = peak.doppler_hz, float(peak.cell)
    span_hz = 0.5 / (coherent * signal.period_s)
    for _ in range(2):
        taps = _taps(periods, prn, doppler_hz, cell, offsets)
        fit = _fit_doppler(taps[:, 1], signal, span_hz)
        turn = np.exp(-2j * np.pi * fit.doppler_hz * signal.period_s * np.arange(len(taps)))
        symbols = np.add.reduceat(taps * turn[:, np.newaxis], fit.starts, axis=0)
        early, _, late = (symbols * symbols[:, 1:2].conj()).real.sum(axis=0)
        cell += float(np.clip((late - early) / (late + early) * (chip - _TAP_CELLS), -1.0, 1.0))
        doppler_hz += fit.doppler_hz
        span_hz = 0.125 / signal.symbol_s
    lengths = np.diff(np.append(fit.starts, len(taps)))
    noise = peak.noise / len(taps)  # of one period
    snr = max(fit.power / noise - len(taps), 1e-3) / float(lengths @ lengths)
    cn0_dbhz = 10.0 * np.log10(snr / signal.period_s)
    code_chips = (cell / chip + periods.half_sample_chips) % signal.id.code_chips
    return doppler_hz, float(code_chips), float(cn0_dbhz)


# --- searches ------------------------------------------------------------------------------------


def _grid_hz(settings: AcquisitionSettings, window: SearchWindow | None) -> FloatArray:
    step_hz = 0.5 / settings.coherent_s
    centre_hz = settings.doppler_centre_hz if window is None else window.doppler_hz
    half_hz = settings.doppler_max_hz if window is None else window.doppler_half_hz
    reach = int(np.ceil(half_hz / step_hz - 1e-9))
    return np.asarray(centre_hz + np.arange(-reach, reach + 1) * step_hz, dtype=np.float64)


def _search_all(
    sums: RunningSums,
    first: int,
    signal: Signal,
    prns: Sequence[int],
    settings: AcquisitionSettings,
    window: SearchWindow | None,
    executor: Executor | None,
) -> list[Acquisition]:
    coherent = round(settings.coherent_s / signal.period_s)
    periods = _cut(sums, first, signal, coherent * settings.noncoherent)
    dopplers_hz = _grid_hz(settings, window)
    searches = [_GridSearch(periods, prn, dopplers_hz.size, window) for prn in prns]
    apply = map if executor is None else executor.map
    for group_hz, rows in _doppler_rows(periods, dopplers_hz, coherent):

        def add(
            search: _GridSearch, group_hz: FloatArray = group_hz, rows: Complex64Array = rows
        ) -> None:
            search.add(group_hz, rows)

        list(apply(add, searches))

    def conclude(search: _GridSearch) -> Acquisition:
        peak = search.peak(settings.noncoherent)
        threshold = detection_threshold(settings.false_alarm, peak.cells, settings.noncoherent)
        doppler_hz, code_chips, cn0_dbhz = _refine(periods, search.prn, peak, coherent)
        found = peak.ratio > threshold
        return Acquisition(
            satellite=signal.satellite(search.prn),
            prn=search.prn,
            first=first,
            doppler_hz=doppler_hz,
            code_chips=code_chips,
            peak_ratio=peak.ratio,
            threshold=threshold,
            cn0_dbhz=cn0_dbhz,
            found=found,
            reason="" if found else f"peak {peak.ratio:.2f} × noise, {threshold:.2f} needed",
        )

    return list(apply(conclude, searches))


def search(
    sums: RunningSums,
    first: int,
    signal: Signal,
    prn: int,
    settings: AcquisitionSettings,
    window: SearchWindow | None = None,
) -> Acquisition:
    """Search one satellite from sample `first` on, everywhere or in a predicted window only.

    Raises ValueError when the sums do not cover coherent × non-coherent time from `first` on.
    """
    return _search_all(sums, first, signal, [prn], settings, window, None)[0]


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
    results = _search_all(sums, first, signal, prns or signal.prns, settings, None, executor)
    return _screen(results, signal, settings)


# --- cross-correlation ---------------------------------------------------------------------------


def cross_power(signal: Signal, strong: Acquisition, weak: Acquisition, coherent_s: float) -> float:
    """Power a strong satellite leaves in the cell of another, relative to its own peak.

    Large only where the Dopplers agree modulo the code repetition rate, 1 kHz for C/A.
    """
    cells = _cells(signal)
    turns = (strong.doppler_hz - weak.doppler_hz) * signal.period_s
    replicas = [
        np.roll(
            _replica(signal.id.name, one.prn, cells),
            -round(one.code_chips * cells / signal.id.code_chips),
        )
        for one in (strong, weak)
    ]
    turning = np.exp(2j * np.pi * turns * np.arange(cells) / cells)
    within = np.mean(replicas[0] * replicas[1] * turning)
    coherent = round(coherent_s / signal.period_s)
    between = np.mean(np.exp(2j * np.pi * turns * np.arange(coherent)))
    return float(abs(within * between) ** 2)


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
