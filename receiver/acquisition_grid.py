"""The grid of the parallel code search: Doppler rows × cells of a code period.

Samples are resampled to about four per chip from the running sum, so that the cost does not
depend on the sampling rate, and cut into code periods whose spectra serve all satellites. A
Doppler row is their phase-aligned sum over one coherent block: whole kHz by shifting the spectra,
half a kHz by a rotated second set, the rest by the phase from period to period (the slow-time
transform, taken before the inverse FFT because both are linear: once for all satellites). Rows of
several blocks are aligned for code Doppler and add up in power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.special
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray, RunningSums
from deepgnss.receiver.baseband import resample
from deepgnss.receiver.signals import Signal, signal_of

Complex64Array = NDArray[np.complex64]

_CELLS_PER_CHIP = 4
# Of padded windows: the longer, the fewer cells are transformed for nothing. Odd numbers, so that
# rows half a bin of one period apart are whole bins of the window.
_WHOLE_PERIODS = (5, 3, 1)
_FINE_CELLS = 256  # of a delay's phases worked out one by one
_NOISE_CELLS = 2**15  # cells whose median gives the noise floor
# Neighbouring cells of the grid (quarter chip, half a Doppler bin) share noise: as far as high
# maxima go, this share of them counts as independent (measured; the tests hold it).
_INDEPENDENT_SHARE = 0.6
_LINE_STRETCH = 64  # cells of spectrum a carrier is compared with
_LINE_CHANCE = 1e-4  # share of the spectrum given up where there is none
LEAK_PEAK = 6.0  # highest cell over mean of a C/A cross-correlation row (−22 against −30 dB)


class SearchWindow(NamedTuple):
    """Where a satellite is predicted: centre and half width of Doppler and code phase."""

    doppler_hz: float
    doppler_half_hz: float
    code_chips: float  # at the first sample of the search
    code_half_chips: float


class Peak(NamedTuple):
    """Highest cell of a search; powers are sums over all blocks."""

    doppler_hz: float
    cell: int
    ratio: float  # power over noise, less what interference in its row may have added
    noise: float  # mean power of a cell without signal
    cells: int  # searched


# --- spectra shared by all satellites ------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Periods:
    """The samples of a search, cut into windows that begin a code period of `cells` apart.

    A window is one code period, correlated as a circle: where the sign changes in it, power is
    lost. Where signs change from period to period windows are one code period longer than the
    `whole` ones they begin, and the code is padded with zeros, so that as many whole periods of
    it lie within, wherever they start.

    samples: (windows, window); spectra: (2, windows, window), the second after mixing by half a
    bin: padded windows, of whole bins only, lack it.
    """

    signal: Signal
    first: int
    cells: int
    whole: int  # code periods from one window to the next
    half_sample_chips: float
    mirror_hz: float | None  # frequency about which the spectrum mirrors itself, if it does
    samples: Complex64Array
    spectra: Complex64Array

    @property
    def window(self) -> int:
        """Cells of a window."""
        return int(self.samples.shape[1])

    def aligned(self, cell: int) -> tuple[Complex64Array, int]:
        """Blocks of one code period (periods, cells) to refine a peak on, and where they begin.

        Padded windows are cut where the code starts: no sign changes within a block.
        """
        start = -cell % self.cells if self.window > self.cells else 0
        taken = self.samples[:, start : start + self.whole * self.cells]
        return taken.reshape(-1, self.cells), start

    @property
    def bin_hz(self) -> float:
        """Width of a bin of a window's spectrum."""
        return self.cells / (self.window * self.signal.period_s)

    @property
    def cells_per_hz_s(self) -> float:
        """Code drift per Hz of Doppler and second, cells."""
        return self.cells / (self.signal.id.code_chips * self.signal.carrier_to_code)


def period_cells(signal: Signal) -> int:
    """Cells of a code period: about four per chip, and quick to transform."""
    cells: int = scipy.fft.next_fast_len(_CELLS_PER_CHIP * signal.id.code_chips)
    return cells


