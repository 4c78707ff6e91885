"""From delays to what the kernel adds: a row of phase cubics and amplitudes for every path.

Level: noise has variance 1 per component, so that A² = 2·(C/N0)/fs for complex samples and
A² = 4·(C/N0)/fs for real ones (power A² or A²/2 over a noise density of 2/fs).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray
from deepgnss.sim.delays import Nodes, hermite_cubics
from deepgnss.sim.navbits import Symbols, sent_symbols
from deepgnss.sim.scenario import Emitter, FrontEnd, Scenario
from deepgnss.sim.synthesis import code_windows

STENCIL: Final = (2, 3)  # nodes the cubics need before the first interval and from its last end on

IntArray = NDArray[np.int64]


class Rows(NamedTuple):
    """Arguments of `add_signals` for a stretch of milliseconds, in its order."""

    amplitude: FloatArray  # (rows, ms)
    carrier_cycles: FloatArray  # (rows, ms, 4)
    code_chips: FloatArray  # (rows, ms, 4)
    chip: IntArray  # (rows, ms)
    period: IntArray  # (rows, ms)
    signs: NDArray[np.int8]  # (rows, periods)
    windows: IntArray  # (rows, chips)
    code_sizes: IntArray  # (rows,)


RowSource = Callable[[Nodes, int], Rows]
"""Nodes from STENCIL[0] before the first millisecond to STENCIL[1] after the last, its number."""


def amplitude(cn0_dbhz: float, front_end: FrontEnd) -> float:
    """Signal amplitude over noise of variance 1 per component."""
    power = 2.0 if front_end.is_complex else 4.0
    return math.sqrt(power * 10.0 ** (cn0_dbhz / 10.0) / front_end.sample_rate_hz)


def row_source(scenario: Scenario, front_end: FrontEnd) -> RowSource:
    """Function that makes the rows of all emitters a front end hears; silent ones are left out."""
    heard = np.array(
        [k for k, e in enumerate(scenario.emitters) if front_end.hears(e.signal.id)], dtype=np.int64
    )
    emitters = [scenario.emitters[k] for k in heard]
    symbols = [symbols_of(scenario, emitter) for emitter in emitters]
    schedules = [_schedule(emitter, front_end) for emitter in emitters]
    longest = max((e.signal.id.code_chips for e in emitters), default=1)
    windows = np.zeros((len(emitters), longest), dtype=np.int64)
    for row, emitter in enumerate(emitters):
        windows[row, : emitter.signal.id.code_chips] = code_windows(
            emitter.signal.primary_code(emitter.prn)
        )
    sizes = np.array([e.signal.id.code_chips for e in emitters], dtype=np.int64)
    carrier_hz, chip_hz = (
        np.array([getattr(e.signal.id, name) for e in emitters], dtype=np.float64)[:, None]
        for name in ("carrier_hz", "chip_rate_hz")
    )
    residual_hz = carrier_hz - front_end.centre_hz + front_end.sense * front_end.intermediate_hz
    whole_s = math.floor(scenario.start.tow_s)
    fraction_s = scenario.start.tow_s - whole_s

    def rows(nodes: Nodes, first_ms: int) -> Rows:
        ms = np.arange(first_ms, first_ms + nodes.code_s.shape[1] - sum(STENCIL))
        level = np.array([_levels(schedule, ms) for schedule in schedules])
        within = slice(STENCIL[0], STENCIL[0] + ms.size)
        level = level.reshape(-1, 1, ms.size) * nodes.factor[heard][..., within]
        which, path = np.nonzero(level.any(axis=2))
        # The satellite sends f·(its time); mixing takes off (centre − IF)·(receiver time), which
        # leaves −f·delay + (f − centre + IF)·sample_s.
        carrier = hermite_cubics(-carrier_hz * nodes.carrier_s[heard])
        carrier[..., 0] += np.mod(residual_hz * 1.0e-3 * ms, 1.0)
        carrier[..., 1] += residual_hz * 1.0e-3
        # Chips sent since the start of the GPS week, whole seconds apart in integers: a week has
        # 6e11 chips.
        chips_per_ms = np.round(chip_hz / 1000.0).astype(np.int64)
        code = hermite_cubics((fraction_s - nodes.code_s[heard]) * chip_hz)
        code[..., 1] += chips_per_ms
        carrier, code = carrier[which], code[which]
        reflected = np.flatnonzero(path)
        taken = heard[which[reflected]], path[reflected]
        delay_s = _detours(nodes.excess_s[taken], nodes.factor[taken] != 0.0)
        carrier[reflected, :, :2] -= carrier_hz[which[reflected], :, None] * delay_s
        carrier[reflected, :, 0] += 0.5
        code[reflected, :, :2] -= chip_hz[which[reflected], :, None] * delay_s
        whole = np.floor(code[..., 0])
        code[..., 0] -= whole
        base = whole.astype(np.int64) + (whole_s * 1000 + ms) * chips_per_ms[which]
        period, chip = np.divmod(base, sizes[which, None])
        first_period = period.min(axis=1, initial=np.iinfo(np.int64).max) - 1
        count = int((period.max(axis=1, initial=0) - first_period).max(initial=0)) + 4
        signs = np.array(
            [
                _signs(emitters[k], symbols[k], np.arange(first, first + count))
                for k, first in zip(which, first_period, strict=True)
            ],
            dtype=np.int8,
        ).reshape(-1, count)
        return Rows(
            level[which, path],
            carrier,
            code,
            chip,
            period - first_period[:, None],
            signs,
            windows[which],
            sizes[which],
        )

    return rows


def _detours(excess_s: FloatArray, heard: NDArray[np.bool_]) -> FloatArray:
    """Extra delay of reflected rays, linear from node to node: (rays, ms, 2), start and rise.

    Both inputs (rays, nodes). An excess means nothing where a ray is silent: in its last
    millisecond it goes on as in the one before.
    """
    rise = np.diff(excess_s, axis=1)
    known = heard[:, :-1] & heard[:, 1:]
    rise = np.where(known, rise, 0.0)
    rise[:, 1:] = np.where(~known[:, 1:], rise[:, :-1], rise[:, 1:])
    both = np.stack([np.where(heard, excess_s, 0.0)[:, :-1], rise], axis=2)
    before, after = STENCIL
    return both[:, before : both.shape[1] + 1 - after]


def symbols_of(scenario: Scenario, emitter: Emitter) -> Symbols:
    """What an emitter sends during the recording, and a little before and after."""
    ephemeris = scenario.orbit_set(emitter.satellite)
    return sent_symbols(emitter.signal, scenario.nav, ephemeris, scenario.start, scenario.seconds)


def _schedule(emitter: Emitter, front_end: FrontEnd) -> tuple[FloatArray, FloatArray]:
    """Seconds from which an amplitude holds, and the amplitudes."""
    starts, values = zip(*emitter.cn0_dbhz, strict=True)
    return np.array(starts), np.array([amplitude(dbhz, front_end) for dbhz in values])


def _levels(schedule: tuple[FloatArray, FloatArray], ms: IntArray) -> FloatArray:
    """Amplitude of the free line of sight in each millisecond."""
    starts, values = schedule
    return values[np.maximum(np.searchsorted(starts, ms * 1.0e-3, side="right") - 1, 0)]


def _signs(emitter: Emitter, symbols: Symbols, periods: IntArray) -> NDArray[np.int8]:
    """Symbol × secondary code of code periods (n,) since the start of the GPS week."""
    signal = emitter.signal
    out = symbols.values[periods // signal.symbol_periods - symbols.first]
    if signal.secondary_code:
        secondary = np.array(signal.secondary_code, dtype=np.int8)
        out = out * secondary[periods % secondary.size]
    return out
