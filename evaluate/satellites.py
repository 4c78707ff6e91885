"""Satellites in the first milliseconds of a recording, and what they say of its description.

Where none are found, descriptions that are wrong in the usual ways are tried: the satellites
themselves tell which one is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray, SampleBlock, StreamInfo
from deepgnss.receiver.acquisition import Acquisition, AcquisitionSettings, cold_search
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.signals import SIGNALS, Signal

Reader = Callable[[int, int], SampleBlock]  # (first sample, count) → samples

_SEARCH_S = 0.021  # two blocks of 10 ms and a margin
_DRIFT_S = 2.0  # between two searches that tell the code's drift
_CODE_SIGMA_CHIPS = 0.1  # of an acquisition's code phase
_REPEAT_SAMPLES = 1 << 21  # for the search of the code's repetition
_SLOWEST_HZ = 0.6e6  # sampling that still holds a signal
_PEAKS = 60  # of the autocorrelation, for guesses of the period
_CLEAR_COMB = 5.0  # mean height of its multiples, σ; noise alone gives 1.8
_WIDE_HZ = 25e3
_CLOCK_PPM = 0.5  # code against carrier: more than any oscillator makes
_USUAL_HZ = 6e3  # Doppler of satellites plus that of a good oscillator


class Drift(NamedTuple):
    """How code phases move, against what Doppler says.

    ratio: code drift over Doppler/1540 (1: upright spectrum, −1: inverted) and its 1σ.
    clock_ppm: common part, by which the sample clock is slow.
    """

    ratio: float
    sigma: float
    clock_ppm: float


@dataclass(frozen=True, slots=True)
class Survey:
    """Satellites of one signal in a stream, strongest first, and guesses at what is wrong."""

    signal: Signal
    found: tuple[Acquisition, ...]
    drift: Drift | None
    findings: tuple[str, ...]
    repeats_hz: float | None = None  # the sample rate at which codes repeat, when it is another
    explained: bool = True  # the findings say what to change


def signals_within(stream: StreamInfo) -> list[Signal]:
    """Signals of this version whose carrier lies in the stream's band."""
    half_hz = stream.sample_rate_hz / 2.0
    return [
        signal
        for forms in SIGNALS.values()
        for signal in forms
        if abs(stream.intermediate_hz + signal.id.carrier_hz - stream.centre_hz) <= half_hz
    ]


def survey(read: Reader, signal: Signal, first: int = 0) -> Survey:
    """Find the satellites of a signal and judge the stream's description by them.

    Parameters
    ----------
    read: (first sample, count) → block; must reach `StreamInfo.sample_count`.
    """
    block = _block(read, first, _SEARCH_S)
    reach_hz = _USUAL_HZ
    found = find_satellites(block, signal, reach_hz)
    if not found:
        rate_hz = _wrong_rate_hz(read, first, signal)
        if rate_hz is not None:
            text = (
                f"codes repeat every {rate_hz * signal.period_s:.10g} samples: a sample rate of"
                f" {rate_hz:.10g} Hz, or another number of values per sample (format, real or iq)?"
            )
            turns = abs(math.log2(rate_hz / block.stream.sample_rate_hz))
            doubtful = turns > 0.5 and abs(turns - round(turns)) < 0.01  # values lost or made up
            return Survey(signal, (), None, (text,), rate_hz, explained=not doubtful)
        reach_hz = _WIDE_HZ
        found = find_satellites(block, signal, reach_hz)
        if not convincing(found):
            for changed, text in _alternatives(block):
                if convincing(find_satellites(changed, signal)):
                    return Survey(signal, (), None, (text,))
            text = "no satellites: no antenna, a wrong format, or a wrong intermediate frequency?"
            return Survey(signal, (), None, (text,), explained=False)
    drift = _drift(read, first, signal, found, reach_hz)
    findings = tuple(_judgements(block.stream, signal, found, drift))
    return Survey(signal, tuple(found), drift, findings)


def _judgements(
    stream: StreamInfo, signal: Signal, found: Sequence[Acquisition], drift: Drift | None
) -> Iterator[str]:
    """What Dopplers, and code against carrier, say of the description."""
    centre_hz = float(np.median([one.doppler_hz for one in found]))
    if drift is not None and drift.ratio < -0.5 and drift.ratio + 4.0 * drift.sigma < 0.0:
        yield (
            "code phases drift against the Doppler: the spectrum is inverted, or I and Q are"
            " swapped (spectrum: inverted; for packed samples see packing.order too)"
        )
    elif drift is not None and abs(drift.clock_ppm) > _CLOCK_PPM + 4.0 * drift.sigma:
        yield rate_finding(stream, signal, -drift.clock_ppm, centre_hz)
    elif len(found) >= 2 and abs(centre_hz) > _USUAL_HZ / 2.0:
        yield (
            f"Dopplers centre on {centre_hz:+.0f} Hz: the oscillator or the intermediate frequency"
            " is off by that"
        )


