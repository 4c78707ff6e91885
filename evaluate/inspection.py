"""What samples look like: levels, balance, spectrum, and guesses at what is wrong with them.

Everything here is a pure function of samples; satellites are looked for in
`deepgnss.evaluate.satellites`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray, SampleBlock

IntArray = NDArray[np.int64]

_FEW_VALUES = 16  # a histogram of no more values is one of a coarse quantizer
_FEWEST_BINS = 64  # of a spectrum that says anything
_FEWEST_NUMBERS = 1000  # of a histogram that does
_HUMP_DB = 3.0  # a front end's passband stands out of its spectrum by more


class Levels(NamedTuple):
    """Level and balance of a block, in units of the samples."""

    rms: float  # per real number
    dbfs: float  # rms over full scale
    dc: complex
    saturated_share: float  # of all real numbers
    zero_share: float
    gain_imbalance_db: float  # I over Q; 0 for real samples
    quadrature_error_rad: float  # by which I and Q miss 90°
    longest_run: int  # samples of one value in a row
    longest_run_at: int  # sample index since the start of the recording


class Spectrum(NamedTuple):
    """Power spectral density, frequencies rising; real samples from 0 to half the rate."""

    frequency_hz: FloatArray
    density_db: FloatArray  # dB of (sample unit)² per Hz


@dataclass(frozen=True, slots=True)
class Inspection:
    """Everything there is to say of a block of samples."""

    block: SampleBlock
    full_scale: int
    values: IntArray  # distinct values, rising
    counts: IntArray  # how often each
    levels: Levels
    spectrum: Spectrum
    findings: tuple[str, ...]  # guesses at what is wrong, one line each


def inspect(block: SampleBlock, full_scale: int) -> Inspection:
    """Look at a block of samples.

    Parameters
    ----------
    full_scale: highest number its file format can hold.
    """
    values, counts = np.unique(block.samples, return_counts=True)
    levels = measure_levels(block, full_scale)
    spectrum = measure_spectrum(block)
    draft = Inspection(
        block, full_scale, values.astype(np.int64), counts.astype(np.int64), levels, spectrum, ()
    )
    return Inspection(
        block, full_scale, draft.values, draft.counts, levels, spectrum, tuple(_findings(draft))
    )


def measure_levels(block: SampleBlock, full_scale: int) -> Levels:
    """Level, offset, saturation and I/Q balance."""
    x = np.atleast_2d(block.samples.T).T.astype(np.float64)  # (n, 1) or (n, 2)
    mean, power = x.mean(axis=0), np.mean(x**2, axis=0)
    rms = math.sqrt(float(power.mean()))
    gain_db, quadrature_rad = 0.0, 0.0
    spread = x.std(axis=0)
    if block.stream.is_complex and spread.min() > 0.0:
        gain_db = 20.0 * math.log10(spread[0] / spread[1])
        correlation = np.mean((x[:, 0] - mean[0]) * (x[:, 1] - mean[1])) / spread.prod()
        quadrature_rad = math.asin(max(-1.0, min(1.0, float(correlation))))
    changes = np.flatnonzero(np.any(np.diff(x, axis=0) != 0.0, axis=1)) + 1
    edges = np.concatenate([[0], changes, [len(x)]])
    runs = np.diff(edges)
    return Levels(
        rms=rms,
        dbfs=20.0 * math.log10(rms / full_scale) if rms > 0.0 else -math.inf,
        dc=complex(mean[0], mean[1] if len(mean) == 2 else 0.0),
        saturated_share=float(np.mean(np.abs(x) >= full_scale)),
        zero_share=float(np.mean(x == 0.0)),
        gain_imbalance_db=gain_db,
        quadrature_error_rad=quadrature_rad,
        longest_run=int(runs.max()),
        longest_run_at=block.first + int(edges[np.argmax(runs)]),
    )


def measure_spectrum(block: SampleBlock, bins: int = 512) -> Spectrum:
    """Welch's spectrum, Hann window, half overlapping segments; the DC line is not removed."""
    samples = block.samples.astype(np.float32)
    is_complex = block.stream.is_complex
    z = samples[:, 0] + 1j * samples[:, 1] if is_complex else samples
    length = min(bins if is_complex else 2 * bins, z.shape[0])
    frequency_hz, density = scipy.signal.welch(
        z,
        fs=block.stream.sample_rate_hz,
        nperseg=length,
        detrend=False,
        return_onesided=not is_complex,
    )
    order = np.argsort(frequency_hz)
    floor = np.finfo(np.float64).tiny
    density_db = 10.0 * np.log10(np.maximum(density[order].astype(np.float64), floor))
    return Spectrum(frequency_hz[order].astype(np.float64), density_db)


