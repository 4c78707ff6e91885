"""Lost and inserted samples, found by what they do to the code phases of all satellites at once.

A few milliseconds here and there show where each code stands. Between two such places every
satellite's code moves as its Doppler says; a common jump of all is a slip of the sample count,
known modulo one code period. Halving the stretch narrows its place to a millisecond or two, and
the sample where the old alignment stops and the new one starts to correlate does the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.special
from numpy.typing import NDArray

from deepgnss.core.records import ComplexArray, FloatArray, RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    cold_search,
    search,
)
from deepgnss.receiver.acquisition_grid import Periods, code_spectrum, cut, doppler_rows
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.precise import half_band_hz, replica
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal

Reader = Callable[[int, int], SampleBlock]  # (first sample, count) → samples

_SEARCH = AcquisitionSettings(doppler_max_hz=12e3, coherent_s=0.005, noncoherent=2)
_FOLLOW = AcquisitionSettings(coherent_s=0.005, noncoherent=2)
_GOOD_VIEW = 5  # satellites
_SATELLITES = 8  # the strongest ones are used
_WEAKEST_DBHZ = 36.0
_ENOUGH = 60.0  # energy over noise density, of all satellites, that a probe shall have
_LONGEST_PROBE = 10  # code periods
_HOP_S = 0.01  # between probes, at least
_FOLLOW_S = 0.1  # between measurements of the satellites one by one
_PROBES = 200  # at most, over the whole recording
_FALSE_ALARM = 1e-6  # of a probe's joint peak
_SAME_CHIPS = 0.4  # probes this close agree
_STEPS_PER_PERIOD = 256  # of the search for the very sample


@dataclass(frozen=True, slots=True)
class SampleSlip:
    """A place where the count of samples jumps.

    sample: the first one after the jump, to ± uncertainty. lost: samples missing there (negative:
    too many), known modulo `modulo`, the samples of a code period; the smallest is given.
    """

    sample: int
    uncertainty: int
    lost: int
    modulo: float


@dataclass(frozen=True, slots=True)
class Continuity:
    """What was looked at, and what was found."""

    satellites: tuple[str, ...]  # empty: nothing to judge by
    probes: int
    slips: tuple[SampleSlip, ...]


class _Track(NamedTuple):
    """A satellite's code as a straight line in time."""

    prn: int
    sample: int
    code_chips: float
    doppler_hz: float
    snr_s: float  # C/N0, 1/s

    def code_at(self, sample: float, stream: StreamInfo, signal: Signal) -> float:
        rate = signal.id.chip_rate_hz * (1.0 + self.doppler_hz / signal.id.carrier_hz)
        chips = self.code_chips + (sample - self.sample) / stream.sample_rate_hz * rate
        return chips % signal.id.code_chips


class _Scene(NamedTuple):
    """All that stays the same while probing."""

    read: Reader
    stream: StreamInfo
    signal: Signal
    tracks: tuple[_Track, ...]
    periods: int  # of a probe

    @property
    def probe_samples(self) -> int:
        return math.ceil(self.periods * self.period_samples) + 2

    @property
    def period_samples(self) -> float:
        return self.signal.period_s * self.stream.sample_rate_hz


class _Probe(NamedTuple):
    """Joint shift of all codes in a short stretch, chips; None where nothing can be seen."""

    first: int
    last: int  # sample after it
    shift_chips: float | None


def find_sample_slips(
    read: Reader, stream: StreamInfo, signal: Signal = GPS_L1CA_SIGNAL
) -> Continuity:
    """Find where samples were lost or inserted in a recording.

    Two slips closer together than a few milliseconds count as one, with the sum of their sizes.

    Parameters: read, (first sample, count) → block of `stream`.
    """
    anchor, found = _anchor(read, stream, signal)
    tracks = _tracks(found, anchor)
    if len(tracks) < 2:
        return Continuity((), 0, ())
    strength = sum(track.snr_s for track in tracks) * signal.period_s
    periods = min(max(math.ceil(_ENOUGH / strength), 1), _LONGEST_PROBE)
    scene = _Scene(read, stream, signal, tracks, periods)
    firsts = _places(scene)
    start = min(range(len(firsts)), key=lambda n: abs(firsts[n] - anchor))
    probes = [_probe(scene, firsts[start])]
    slips: list[SampleSlip] = []
    for way in (1, -1):
        here, before = scene, probes[0]
        stop = len(firsts) if way > 0 else -1
        for n in range(start + way, stop, way):
            now = _probe(here, firsts[n])
            probes.append(now)
            if now.shift_chips is None:
                continue
            if before.shift_chips is None:
                before = now
            elif abs(_wrap(now.shift_chips - before.shift_chips, here)) > _SAME_CHIPS:
                pair = (before, now) if way > 0 else (now, before)
                slips += _between(here, *pair)
            aged = abs(now.first - here.tracks[0].sample) > _FOLLOW_S * stream.sample_rate_hz
            if aged or abs(now.shift_chips) > _SAME_CHIPS:
                here = _followed(here, now, way)
                now = now._replace(shift_chips=0.0)
            before = now
    names = tuple(signal.satellite(track.prn) for track in tracks)
    return Continuity(names, len(probes), tuple(sorted(slips, key=lambda slip: slip.sample)))