def rate_finding(
    stream: StreamInfo, signal: Signal, off_ppm: float, doppler_hz: float | None = None
) -> str:
    """What to change when the code runs off the carrier.

    Parameters
    ----------
    off_ppm: by which the stream's sample rate would have to be changed to bring them together.
    doppler_hz: the middle of the Dopplers, which tells what is wrong when much is.
    """
    off_hz = off_ppm * 1e-6 * signal.id.carrier_hz
    rate = f"the sample rate is {stream.sample_rate_hz * (1.0 + off_ppm * 1e-6):.1f} Hz"
    place = f"the intermediate frequency is {stream.intermediate_hz + off_hz:.0f} Hz"
    if doppler_hz is None or abs(off_hz) < _USUAL_HZ:
        causes = f"{rate}, or {place}"
    else:
        causes = place if abs(doppler_hz - off_hz) < _USUAL_HZ else rate
    return f"codes run {-off_ppm:+.2f} ppm against the carriers: {causes}"


def find_satellites(
    block: SampleBlock, signal: Signal, doppler_max_hz: float = _USUAL_HZ
) -> list[Acquisition]:
    """Satellites found in a block of milliseconds, strongest first; whole periods are used."""
    seconds = len(block.samples) / block.stream.sample_rate_hz
    periods = int(seconds / signal.period_s + 1e-6)
    coherent, blocks = (min(periods // 2, 10), 2) if periods >= 2 else (1, 1)
    if periods < 1:
        return []
    settings = AcquisitionSettings(
        doppler_max_hz=doppler_max_hz,
        coherent_s=coherent * signal.period_s,
        noncoherent=blocks,
    )
    sums = running_sums(block, signal.id.carrier_hz)
    with ThreadPoolExecutor() as pool:
        results = cold_search(sums, sums.first, signal, settings, executor=pool)
    return sorted((one for one in results if one.found), key=lambda one: -one.peak_ratio)


def code_drift(
    before: Sequence[Acquisition], after: Sequence[Acquisition], signal: Signal, seconds: float
) -> Drift | None:
    """Compare code phases `seconds` apart with Doppler: a line fit over satellites seen twice."""
    later = {one.prn: one for one in after}
    pairs = [(one, later[one.prn]) for one in before if one.prn in later]
    if len(pairs) < 3:
        return None
    length = signal.id.code_chips
    doppler_hz = np.array([(a.doppler_hz + b.doppler_hz) / 2.0 for a, b in pairs])
    moved = np.array([b.code_chips - a.code_chips for a, b in pairs])
    moved -= signal.id.chip_rate_hz * seconds
    moved = (moved - moved[0] + length / 2.0) % length - length / 2.0 + _wrapped(moved[0], length)
    rate = moved / seconds  # chips/s beyond the nominal chip rate
    expected = doppler_hz / signal.carrier_to_code
    spread = expected - expected.mean()
    power = float(np.sum(spread**2))
    if power == 0.0:
        return None
    ratio = float(np.sum(spread * rate) / power)
    sigma = math.sqrt(2.0) * _CODE_SIGMA_CHIPS / seconds / math.sqrt(power)
    clock_ppm = float(np.mean(rate - ratio * expected)) / signal.id.chip_rate_hz * 1e6
    return Drift(ratio, sigma, clock_ppm)


def repetition_rate_hz(block: SampleBlock, period_s: float = 1e-3) -> float | None:
    """Sample rate at which the codes in a block repeat every `period_s`; None if nothing does.

    All satellites repeat their code, whatever their Doppler: the autocorrelation of the whitened
    samples has a peak there. Needs about 0.1 s of strong signals.
    """
    z = _analytic(block)
    size = scipy.fft.next_fast_len(2 * z.size)
    spectrum = scipy.fft.fft(z, size)
    power = np.abs(spectrum) ** 2
    smooth = _smooth(power, size // 2048)
    if not np.any(smooth):
        return None
    power = np.minimum(power / np.maximum(smooth, smooth.max() * 1e-9), 20.0)  # lines cut off
    correlation = np.abs(scipy.fft.ifft(power)[: z.size // 4])
    correlation /= float(np.median(correlation)) / math.sqrt(math.log(4.0))  # Rayleigh: σ = 1
    correlation[: int(period_s * _SLOWEST_HZ)] = 0.0
    peaks = np.argsort(-correlation)[:_PEAKS]
    periods = [lag / k for lag in peaks[correlation[peaks] > 6.0].tolist() for k in range(1, 21)]
    candidates = [p for p in periods if p > period_s * _SLOWEST_HZ]
    scores = [_comb_score(correlation, candidate) for candidate in candidates]
    if not scores or max(scores) < _CLEAR_COMB:
        return None
    # multiples of the period score as well as itself, fractions clearly less
    good = [c for c, score in zip(candidates, scores, strict=True) if score > 0.75 * max(scores)]
    coarse = min(good)
    lags = [round(k * coarse) for k in range(1, 21)]
    best = max((lag for lag in peaks.tolist() if any(abs(lag - m) <= 1 for m in lags)), default=0)
    period = best / round(best / coarse) if best else coarse
    return _round_rate(period / period_s)


def _comb_score(correlation: FloatArray, period: float) -> float:
    """Mean height, σ, of the autocorrelation at eight multiples of a period; one cannot rule."""
    lags = np.rint(period * np.arange(1, 9)).astype(np.int64)
    lags = lags[lags + 1 < correlation.size]
    heights = np.max([correlation[lags - 1], correlation[lags], correlation[lags + 1]], axis=0)
    return float(np.mean(np.minimum(heights, 20.0))) if lags.size >= 4 else 0.0


# --- descriptions tried when nothing is found ----------------------------------------------------


def _wrong_rate_hz(read: Reader, first: int, signal: Signal) -> float | None:
    """Sample rate by the codes' repetition, if it is not the one described."""
    stream = read(first, 0).stream
    count = min(_REPEAT_SAMPLES, stream.sample_count - first)
    rate_hz = repetition_rate_hz(read(first, count), signal.period_s)
    if rate_hz is None or abs(rate_hz / stream.sample_rate_hz - 1.0) < 1e-4:
        return None
    return rate_hz


def _alternatives(block: SampleBlock) -> Iterator[tuple[SampleBlock, str]]:
    """Blocks under other descriptions, and what to tell when satellites appear."""
    stream = block.stream
    if stream.is_complex and stream.intermediate_hz:
        yield (
            _moved(block, -stream.intermediate_hz),
            "satellites appear with the other sign: wrong sign of intermediate_frequency, or the"
            " spectrum inverted, or I and Q swapped",
        )
    for place_hz, name in ((0.0, "0"), (stream.sample_rate_hz / 4.0, "a quarter of the rate")):
        if place_hz != abs(stream.intermediate_hz):
            yield (
                _moved(block, place_hz),
                f"satellites appear with the intermediate frequency at {name}",
            )


def _moved(block: SampleBlock, intermediate_hz: float) -> SampleBlock:
    """The same samples said to lie elsewhere."""
    return replace(block, stream=replace(block.stream, intermediate_hz=intermediate_hz))


def convincing(found: Sequence[Acquisition]) -> bool:
    """Two satellites, or one far above the threshold: no matter of chance."""
    return len(found) >= 2 or any(one.peak_ratio > 2.0 * one.threshold for one in found)


def _drift(
    read: Reader, first: int, signal: Signal, found: Sequence[Acquisition], reach_hz: float
) -> Drift | None:
    stream = _block(read, first, 0.0).stream
    rest_s = (stream.sample_count - first) / stream.sample_rate_hz - _SEARCH_S
    if rest_s < 0.3 or len(found) < 3:
        return None
    later = first + round(min(rest_s, _DRIFT_S) * stream.sample_rate_hz)
    again = find_satellites(_block(read, later, _SEARCH_S), signal, reach_hz)
    if not again:
        return None
    return code_drift(
        found, again, signal, (again[0].first - found[0].first) / stream.sample_rate_hz
    )


def _block(read: Reader, first: int, seconds: float) -> SampleBlock:
    """Samples from `first` on, as many as there are of those wanted."""
    stream = read(first, 0).stream
    return read(first, min(round(seconds * stream.sample_rate_hz), stream.sample_count - first))


def _wrapped(chips: float, length: int) -> float:
    return (chips + length / 2.0) % length - length / 2.0


def _analytic(block: SampleBlock) -> NDArray[np.complex64]:
    """Samples as complex numbers without mean; real ones by their positive frequencies."""
    samples = block.samples.astype(np.float32)
    if block.stream.is_complex:
        z = samples[:, 0] + 1j * samples[:, 1]
        centred: NDArray[np.complex64] = (z - z.mean()).astype(np.complex64)
        return centred
    spectrum = scipy.fft.fft(samples - samples.mean())
    spectrum[samples.size // 2 :] = 0.0
    analytic: NDArray[np.complex64] = scipy.fft.ifft(spectrum).astype(np.complex64)
    return analytic


def _smooth(power: FloatArray, width: int) -> FloatArray:
    """Moving mean over `width` bins, around the circle."""
    width = max(width | 1, 3)
    padded = np.pad(power.astype(np.float64), width // 2, mode="wrap")
    total = np.cumsum(np.concatenate([[0.0], padded]))
    smooth: FloatArray = (total[width:] - total[:-width]) / width
    return smooth


def _round_rate(rate_hz: float) -> float:
    """The roundest number within one part in 10⁴: rates are rarely anything else."""
    for digits in range(1, 8):
        rounded = float(f"{rate_hz:.{digits}g}")
        if abs(rounded / rate_hz - 1.0) < 1e-4:
            return rounded
    return rate_hz