def passband(spectrum: Spectrum) -> tuple[float, float] | None:
    """Lower and upper edge, Hz, of what stands highest out of the spectrum; None if it is flat.

    Lines are smoothed away; the edges are where half of the (log) rise is passed.
    """
    if spectrum.density_db.size < _FEWEST_BINS:
        return None
    smooth = scipy.signal.medfilt(spectrum.density_db, 9)
    smooth = np.convolve(np.pad(smooth, 8, mode="edge"), np.ones(17) / 17, mode="valid")
    low, high = np.percentile(smooth, [10.0, 95.0])
    if high - low < _HUMP_DB:
        return None
    below = np.flatnonzero(smooth < (low + high) / 2.0)
    top = int(np.argmax(smooth))
    first = int(below[below < top].max(initial=-1)) + 1
    last = int(below[below > top].min(initial=smooth.size)) - 1
    return float(spectrum.frequency_hz[first]), float(spectrum.frequency_hz[last])


# --- what may be wrong ---------------------------------------------------------------------------


def _findings(seen: Inspection) -> Iterator[str]:
    """Guesses, gravest first; a dead stream needs no further ones."""
    if seen.values.size == 1:
        what = "all samples are zero" if seen.values[0] == 0 else f"all are {seen.values[0]}"
        yield f"{what}: nothing was recorded, or the offset or format is wrong"
        return
    for find in (_dead_channel, _format_findings):
        grave = list(find(seen))
        yield from grave
        if grave:
            return  # levels of misread numbers say nothing
    yield from _level_findings(seen)
    yield from _balance_findings(seen)
    yield from _spectrum_findings(seen)


def _dead_channel(seen: Inspection) -> Iterator[str]:
    for name, part in zip("IQ", seen.block.samples.T, strict=False):
        if seen.block.stream.is_complex and not np.any(part != part[0]):
            yield f"{name} is always {part[0]}: real samples described as iq, or a dead channel?"


def _format_findings(seen: Inspection) -> Iterator[str]:
    """Whether the numbers look like noise in the format they are said to have."""
    numbers = seen.block.samples.reshape(-1)
    if numbers.size < _FEWEST_NUMBERS:
        return
    entropy = [_entropy_bits(numbers[phase::4]) for phase in range(4)]
    pairs = abs(entropy[0] - entropy[2]) < 0.5 and abs(entropy[1] - entropy[3]) < 0.5
    if numbers.dtype == np.int16:
        halves = numbers.view(np.int8).reshape(-1, 2).astype(np.int64)  # low byte, high byte
        extends = np.mean(halves[:, 1] == np.where(halves[:, 0] < 0, -1, 0))
        if seen.full_scale > 128 and _entropy_bits(halves[:, 0]) < 7.5 and extends < 0.95:
            yield "the two bytes of the numbers look alike: 8-bit samples read as int16?"
    elif seen.full_scale == 128 and pairs and abs(entropy[0] - entropy[1]) > 1.0:
        yield "every other byte is of another kind: int16 read as int8?"
    elif seen.full_scale == 128 and max(entropy) > 7.0 and max(entropy) - min(entropy) > 1.0:
        yield "every 4th byte is of another kind: float32 read as int8?"
    elif seen.full_scale == 128 and seen.values.size > _FEW_VALUES and _unlike_noise(numbers):
        yield "values are not spread like noise: packed bits (bits1, bits2, bits4) read as int8?"
    if seen.full_scale < 128:
        if _depends_on_place(numbers):
            yield "values depend on their place in the byte: not packed samples, or a wrong offset?"
    elif seen.values.size == 256 and seen.full_scale == 128 and min(entropy) > 7.9:
        yield "all bytes are equally frequent: packed 1-bit samples, compressed or encrypted data?"