def cut(
    sums: RunningSums, first: int, signal: Signal, periods: int, *, padded: bool = False
) -> Periods:
    """The samples of `periods` code periods from sample `first` on, carriers taken out.

    Padded windows take one code period more.

    Raises ValueError when the sums do not cover them.
    """
    cells = period_cells(signal)
    rate_hz = cells / signal.period_s
    entries_per_cell = sums.sample_rate_hz / (rate_hz * sums.step)
    start = (first - sums.first) / sums.step
    there = int((sums.packed.size - 2 - start) / entries_per_cell)
    total = periods + padded
    lacking = total * cells - there
    # The last few cells of a recording may lack the entry behind them: they count as zero.
    if start < 0 or lacking > _CELLS_PER_CHIP:
        raise ValueError(
            f"search of {total} code periods from sample {first} on exceeds the samples at hand "
            f"({sums.first} to {sums.first + (sums.packed.size - 1) * sums.step})"
        )
    flat = np.zeros(total * cells, dtype=np.complex64)
    count = min(there, flat.size)
    flat[:count] = resample(sums, first, rate_hz, count)
    whole = next(n for n in _WHOLE_PERIODS if periods % n == 0) if padded else 1
    window = cells * (whole + padded)
    spectra = scipy.fft.fft(sliding_window_view(flat, window)[:: whole * cells])
    spectra *= line_weights(spectra)
    samples = np.asarray(scipy.fft.ifft(spectra))
    mixed = [spectra]
    if not padded:
        half_bin = np.exp(-1j * np.pi * np.arange(window) / window).astype(np.complex64)
        mixed.append(scipy.fft.fft(samples * half_bin))
    half_sample_chips = 0.5 * signal.id.chip_rate_hz / sums.sample_rate_hz
    mirror_hz = mirror_frequency_hz(samples[:, : whole * cells].ravel(), rate_hz)
    return Periods(
        signal, first, cells, whole, half_sample_chips, mirror_hz, samples, np.stack(mixed)
    )


def mirror_frequency_hz(samples: Complex64Array, rate_hz: float) -> float | None:
    """Where real samples at (nearly) zero IF have their zero: noise is not circular there."""
    squares = samples * samples
    lag = 64
    product = complex(np.vdot(squares[:-lag], squares[lag:])) / samples.size
    level = float(np.vdot(samples, samples).real) / samples.size
    if abs(product) < 0.25 * level**2:
        return None
    return float(np.angle(product)) * rate_hz / (4.0 * np.pi * lag)


def line_weights(spectra: Complex64Array) -> NDArray[np.float32]:
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
    weights = np.ones(cells, dtype=np.float32)
    np.divide(floor, power, out=weights, where=power > limit * floor, casting="same_kind")
    return weights


@cache
def replica_cells(signal_name: str, prn: int, cells: int) -> FloatArray:
    """One code period in cells, each the mean of the chips it covers."""
    code = signal_of(signal_name, prn).primary_code(prn).astype(np.float64)
    integral = np.concatenate([[0.0], np.cumsum(code)])
    edges = np.linspace(0.0, code.size, cells + 1)
    replica: FloatArray = np.diff(np.interp(edges, np.arange(code.size + 1), integral))
    replica *= cells / code.size
    replica.flags.writeable = False
    return replica


@cache
def code_spectrum(signal_name: str, prn: int, cells: int, window: int) -> Complex64Array:
    """Conjugate spectrum of the replica, padded with zeros to a window.

    The forward FFT of a data spectrum times this has the correlation at code phase s in cell s,
    in a padded window in its last cells, with whole periods one before the other.
    """
    replica = replica_cells(signal_name, prn, cells)
    spectrum = (cells / window * np.conj(scipy.fft.fft(replica, window))).astype(np.complex64)
    spectrum.flags.writeable = False
    return spectrum


