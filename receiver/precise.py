"""Delay, Doppler and C/N0 of a signal from milliseconds of samples, as well as noise allows.

Every sample is multiplied by the local signal at its own instant: no resampling, no cut at sample
borders, the code limited to the band the samples can hold. A rectangular replica would tell
nothing of where between two samples a chip edge lies, least of all where the sampling rate is a
multiple of the chip rate. The delay is that of the correlation's peak (maximum likelihood),
Doppler is fitted over all places and signs of the symbol edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import ComplexArray, FloatArray, SampleBlock
from deepgnss.receiver.signals import Signal, signal_of
from deepgnss.receiver.symbols import fit_symbols

_POINTS_PER_CHIP = 32
_WIDEST_HZ = 10e6  # side of the replica's spectrum: nothing is gained beyond
_REACH_CHIPS = 0.3  # first look around a rough code phase
_LOOK_CHIPS = 0.25  # spacing of taps in a narrow search
_BAND_EDGE = 0.95  # of half the sampling rate


class Replica(NamedTuple):
    """A band-limited code as a table over its phase, and its autocorrelation."""

    table: FloatArray  # (chips · points + 1,), the last entry repeats the first
    energy: float  # mean square
    slope: float  # −d|R|/dτ at one tap offset, per chip, of the normalized autocorrelation
    apart: float  # normalized autocorrelation over the distance of the outer taps
    offset_chips: float  # of the outer taps


@dataclass(frozen=True, slots=True)
class Measurement:
    """One satellite of a snapshot, at its first sample."""

    satellite: str
    prn: int
    code_chips: float  # in [0, code length)
    doppler_hz: float
    cn0_dbhz: float
    code_sigma_chips: float
    doppler_sigma_hz: float
    snr: float  # energy over noise density of the whole snapshot, at the peak


@cache
def replica(signal_name: str, prn: int, half_band_hz: float) -> Replica:
    """Code of a satellite, its spectrum cut at half_band_hz on either side."""
    signal = signal_of(signal_name, prn)
    chips = signal.primary_code(prn).astype(np.float64)
    spectrum = scipy.fft.fft(np.repeat(chips, _POINTS_PER_CHIP))
    harmonic = scipy.fft.fftfreq(spectrum.size, 1.0 / spectrum.size)
    # `repeat` holds every chip from its edge on: centre the steps of the table on the edges.
    spectrum *= np.exp(-1j * np.pi * harmonic / spectrum.size)
    spectrum[np.abs(harmonic) > half_band_hz * signal.period_s] = 0.0
    values = scipy.fft.ifft(spectrum).real
    table = np.append(values, values[0])
    table.flags.writeable = False
    power = np.abs(spectrum) ** 2
    offset_chips = min(0.125, 0.25 * signal.id.chip_rate_hz / half_band_hz)
    angle = 2.0 * np.pi * harmonic / chips.size
    total = power.sum()
    return Replica(
        table=table,
        energy=float(np.mean(values**2)),
        slope=float((power * angle * np.sin(angle * offset_chips)).sum() / total),
        apart=float((power * np.cos(2.0 * angle * offset_chips)).sum() / total),
        offset_chips=offset_chips,
    )


@kernel
def correlate_samples(
    samples: NDArray[np.integer[Any]],
    carrier_cycles: float,
    code_chips: float,
    code_chips_per_sample: float,
    length: int,
    table: FloatArray,
    offsets: FloatArray,
    out: ComplexArray,
    lengths: FloatArray,
) -> None:
    """Sum samples·e^{−j2π·carrier}·table(code) per code period and tap, (periods, taps).

    samples: (n, 1) real or (n, 2) complex. carrier_cycles: per sample. lengths: samples summed
    into each period. The first period is the one the first sample lies in.
    """
    turn = np.exp(-2j * np.pi * carrier_cycles)
    phase = 1.0 + 0.0j
    is_complex = samples.shape[1] == 2
    entries = table.size - 1
    for n in range(samples.shape[0]):
        periods = (code_chips + n * code_chips_per_sample) / length
        period = int(periods)
        prompt = (periods - period) * entries
        value = samples[n, 0] * phase
        if is_complex:
            value = complex(samples[n, 0], samples[n, 1]) * phase
        for tap in range(offsets.size):
            at = prompt + offsets[tap] * (entries / length)
            if at < 0.0:
                at += entries
            elif at >= entries:
                at -= entries
            whole = int(at)
            replica = table[whole] + (at - whole) * (table[whole + 1] - table[whole])
            out[period, tap] += value * replica
        lengths[period] += 1.0
        phase *= turn


def half_band_hz(block: SampleBlock) -> float:
    """Band on either side of a carrier that the samples of a stream can hold."""
    return min(_BAND_EDGE * 0.5 * block.stream.sample_rate_hz, _WIDEST_HZ)


class TapSums(NamedTuple):
    """Correlations of a snapshot per code period and tap."""

    sums: ComplexArray  # (periods, taps)
    times_s: FloatArray  # middles of the periods, after the first sample
    noise: float  # mean power of noise in the sum over everything


def correlate_snapshot(
    block: SampleBlock,
    signal: Signal,
    prn: int,
    doppler_hz: float,
    code_chips: float,
    offsets: FloatArray,
) -> TapSums:
    """Correlate all samples of a block, code period by code period.

    Parameters: code phase at the first sample in [0, code length); offsets of the taps, chips.
    """
    stream = block.stream
    local = replica(signal.id.name, prn, half_band_hz(block))
    samples = block.samples if block.samples.ndim == 2 else block.samples[:, np.newaxis]
    mix_hz = stream.intermediate_hz + signal.id.carrier_hz - stream.centre_hz + doppler_hz
    rate = signal.id.chip_rate_hz * (1.0 + doppler_hz / signal.id.carrier_hz)
    chips_per_sample = rate / stream.sample_rate_hz
    length = signal.id.code_chips
    periods = int((code_chips + (len(samples) - 1) * chips_per_sample) / length) + 1
    sums = np.zeros((periods, offsets.size), dtype=np.complex128)
    counts = np.zeros(periods)
    correlate_samples(
        samples,
        mix_hz / stream.sample_rate_hz,
        code_chips,
        chips_per_sample,
        length,
        local.table,
        offsets,
        sums,
        counts,
    )
    ends = np.cumsum(counts)
    times_s = (ends - 0.5 * counts - 0.5) / stream.sample_rate_hz
    values = samples.astype(np.float64)
    noise = float(np.vdot(values, values)) * local.energy
    return TapSums(sums[counts > 0], times_s[counts > 0], noise)


def measure(
    block: SampleBlock,
    signal: Signal,
    prn: int,
    doppler_hz: float,
    code_chips: float,
    span_hz: float = 20.0,
) -> Measurement:
    """Measure a satellite whose Doppler and code phase are known to ± span_hz and ± half a chip.

    Parameters: code phase in [0, code length) at the first sample.
    """
    local = replica(signal.id.name, prn, half_band_hz(block))
    length = signal.id.code_chips
    around = math.ceil(_REACH_CHIPS / max(local.offset_chips, _REACH_CHIPS / 4.0))
    offsets = np.linspace(-_REACH_CHIPS, _REACH_CHIPS, 2 * around + 1)
    for attempt in range(4):
        c = correlate_snapshot(block, signal, prn, doppler_hz, code_chips % length, offsets)
        fit = fit_symbols(c.sums[:, offsets.size // 2], c.times_s, signal.secondary, span_hz)
        taps = fit.strip(c.sums, c.times_s).sum(axis=0)
        doppler_hz += fit.doppler_hz
        span_hz = min(span_hz, 5.0)
        if attempt == 0:
            code_chips += float(offsets[np.abs(taps).argmax()])
            offsets = np.array([-1.0, 0.0, 1.0]) * local.offset_chips
            continue
        less, peak, more = taps
        step = ((more - less) * peak.conjugate()).real / abs(peak) ** 2 / (2.0 * local.slope)
        code_chips += min(max(step, -local.offset_chips), local.offset_chips)
        if abs(step) < 1e-4 and abs(fit.doppler_hz) < 0.05:
            break
    seconds = len(block.samples) / block.stream.sample_rate_hz
    snr = max(abs(peak) ** 2 / c.noise - 1.0, 1e-3)
    return Measurement(
        satellite=signal.satellite(prn),
        prn=prn,
        code_chips=code_chips % length,
        doppler_hz=doppler_hz,
        cn0_dbhz=10.0 * math.log10(snr / seconds),
        code_sigma_chips=math.sqrt((1.0 - local.apart) / snr) / (2.0 * local.slope),
        doppler_sigma_hz=math.sqrt(6.0 / snr) / (2.0 * math.pi * seconds),
        snr=snr,
    )


def look(
    block: SampleBlock,
    signal: Signal,
    prn: int,
    doppler_hz: float,
    code_chips: float,
    doppler_half_hz: float,
    code_half_chips: float,
    false_alarm: float = 1e-3,
) -> Measurement | None:
    """Measure a satellite in a narrow window if its peak stands out there, None otherwise.

    Parameters: false_alarm, the probability that noise alone is taken for the satellite.
    """
    steps = math.ceil(code_half_chips / _LOOK_CHIPS)
    offsets = np.arange(-steps, steps + 1, dtype=np.float64) * _LOOK_CHIPS
    c = correlate_snapshot(
        block, signal, prn, doppler_hz, code_chips % signal.id.code_chips, offsets
    )
    fits = [
        fit_symbols(c.sums[:, tap], c.times_s, signal.secondary, doppler_half_hz)
        for tap in range(offsets.size)
    ]
    best = max(range(offsets.size), key=lambda tap: fits[tap].score)
    seconds = len(block.samples) / block.stream.sample_rate_hz
    trials = offsets.size * (1.0 + 2.0 * doppler_half_hz * seconds) * len(c.times_s)
    if fits[best].score < c.noise * math.log(trials / false_alarm):
        return None
    return measure(
        block,
        signal,
        prn,
        doppler_hz + fits[best].doppler_hz,
        code_chips + offsets[best],
        span_hz=5.0,
    )