# --- satellites ----------------------------------------------------------------------------------


def _sums(read: Reader, first: int, count: int, signal: Signal) -> RunningSums:
    return running_sums(read(first, count), signal.id.carrier_hz)


def _search_samples(stream: StreamInfo, settings: AcquisitionSettings) -> int:
    seconds = settings.coherent_s * settings.noncoherent
    return math.ceil(seconds * stream.sample_rate_hz) + 2


def _anchor(read: Reader, stream: StreamInfo, signal: Signal) -> tuple[int, list[Acquisition]]:
    """A place where satellites are well seen: the first good one, or the best, of three."""
    count = _search_samples(stream, _SEARCH)
    if stream.sample_count < count:
        return 0, []
    best: tuple[int, list[Acquisition]] = (0, [])
    for share in (0.5, 0.2, 0.8):
        first = int(share * (stream.sample_count - count))
        found = [
            one
            for one in cold_search(_sums(read, first, count, signal), first, signal, _SEARCH)
            if one.found and one.cn0_dbhz > _WEAKEST_DBHZ
        ]
        if len(found) > len(best[1]):
            best = first, found
        if len(found) >= _GOOD_VIEW:
            break
    return best


def _tracks(found: Sequence[Acquisition], first: int) -> tuple[_Track, ...]:
    strongest = sorted(found, key=lambda one: -one.cn0_dbhz)[:_SATELLITES]
    return tuple(
        _Track(one.prn, first, one.code_chips, one.doppler_hz, 10.0 ** (one.cn0_dbhz / 10.0))
        for one in strongest
    )


def _followed(scene: _Scene, probe: _Probe, way: int) -> _Scene:
    """The tracks moved on to a probe, with Doppler and code measured anew where they can be.

    The samples measured lie on the far side of the probe: what was passed may hold a slip.
    """
    stream, signal = scene.stream, scene.signal
    count = _search_samples(stream, _FOLLOW)
    first = probe.first if way > 0 else probe.last - count
    first = min(max(first, 0), stream.sample_count - count)
    shift = probe.shift_chips or 0.0
    moved = []
    sums = _sums(scene.read, first, count, signal)
    for track in scene.tracks:
        code = (track.code_at(first, stream, signal) + shift) % signal.id.code_chips
        now = track._replace(sample=first, code_chips=code)
        seen = search(
            sums, first, signal, track.prn, _FOLLOW, SearchWindow(track.doppler_hz, 100, code, 0.5)
        )
        if seen.found and abs(seen.doppler_hz - track.doppler_hz) < 100.0:
            now = now._replace(code_chips=seen.code_chips, doppler_hz=seen.doppler_hz)
        moved.append(now)
    return scene._replace(tracks=tuple(moved))


# --- probes --------------------------------------------------------------------------------------


def _places(scene: _Scene) -> list[int]:
    """First samples of all probes: evenly spread, the first and the last at the very ends."""
    last = scene.stream.sample_count - scene.probe_samples
    hop = max(_HOP_S * scene.stream.sample_rate_hz, last / _PROBES)
    return [int(place) for place in np.linspace(0, last, math.ceil(last / hop) + 1)]


def _probe(scene: _Scene, first: int) -> _Probe:
    """Joint shift against the tracks at a place."""
    sums = _sums(scene.read, first, scene.probe_samples, scene.signal)
    periods = cut(sums, first, scene.signal, scene.periods)
    last = first + scene.probe_samples
    joint = np.zeros(periods.cells)
    for track in scene.tracks:
        power = _power(periods, track, scene)
        joint += power / np.median(power) * _median_share(1)
    chip = periods.cells / scene.signal.id.code_chips
    best = int(joint.argmax())
    satellites = len(scene.tracks)
    threshold = scipy.special.gammainccinv(satellites, _FALSE_ALARM / joint.size)
    if joint[best] < threshold:
        return _Probe(first, last, None)
    left, mid, right = np.sqrt(joint[[best - 1, best, (best + 1) % joint.size]])
    # The peak of a triangle, however its top is rounded, lies where its sides say.
    fraction = 0.5 * (right - left) / (mid - min(left, right))
    shift = (best + fraction) / chip
    half = 0.5 * scene.signal.id.code_chips
    return _Probe(first, last, (shift + half) % (2.0 * half) - half)


def _median_share(blocks: int) -> float:
    """Median over mean of noise power."""
    return float(scipy.special.gammaincinv(blocks, 0.5)) / blocks


