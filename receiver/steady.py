"""Steady channels: phase locks in which there is nothing to decide, many updates in one call.

The kernel here is the step of `channel` for the case that is nearly always at hand: a Costas loop
on whole symbols, a code loop at its last bandwidth, no open loop to account for. It is put
together of the same parts (`generators`, `discriminators`, `leading`, `locks`), so both come to the
same, to rounding. It stops a channel before the first update after which something would have to
be decided: the channel then does that update by itself, from the same correlations.

No lock of the interpreter is held, so that the channels of two streams run at the same time.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import compilable, kernel
from deepgnss.core.loops import LoopGains
from deepgnss.core.records import ComplexArray, FloatArray, NcoCommand
from deepgnss.receiver.baseband import (
    NOTHING_SHARED,
    Summable,
    correlate_periods,
    sum_stretch,
)
from deepgnss.receiver.decisions import Calm, in_order, lately_dbhz
from deepgnss.receiver.discriminators import costas_arctan, early_minus_late_envelope
from deepgnss.receiver.generators import (
    Rates,
    next_command,
    periods_before,
    run_through,
    seconds_until,
)
from deepgnss.receiver.leading import follow, predicted
from deepgnss.receiver.locks import (
    RECENT,
    USUAL_S,
    LockState,
    averaged,
    coherent_powers,
    mean_shifted_powers,
    next_to_nothing,
    phase_averaged,
    shifted_averaged,
    strength_dbhz,
    stronger_side,
)
from deepgnss.receiver.modes import AidingRate
from deepgnss.receiver.open_loop import MEAN_S, learnt, offset_of
from deepgnss.receiver.sync import decided_signs
from deepgnss.receiver.trackers import NO_CORRECTION, Correction, NcoState, smoothed_hz, totals

NEAR_ENTRIES = 65_536
"""Of running sums, half a MB: all channels go over them before they go on."""


class State(NamedTuple):
    """A channel between two updates."""

    # `NcoCommand`
    sample: int
    carrier_cycles: float
    carrier_hz: float
    carrier_hzps: float
    code_chips: float
    code_hz: float
    code_hzps: float
    code_offset_hz: float
    error_hz: float  # of the frequency, smoothed
    filled: int  # code periods taken under the command
    # `LockState`
    seconds: float
    signal: float
    fast_signal: float
    noise: float
    phase: float
    phase_seconds: float
    down: float
    same: float
    up: float
    # What the command was predicted by, and the mean offset from the prediction.
    aid_hz: float
    aid_hzps: float
    clock_hz: float
    led_hz: float
    led_hzps: float
    offset_hz: float
    offset_seconds: float
    # The source of what is to come: `Grid`, its number of points; 0: unaided.
    points: int
    first: float
    step: float
    ahead: float
    ahead_s: float
    source_clock_hz: float
    fresh: int  # 1: it has not been asked yet
    # The code: its row in the table, and the slope of its discriminator.
    row: int
    slope: float
    # What came of it.
    updates: int  # that are told
    stopped: int  # 1: an update is complete that the channel has to do itself

    def locks(self, recent: FloatArray) -> LockState:
        """What its lock detectors say; recent: (RECENT_KEPT,) powers."""
        return LockState(
            self.seconds,
            self.signal,
            self.fast_signal,
            tuple(recent.tolist()),
            self.noise,
            self.phase,
            self.phase_seconds,
            (self.down, self.same, self.up),
        )


@cache
def records(kind: type[NamedTuple]) -> np.dtype[np.void]:
    """How arrays of a tuple of integers and floats are made up."""
    fields = [(name, np.dtype(of)) for name, of in get_type_hints(kind).items()]
    return np.dtype(fields, align=True)


Record = Any
"""One of an array of `State` or `Update`: types of structured arrays do not know their fields."""


class Loops(NamedTuple):
    """What steady channels of a signal have in common."""

    rates: Rates
    period_s: float
    periods: int  # of an update
    symbol_periods: int
    margin: int  # samples beyond a code period's end that its taps reach
    carrier: LoopGains
    code: LoopGains
    own_rate: bool  # the carrier loop has one
    limits: Calm
    indicator_s: float
    fast_s: float


class Side(NamedTuple):
    """n steady channels of a signal side by side, and what comes of them."""

    loops: Loops
    # All codes (`CodeTable`).
    edges: FloatArray
    signs: FloatArray
    runs: NDArray[np.int64]
    taps_chips: FloatArray
    secondary: FloatArray  # (periods,) signs over an update
    shifts: ComplexArray  # `half_shifts`
    # By channel.
    states: NDArray[np.void]  # (n,) `State`
    recent: FloatArray  # (n, RECENT_KEPT) powers, the last one last
    taken: ComplexArray  # (n, periods, taps)
    cycles: FloatArray  # (n, points) of the predictions
    steps: FloatArray  # (n, 4, edges) phasors of the command under way, …
    shared: NDArray[np.int64]  # (n,) … and whose (`correlate_periods`)
    # What comes of it.
    told: NDArray[np.void]  # (n, updates) `Update`
    symbols: NDArray[np.uint8]  # (n, updates, symbols) 1 for negative


@kernel
def run_stretch(
    source: Summable,
    count: int,
    first: int,
    kept: int,
    room: NDArray[np.int64],
    sides: tuple[Side, ...],
) -> None:
    """Track channels through `count` samples of a source, which begin at sample `first`.

    They are summed a stretch at a time, so that sums stay in the nearest cache; `kept` of them
    before a stretch. room: (entries,) for sums, more than twice as many as are kept.
    """
    room[0] = 0
    total = np.int64(0)
    held, done, begin = 1, 0, first
    while done < count:
        new = min(room.size - held, count - done)
        total = sum_stretch(source, done, total, room[held : held + new])
        held += new
        done += new
        for side in sides:
            run_steady(room[:held], begin, 1, 1.0, side)
        drop = max(0, held - 1 - kept)
        for k in range(held - drop):
            room[k] = room[k + drop]
        held -= drop
        begin += drop


@kernel
def run_steady(packed: NDArray[np.int64], first: int, step: int, scale: float, side: Side) -> None:
    """Track channels as far as running sums go (`packed` from sample `first` on, `scale`)."""
    loops, taken, told = side.loops, side.taken, side.told
    stripped = np.empty(taken.shape[1:], dtype=np.complex128)
    for entries in range(NEAR_ENTRIES, packed.size + NEAR_ENTRIES, NEAR_ENTRIES):
        end = first + (min(entries, packed.size) - 1) * step
        for k in range(side.states.size):
            s = side.states[k]
            row = s.row
            while s.stopped == 0 and s.updates < told.shape[1]:
                command = command_of(s)
                there = min(periods_before(loops.rates, command, end - loops.margin), loops.periods)
                if there > s.filled:
                    due = taken[k, s.filled : there]
                    side.shared[k] = correlate_periods(
                        packed,
                        first,
                        step,
                        loops.rates.sample_hz,
                        command,
                        side.edges[row, : side.runs[row] + 1],
                        side.signs[row, : side.runs[row]],
                        side.taps_chips,
                        s.filled,
                        side.shared[k],
                        side.steps[k],
                        due,
                    )
                    if scale != 1.0:
                        due *= scale
                    s.filled = there
                if s.filled < loops.periods:
                    break
                update(
                    loops,
                    command,
                    taken[k],
                    side.secondary,
                    side.shifts,
                    s,
                    side.recent[k],
                    side.cycles[k, : s.points],
                    told[k, s.updates],
                    side.symbols[k, s.updates],
                    stripped,
                )
                side.shared[k] = NOTHING_SHARED


@compilable
def command_of(s: Record) -> NcoCommand:
    """The command of a channel."""
    return NcoCommand(
        s.sample,
        s.carrier_cycles,
        s.carrier_hz,
        s.carrier_hzps,
        s.code_chips,
        s.code_hz,
        s.code_hzps,
    )


@compilable
def update(
    loops: Loops,
    command: NcoCommand,
    taken: ComplexArray,
    secondary: FloatArray,
    shifts: ComplexArray,
    s: Record,
    recent: FloatArray,
    cycles: FloatArray,
    out: Record,
    symbols: NDArray[np.uint8],
    stripped: ComplexArray,
) -> None:
    """Detect, discriminate, filter, and command; nothing where a decision is called for.

    stripped: room for (periods, taps).
    """
    periods, period_s = loops.periods, loops.period_s
    seconds = periods * period_s

    strip(taken, secondary, loops.symbol_periods, stripped, symbols)
    early, prompt, late = totals(stripped)
    if prompt == 0.0:
        s.stopped = 1
        return

    power, scatter = coherent_powers(stripped, periods)
    phase, phase_seconds, share = phase_averaged(
        s.phase, s.phase_seconds, prompt, seconds, loops.indicator_s
    )
    now = mean_shifted_powers(stripped, shifts)
    shifted = shifted_averaged((s.down, s.same, s.up), now, share)
    means = (s.seconds, s.signal, s.fast_signal, s.noise)
    means = averaged(means, power, scatter, seconds, USUAL_S, loops.fast_s)
    _, signal, fast_signal, noise = means
    lately = power
    for k in range(recent.size - RECENT + 1, recent.size):
        lately += recent[k]
    cn0 = strength_dbhz(signal, noise, period_s)
    fast = lately_dbhz(
        cn0,
        strength_dbhz(fast_signal, noise, period_s),
        strength_dbhz(lately / RECENT, noise, period_s),
        loops.limits.strong,
    )
    if next_to_nothing(power, signal, noise, period_s) or not in_order(
        loops.limits, cn0, fast, phase, stronger_side(shifted)
    ):
        s.stopped = 1
        return

    error = costas_arctan(prompt)
    gains = loops.carrier
    carrier = Correction(gains.phase * error, gains.frequency * error, gains.rate * error)
    error = early_minus_late_envelope(abs(early), abs(late), s.slope)
    code = Correction(loops.code.phase * error, loops.code.frequency * error, 0.0)
    middle_s = seconds_until(loops.rates, command, 0.5 * periods)
    end_s = seconds_until(loops.rates, command, periods)
    generator = NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps)
    run = run_through(loops.rates, generator, carrier, code, NO_CORRECTION, middle_s, end_s)

    led = run.carrier
    aid = AidingRate(s.aid_hz, s.aid_hzps, s.clock_hz)
    if s.points > 0:
        offset = offset_of(run.turned_cycles, aid, run.seconds)
        s.offset_hz, s.offset_seconds = learnt(
            s.offset_hz, s.offset_seconds, offset, run.seconds, MEAN_S
        )
        if s.fresh:
            hz, hzps = predicted(s.first, s.step, s.ahead, s.ahead_s, cycles, command.sample)
            aid = AidingRate(hz, hzps if loops.own_rate else aid.rate_hzps, s.source_clock_hz)
            s.fresh = 0
        there = command.sample + run.samples
        hz, hzps = predicted(s.first, s.step, s.ahead, s.ahead_s, cycles, there)
        lead = follow(
            led,
            s.led_hz,
            s.led_hzps,
            aid,
            AidingRate(hz, hzps, s.source_clock_hz),
            run.samples / loops.rates.sample_hz,
            False,
        )
        led, s.led_hz, s.led_hzps = lead.carrier, lead.led_hz, lead.led_hzps
        s.aid_hz, s.aid_hzps, s.clock_hz = hz, hzps, s.source_clock_hz
    s.code_offset_hz += code.frequency
    following = next_command(loops.rates, command, run, led, s.code_offset_hz, periods)

    s.error_hz = smoothed_hz(s.error_hz, carrier.frequency, 1.0)
    s.seconds, s.signal, s.fast_signal, s.noise = means
    s.phase, s.phase_seconds = phase, phase_seconds
    s.down, s.same, s.up = shifted
    recent[:-1] = recent[1:]
    recent[-1] = power
    s.filled = 0
    s.updates += 1
    put(following, s)
    put(following, out)
    out.phase, out.frequency, out.rate = carrier.phase, carrier.frequency, carrier.rate
    out.middle_s = middle_s
    out.power = power
    out.aid_hz, out.aid_hzps, out.clock_hz = s.aid_hz, s.aid_hzps, s.clock_hz
    out.offset_hz = s.offset_hz
    out.cn0_dbhz = cn0


@compilable
def strip(
    taken: ComplexArray,
    secondary: FloatArray,
    symbol_periods: int,
    out: ComplexArray,
    symbols: NDArray[np.uint8],
) -> None:
    """Take secondary code and, where there are several, symbols off an update's correlations."""
    count = taken.shape[0] // symbol_periods
    sums = np.zeros(count, dtype=np.complex128)
    for k in range(taken.shape[0]):
        out[k] = taken[k] * secondary[k]
        sums[k // symbol_periods] += out[k, 1]
    if count == 1:
        symbols[0] = sums[0].real < 0.0
        return
    signs = decided_signs(sums)
    for k in range(taken.shape[0]):
        out[k] *= signs[k // symbol_periods]
    symbols[:] = signs < 0.0


@compilable
def put(command: NcoCommand, record: Record) -> None:
    """Put a command into a record."""
    record.sample = command.sample
    record.carrier_cycles = command.carrier_cycles
    record.carrier_hz = command.carrier_hz
    record.carrier_hzps = command.carrier_hzps
    record.code_chips = command.code_chips
    record.code_hz = command.code_hz
    record.code_hzps = command.code_hzps
