"""From a scenario to samples: any stretch of the recording, the same whoever asks and how.

Noise is drawn per fixed block of samples from a counter-based generator keyed by seed and block
number; signals follow polynomials of fixed milliseconds. Threads therefore only share out work.

Level: noise has variance 1 per component, so that A² = 2·(C/N0)/fs for complex samples and
A² = 4·(C/N0)/fs for real ones (power A² or A²/2 over a noise density of 2/fs).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.sim.converter import convert
from deepgnss.sim.delays import Nodes, hermite_cubics, node_source
from deepgnss.sim.navbits import Symbols, lnav_symbols
from deepgnss.sim.scenario import Emitter, FrontEnd, Scenario
from deepgnss.sim.synthesis import add_signal, filter_centred

NOISE_BLOCK: Final = 8192
"""Samples per draw of the noise generator."""

_PIECE_S: Final = 0.016  # about what one thread makes at a time
_STENCIL: Final = (2, 3)  # nodes the cubics need before the first interval and from its last end on

Samples = NDArray[np.float32]


def sample_source(scenario: Scenario, stream: int = 0) -> Callable[[int, int], Samples]:
    """Function (first, count) → samples before the converter, (2, count) as I, Q or (1, count).

    It may be called from several threads.
    """
    front_end = scenario.streams[stream].front_end
    nodes = node_source(scenario)
    symbols = [_symbols(scenario, emitter) for emitter in scenario.emitters]
    taps = low_pass(front_end)
    margin = 0 if taps is None else taps.size // 2
    rows = 2 if front_end.is_complex else 1

    def unfiltered(first: int, count: int) -> Samples:
        if scenario.noise:
            samples = _noise(scenario.seed, first, count, rows)
        else:
            samples = np.zeros((rows, count), dtype=np.float32)
        samples_per_ms = front_end.sample_rate_hz / 1000.0
        first_ms = math.floor(first / samples_per_ms)
        end_ms = math.ceil((first + count) / samples_per_ms) + 1
        before, after = _STENCIL
        window = nodes(first_ms - before, end_ms + after)
        for row, emitter in enumerate(scenario.emitters):
            _add(
                samples,
                first,
                first_ms,
                end_ms,
                scenario,
                front_end,
                emitter,
                window,
                row,
                symbols[row],
            )
        return samples

    def filtered(first: int, count: int) -> Samples:
        if taps is None:
            return unfiltered(first, count)
        out = np.empty((rows, count), dtype=np.float32)
        filter_centred(unfiltered(first - margin, count + 2 * margin), taps, out)
        return out

    return filtered


def recording(scenario: Scenario, stream: int = 0, threads: int = 1) -> Iterator[bytes]:
    """The bytes of a stream, piece by piece in order."""
    samples = sample_source(scenario, stream)
    front_end = scenario.streams[stream].front_end
    sigma = input_sigma(scenario, front_end)
    total = scenario.sample_count(scenario.streams[stream])
    piece = max(round(_PIECE_S * front_end.sample_rate_hz / NOISE_BLOCK), 1) * NOISE_BLOCK

    def make(first: int) -> bytes:
        return convert(samples(first, min(piece, total - first)), sigma, front_end)

    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[Future[bytes]] = deque()
        try:
            for first in range(0, total, piece):
                ahead.append(pool.submit(make, first))
                if len(ahead) > 2 * threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


def amplitude(cn0_dbhz: float, front_end: FrontEnd) -> float:
    """Signal amplitude over noise of variance 1 per component."""
    power = 2.0 if front_end.is_complex else 4.0
    return math.sqrt(power * 10.0 ** (cn0_dbhz / 10.0) / front_end.sample_rate_hz)


def input_sigma(scenario: Scenario, front_end: FrontEnd) -> float:
    """Standard deviation of one component at the converter: what an ideal AGC settles to.

    Signals enter with their level at the start; they lie far below the noise unless it is off.
    """
    signal = sum(amplitude(e.cn0_dbhz[0][1], front_end) ** 2 for e in scenario.emitters)
    taps = low_pass(front_end)
    passed = 1.0 if taps is None else float(np.sum(taps.astype(np.float64) ** 2))
    return math.sqrt((passed if scenario.noise else 0.0) + signal / 2.0)


def low_pass(front_end: FrontEnd) -> NDArray[np.float32] | None:
    """Taps of the front end's filter, unit gain in mid-band; None when there is none."""
    if front_end.bandwidth_hz is None:
        return None
    half_hz, middle_hz = front_end.bandwidth_hz / 2.0, abs(front_end.intermediate_hz)
    if front_end.is_complex:
        edges, through_zero = [half_hz], True
    else:
        edges, through_zero = [middle_hz - half_hz, middle_hz + half_hz], False
    taps = scipy.signal.firwin(
        front_end.filter_taps, edges, pass_zero=through_zero, fs=front_end.sample_rate_hz
    )
    return np.asarray(taps, dtype=np.float32)


