"""One channel: generators, correlator call, carrier and code trackers, and a state machine.

A step runs over one interval of whole code periods and reads like the block diagram: generate,
correlate, discriminate, filter, command, lock, decide. Carrier phase runs at +Doppler here; the
observables turn its sign (see `observables`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepgnss.core.loops import settling_time_s
from deepgnss.core.records import (
    ChannelReport,
    ComplexArray,
    Correlations,
    Event,
    FloatArray,
    NcoCommand,
    RunningSums,
)
from deepgnss.receiver.baseband import Correlator, correlate
from deepgnss.receiver.frequency_tracking import (
    LockWatch,
    always_squares,
    noise_bandwidth_hz,
    spectral_lock,
    window_of,
)
from deepgnss.receiver.known_symbols import KnownSymbols, signs
from deepgnss.receiver.locks import (
    FAINT_S,
    NO_LOCK,
    USUAL_S,
    cn0_dbhz,
    faint_cn0_dbhz,
    false_lock_side,
    fast_cn0_dbhz,
    recent_cn0_dbhz,
    restart_phase,
    surely_seen_dbhz,
    update_locks,
    update_powers,
)
from deepgnss.receiver.modes import (
    NO_AIDING,
    TRANSITIONS,
    AidingRate,
    AidingSource,
    Coast,
    Mode,
    TrackingSettings,
    lowest_frequency_lock_dbhz,
    unaided,
)
from deepgnss.receiver.signals import Signal, code_runs, neighbour_correlation
from deepgnss.receiver.sync import (
    BitSync,
    add_prompts,
    decided_signs,
    demodulate,
    start_bit_sync,
    symbol_edge,
)
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    DelayLock,
    FrequencyLock,
    NcoState,
    PhaseLock,
    Tracker,
    accumulate,
    advance,
    corrected,
    scheduled_bandwidth_hz,
)

_REMEMBERED_S = 4.0  # prompts of a frequency-locked stretch kept for bit sync
_HYSTERESIS_DB = 2.0  # below the threshold of phase lock before it is given up
_RETURN_DB = 1.0  # above the threshold of frequency tracking: it is taken up again
_DOUBTED_DB = 3.0  # below the threshold of frequency tracking: a window with nothing to follow
_ABSENT_DB = 7.0  # below that threshold: nothing is there
_FAINT_S = 2.5  # of frequency tracking before its C/N0 is believed
_SETTLING_WINDOWS = 3  # after which a code loop on windows is believed
_LOOP_PRODUCT = 0.4  # bandwidth × window: a wider code loop does not settle
_HISTORY_UPDATES = 3  # commands kept for observables of the epoch before


class Interval(NamedTuple):
    """A command with what was known when it was given, and what it was found to lack.

    The observables read these: generators' state plus correction is the loop's estimate with the
    interval's own correlations taken in, so it is less noisy and lags less than the generators.
    """

    command: NcoCommand
    periods: int  # code periods since the channel started
    code_valid: bool
    phase_valid: bool
    slips: int  # possible cycle slips so far, of the satellite: the number of the arc
    phase_since: int  # sample of phase lock
    cn0_dbhz: float
    half_cycle: float | None  # 0 or ½ cycle once the polarity is known
    correction: Correction = NO_CORRECTION  # what the interval's correlations said of it …
    middle_s: float = 0.0  # … at its middle, s after the command
    coasting: bool = False  # in open loop, by aiding


class Channel:
    """A satellite's signal being tracked."""

    def __init__(
        self,
        signal: Signal,
        prn: int,
        settings: TrackingSettings,
        *,
        sample_rate_hz: float,
        sample: int,
        code_chips: float,
        doppler_hz: float,
        correlator: Correlator = correlate,
        slips: int = 0,
    ) -> None:
        """Start at an integer sample with the code phase there (chips) and a Doppler.

        correlator: what correlates with samples; a model may stand in for it.
        slips: of the satellite in channels before.
        """
        self.signal = signal
        self.satellite = signal.satellite(prn)
        self.settings = settings
        self.mode = Mode.PULL_IN
        self.events: list[Event] = []
        self.recorded: list[Correlations] = []
        self.symbols = bytearray()  # hard decisions since the last phase lock, 1: negative
        self.symbols_first = 0  # code period at which symbols[0] starts
        self.anchor: int | None = None  # code period of the satellite's week at period 0
        self.edge: int | None = None  # period of a symbol edge, modulo the symbol's length
        self.half_cycle: float | None = None  # 0 or ½ cycle once the polarity is known
        self.known: KnownSymbols | None = None  # symbols that need not be guessed
        self.slips = slips
        self.locks = NO_LOCK
        self._correlator = correlator
        self._runs = code_runs(signal.id.name, prn)
        half = settings.spacing_chips / 2.0
        self._taps: FloatArray = np.array([half, 0.0, -half])
        self._rate = sample_rate_hz
        self._sample_chips = signal.id.chip_rate_hz / sample_rate_hz
        self._neighbour = neighbour_correlation(signal.id.name, prn)
        self._length = float(signal.id.code_chips)
        self._margin = 4 + int(2.0 * settings.spacing_chips / self._sample_chips)
        self._history = int(_HISTORY_UPDATES * signal.update_s * sample_rate_hz)
        self._coded = bool(signal.secondary_code)
        self._bit_sync: BitSync = start_bit_sync(signal.secondary, coded=self._coded)
        self._heard: list[tuple[NcoCommand, ComplexArray]] = []  # without phase lock: prompts
        self._heard_first = 0
        faint = settings.frequency
        self._window: list[ComplexArray] = []  # correlations of frequency tracking, no code on
        self._window_updates = int(faint.window_s / signal.update_s + 1e-9)
        self._watch = LockWatch(signal.symbol_s, self._window_updates * signal.update_s, faint.bins)
        self._bit_sync_first = 0
        self._pieces: list[ComplexArray] = []  # of a symbol the lock detectors wait for
        self._symbol_sum = 0j
        self._symbol_periods = 0
        self._aiding = NO_AIDING
        self._since = sample  # sample of the last change of mode
        self._carrier_trackers: dict[Mode, Tracker] = {
            Mode.PULL_IN: FrequencyLock(settings.pull_in_bandwidth_hz, squared=self._coded),
            Mode.FREQUENCY: FrequencyLock(
                settings.frequency_bandwidth_hz, signal.symbol_periods // 4
            ),
            Mode.PHASE: PhaseLock(settings.carrier_order, settings.carrier_bandwidth_hz),
        }
        self._spectral_tracker = spectral_lock(faint)
        self._always_squares = always_squares(faint.discriminator)
        self._off_hz = 0.0  # by which a watched frequency lock is off
        self._blind_tracker = FrequencyLock(settings.frequency_bandwidth_hz, squared=True)
        self._phase_since = sample
        self._phase_valid = False
        self._frequency_error_hz = 0.0
        self._acquired_hz = doppler_hz

        self._restart_code_loop(sample, settings.pull_in_s)
        self.periods = 0
        self._carrier = NcoState(0.0, doppler_hz, 0.0)
        self._code_offset_hz = 0.0
        # The first period starts at the next code epoch after the given sample.
        chip_rate = signal.id.chip_rate_hz * (1.0 + doppler_hz / signal.id.carrier_hz)
        wait_s = (self._length - code_chips % self._length) / chip_rate
        start = sample + int(wait_s * sample_rate_hz)
        chips = ((start - sample) / sample_rate_hz - wait_s) * chip_rate
        self.command = self._command(start, chips)
        self.history: list[Interval] = [self._interval()]
        self._plan()

    # --- the step ----------------------------------------------------------------------------

    def begin_epoch(self) -> None:
        """Forget what the epoch before has told, but the commands observables still need."""
        oldest = self.command.sample - self._history
        self.history = [i for i in self.history if i.command.sample >= oldest]
        self.events = []
        self.recorded = []

    def run(self, sums: RunningSums, aiding: AidingSource = unaided) -> None:
        """Track as far as the running sums go."""
        while self.mode is not Mode.LOST:
            if not self._correlate(sums):
                return
            middle_s, end_s = self._times(self._taken.shape[0])
            seen = self._accumulate()
            self._steer(seen, middle_s, end_s, aiding)
            self._detect(seen)
            self._collect_symbols(seen)
            self._decide(seen)
            self.history.append(self._interval())
            self._plan()

    def _plan(self) -> None:
        """Length of the next interval in code periods, and whether its signs are known."""
        periods = self.signal.update_periods
        if self.edge is not None:
            to_edge = (self.edge - self.periods) % self.signal.symbol_periods
            periods = to_edge % self._full or self._full
        self._coherent = self.edge is not None
        self._taken = np.empty((periods, self._taps.size), dtype=np.complex128)
        self._filled = 0

    def _correlate(self, sums: RunningSums) -> bool:
        """Correlate the code periods at hand; True once the interval is complete."""
        command = self.command
        there_s = (sums.end - self._margin - command.sample) / self._rate
        chips = command.code_chips + there_s * (command.code_hz + 0.5 * there_s * command.code_hzps)
        ready = min(int(chips // self._length), self._taken.shape[0])
        if ready > self._filled:
            self._taken[self._filled : ready] = self._correlator(
                sums, command, self._runs, self._taps, ready - self._filled, self._filled
            )
            self._filled = ready
        return ready == self._taken.shape[0]

    def _times(self, periods: int) -> tuple[float, float]:
        """Middle and end of the next interval, s after the command's sample."""
        command = self.command

        def reach(chips: float) -> float:
            t = (chips - command.code_chips) / command.code_hz
            return (chips - command.code_chips) / (command.code_hz + 0.5 * command.code_hzps * t)

        return reach(0.5 * periods * self._length), reach(periods * self._length)

    def _accumulate(self) -> Accumulated:
        period_s = self.signal.period_s
        if self.settings.record_correlations:
            self.recorded.append(Correlations(self.command.sample, period_s, self._taken))
        blind = self._coded and not self._coherent
        return accumulate(self._stripped(), period_s, self._coherent, blind)

    def _stripped(self) -> ComplexArray:
        """Correlations without the secondary code, and without symbols where there are several."""
        if self.edge is None or not self._coherent:
            return self._taken
        signal, count = self.signal, self._taken.shape[0]
        size = signal.symbol_periods
        if not self._coded and count <= size:
            return self._taken
        signs = np.resize(np.roll(signal.secondary, (self.edge - self.periods) % size), count)
        if count > size:
            symbols = (self._taken[:, 1] * signs).reshape(-1, size).sum(axis=1)
            signs *= np.repeat(decided_signs(symbols), size)
        return np.asarray(self._taken * signs[:, np.newaxis])

    def _steer(
        self, seen: Accumulated, middle_s: float, end_s: float, aiding: AidingSource
    ) -> None:
        """Discriminate, filter, and give the next command."""
        command = self.command
        whole = int(end_s * self._rate)
        elapsed_s = whole / self._rate
        carrier = code = NO_CORRECTION
        if self.mode is Mode.WEAK:
            window = self._complete_window(seen)
            if window is not None:
                carrier = self._spectral_tracker.correct(window)
                code = self._window_code_tracker.correct(
                    self._spectral_tracker.straightened(window)
                )
                middle_s = end_s - 0.5 * window.seconds
        elif self.mode is not Mode.HOLD and 4 * seen.periods.shape[0] >= self._full:
            carrier = self._carrier_tracker.correct(seen)
            code = self._code_tracker.correct(seen)
        self.history[-1] = self.history[-1]._replace(correction=carrier, middle_s=middle_s)
        before = advance(self._carrier, elapsed_s)
        after = corrected(before, carrier, elapsed_s - middle_s)
        self._carrier = self._aided(after, aiding(command.sample + whole), elapsed_s)
        self._frequency_error_hz += 0.3 * (carrier.frequency - self._frequency_error_hz)
        if self._narrow_code_loop():  # a wide loop's noisy rate must not live on
            self._code_offset_hz = 0.0
            code = code._replace(frequency=0.0)
        self._code_offset_hz += code.frequency
        chips = (
            advance(NcoState(command.code_chips, command.code_hz, command.code_hzps), elapsed_s)[0]
            - seen.periods.shape[0] * self._length
            + code.phase
            + code.frequency * (elapsed_s - middle_s)
            + (after.phase - before.phase) / self.signal.carrier_to_code
        )
        self.periods += seen.periods.shape[0]
        self.command = self._command(command.sample + whole, chips)

    def _aided(self, carrier: NcoState, aid: AidingRate, elapsed_s: float) -> NcoState:
        """Carrier with what the prediction says has changed since the last command."""
        was, self._aiding = self._aiding, aid
        if NO_AIDING in (was, aid):  # it begins or ends: a loop with a rate of its own goes on
            return carrier if self._has_own_rate else carrier._replace(rate=aid.rate_hzps)
        step_hz = aid.frequency_hz - (was.frequency_hz + elapsed_s * was.rate_hzps)
        if self.mode is Mode.HOLD:
            step_hz += aid.clock_hz - was.clock_hz
        return NcoState(
            carrier.phase,
            carrier.frequency + step_hz,
            carrier.rate + aid.rate_hzps - was.rate_hzps,
        )

    @property
    def _has_own_rate(self) -> bool:
        settings = self.settings
        return (self.mode is Mode.PHASE and settings.carrier_order == 3) or (
            self.mode is Mode.WEAK and settings.frequency.order == 2
        )

    def _command(self, sample: int, code_chips: float) -> NcoCommand:
        carrier, to_code = self._carrier, self.signal.carrier_to_code
        return NcoCommand(
            sample,
            carrier.phase,
            carrier.frequency,
            carrier.rate,
            code_chips,
            self.signal.id.chip_rate_hz + carrier.frequency / to_code + self._code_offset_hz,
            carrier.rate / to_code,
        )

    # --- parts of the moment -----------------------------------------------------------------

    @property
    def _full(self) -> int:
        """Periods of an undivided interval; frequency is seen best over whole symbols."""
        if self.mode is not Mode.PHASE:
            return self.signal.update_periods
        symbol = self.signal.symbol_periods
        periods = min(
            round(self.settings.coherent_s / self.signal.period_s), self.signal.update_periods
        )
        return periods if periods < symbol else periods // symbol * symbol

    @property
    def _carrier_tracker(self) -> Tracker:
        if self._coded and self.edge is None and self.mode is not Mode.PULL_IN:
            return self._blind_tracker
        return self._carrier_trackers.get(self.mode, self._carrier_trackers[Mode.FREQUENCY])

    def _restart_code_loop(self, sample: int, settled_s: float) -> None:
        """Begin the bandwidth schedule anew; ranges count once the loop has settled."""
        self._code_since = sample
        self._code_settled_s = settled_s
        self._code_tracker = self._delay_lock(self.settings.code_bandwidths_hz[0])

    def _settling_s(self, mode: Mode) -> float:
        """Time a code loop takes that starts in a mode some way off."""
        if mode is Mode.WEAK:
            return _SETTLING_WINDOWS * self._window_updates * self.signal.update_s
        return settling_time_s(self.settings.code_bandwidths_hz[0])

    @property
    def _code_settled(self) -> bool:
        return self._seconds_since(self._code_since) > self._code_settled_s

    def _delay_lock(self, bandwidth_hz: float) -> DelayLock:
        settings = self.settings
        return DelayLock(
            settings.code_order,
            bandwidth_hz,
            settings.spacing_chips,
            self._sample_chips,
            self._neighbour,
        )

    def _narrow_code_loop(self) -> bool:
        """Follow the bandwidth schedule; True when the loop just became narrower."""
        schedule = self.settings.code_bandwidths_hz
        present = self._code_tracker.bandwidth_hz
        if present == schedule[-1]:
            return False
        due = scheduled_bandwidth_hz(schedule, self._seconds_since(self._code_since))
        if due == present:
            return False
        self._code_tracker = self._delay_lock(due)
        return True

    def _seconds_since(self, sample: int) -> float:
        return (self.command.sample - sample) / self._rate

    # --- frequency tracking --------------------------------------------------------------------

    def _restart_window(self) -> None:
        self._window = []
        self._watch.clear()
        self._off_hz = 0.0

    def _complete_window(self, seen: Accumulated) -> Accumulated | None:
        """Collect an update; the window it completes, None where that has no signal to follow."""
        count, size = seen.periods.shape[0], self.signal.symbol_periods
        if count % size:  # up to the first symbol edge
            return None
        self._window.append(seen.periods if count == size else self._taken)
        if len(self._window) < self._window_updates:
            return None
        taps, self._window = np.concatenate(self._window), []
        first = self.periods + count - taps.shape[0]
        symbols = taps.reshape(-1, size, taps.shape[1])
        sums = symbols.sum(axis=1)
        unaided_hz = self.command.carrier_hz - self._aiding.frequency_hz
        self._off_hz = self._watch.off_hz(symbols[:, :, 1], unaided_hz)
        power = float(np.vdot(sums[:, 1], sums[:, 1]).real) / sums.shape[0]
        signal = (power / size - self.locks.noise) / size
        lowest = 10.0 ** (0.1 * (self.settings.frequency_threshold_dbhz - _DOUBTED_DB))
        if signal < lowest * seen.period_s * self.locks.noise:
            return None
        known = self._known_signs(first, sums.shape[0])
        return window_of(sums, self.signal.symbol_s, known, size * self.locks.noise)

    def _known_signs(self, first: int, count: int) -> FloatArray | None:
        """Signs of symbols from a period of this channel's count on, where they are known."""
        if self.known is None or self.anchor is None or self._always_squares:
            return None
        return signs(self.known, self.anchor + first, count, self.signal.symbol_periods)

    @property
    def _window_code_tracker(self) -> DelayLock:
        """The code loop on windows: one too wide for them does not settle."""
        widest_hz = _LOOP_PRODUCT / (self._window_updates * self.signal.update_s)
        return self._delay_lock(min(self._code_tracker.bandwidth_hz, widest_hz))

    # --- detect, collect, decide -------------------------------------------------------------

    def _detect(self, seen: Accumulated) -> None:
        symbol = self._whole_symbol(seen)
        if symbol is not None:
            size = self.signal.symbol_periods
            if self.mode in (Mode.WEAK, Mode.HOLD):  # signs of short symbols are not to be had
                slow_s = FAINT_S if self.mode is Mode.WEAK else USUAL_S
                self.locks = update_powers(self.locks, symbol, slow_s, size)
            else:
                self.locks = update_locks(self.locks, symbol, size)
        if self.mode not in (Mode.FREQUENCY, Mode.WEAK):
            return
        if not self._heard:
            self._heard_first = self.periods - seen.periods.shape[0]
        prompts = self._taken[:, 1]
        self._heard.append((self.history[-1].command, prompts))
        if len(self._heard) * self.signal.update_s > _REMEMBERED_S:
            self._heard_first += self._heard.pop(0)[1].size
        if self.edge is None:
            first = self._heard_first if self._bit_sync.symbols == 0 else self._bit_sync_first
            self._bit_sync_first = first
            self._bit_sync = add_prompts(
                self._bit_sync, prompts, self.locks.signal, self.locks.noise
            )
            edge = symbol_edge(self._bit_sync)
            if edge is not None and edge.alternating:
                self._leave_alternating_lock()
            elif edge is not None:
                symbols = self._bit_sync.symbols
                self.set_edge(self._bit_sync_first + edge.period, f"{symbols} symbols")

    def _carrier_turns(self, command: NcoCommand, periods: int) -> ComplexArray:
        """Carrier the generator ran on a command in the middles of its code periods."""
        t = self.signal.period_s * (np.arange(periods) + 0.5) - command.code_chips / command.code_hz
        cycles = command.carrier_cycles + t * (command.carrier_hz + 0.5 * t * command.carrier_hzps)
        return np.asarray(np.exp(2j * np.pi * np.mod(cycles, 1.0)))

    def _whole_symbol(self, seen: Accumulated) -> Accumulated | None:
        """Intervals put together to a symbol for the lock detectors; None while it is not full."""
        size = self.signal.symbol_periods
        if self.edge is None or seen.periods.shape[0] >= size:
            return seen
        self._pieces.append(seen.periods)
        if (self.periods - self.edge) % size:
            return None
        taps, self._pieces = np.concatenate(self._pieces), []
        return accumulate(taps, seen.period_s, seen.coherent)

    def set_edge(self, period: int, reason: str) -> None:
        """Make known that a symbol starts at a code period of this channel's count."""
        self.edge = period % self.signal.symbol_periods
        self._note("bit sync", reason)
        if self._filled == 0:
            self._plan()

    def _look_back(self, edge: int) -> None:
        """Demodulate the symbols heard without phase lock and hand the phase to the phase loop.

        Called at a symbol edge, so the last symbol remembered ends at the command.
        """
        size = self.signal.symbol_periods
        prompts: ComplexArray = np.concatenate(
            [prompts * self._carrier_turns(at, prompts.size) for at, prompts in self._heard]
        )
        # The generator followed the loop; seen from one frequency the carrier runs straight.
        back_s = self.signal.period_s * (np.arange(prompts.size) + 0.5 - prompts.size)
        prompts *= np.exp(-2j * np.pi * (self._carrier.frequency * back_s + self._carrier.phase))
        skip = (edge - self._heard_first) % size
        seen = demodulate(
            prompts[skip:].reshape(-1, size) @ self.signal.secondary, self.signal.symbol_s
        )
        self.symbols = seen.symbols
        self.symbols_first = self._heard_first + skip
        self._carrier = self._carrier._replace(
            phase=self._carrier.phase + seen.phase_cycles + 0.5 * seen.step_cycles,
            frequency=self._carrier.frequency + seen.step_cycles / self.signal.symbol_s,
        )
        self._symbol_sum, self._symbol_periods = 0j, 0

    def _collect_symbols(self, seen: Accumulated) -> None:
        if self.mode is not Mode.PHASE or self.edge is None:
            return
        size = self.signal.symbol_periods
        if seen.periods.shape[0] > size:  # none has a secondary code
            symbols = self._taken[:, 1].reshape(-1, size).sum(axis=1)
            self.symbols.extend(int(negative) for negative in symbols.real < 0.0)
            return
        self._symbol_sum += seen.prompt
        self._symbol_periods += seen.periods.shape[0]
        if (self.periods - self.edge) % size == 0:
            if self._symbol_periods == size:
                self.symbols.append(int(self._symbol_sum.real < 0.0))
            self._symbol_sum, self._symbol_periods = 0j, 0

    def _decide(self, seen: Accumulated) -> None:
        """The state machine: at most one transition per interval."""
        settings = self.settings
        here_s = self._seconds_since(self._since)
        cn0 = cn0_dbhz(self.locks, seen.period_s)
        fast = fast_cn0_dbhz(self.locks, seen.period_s)
        weak = max(
            settings.frequency_threshold_dbhz,
            lowest_frequency_lock_dbhz(settings.phase_threshold_dbhz),
        )
        if cn0 > weak + 10.0:
            fast = min(fast, recent_cn0_dbhz(self.locks, seen.period_s))
        gone = fast < weak
        match self.mode:
            case Mode.PULL_IN:
                if here_s >= settings.pull_in_s and gone:
                    self._go(Mode.LOST, f"no signal after acquisition: {fast:.1f} dB-Hz")
                elif here_s >= settings.pull_in_s and abs(self._frequency_error_hz) < 5.0:
                    self._go(Mode.FREQUENCY, f"frequency settled at {fast:.1f} dB-Hz")
                elif here_s > 10.0 * settings.pull_in_s:
                    self._go(Mode.LOST, "frequency does not settle")
            case Mode.FREQUENCY:
                if gone and here_s > 0.1:
                    self._go(self._refuge(fast), f"C/N0 fell to {fast:.1f} dB-Hz")
                elif here_s > 1.0 and self.edge is not None and cn0 < settings.phase_threshold_dbhz:
                    self._go(Mode.WEAK, f"{cn0:.1f} dB-Hz, too weak for the phase")
                elif (
                    self.edge is not None
                    and (self.periods - self.edge) % self.signal.symbol_periods == 0
                    and here_s > 0.1
                    and abs(self._frequency_error_hz) < 3.0
                    and cn0 > settings.phase_threshold_dbhz
                ):
                    self._go(Mode.PHASE, f"symbol edges known, {cn0:.1f} dB-Hz")
            case Mode.PHASE:
                self._watch_phase(here_s, cn0, fast, gone)
            case Mode.WEAK:
                self._watch_frequency(here_s, cn0)
            case Mode.HOLD:
                back = faint_cn0_dbhz(self.locks, seen.period_s)
                if not gone and here_s > 0.1 and fast > settings.phase_threshold_dbhz:
                    self._go(Mode.FREQUENCY, f"signal back at {fast:.1f} dB-Hz")
                elif (
                    self.edge is not None
                    and here_s > 0.5
                    and back
                    > max(
                        settings.frequency_threshold_dbhz + _RETURN_DB,
                        surely_seen_dbhz(self.signal.symbol_periods, seen.period_s),
                    )
                ):
                    self._go(Mode.WEAK, f"signal back at {back:.1f} dB-Hz")
                elif here_s > (
                    settings.lost_after_s if self._aiding == NO_AIDING else settings.open_loop_s
                ):
                    self._go(Mode.LOST, f"no signal for {here_s:.1f} s")
            case Mode.LOST:
                pass

    def _refuge(self, fast_dbhz: float) -> Mode:
        """Where a channel goes whose signal fell below what phase or FLL need."""
        bearable = fast_dbhz > self.settings.frequency_threshold_dbhz
        return Mode.WEAK if bearable and self.edge is not None else Mode.HOLD

    def _watch_frequency(self, here_s: float, cn0: float) -> None:
        settings = self.settings
        lowest = settings.frequency_threshold_dbhz
        if self._window:  # in the midst of one
            return
        recent = faint_cn0_dbhz(self.locks, self.signal.period_s)
        if self._off_hz:
            self._leave_false_lock(self._off_hz)
        elif self._watch.suspicious:
            pass
        elif here_s > 0.6 and recent < lowest - _ABSENT_DB:
            self._go(Mode.HOLD, f"C/N0 fell to {recent:.1f} dB-Hz")
        elif here_s > _FAINT_S and cn0 < lowest:
            self._go(Mode.HOLD, f"C/N0 {cn0:.1f} dB-Hz, too weak for the frequency")
        elif (
            here_s > 1.0
            and min(cn0, recent) > settings.phase_threshold_dbhz
            and (self.periods - (self.edge or 0)) % self.signal.symbol_periods == 0
        ):
            self._go(Mode.PHASE, f"strong enough for the phase, {cn0:.1f} dB-Hz")

    def _watch_phase(self, here_s: float, cn0: float, fast_dbhz: float, gone: bool) -> None:
        indicator = self.locks.phase
        lowest = self.settings.phase_threshold_dbhz - _HYSTERESIS_DB
        if gone:
            self._go(self._refuge(fast_dbhz), f"C/N0 fell to {fast_dbhz:.1f} dB-Hz")
        elif here_s > 0.5 and cn0 < lowest:
            self._go(Mode.WEAK, f"C/N0 {cn0:.1f} dB-Hz, too weak for the phase")
        elif here_s > 0.5 and indicator < 0.4:
            self._go(Mode.FREQUENCY, f"phase lock lost: mean cos 2φ {indicator:.2f}")
        elif here_s > 0.2 and indicator > 0.8:
            side = false_lock_side(self.locks)
            if side:
                self._leave_false_lock(side * 0.5 / self.signal.symbol_s)
            elif not self._phase_valid:
                self._phase_valid = True
                self._phase_since = self.command.sample
                self._note("phase lock", f"mean cos 2φ {indicator:.2f}")

    def _leave_false_lock(self, off_hz: float) -> None:
        self._forget_phase()
        self._carrier = NcoState(
            self._carrier.phase, self._carrier.frequency + off_hz, self._aiding.rate_hzps
        )
        self.command = self._command(self.command.sample, self.command.code_chips)
        self.locks = restart_phase(self.locks)
        self._restart_window()
        self._since = self.command.sample
        self._note("false lock", f"frequency moved by {off_hz:+.0f} Hz")

    def _leave_alternating_lock(self) -> None:
        """Frequency lock blind to signs also holds ±1/2T off: go to the side acquisition saw."""
        off_hz = math.copysign(
            0.5 / self.signal.period_s, self._acquired_hz - self._carrier.frequency
        )
        self._carrier = self._carrier._replace(frequency=self._carrier.frequency + off_hz)
        self.command = self._command(self.command.sample, self.command.code_chips)
        self._heard = []
        self._bit_sync = start_bit_sync(self.signal.secondary, coded=self._coded)
        self._note("false lock", f"frequency moved by {off_hz:+.0f} Hz")

    def _forget_phase(self) -> None:
        """Phase continues with an unknown number of cycles and an unknown polarity."""
        self.slips += 1
        self.half_cycle = None
        self._phase_valid = False

    def _go(self, mode: Mode, reason: str) -> None:
        if mode not in TRANSITIONS[self.mode]:
            raise ValueError(f"{self.satellite}: no way from {self.mode.name} to {mode.name}")
        if self.mode in (Mode.PHASE, Mode.HOLD):
            self._forget_phase()
        if mode is Mode.PHASE and self.edge is not None:
            self._look_back(self.edge)
            self.locks = restart_phase(self.locks)
        else:  # only a phase loop keeps a frequency rate of its own
            self._carrier = self._carrier._replace(rate=self._aiding.rate_hzps)
        self.command = self._command(self.command.sample, self.command.code_chips)
        if self.mode not in (Mode.FREQUENCY, Mode.WEAK):
            self._heard = []
        self._restart_window()
        if mode is Mode.FREQUENCY:
            self._bit_sync = start_bit_sync(self.signal.secondary, coded=self._coded)
        if self.mode is Mode.HOLD or (self.mode is Mode.WEAK and not self._code_settled):
            self._restart_code_loop(self.command.sample, self._settling_s(mode))
        if mode is Mode.WEAK:  # its long average is not to begin with what was stronger
            self.locks = self.locks._replace(seconds=0.0)
        self._frequency_error_hz = 0.0
        self.mode = mode
        self._since = self.command.sample
        self._note(mode.value, reason)

    def begin_weak(self, cn0_dbhz: float) -> None:
        """Start in frequency tracking: found where it was predicted, too weak to be pulled in."""
        self._go(Mode.WEAK, f"found at {cn0_dbhz:.1f} dB-Hz")

    def drop(self, reason: str) -> None:
        """Stop tracking."""
        self.mode = Mode.LOST
        self._note(Mode.LOST.value, reason)

    def set_polarity(self, half_cycle: float) -> None:
        """Make known whether the tracked carrier is half a cycle off (0 or ½).

        It holds for all of the present lock, also for intervals not yet observed.
        """
        if self.half_cycle is not None:
            return
        before, self.half_cycle = self.slips, half_cycle
        if half_cycle:
            self.slips += 1
        self.history = [
            i._replace(slips=self.slips, half_cycle=half_cycle) if i.slips == before else i
            for i in self.history
        ]

    # --- told from outside -----------------------------------------------------------------------

    @property
    def coasting(self) -> bool:
        """Whether the generators run on by aiding alone."""
        return self.mode is Mode.HOLD and self._aiding != NO_AIDING

    def coast(self, move: Coast) -> None:
        """Put right a phase carried on in open loop, and the code with it."""
        if not self.coasting:
            return  # the signal is back: the loop sees for itself
        self._move(-move.cycles, code=True, since=self._since)

    def mend(self, cycles: float | None, reason: str, *, told: bool) -> None:
        """A slip found from outside: `cycles` (RINEX) are missing, None: nobody knows how many.

        told: phases that miss them have been put out.
        """
        if cycles is not None:
            if round(2.0 * cycles) != 2.0 * cycles:
                raise ValueError(f"{self.satellite}: a slip of {cycles} cycles is no half number")
            self._move(-cycles, code=False)
            self._note("slip repaired", f"{cycles:+.1f} cycles: {reason}")
        else:
            self._note("cycle slip", reason)
        if cycles is None or told:
            before, self.slips = self.slips, self.slips + 1
            self.half_cycle = self.half_cycle if cycles is not None else None
            self.history = [
                i._replace(slips=self.slips, half_cycle=self.half_cycle) if i.slips == before else i
                for i in self.history
            ]
        if cycles is None or cycles % 1.0:  # the symbols before it may be of the other sign
            self._restart_symbols()

    def _move(self, cycles: float, *, code: bool, since: int | None = None) -> None:
        """Turn the carrier generator (+Doppler), also where it is not yet observed."""
        chips = cycles / self.signal.carrier_to_code if code else 0.0

        def moved(command: NcoCommand) -> NcoCommand:
            return command._replace(
                carrier_cycles=command.carrier_cycles + cycles,
                code_chips=command.code_chips + chips,
            )

        self._carrier = self._carrier._replace(phase=self._carrier.phase + cycles)
        self.command = moved(self.command)
        self._taken[: self._filled] *= np.exp(-2j * np.pi * math.fmod(cycles, 1.0))
        self.history = [
            i
            if since is not None and i.command.sample < since
            else i._replace(command=moved(i.command))
            for i in self.history
        ]

    def _restart_symbols(self) -> None:
        """Begin a new stretch of symbols at the next edge."""
        if self.edge is None:
            return
        self.symbols = bytearray()
        self.symbols_first = self.periods + (self.edge - self.periods) % self.signal.symbol_periods
        self._symbol_sum, self._symbol_periods = 0j, 0

    # --- what others read --------------------------------------------------------------------

    def _note(self, what: str, reason: str) -> None:
        self.events.append(Event(self.command.sample, self.satellite, what, reason))

    def _interval(self) -> Interval:
        settled = self.mode in (Mode.FREQUENCY, Mode.PHASE, Mode.WEAK)
        return Interval(
            self.command,
            self.periods,
            settled and self._code_settled,
            self._phase_valid,
            self.slips,
            self._phase_since,
            self.cn0_dbhz,
            self.half_cycle,
            coasting=self.coasting,
        )

    def at(self, sample: int) -> Interval:
        """The interval that holds at a sample of the epoch just run."""
        for interval in reversed(self.history):
            if interval.command.sample <= sample:
                return interval
        return self.history[0]

    @property
    def _carrier_bandwidth_hz(self) -> float:
        settings = self.settings
        if self.mode is Mode.PHASE:
            return settings.carrier_bandwidth_hz
        if self.mode is Mode.WEAK:
            return noise_bandwidth_hz(settings.frequency)
        return settings.frequency_bandwidth_hz

    @property
    def cn0_dbhz(self) -> float:
        """C/N0 of about the last second."""
        return cn0_dbhz(self.locks, self.signal.period_s)

    def report(self, stage: str) -> ChannelReport:
        """State now, for logs and screen."""
        return ChannelReport(
            satellite=self.satellite,
            signal=self.signal.id.name,
            stage=stage,
            mode=self.mode.value,
            cn0_dbhz=self.cn0_dbhz,
            doppler_hz=self.command.carrier_hz,
            carrier_lock=self.locks.phase,
            aiding_minus_loop_hz=self._aiding.frequency_hz
            + self._aiding.clock_hz
            - self.command.carrier_hz
            if self._aiding != NO_AIDING
            else 0.0,
            lock_time_s=self._seconds_since(self._phase_since) if self._phase_valid else 0.0,
            coherent_s=min(self._full, self.signal.symbol_periods) * self.signal.period_s
            if self.edge is not None
            else self.signal.period_s,
            carrier_bandwidth_hz=self._carrier_bandwidth_hz,
            code_bandwidth_hz=self._code_tracker.bandwidth_hz,
        )