def _level_findings(seen: Inspection) -> Iterator[str]:
    levels = seen.levels
    if seen.values.size > _FEW_VALUES and levels.saturated_share > 0.01:
        yield f"{levels.saturated_share:.1%} of the values are at full scale: gain too high"
    if levels.zero_share > 0.9:
        yield f"{levels.zero_share:.1%} of the values are zero: gain too low, or a wrong format?"
    # the chance of a value to be repeated, from how often each occurs
    share = seen.counts / seen.counts.sum()
    again = float(np.sum(share**2)) ** (2 if seen.block.stream.is_complex else 1)
    expected = math.log(max(len(seen.block.samples), 2)) / -math.log(min(again, 0.99))
    if levels.longest_run > max(8.0 * expected, 32.0):
        yield (
            f"{levels.longest_run} equal samples in a row at sample {levels.longest_run_at}:"
            " a dropped buffer?"
        )
    if abs(levels.dc) > 0.1 * levels.rms:
        yield f"DC offset of {abs(levels.dc) / levels.rms:.0%} of the rms"


def _balance_findings(seen: Inspection) -> Iterator[str]:
    if not seen.block.stream.is_complex:
        return
    if abs(seen.levels.quadrature_error_rad) > math.radians(60.0):
        yield "I and Q are the same but for sign: real samples described as iq?"
    elif abs(seen.levels.quadrature_error_rad) > math.radians(5.0):
        yield f"I and Q miss 90° by {math.degrees(seen.levels.quadrature_error_rad):.1f}°"
    if abs(seen.levels.gain_imbalance_db) > 1.0:
        yield f"I is {seen.levels.gain_imbalance_db:+.1f} dB against Q"


def _spectrum_findings(seen: Inspection) -> Iterator[str]:
    """Lines, and a passband that is not where the intermediate frequency says."""
    frequency_hz, density_db = seen.spectrum
    if density_db.size < _FEWEST_BINS:
        return
    median = scipy.signal.medfilt(density_db, 31)
    line = int(np.argmax(density_db - median))
    rise_db = float(density_db[line] - median[line])
    width_hz = 2.0 * float(frequency_hz[1] - frequency_hz[0])
    if rise_db > 10.0 and abs(frequency_hz[line]) > width_hz:  # DC has its own finding
        yield f"a line {rise_db:.0f} dB above its surroundings at {frequency_hz[line]:.0f} Hz"
    band = passband(seen.spectrum)
    intermediate_hz = seen.block.stream.intermediate_hz
    if band is None:
        return
    if not seen.block.stream.is_complex:
        intermediate_hz = _folded_hz(intermediate_hz, seen.block.stream.sample_rate_hz)
    if band[0] <= intermediate_hz <= band[1]:
        return
    mirrored = band[0] <= -intermediate_hz <= band[1]
    yield (
        f"the passband {band[0] / 1e6:.3f} … {band[1] / 1e6:.3f} MHz does not hold the"
        f" intermediate frequency {intermediate_hz / 1e6:.3f} MHz"
        + (": wrong sign, or I and Q swapped?" if mirrored else "")
    )


def _folded_hz(frequency_hz: float, rate_hz: float) -> float:
    """Where a frequency appears in the one-sided spectrum of real samples."""
    return abs((frequency_hz + rate_hz / 2.0) % rate_hz - rate_hz / 2.0)


def _entropy_bits(numbers: NDArray[np.generic]) -> float:
    _, counts = np.unique(numbers, return_counts=True)
    share = counts / counts.sum()
    return float(-np.sum(share * np.log2(share)))


def _depends_on_place(numbers: NDArray[np.generic]) -> bool:
    """Whether mean or correlation of neighbours changes within eight values.

    Places of one parity are compared only: I and Q may differ.
    """
    values = numbers[: (numbers.size - 1) // 8 * 8 + 1].astype(np.float64)
    power = float(np.mean(values**2))
    for statistic, scale in ((values[:-1], math.sqrt(power)), (values[:-1] * values[1:], power)):
        by_place = statistic.reshape(-1, 8).mean(axis=0).reshape(4, 2)
        noise = scale / math.sqrt(statistic.size / 8)
        if by_place.std(axis=0).max() > 0.05 * scale + 5.0 * noise:
            return True
    return False


def _unlike_noise(numbers: NDArray[np.generic]) -> bool:
    """Whether 8-bit values differ from a Gaussian of their own mean and spread by a quarter."""
    values = numbers.astype(np.float64)
    histogram = np.bincount((values + 128).astype(np.int64), minlength=256) / values.size
    bell = np.exp(-0.5 * ((np.arange(256) - 128 - values.mean()) / values.std()) ** 2)
    return float(0.5 * np.sum(np.abs(histogram - bell / bell.sum()))) > 0.25
