"""From a scenario to samples: any stretch of a stream, the same whoever asks and how.

Noise is a function of seed, stream and sample number; signals follow polynomials of fixed
milliseconds. Threads therefore only share out work.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import ConfigError
from deepgnss.sim.converter import convert
from deepgnss.sim.delays import Nodes, node_source
from deepgnss.sim.filters import filter_centred, low_pass
from deepgnss.sim.noise import normal_pairs
from deepgnss.sim.rows import STENCIL, amplitude, row_source
from deepgnss.sim.scenario import FrontEnd, Scenario
from deepgnss.sim.seeds import seed_sequence
from deepgnss.sim.synthesis import MOST_CHIPS_PER_SAMPLE, add_signals

PIECE_SAMPLES: Final = 1 << 17
"""About what one thread makes at a time."""

Samples = NDArray[np.float32]
SampleSource = Callable[[int, int], Samples]
NodeSource = Callable[[int, int], Nodes]


class Piece(NamedTuple):
    """Consecutive bytes of one stream."""

    stream: int  # of Scenario.streams
    end: int  # sample after the last one
    data: bytes


def sample_source(
    scenario: Scenario, stream: int = 0, nodes: NodeSource | None = None
) -> SampleSource:
    """Function (first, count) → samples before the converter, (2, count) as I, Q or (1, count).

    It may be called from several threads. nodes: of the stream's antenna, to share them.
    """
    front_end = scenario.streams[stream].front_end
    _check(scenario, front_end)
    nodes = nodes or node_source(scenario, scenario.streams[stream].antenna)
    rows = row_source(scenario, front_end)
    noise = _noise_source(scenario, stream)
    taps = low_pass(front_end)
    margin = 0 if taps is None else taps.size // 2
    samples_per_ms = front_end.sample_rate_hz / 1000.0

    def unfiltered(first: int, count: int) -> Samples:
        samples = noise(first, count)
        first_ms = math.floor(first / samples_per_ms)
        end_ms = math.ceil((first + count) / samples_per_ms) + 1
        window = nodes(first_ms - STENCIL[0], end_ms + STENCIL[1])
        add_signals(samples, first, first_ms, samples_per_ms, *rows(window, first_ms))
        if front_end.inverted and front_end.is_complex:
            samples[1] *= -1.0
        return samples

    def filtered(first: int, count: int) -> Samples:
        if taps is None:
            return unfiltered(first, count)
        samples = unfiltered(first - margin, count + 2 * margin)
        out = np.empty((samples.shape[0], count), dtype=np.float32)
        filter_centred(samples, taps, out)
        return out

    return filtered


def pieces(
    scenario: Scenario, threads: int = 1, streams: Sequence[int] | None = None
) -> Iterator[Piece]:
    """Streams piece by piece (default: all): each in order, abreast in time.

    Streams of one antenna share its delays, which saves time over one after the other.
    """
    chosen = range(len(scenario.streams)) if streams is None else streams
    antennas = {scenario.streams[index].antenna for index in chosen}
    nodes = {antenna: node_source(scenario, antenna) for antenna in antennas}
    makers = {index: _maker(scenario, index, nodes) for index in chosen}
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[Future[Piece]] = deque()
        try:
            for index, first, end in _order(scenario, chosen):
                ahead.append(pool.submit(makers[index], first, end))
                if len(ahead) > 2 * threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


def recording(scenario: Scenario, stream: int = 0, threads: int = 1) -> Iterator[bytes]:
    """The bytes of a stream, piece by piece in order."""
    return (piece.data for piece in pieces(scenario, threads, [stream]))


def notes(scenario: Scenario) -> tuple[str, ...]:
    """What a user should know of streams that can be made but are not what they seem."""
    return tuple(
        f"{stream.name}: {stream.front_end.sample_rate_hz / 1e6:g} Msps keep step with the chips"
        f" of {signal.name}: code delays come in steps of {grid_m:.1f} m"
        for stream in scenario.streams
        for signal in dict.fromkeys(e.signal.id for e in scenario.emitters)
        if stream.front_end.hears(signal)
        and (grid_m := stream.front_end.grid_m(signal)) is not None
    )


def input_sigma(scenario: Scenario, front_end: FrontEnd) -> float:
    """Standard deviation of one component at the converter: what an ideal AGC settles to.

    Signals enter with their level at the start; they lie far below the noise unless it is off.
    """
    heard = [e for e in scenario.emitters if front_end.hears(e.signal.id)]
    signal = sum(amplitude(e.cn0_dbhz[0][1], front_end) ** 2 for e in heard)
    taps = low_pass(front_end)
    passed = 1.0 if taps is None else float(np.sum(taps.astype(np.float64) ** 2))
    return math.sqrt((passed if scenario.noise else 0.0) + signal / 2.0)


def _check(scenario: Scenario, front_end: FrontEnd) -> None:
    """Refuse a rate too low for the codes that are heard."""
    for emitter in scenario.emitters:
        signal = emitter.signal.id
        if (
            front_end.hears(signal)
            and signal.chip_rate_hz > MOST_CHIPS_PER_SAMPLE * front_end.sample_rate_hz
        ):
            raise ConfigError(
                f"sample_rate: {front_end.sample_rate_hz:g} Hz is too low for {signal.name} of"
                f" {signal.chip_rate_hz:g} chips/s"
            )


def _noise_source(scenario: Scenario, stream: int) -> SampleSource:
    """Function (first, count) → white noise of variance 1 per component, or nothing."""
    is_complex = scenario.streams[stream].front_end.is_complex
    key = int(seed_sequence(scenario.seed, "noise", stream).generate_state(1, np.uint64)[0])

    def noise(first: int, count: int) -> Samples:
        if not scenario.noise:
            return np.zeros((1 + is_complex, count), dtype=np.float32)
        if is_complex:
            return normal_pairs(key, first, count)
        low, high = first // 2, (first + count + 1) // 2  # a pair makes two real samples
        values = normal_pairs(key, low, high - low).T.reshape(1, -1)
        return np.ascontiguousarray(values[:, first - 2 * low :][:, :count])

    return noise


def _maker(
    scenario: Scenario, index: int, nodes: Mapping[int, NodeSource]
) -> Callable[[int, int], Piece]:
    """Function that makes samples [first, end) of a stream; nodes: by antenna."""
    stream = scenario.streams[index]
    samples = sample_source(scenario, index, nodes[stream.antenna])
    sigma = input_sigma(scenario, stream.front_end)

    def make(first: int, end: int) -> Piece:
        return Piece(index, end, convert(samples(first, end - first), sigma, stream.front_end))

    return make


def _order(scenario: Scenario, streams: Iterable[int]) -> Iterator[tuple[int, int, int]]:
    """(stream, first, end) of all pieces, by the time at which they begin."""

    def of_stream(index: int) -> Iterator[tuple[float, int, int, int]]:
        total = scenario.sample_count(scenario.streams[index])
        rate_hz = scenario.streams[index].front_end.sample_rate_hz
        for first in range(0, total, PIECE_SAMPLES):
            yield first / rate_hz, index, first, min(first + PIECE_SAMPLES, total)

    return ((index, first, end) for _, index, first, end in heapq.merge(*map(of_stream, streams)))
