"""The baseband core (SPEC 4): one running sum for all channels, correlations as sums over runs.

The cost of a channel does not grow with the sampling rate: one code period costs some 500
look-ups per tap. Kernels here know samples and chips only, nothing of satellites or loops.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import compilable, kernel, overload, summing_kernel
from deepgnss.core.records import (
    ComplexArray,
    FloatArray,
    NcoCommand,
    PackedSamples,
    RunningSums,
    SampleBlock,
    Samples,
    StreamInfo,
)
from deepgnss.receiver.signals import CodeRuns

_TABLE_BITS = 10
_SAMPLES_PER_CHIP = 96.0  # finer streams are thinned: entries of the sum are left out
_SHARED_HZ = 1.0  # by which the carrier may be off where periods share the phasors of their runs
_SHARED_PERIODS = 20.0
NOTHING_SHARED = -1


@kernel
def sum_complex(
    samples: NDArray[np.integer[Any]],
    total: np.int64,
    lead: int,
    thin: int,
    out: NDArray[np.int64],
) -> tuple[np.int64, int]:
    """Continue a running sum over complex samples (n, 2) that need no mixing.

    The first entry is written after `lead` samples, then one after every `thin`-th.
    Returns the running total and the number of entries written.
    """
    if thin == 1:  # the usual case, without counting
        for n in range(samples.shape[0]):
            total += (np.int64(samples[n, 0]) << 32) + np.int64(samples[n, 1])
            out[n] = total
        return total, samples.shape[0]
    entry = 0
    left = lead
    for n in range(samples.shape[0]):
        total += (np.int64(samples[n, 0]) << 32) + np.int64(samples[n, 1])
        left -= 1
        if left == 0:
            out[entry] = total
            entry += 1
            left = thin
    return total, entry


@kernel
def sum_packed(
    data: NDArray[np.uint8],
    skip: int,
    increments: tuple[NDArray[np.int64], ...],
    total: np.int64,
    out: NDArray[np.int64],
) -> None:
    """As `sum_complex` without thinning, straight from the bytes the samples are packed in.

    increments: (256,) for each sample of a byte: what those up to it add. skip: samples of the
    first byte that come before. out: (samples,), not empty.
    """
    per_byte = len(increments)
    if skip > 0:
        total -= increments[skip - 1][data[0]]
    for k in range(skip, min(per_byte, skip + out.size)):
        out[k - skip] = total + increments[k][data[0]]
    total += increments[per_byte - 1][data[0]]
    rest, whole = out[per_byte - skip :], data[1 : (skip + out.size) // per_byte]
    for b in range(whole.size):
        for k in range(per_byte):
            rest[b * per_byte + k] = total + increments[k][whole[b]]
        total = rest[b * per_byte + per_byte - 1]
    for k in range(rest.size - whole.size * per_byte):
        rest[whole.size * per_byte + k] = total + increments[k][data[data.size - 1]]


class Packed(NamedTuple):
    """Complex samples to be summed as they are, in the bytes their file has."""

    data: NDArray[np.uint8]
    skip: int  # samples of the first byte that come before
    increments: tuple[NDArray[np.int64], ...]  # as of `sum_packed`


class Plain(NamedTuple):
    """Complex samples to be summed as they are."""

    samples: Samples  # (n, 2)


Summable = Packed | Plain


def sum_stretch(source: Summable, first: int, total: np.int64, out: NDArray[np.int64]) -> np.int64:
    """Continue a running sum over the samples from `first` of the source on; the total after them.

    out: (samples,), not empty.
    """
    if isinstance(source, Packed):
        return _stretch_of_packed(source, first, total, out)
    return _stretch_of_plain(source, first, total, out)


@compilable
def _stretch_of_packed(
    source: Packed, first: int, total: np.int64, out: NDArray[np.int64]
) -> np.int64:
    per_byte = len(source.increments)
    before = source.skip + first
    data = source.data[before // per_byte : -(-(before + out.size) // per_byte)]
    sum_packed(data, before % per_byte, source.increments, total, out)
    return np.int64(out[out.size - 1])


@compilable
def _stretch_of_plain(
    source: Plain, first: int, total: np.int64, out: NDArray[np.int64]
) -> np.int64:
    total, _ = sum_complex(source.samples[first : first + out.size], total, 1, 1, out)
    return total


@overload(sum_stretch)  # type: ignore[untyped-decorator]
def _sum_stretch(source: Any, first: Any, total: Any, out: Any) -> Any:
    """What `sum_stretch` is in a kernel: the kind of source is known when it is compiled."""
    chosen = _stretch_of_packed if source.instance_class is Packed else _stretch_of_plain

    def stretch(source: Any, first: Any, total: Any, out: Any) -> Any:
        return chosen(source, first, total, out)

    return stretch


@kernel
def sum_mixed(
    samples: NDArray[np.integer[Any]],
    total: np.int64,
    lead: int,
    thin: int,
    turn: np.uint64,
    increment: np.uint64,
    table: NDArray[np.int64],
    out: NDArray[np.int64],
) -> tuple[np.int64, int]:
    """As `sum_complex` of samples·e^{−j2π·turn}; turn and its increment in 2⁻⁶⁴ cycles.

    samples: (n, 1) real or (n, 2) complex. table: (2¹⁰, 2) packed e^{−jθ} and j·e^{−jθ}.
    """
    entry = 0
    left = lead
    shift = np.uint64(64 - _TABLE_BITS)
    is_complex = samples.shape[1] == 2
    for n in range(samples.shape[0]):
        row = turn >> shift
        total += np.int64(samples[n, 0]) * table[row, 0]
        if is_complex:
            total += np.int64(samples[n, 1]) * table[row, 1]
        turn += increment
        left -= 1
        if left == 0:
            out[entry] = total
            entry += 1
            left = thin
    return total, entry


@summing_kernel
def run_phasors(
    edges: FloatArray,
    signs: FloatArray,
    cycles_per_chip: float,
    real: FloatArray,
    imag: FloatArray,
    steps_real: FloatArray,
    steps_imag: FloatArray,
) -> None:
    """What a running sum counts at each edge of a code: steps (runs + 1,) of the signed carrier.

    The carrier is taken at the runs' middles, at phase 0 in the middle of the code. real, imag:
    room for (runs,) values. By Abel's summation one look-up an edge is left.
    """
    runs = signs.size
    middle = 0.5 * (edges[0] + edges[runs])
    for k in range(runs):
        x = cycles_per_chip * (0.5 * (edges[k] + edges[k + 1]) - middle)
        x -= math.floor(x + 0.5)
        c = abs(x) - 0.25  # cos 2πx = −sin 2πc
        s = math.copysign(0.25 - abs(c), x)  # sin 2πx = sin 2πs
        c2 = c * c
        s2 = s * s
        real[k] = (
            -signs[k]
            * c
            * (  # Taylor to c¹¹: within 6e-8 for |c| ≤ 1/4
                6.283185307179586
                + c2
                * (
                    -41.341702240399755
                    + c2
                    * (
                        81.60524927607504
                        + c2
                        * (-76.70585975306136 + c2 * (42.05869394489765 - 15.094642576822987 * c2))
                    )
                )
            )
        )
        imag[k] = (
            -signs[k]
            * s
            * (
                6.283185307179586
                + s2
                * (
                    -41.341702240399755
                    + s2
                    * (
                        81.60524927607504
                        + s2
                        * (-76.70585975306136 + s2 * (42.05869394489765 - 15.094642576822987 * s2))
                    )
                )
            )
        )
    steps_real[0] = -real[0]
    steps_imag[0] = -imag[0]
    for k in range(1, runs):
        steps_real[k] = real[k - 1] - real[k]
        steps_imag[k] = imag[k - 1] - imag[k]
    steps_real[runs] = real[runs - 1]
    steps_imag[runs] = imag[runs - 1]


@summing_kernel
def correlate_period(
    packed: NDArray[np.int64],
    base: int,
    start: float,
    entries_per_chip: float,
    edges: FloatArray,
    steps_real: FloatArray,
    steps_imag: FloatArray,
    phase_cycles: float,
    taps_chips: FloatArray,
    out: ComplexArray,
) -> None:
    """Correlate one code period with all taps.

    The period starts at entry base + start of `packed`; phase_cycles is the carrier in its middle,
    the steps are those of `run_phasors`. The prompt (offset 0) gives a sample at an edge whole to
    the nearer chip, as a sampled replica would, so it loses nothing; other taps split it (linear
    interpolation), so that discriminators stay smooth when the sampling rate is a multiple of the
    chip rate.
    """
    turn_real = math.cos(2.0 * math.pi * phase_cycles)
    turn_imag = -math.sin(2.0 * math.pi * phase_cycles)
    reference = packed[base]
    for t in range(taps_chips.size):
        first = start - taps_chips[t] * entries_per_chip
        sum_real = 0.0
        sum_imag = 0.0
        if taps_chips[t] == 0.0:
            for k in range(edges.size):
                index = np.uint64(base + np.int32(first + edges[k] * entries_per_chip + 0.5))
                value = packed[index] - reference
                q_whole = np.int32(value)
                i = np.float64(np.int32((value - q_whole) >> 32))
                q = np.float64(q_whole)
                sum_real += i * steps_real[k] - q * steps_imag[k]
                sum_imag += i * steps_imag[k] + q * steps_real[k]
        else:
            for k in range(edges.size):
                entry = first + edges[k] * entries_per_chip
                whole = np.int32(entry)
                fraction = entry - whole
                index = np.uint64(base + whole)
                before = packed[index]
                lower = before - reference
                ahead = packed[index + np.uint64(1)] - before
                lower_q = np.int32(lower)
                ahead_q = np.int32(ahead)
                lower_i = np.int32((lower - lower_q) >> 32)
                ahead_i = np.int32((ahead - ahead_q) >> 32)
                i = lower_i + fraction * np.float64(ahead_i)
                q = lower_q + fraction * np.float64(ahead_q)
                sum_real += i * steps_real[k] - q * steps_imag[k]
                sum_imag += i * steps_imag[k] + q * steps_real[k]
        out[t] = complex(
            turn_real * sum_real - turn_imag * sum_imag,
            turn_real * sum_imag + turn_imag * sum_real,
        )


@kernel
def correlate_periods(
    packed: NDArray[np.int64],
    first: int,
    step: int,
    sample_rate_hz: float,
    command: NcoCommand,
    edges: FloatArray,
    signs: FloatArray,
    taps_chips: FloatArray,
    skip: int,
    shared: int,
    steps: FloatArray,
    out: ComplexArray,
) -> int:
    """Correlate out.shape[0] code periods under one command, after `skip` that follow it.

    The phasors of one code period serve its neighbours as long as the carrier moves by less than
    1 Hz (0.0005 cycle at a period's ends). Returned is whose are left in steps (4, edges or more),
    to be given as `shared` when the command goes on (−1: nothing is left). `first` is the sample
    of packed[0]. Sums stand between samples, so that sample n fills [n − ½, n + ½): chip edges are
    shifted by half a sample to look them up.
    """
    length = edges[edges.size - 1]
    margin = 4 + int(np.max(np.abs(taps_chips)) * sample_rate_hz / command.code_hz)
    steps_real, steps_imag, real, imag = steps[0], steps[1], steps[2], steps[3]
    # Counted from the command on, so that it does not matter where blocks of samples end.
    moved_hz = abs(command.carrier_hzps) * length / command.code_hz
    sharing = int(max(1.0, min(2.0 * _SHARED_HZ / max(moved_hz, 1e-9), _SHARED_PERIODS)))
    for period in range(out.shape[0]):
        if (skip + period) // sharing != shared:
            shared = (skip + period) // sharing
            ahead = ((shared + 0.5) * sharing * length - command.code_chips) / command.code_hz
            hz = command.carrier_hz + command.carrier_hzps * ahead
            cycles_per_chip = hz / (command.code_hz + command.code_hzps * ahead)
            run_phasors(edges, signs, cycles_per_chip, real, imag, steps_real, steps_imag)
        chips = (skip + period) * length - command.code_chips
        t = chips / command.code_hz
        t = chips / (command.code_hz + 0.5 * command.code_hzps * t)
        t = chips / (command.code_hz + 0.5 * command.code_hzps * t)
        middle = t + 0.5 * length / command.code_hz
        chip_rate = command.code_hz + command.code_hzps * middle
        at_middle = command.carrier_cycles + middle * (
            command.carrier_hz + 0.5 * command.carrier_hzps * middle
        )
        whole = int(t * sample_rate_hz) - margin
        base = (command.sample + whole - first) // step
        behind = first + base * step - command.sample
        correlate_period(
            packed,
            base,
            (t * sample_rate_hz + 0.5 - behind) / step,
            sample_rate_hz / (chip_rate * step),
            edges,
            steps_real,
            steps_imag,
            at_middle - math.floor(at_middle),
            taps_chips,
            out[period],
        )
    return shared


@kernel
def resample_sums(
    packed: NDArray[np.int64],
    start: float,
    entries_per_output: float,
    scale: float,
    out: NDArray[np.complex64],
) -> None:
    """Samples at another rate as differences of the running sum; output m starts at entry
    start + m·entries_per_output."""
    before_i = 0.0
    before_q = 0.0
    reference = packed[int(start)]
    for m in range(out.size + 1):
        entry = start + m * entries_per_output
        whole = int(entry)
        fraction = entry - whole
        lower = packed[whole] - reference
        upper = packed[whole + 1] - reference
        lower_q = np.int32(lower)
        upper_q = np.int32(upper)
        lower_i = np.int32((lower - lower_q) >> 32)
        upper_i = np.int32((upper - upper_q) >> 32)
        i = lower_i + fraction * (np.float64(upper_i) - lower_i)
        q = lower_q + fraction * (np.float64(upper_q) - lower_q)
        if m > 0:
            out[m - 1] = complex((i - before_i) * scale, (q - before_q) * scale)
        before_i = i
        before_q = q


def _mixing_table(amplitude: int) -> NDArray[np.int64]:
    angle = 2.0 * np.pi * (np.arange(2**_TABLE_BITS) + 0.5) / 2**_TABLE_BITS
    real = np.rint(amplitude * np.cos(angle)).astype(np.int64)
    imag = np.rint(-amplitude * np.sin(angle)).astype(np.int64)
    return np.stack([(real << 32) + imag, (-imag << 32) + real], axis=1)


# Largest value of the mixing table by sample width: sums over a code period keep to 31 bits.
_AMPLITUDE = {1: 127, 2: 15}


class RunningSumBuffer:
    """The running sum of one stream, mixed to one carrier, over a sliding window of samples.

    The sum and the mixing phase are anchored to the recording's sample 0, so that results do not
    depend on how the samples were cut into blocks.
    """

    def __init__(self, stream: StreamInfo, carrier_hz: float, capacity: int) -> None:
        """Room for `capacity` samples; older ones are let go by `keep_from`."""
        mix_hz = stream.intermediate_hz + (carrier_hz - stream.centre_hz)
        turns = math.remainder(mix_hz / stream.sample_rate_hz, 1.0)
        self._increment = round(turns * 2**64) % 2**64
        self._stream = stream
        self._thin = max(1, int(stream.sample_rate_hz / (1.023e6 * _SAMPLES_PER_CHIP)))
        self._packed = np.zeros(capacity // self._thin + 2, dtype=np.int64)
        self._table: NDArray[np.int64] | None = None
        self._increments: tuple[NDArray[np.int64], ...] = ()  # of a stream packed in bytes
        self._scale = 1.0
        self._carrier_hz = carrier_hz
        self._entries = 1
        self._total = np.int64(0)
        self._needed = 0
        self.first = 0  # sample of the oldest entry
        self.end = 0  # sample after the newest one summed

    def restart(self, sample: int) -> None:
        """Drop everything and continue at a sample (which must divide by the thinning)."""
        self.first = self.end = sample - sample % self._thin
        self._entries = 1
        self._total = np.int64(0)
        self._packed[0] = 0

    @property
    def grain(self) -> int:
        """Samples per entry."""
        return self._thin

    def append(self, block: SampleBlock) -> None:
        """Sum the next block, which must start where the last one ended and fit the window."""
        if block.first != self.end:
            raise ValueError(f"block starts at sample {block.first}, expected {self.end}")
        count = block.count
        self._make_room(count)
        out = self._packed[self._entries :]
        with np.errstate(over="ignore"):  # as plain Python the wrap-around would be remarked on
            if self.as_they_are:
                if count:
                    source = self.summable(block)
                    self._total = sum_stretch(source, 0, self._total, out[:count])
                written = count
            else:
                written = self._sum(block.samples, out)
        self._entries += written
        self.end += count

    @property
    def as_they_are(self) -> bool:
        """Whether samples are summed as they are: neither mixed nor thinned."""
        return not self._mixed and self._thin == 1

    @property
    def _mixed(self) -> bool:
        return self._increment != 0 or not self._stream.is_complex

    def summable(self, block: SampleBlock) -> Summable:
        """Samples that are summed as they are, for kernels that do it themselves."""
        held = block.held
        if not isinstance(held, PackedSamples):
            return Plain(held)
        if not self._increments:
            values = held.table.astype(np.int64)
            self._increments = (
                *np.cumsum((values[..., 0] << 32) + values[..., 1], axis=1).T.copy(),
            )
        return Packed(held.data, held.skip, self._increments)

    def _sum(self, samples: Samples, out: NDArray[np.int64]) -> int:
        """Entries written."""
        lead = self._thin - self.end % self._thin
        if not self._mixed:
            self._total, written = sum_complex(samples, self._total, lead, self._thin, out)
            return written
        if self._table is None:
            amplitude = _AMPLITUDE[samples.dtype.itemsize]
            self._table = _mixing_table(amplitude)
            self._scale = 1.0 / amplitude
        self._total, written = sum_mixed(
            samples if samples.ndim == 2 else samples[:, np.newaxis],
            self._total,
            lead,
            self._thin,
            np.uint64(self._increment * self.end % 2**64),
            np.uint64(self._increment),
            self._table,
            out,
        )
        return written

    def keep_from(self, sample: int) -> None:
        """Samples before this one are not needed any more; their room is used when it runs out."""
        self._needed = sample

    def _make_room(self, samples: int) -> None:
        if self._entries + samples // self._thin + 1 <= self._packed.size:
            return
        drop = min(max(0, (self._needed - self.first) // self._thin), self._entries - 1)
        kept = self._entries - drop
        self._packed[:kept] = self._packed[drop : self._entries]
        self._entries = kept
        self.first += drop * self._thin
        if self._entries + samples // self._thin + 1 > self._packed.size:
            raise ValueError(f"{samples} more samples do not fit the window of running sums")

    @property
    def sums(self) -> RunningSums:
        """The present window, as a view."""
        return RunningSums(
            packed=self._packed[: self._entries],
            first=self.first,
            step=self._thin,
            scale=self._scale,
            sample_rate_hz=self._stream.sample_rate_hz,
            centre_hz=self._carrier_hz,
        )


def running_sums(block: SampleBlock, carrier_hz: float) -> RunningSums:
    """Running sum of a single block mixed to zero at an RF carrier frequency."""
    buffer = RunningSumBuffer(block.stream, carrier_hz, block.count + 1)
    buffer.restart(block.first)
    skipped = block.first - buffer.first  # entries stand at multiples of the thinning
    if skipped:
        skipped = buffer.grain - skipped
        first = block.first + skipped
        buffer.restart(first)
        block = SampleBlock(block.stream, first, block.samples[skipped:])
    buffer.append(block)
    return buffer.sums


class Correlator(Protocol):
    """`correlate`, or what stands in for it."""

    def __call__(
        self,
        sums: RunningSums,
        command: NcoCommand,
        runs: CodeRuns,
        taps_chips: FloatArray,
        periods: int,
        skip: int = 0,
        /,
    ) -> ComplexArray:
        """Correlations (periods, taps)."""
        ...


def correlate(
    sums: RunningSums,
    command: NcoCommand,
    runs: CodeRuns,
    taps_chips: FloatArray,
    periods: int,
    skip: int = 0,
) -> ComplexArray:
    """Correlate `periods` code periods with every tap, (periods, taps).

    Period 0 is that at the command; `skip` periods are left out before the first. taps_chips:
    offset of each local replica, early positive. Scaled to the input's amplitude.
    """
    out = np.empty((periods, taps_chips.size), dtype=np.complex128)
    correlate_periods(
        sums.packed,
        sums.first,
        sums.step,
        sums.sample_rate_hz,
        command,
        *runs,
        taps_chips,
        skip,
        NOTHING_SHARED,
        np.empty((4, runs.edges.size)),
        out,
    )
    if sums.scale != 1.0:
        out *= sums.scale
    return out


def resample(sums: RunningSums, first: float, rate_hz: float, count: int) -> NDArray[np.complex64]:
    """`count` samples at `rate_hz` from sample `first` on: each the sum of what falls into it.

    Output sample m fills [first − ½ + m·r, first − ½ + (m + 1)·r), r = sample rate / rate_hz.
    """
    out = np.empty(count, dtype=np.complex64)
    resample_sums(
        sums.packed,
        (first - sums.first) / sums.step,
        sums.sample_rate_hz / (rate_hz * sums.step),
        sums.scale,
        out,
    )
    return out