def _noise(seed: int, first: int, count: int, rows: int) -> Samples:
    """White Gaussian samples [first, first + count) of variance 1; first ≥ −NOISE_BLOCK."""
    low, high = first // NOISE_BLOCK, -(-(first + count) // NOISE_BLOCK)
    drawn = np.empty((rows, high - low, NOISE_BLOCK), dtype=np.float32)
    for block in range(low, high):
        random = np.random.Generator(np.random.Philox(key=[seed, block + 1]))
        for row in range(rows):
            random.standard_normal(dtype=np.float32, out=drawn[row, block - low])
    start = first - low * NOISE_BLOCK
    return drawn.reshape(rows, -1)[:, start : start + count]


def _symbols(scenario: Scenario, emitter: Emitter) -> Symbols:
    ephemeris = scenario.orbit_set(emitter.satellite)
    return lnav_symbols(scenario.nav, ephemeris, scenario.start, scenario.seconds)


def _add(
    samples: Samples,
    first: int,
    first_ms: int,
    end_ms: int,
    scenario: Scenario,
    front_end: FrontEnd,
    emitter: Emitter,
    window: Nodes,
    row: int,
    symbols: Symbols,
) -> None:
    """Turn one emitter's delays into phase cubics and let the kernel add its signal."""
    ms = np.arange(first_ms, end_ms)
    code_chips, chip_base = _code_cubics(scenario, emitter, window.code_s[row], ms)
    signal = emitter.signal
    add_signal(
        samples,
        first,
        first_ms,
        front_end.sample_rate_hz / 1000.0,
        _carrier_cubics(front_end, emitter, window.carrier_s[row], ms),
        code_chips,
        chip_base,
        _amplitudes(front_end, emitter, ms),
        signal.primary_code(emitter.prn),
        symbols.values,
        symbols.first,
        signal.symbol_periods * signal.id.code_chips,
    )


def _carrier_cubics(
    front_end: FrontEnd, emitter: Emitter, delay_s: FloatArray, ms: NDArray[np.int64]
) -> FloatArray:
    """Carrier phase at the converter, cycles, (milliseconds, 4).

    The satellite sends f·(its time); mixing takes off (centre − IF)·(receiver time), which leaves
    −f·delay + (f − centre + IF)·sample_s.
    """
    carrier_hz = emitter.signal.id.carrier_hz
    residual_hz = carrier_hz - front_end.centre_hz + front_end.intermediate_hz
    cubics: FloatArray = hermite_cubics(-carrier_hz * delay_s[None])[0]
    cubics[:, 0] += np.mod(residual_hz * 1.0e-3 * ms, 1.0)
    cubics[:, 1] += residual_hz * 1.0e-3
    return cubics


def _code_cubics(
    scenario: Scenario, emitter: Emitter, delay_s: FloatArray, ms: NDArray[np.int64]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Chips sent since the signal's time zero: cubics (milliseconds, 4) above whole numbers.

    Whole seconds are kept apart in integers: a week has 6e11 chips.
    """
    rate_hz = emitter.signal.id.chip_rate_hz
    whole_s = math.floor(scenario.start.tow_s)
    cubics = hermite_cubics((scenario.start.tow_s - whole_s - delay_s[None]) * rate_hz)[0]
    chips_per_ms = round(rate_hz / 1000.0)
    cubics[:, 1] += chips_per_ms
    floor = np.floor(cubics[:, 0])
    cubics[:, 0] -= floor
    base = floor.astype(np.int64) + (whole_s * 1000 + ms) * chips_per_ms
    return cubics, base


def _amplitudes(front_end: FrontEnd, emitter: Emitter, ms: NDArray[np.int64]) -> FloatArray:
    """Amplitude in each millisecond."""
    starts = np.array([second for second, _ in emitter.cn0_dbhz])
    values = np.array([amplitude(dbhz, front_end) for _, dbhz in emitter.cn0_dbhz])
    return values[np.maximum(np.searchsorted(starts, ms * 1.0e-3, side="right") - 1, 0)]