def _power(periods: Periods, track: _Track, scene: _Scene) -> FloatArray:
    """Correlation power over code phase, the predicted one first; mean of noise not normalized."""
    doppler_hz = np.array([track.doppler_hz])
    rows = doppler_rows(periods, doppler_hz, scene.periods)
    code = code_spectrum(scene.signal.id.name, track.prn, periods.cells, periods.cells)
    wavenumber = scipy.fft.fftfreq(periods.cells)
    chips = track.code_at(periods.first, scene.stream, scene.signal) - periods.half_sample_chips
    cells = chips * periods.cells / scene.signal.id.code_chips
    # Shift by a fraction of a cell, so that all satellites' predictions fall on cell 0.
    steered = rows[0, 0] * code * np.exp(-2j * np.pi * wavenumber * cells)
    return np.asarray(np.abs(scipy.fft.fft(steered)) ** 2, dtype=np.float64)


# --- from a stretch to a sample ------------------------------------------------------------------


def _between(scene: _Scene, before: _Probe, after: _Probe) -> Iterator[SampleSlip]:
    """Slips between two probes that do not agree; shifts are against the scene's tracks."""
    if before.shift_chips is None or after.shift_chips is None:
        return
    if abs(_wrap(after.shift_chips - before.shift_chips, scene)) < _SAME_CHIPS:
        return
    length = scene.probe_samples
    if after.first - before.first > 2 * length:
        middle = _probe(scene, (before.first + after.first) // 2)
        if middle.shift_chips is not None:
            yield from _between(scene, before, middle)
            yield from _between(scene, middle, after)
            return
    yield _place(scene, before, after)


def _wrap(chips: float, scene: _Scene) -> float:
    length = scene.signal.id.code_chips
    return (chips + 0.5 * length) % length - 0.5 * length


def _place(scene: _Scene, before: _Probe, after: _Probe) -> SampleSlip:
    """The most likely sample of a slip: where the old codes end and the new ones begin."""
    block = scene.read(before.first, after.last - before.first)
    step = max(1, int(scene.period_samples / _STEPS_PER_PERIOD))
    old = [_pieces(scene, block, track, before.shift_chips or 0.0, step) for track in scene.tracks]
    new = [_pieces(scene, block, track, after.shift_chips or 0.0, step) for track in scene.tracks]
    score: FloatArray = np.zeros(old[0][0].size + 1)
    for (old_sums, noise), (new_sums, _) in zip(old, new, strict=True):
        head = np.concatenate([[0.0], np.cumsum(old_sums)])
        tail = np.concatenate([[0.0], np.cumsum(new_sums)])
        # Powers over the noise each sum holds, as a likelihood has them.
        held = np.arange(score.size) + 0.5
        score += np.abs(head) ** 2 / (noise * held)
        score += np.abs(tail[-1] - tail) ** 2 / (noise * held[::-1])
    best = int(score.argmax())
    near = np.flatnonzero(score > score[best] - 4.0)
    chips = _wrap((after.shift_chips or 0.0) - (before.shift_chips or 0.0), scene)
    lost = chips / scene.signal.id.chip_rate_hz * scene.stream.sample_rate_hz
    return SampleSlip(
        sample=before.first + best * step,
        uncertainty=step * (1 + max(best - int(near[0]), int(near[-1]) - best)),
        lost=round(lost),
        modulo=scene.period_samples,
    )


def _pieces(
    scene: _Scene, block: SampleBlock, track: _Track, shift_chips: float, step: int
) -> tuple[ComplexArray, float]:
    """Correlation of consecutive pieces of `step` samples, and the noise power of one."""
    stream, signal = scene.stream, scene.signal
    table = replica(signal.id.name, track.prn, half_band_hz(block)).table
    samples = block.samples.astype(np.float64)
    values = samples[:, 0] + 1j * samples[:, 1] if samples.ndim == 2 else samples
    n = np.arange(values.size)
    rate = signal.id.chip_rate_hz * (1.0 + track.doppler_hz / signal.id.carrier_hz)
    start_chips = track.code_at(block.first, stream, signal) + shift_chips
    chips = (start_chips + n * (rate / stream.sample_rate_hz)) % signal.id.code_chips
    places = chips * ((table.size - 1) / signal.id.code_chips)
    mix_hz = stream.intermediate_hz + signal.id.carrier_hz - stream.centre_hz + track.doppler_hz
    turn = np.exp(-2j * np.pi * (mix_hz / stream.sample_rate_hz) * n)
    product = values * np.interp(places, np.arange(table.size), table) * turn
    starts: NDArray[np.int64] = np.arange(0, values.size - step + 1, step)
    noise = float(np.mean(np.abs(product) ** 2)) * step
    return np.add.reduceat(product[: starts.size * step], starts), noise