def delay(by_cells: float, cells: int) -> Complex64Array:
    """What delays a circle of cells, on its spectrum: e^{−j2π·by·k/cells}, (cells,)."""
    fine = np.exp(-2j * np.pi * by_cells / cells * np.arange(_FINE_CELLS))
    coarse = np.exp(-2j * np.pi * by_cells / cells * np.arange(0, cells, _FINE_CELLS))
    turns: Complex64Array = np.outer(coarse, fine).ravel()[:cells].astype(np.complex64)
    turns[(cells + 1) // 2 :] *= np.exp(2j * np.pi * by_cells)  # k − cells
    return turns


@kernel
def shift_blocks(
    spectra: Complex64Array, bins: int, half: Complex64Array, out: Complex64Array
) -> None:
    """Spectra (blocks, rows, cells) moved down by bins, block b times half to the power 2b + 1."""
    blocks, count, cells = spectra.shape
    turn, step = half.copy(), half * half
    for block in range(blocks):
        for row in range(count):
            source, target = spectra[block, row], out[block, row]
            for cell in range(cells - bins):
                target[cell] = source[cell + bins] * turn[cell]
            for cell in range(cells - bins, cells):
                target[cell] = source[cell + bins - cells] * turn[cell]
        turn *= step


def doppler_groups(periods: Periods, dopplers_hz: FloatArray) -> list[FloatArray]:
    """Dopplers in groups that the same shift of the spectra serves: rows are made of one each."""
    half_bins = _half_bins(periods, dopplers_hz)
    return [dopplers_hz[half_bins == half_bin] for half_bin in np.unique(half_bins)]


def doppler_rows(
    periods: Periods, group_hz: FloatArray, coherent: int, space: Complex64Array | None = None
) -> Complex64Array:
    """Spectra of coherent blocks at a group of Dopplers, (blocks, rows, window).

    space: (2, blocks, rows, window) to work in, whose first half then holds the result.
    """
    period_s = periods.signal.period_s
    half_bin = int(_half_bins(periods, group_hz)[0])
    shift, half = divmod(half_bin, 2)
    blocks = periods.samples.shape[0] // coherent
    if space is None:
        space = np.empty((2, blocks, group_hz.size, periods.window), dtype=np.complex64)
    rows: Complex64Array = space[0]
    source = periods.spectra[half].reshape(blocks, coherent, periods.window)
    if coherent > 1:  # products of single numbers take longer than the transforms
        within = np.arange(coherent) * period_s
        weights = np.exp(-2j * np.pi * group_hz[:, np.newaxis] * within).astype(np.complex64)
        source = np.matmul(weights, source, out=space[1])
    # Where the code stands in the middle of each block, against that at the start.
    half_block_s = 0.5 * coherent * periods.whole * period_s
    drift = half_block_s * 0.5 * half_bin * periods.bin_hz * periods.cells_per_hz_s
    shift_blocks(source, shift % periods.window, delay(drift, periods.window), rows)
    return rows


def _half_bins(periods: Periods, dopplers_hz: FloatArray) -> NDArray[np.int64]:
    return np.rint(2.0 * dopplers_hz / periods.bin_hz).astype(np.int64)


# --- the grid ------------------------------------------------------------------------------------


@kernel
def sum_power(
    correlations: Complex64Array, whole: int, power: NDArray[np.float32], totals: FloatArray
) -> None:
    """Power of (blocks, rows, window) summed up into (rows, cells), and over cells.

    The last `whole` stretches of `cells` count, each one code period.
    """
    blocks, rows, window = correlations.shape
    cells = power.shape[1]
    for row in range(rows):
        sums = power[row]
        sums[:] = 0.0
        for block in range(blocks):
            for start in range(window - whole * cells, window, cells):
                stretch = correlations[block, row, start : start + cells]
                for cell in range(cells):
                    value = stretch[cell]
                    sums[cell] += value.real * value.real + value.imag * value.imag
        total = 0.0
        for cell in range(cells):
            total += sums[cell]
        totals[row] = total


class Rows(NamedTuple):
    """What one satellite's search of a group of Doppler rows came to."""

    dopplers_hz: FloatArray  # (rows,)
    cells: NDArray[np.int64]  # (rows,): the highest within the window …
    highest: NDArray[np.float32]  # … and their powers
    means: FloatArray  # (rows,): of whole rows, without the share of their peak
    noise: NDArray[np.float32]  # powers of some cells


class GridSearch:
    """One satellite's search, a group of Doppler rows at a time and in any order."""

    def __init__(
        self,
        periods: Periods,
        prn: int,
        rows: int,
        coherent_s: float,
        window: SearchWindow | None,
    ) -> None:
        self.prn = prn
        self._cells_searched = periods.cells
        self._circular_hz = 0.6 / coherent_s
        self._code = code_spectrum(periods.signal.id.name, prn, periods.cells, periods.window)
        self._whole = periods.whole
        self._stride = max(1, rows * periods.cells // _NOISE_CELLS) | 1
        self._allowed = np.arange(periods.cells)
        if window is not None:
            per_chip = periods.cells / periods.signal.id.code_chips
            centre = round((window.code_chips - periods.half_sample_chips) * per_chip)
            half = min(int(window.code_half_chips * per_chip) + 1, (periods.cells - 1) // 2)
            self._allowed = (centre + np.arange(-half, half + 1)) % periods.cells
        self._mirror_hz = periods.mirror_hz
        # A peak's triangle and side lobes, as cells of its height (Parseval of |code|²).
        code = code_spectrum(periods.signal.id.name, prn, periods.cells, periods.cells)
        spectrum = np.abs(code.astype(np.complex128)) ** 2
        self._own = spectrum.size * (spectrum**2).sum() / spectrum.sum() ** 2

    def through(self, dopplers_hz: FloatArray, rows: Complex64Array, work: Complex64Array) -> Rows:
        """Search one group of Doppler rows; `work` is written over, of the same shape."""
        np.multiply(rows, self._code, out=work)
        correlations = scipy.fft.fft(work, overwrite_x=True)
        power = np.empty((dopplers_hz.size, self._cells_searched), dtype=np.float32)
        totals = np.empty(dopplers_hz.size)
        sum_power(correlations, self._whole, power, totals)
        searched = power
        if self._allowed.size < power.shape[1]:
            searched = np.ascontiguousarray(power[:, self._allowed])
        columns = searched.argmax(axis=1)
        whole = power.shape[1]
        return Rows(
            dopplers_hz,
            self._allowed[columns],
            searched[np.arange(columns.size), columns],
            (totals - self._own * power.max(axis=1)) / (whole - self._own),
            power.reshape(-1)[:: self._stride].copy(),
        )

    def peak(self, groups: Sequence[Rows], blocks: int) -> Peak:
        """The highest cell against the noise floor, which is the median of all cells.

        Carriers, and signals with like codes at the same Doppler modulo 1 kHz, known or not,
        raise the mean of a whole row: what they may add to a single cell is taken off first.
        """
        dopplers_hz, cells, powers, means, noises = map(np.concatenate, zip(*groups, strict=True))
        median = float(np.median(noises))
        noise = median * blocks / float(scipy.special.gammaincinv(blocks, 0.5))
        noise = max(noise, float(np.finfo(np.float64).tiny))  # a recording of zeros
        highest = powers.astype(np.float64) / noise
        excess = means / noise - 1.0
        excess -= 3.0 * np.sqrt(self._own / (self._cells_searched * blocks))  # by chance
        leaks = LEAK_PEAK * np.maximum(excess, 0.0)
        ratios = np.maximum(np.sqrt(highest) - np.sqrt(leaks), 0.0) ** 2
        if self._mirror_hz is not None:  # all noise in one dimension: half the exponent
            ratios[abs(dopplers_hz - self._mirror_hz) < self._circular_hz] *= 0.5
        best = int(ratios.argmax())
        return Peak(
            doppler_hz=float(dopplers_hz[best]),
            cell=int(cells[best]),
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
