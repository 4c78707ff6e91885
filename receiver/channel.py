"""One channel: generators, correlator call, carrier and code trackers, and a state machine.

A step runs over one interval of whole code periods and reads like the block diagram: generate,
correlate, discriminate, filter, command, lock, decide. What it decides by is in `decisions`, its
code loop in `code_loop`, what it does without phase lock in `hearing` and `windows`. Carrier phase
runs at +Doppler here; the observables turn its sign (see `observables`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

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
from deepgnss.receiver.carrier_tracking import CarrierTracking
from deepgnss.receiver.code_loop import CodeLoop
from deepgnss.receiver.decisions import Go, Locked, Shift, decide
from deepgnss.receiver.frequency_tracking import tone_sigma_hz
from deepgnss.receiver.hearing import Hearing
from deepgnss.receiver.interval import NOTHING_HEARD, Heard, Interval, led_on, of_arc, turned
from deepgnss.receiver.known_symbols import KnownSymbols, signs
from deepgnss.receiver.leading import Leading
from deepgnss.receiver.locks import (
    FAINT_S,
    NO_LOCK,
    USUAL_S,
    cn0_dbhz,
    dark,
    restart_phase,
    strength_dbhz,
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
    unaided,
)
from deepgnss.receiver.open_loop import OpenLoop
from deepgnss.receiver.signals import Signal, code_runs, neighbour_correlation
from deepgnss.receiver.symbol_stream import SymbolStream
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    NcoState,
    accumulate,
    advance,
    corrected,
    pieces,
    straightened,
)
from deepgnss.receiver.windows import Windows

_FOUND_AGAIN_S = 0.3  # after a gap: twice the time of a frequency loop
_FAR_OFF_HZ = 10.0  # a signal's return: a frequency loop would take its time
_PULLED_IN = 5.0  # over a phase loop's bandwidth: when its frequency is one
_HISTORY_UPDATES = 3  # commands kept for observables of the epoch before


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
        self.prn = prn
        self.satellite = signal.satellite(prn)
        self.settings = settings
        self.mode = Mode.PULL_IN
        self.events: list[Event] = []
        self.recorded: list[Correlations] = []
        self.anchor: int | None = None  # code period of the satellite's week at period 0
        self.edge: int | None = None  # period of a symbol edge, modulo the symbol's length
        self.half_cycle: float | None = None  # 0 or ½ cycle once the polarity is known
        self.known: KnownSymbols | None = None  # symbols that need not be guessed
        self.slips = slips
        self.locks = NO_LOCK
        self._correlator = correlator
        self._runs = code_runs(signal.id.name, prn)
        half = settings.spacing_chips / 2.0
        self.taps_chips: FloatArray = np.array([half, 0.0, -half])
        self._rate = sample_rate_hz
        self._sample_chips = signal.id.chip_rate_hz / sample_rate_hz
        self._length = float(signal.id.code_chips)
        self._margin = 4 + int(2.0 * settings.spacing_chips / self._sample_chips)
        self._carriers = CarrierTracking(signal, settings)
        longest = self._carriers.longest
        self._history = int(_HISTORY_UPDATES * longest * signal.period_s * sample_rate_hz)
        self._coded = bool(signal.secondary_code)
        self._stream = SymbolStream(signal, longest)
        self._hearing = Hearing(signal, self._carriers.remembered_s)
        self.windows = Windows(signal, settings)
        self._leading = Leading(sample_rate_hz)
        self._open = OpenLoop(signal, sample_rate_hz, settings.open_loop_phase_sigma_cycles)
        self.unproven = False  # the polarity was carried through an open loop
        self._since = sample  # sample of the last change of mode
        self._phase_since = sample
        self.phase_valid = False
        self.frequency_error_hz = 0.0
        self._heard = NOTHING_HEARD
        self._acquired_hz = doppler_hz
        self._returned = sample - int(1e9)  # from no gap yet

        self._code_loop = CodeLoop(
            settings,
            self._sample_chips,
            neighbour_correlation(signal.id.name, prn),
            sample_rate_hz,
            self.windows.seconds,
        )
        self._code_loop.restart(sample, settings.pull_in_s)
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
        self._taken: ComplexArray  # correlations of the interval under way: …
        self.filled: int  # … as many of its code periods are in, …
        self._planned: int  # … of so many until the next command, …
        self._begun: int  # … and as many came before the present one
        self._commands: int  # … of so many
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
            count = self.due(sums.end)
            if count > 0:
                self.take(
                    self._correlator(
                        sums, self.command, self._runs, self.taps_chips, count, self.skip
                    )
                )
            if not self.complete:
                return
            self.conclude(aiding)

    def due(self, end: int) -> int:
        """Code periods under the present command that are there before a sample but not taken."""
        command = self.command
        there_s = (end - self._margin - command.sample) / self._rate
        chips = command.code_chips + there_s * (command.code_hz + 0.5 * there_s * command.code_hzps)
        return min(int(chips // self._length) + self._begun, self._planned) - self.filled

    @property
    def skip(self) -> int:
        """Code periods taken under the present command."""
        return self.filled - self._begun

    def take(self, correlations: ComplexArray) -> None:
        """Take the next code periods of the interval under way, (periods, taps)."""
        filled = self.filled + correlations.shape[0]
        self._taken[self.filled : filled] = correlations
        self.filled = filled

    @property
    def complete(self) -> bool:
        """Whether the present command is over."""
        return self.filled == self._planned

    def conclude(self, aiding: AidingSource) -> None:
        """Command, and at an interval's end detect and decide; the next one begins."""
        begun = self.command, self._carrier, self._aiding, self.periods
        middle_s, end_s = self._times()
        if self.filled < self._taken.shape[0]:
            self._move_on(NO_CORRECTION, NO_CORRECTION, middle_s, end_s, aiding)
            self._remember(*begun)
            self.history.append(self._interval())
            self._go_on()
            return
        seen = self._accumulate()
        self._steer(seen, middle_s, end_s, aiding)
        fell = self._detect(seen)
        self._collect_symbols(seen)
        if self.phase_valid and fell:
            self._revise(lambda interval: interval._replace(phase_valid=False))
        self._remember(*begun)
        self._decide(seen)
        self.history.append(self._interval())
        self._plan()

    def _plan(self) -> None:
        """Length of the next interval in code periods, and whether its signs are known."""
        periods = self._full
        if self.edge is not None:
            to_edge = (self.edge - self.periods) % self.signal.symbol_periods
            periods = to_edge % self._full or self._full
        self._coherent = self.edge is not None
        self._taken = np.empty((periods, self.taps_chips.size), dtype=np.complex128)
        self.filled = self._planned = self._commands = 0
        self._go_on()

    def _go_on(self) -> None:
        """To the next command of an interval: aided, there is one for every update."""
        self._begun, periods = self._planned, self._taken.shape[0]
        most = self.signal.update_periods if self.aided else periods
        self._planned = min(periods, self._begun + most)
        self._commands += 1

    def _times(self) -> tuple[float, float]:
        """The interval's middle and the command's end, s after the command's sample."""
        command, whole = self.command, self._taken.shape[0]

        def reach(chips: float) -> float:
            t = (chips - command.code_chips) / command.code_hz
            return (chips - command.code_chips) / (command.code_hz + 0.5 * command.code_hzps * t)

        return (
            reach((0.5 * whole - self._begun) * self._length),
            reach((self._planned - self._begun) * self._length),
        )

    def _revise(self, change: Callable[[Interval], Interval]) -> None:
        """Change what is remembered of the interval just over, command by command."""
        first = len(self.history) - self._commands
        self.history[first:] = [change(interval) for interval in self.history[first:]]

    def _accumulate(self) -> Accumulated:
        period_s = self.signal.period_s
        if self.settings.record_correlations:
            first = self.history[-self._commands].command
            self.recorded.append(Correlations(first.sample, period_s, self._taken))
        taps, coherent = self._taken, self._coherent
        if coherent and self.edge is not None:
            first_period = self.periods - self._begun
            taps = self._stream.stripped(taps, first_period, self.edge, self._signs)
        cn0_hz = 10.0 ** (0.1 * self.cn0_dbhz)
        return accumulate(taps, period_s, coherent, self._coded and not coherent, cn0_hz)

    def _signs(self, sums: ComplexArray) -> FloatArray:
        return self._carriers.signs(self.mode, sums)

    def _steer(
        self, seen: Accumulated, middle_s: float, end_s: float, aiding: AidingSource
    ) -> None:
        """Discriminate, filter, and give the next command."""
        carrier = code = NO_CORRECTION
        if self.mode is Mode.WEAK:
            window = self._complete_window(seen)
            if window is not None:
                carrier = self._carriers.windowed.correct(window)
                code = self._code_loop.on_windows.correct(
                    self._carriers.windowed.straightened(window)
                )
                middle_s = end_s - 0.5 * window.seconds
                self._heard = Heard(
                    self._carriers.windowed.unfollowed_hz(carrier),
                    tone_sigma_hz(self.cn0_dbhz, window),
                    window.seconds,
                )
        elif self.mode is not Mode.HOLD and 4 * seen.periods.shape[0] >= self._full:
            edge_known = self.edge is not None
            carrier = self._carriers.correct(self.mode, seen, edge_known=edge_known)
            code = self._code_loop.over(seen.seconds).correct(seen)
        here = self.command.sample

        def put_right(interval: Interval) -> Interval:
            later_s = (here - interval.command.sample) / self._rate
            return interval._replace(
                correction=carrier, middle_s=middle_s + later_s, window=self._heard
            )

        self._revise(put_right)
        count = seen.periods.shape[0]
        share = (
            0.3
            if count <= self.signal.update_periods
            else 1.0 - 0.7 ** (count / self.signal.update_periods)
        )
        self.frequency_error_hz += share * (carrier.frequency - self.frequency_error_hz)
        foreseen = self._carriers.foreseen(self.mode, seen.seconds)
        self._move_on(carrier, code, middle_s, end_s, aiding, foreseen)

    def _move_on(
        self,
        carrier: Correction,
        code: Correction,
        middle_s: float,
        end_s: float,
        aiding: AidingSource,
        foreseen: Correction = NO_CORRECTION,
    ) -> None:
        """Give the next command: corrections count in the middle, what is foreseen at the end."""
        command = self.command
        whole = int(end_s * self._rate)
        elapsed_s = whole / self._rate
        before = advance(self._carrier, elapsed_s)
        after = corrected(before, carrier, elapsed_s - middle_s)
        after = corrected(after, foreseen, elapsed_s - end_s)
        shift_chips = code.phase + code.frequency * (elapsed_s - middle_s)
        self._learn(
            after.phase - self._carrier.phase,
            shift_chips + self._code_offset_hz * elapsed_s,
            elapsed_s,
        )
        own_rate = self._carriers.has_own_rate(self.mode)
        self._carrier = self._leading.lead(
            after, aiding, command.sample, whole, self.mode, own_rate=own_rate
        )
        if self._code_loop.narrow(command.sample):  # a wide loop's noisy rate must not live on
            self._code_offset_hz = 0.0
            shift_chips, code = code.phase, code._replace(frequency=0.0)
        self._code_offset_hz += code.frequency
        chips = (
            advance(NcoState(command.code_chips, command.code_hz, command.code_hzps), elapsed_s)[0]
            - self.skip * self._length
            + shift_chips
            + (after.phase - before.phase) / self.signal.carrier_to_code
        )
        self.periods += self.skip
        self.command = self._command(command.sample + whole, chips)

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
        return self._carriers.periods(self.mode)

    @property
    def _aiding(self) -> AidingRate:
        return self._leading.now

    def _seconds_since(self, sample: int) -> float:
        return (self.command.sample - sample) / self._rate

    # --- frequency tracking --------------------------------------------------------------------

    def _complete_window(self, seen: Accumulated) -> Accumulated | None:
        """Collect an update; the window it completes, None where that has no signal to follow."""
        count, size = seen.periods.shape[0], self.signal.symbol_periods
        if count % size:  # up to the first symbol edge
            return None
        return self.windows.add(
            seen.periods if count == size else self._taken,
            self.periods + count,
            self.locks.noise,
            self.command.carrier_hz - self._leading.led_hz,
            self._known_signs,
        )

    def _known_signs(self, first: int, count: int) -> FloatArray | None:
        """Signs of symbols from a period of this channel's count on, where they are known."""
        if self.known is None or self.anchor is None or self._carriers.always_squares:
            return None
        return signs(self.known, self.anchor + first, count, self.signal.symbol_periods)

    # --- open loop -----------------------------------------------------------------------------

    def _learn(self, turned_cycles: float, shifted_chips: float, elapsed_s: float) -> None:
        """See what an interval of the loops did beyond what was predicted of it."""
        if not self.aided:
            return
        pulled_in_s = _PULLED_IN / self._carriers.settled.bandwidth_hz
        self._open.saw(turned_cycles, shifted_chips, self._aiding, elapsed_s)
        if self.mode is Mode.PHASE and self.phase_valid and self.seconds_in_mode > pulled_in_s:
            self._open.learn_phase(turned_cycles, self._aiding, elapsed_s)
        elif self.mode is Mode.WEAK:
            self._open.learn_frequency(self._carrier.frequency, self._aiding, elapsed_s)

    def _remember(
        self, command: NcoCommand, carrier: NcoState, aid: AidingRate, periods: int
    ) -> None:
        """Keep a command whose interval is over, for the case that its signal is just falling."""
        if aid == NO_AIDING or not self.aided:
            self._open.forget()
        else:
            chips = periods * self._length + command.code_chips
            power = self.locks.recent[-1] if self.locks.recent else 0.0
            self._open.remember(command.sample, carrier, chips, aid, power)
        if self.mode is Mode.HOLD and self._open.carried and not self._vouched_for(2.0):
            self._forget_phase()
        self._tell(self._open.judged(self.command.sample))

    def _vouched_for(self, share: float) -> bool:
        return self.aided and self._open.vouched(self.command.sample, share)

    @property
    def wide_cn0_dbhz(self) -> float:
        """C/N0 in open loop by quarters of symbols: of a signal far off in frequency."""
        return strength_dbhz(
            self._open.wide_signal(self.locks.noise), self.locks.noise, self.signal.period_s
        )

    @property
    def phase_kept(self) -> bool:
        """Whether a phase carried through an open loop is right to the half cycle, or the whole."""
        return self._vouched_for(1.0) or (self._vouched_for(2.0) and self._held_signs() is not None)

    def _held_signs(self) -> list[FloatArray] | None:
        """Signs of the last symbols of an open loop as they shall be seen; None if not known."""
        if self.half_cycle is None:
            return None
        upright = -1.0 if self.half_cycle else 1.0
        found = []
        for first, sums in self._open.symbols:
            told = self._known_signs(first, sums.size)
            if told is None:
                return None
            found.append(upright * told)
        return found

    def _begin_open_loop(self) -> str:
        """Go back to before the signal fell, and on from there by aiding alone."""
        here, power = self.command.sample, self.locks.signal
        if not self.aided:
            return ""
        phase_since = self._phase_since if self.phase_valid else None
        self._tell(self._open.fallen())
        led = self._open.begin(
            here, self._aiding, None if self.mode is Mode.WEAK else power, phase_since
        )
        if not led:
            return ""
        self._carrier = led[-1].carrier
        self._code_offset_hz = 0.0
        self.command = self._command(here, led[-1].chips - self.periods * self._length)
        carried = self._vouched_for(2.0)
        self.history = led_on(self.history, led[:-1], self._length, phase=carried)
        phase = "" if carried else "out"
        return (
            f"; from {self._seconds_since(led[0].sample):.2f} s before open loop with{phase} phase"
        )

    def _end_open_loop(self, mode: Mode) -> None:
        """The signal is back; a phase carried on is turned to what its first symbols show."""
        off_hz = self._open.off_hz
        if mode is Mode.FREQUENCY and abs(off_hz) > _FAR_OFF_HZ:
            self._carrier = self._carrier._replace(frequency=self._carrier.frequency + off_hz)
        self._open.end(self.command.sample, self._carrier.frequency, self._aiding)
        self._returned = self.command.sample
        if mode is Mode.PHASE:
            turn = self._open.seen_cycles(self._held_signs())
            self._carrier = self._carrier._replace(phase=self._carrier.phase + turn)
            self.unproven = self.half_cycle is not None
            self._restart_symbols()

    def _tell(self, verdict: str) -> None:
        if verdict:
            self._note("returned", verdict)

    @property
    def _found_again_s(self) -> float:
        """Time after a gap in which the frequency is the prediction's rather than the loop's."""
        return 3.0 * self.windows.seconds if self.mode is Mode.WEAK else _FOUND_AGAIN_S

    # --- detect, collect, decide -------------------------------------------------------------

    def _detect(self, seen: Accumulated) -> bool:
        """Take an interval into the lock detectors; whether it has next to nothing somewhere."""
        fell = False
        symbol = self._stream.whole(seen, self.periods, self.edge)
        if symbol is not None:
            for piece in self._updates(symbol):
                self._take_power(piece)
                fell |= dark(self.locks, self.signal.period_s)
        if self.mode is Mode.HOLD and self.edge is not None:
            self._open.collect(self._taken[:, 1], self.periods)
        if self.mode in (Mode.FREQUENCY, Mode.WEAK):
            self._hear()
        return fell or (symbol is None and dark(self.locks, self.signal.period_s))

    def _updates(self, seen: Accumulated) -> Iterable[Accumulated]:
        """A long interval cut into usual ones, as the loop now knows the carrier in it."""
        periods = self.signal.update_periods
        if seen.periods.shape[0] <= periods:
            return (seen,)
        return pieces(straightened(seen, self.history[-1].correction), periods)

    def _take_power(self, seen: Accumulated) -> None:
        size = self.signal.symbol_periods
        if self.mode in (Mode.WEAK, Mode.HOLD):  # signs of short symbols are not to be had
            slow_s = FAINT_S if self.mode is Mode.WEAK else USUAL_S
            self.locks = update_powers(self.locks, seen, slow_s, size)
        else:
            self.locks = update_locks(
                self.locks, seen, size, self._carriers.indicator_s, self._carriers.fast_s
            )

    def _hear(self) -> None:
        """Without phase lock: find the symbols' edges."""
        prompts = self._taken[:, 1]
        intervals = self.history[-self._commands :]
        ends = [interval.periods for interval in intervals[1:]]
        first = intervals[0].periods
        for interval, end in zip(intervals, [*ends, self.periods], strict=True):
            heard = prompts[interval.periods - first : end - first]
            self._hearing.add(interval.command, heard, interval.periods)
        if self.edge is None:
            edge = self._hearing.edge(prompts, self.locks.signal, self.locks.noise)
            if edge is not None and edge.alternating:
                self._leave_alternating_lock()
            elif edge is not None:
                self.set_edge(edge.period, f"{self._hearing.synced_by} symbols")

    def set_edge(self, period: int, reason: str) -> None:
        """Make known that a symbol starts at a code period of this channel's count."""
        self.edge = period % self.signal.symbol_periods
        self._note("bit sync", reason)
        if self.filled == 0:
            self._plan()

    def _look_back(self, edge: int) -> None:
        """Hand the phase of what was heard without phase lock to the phase loop."""
        own = self._carriers.finds_rate(self.mode)
        rate_hzps = self._carrier.rate if own else self._aiding.rate_hzps
        seen = self._hearing.look_back(edge, self._carrier, rate_hzps)
        self._stream.look_back(seen)
        self._carrier = seen.carrier

    def _collect_symbols(self, seen: Accumulated) -> None:
        if self.mode is Mode.PHASE and self.edge is not None:
            self._stream.decide(self._taken, seen, self.periods, self.edge)

    def _decide(self, seen: Accumulated) -> None:
        match decide(self, seen.period_s):
            case Go(mode, reason):
                self._go(mode, reason)
            case Shift(off_hz):
                self._leave_false_lock(off_hz)
            case Locked(reason):
                self.phase_valid = True
                if not self._open.locked():
                    self._phase_since = self.command.sample
                self._note("phase lock", reason)

    def _leave_false_lock(self, off_hz: float) -> None:
        self._forget_phase()
        self._carrier = NcoState(
            self._carrier.phase, self._carrier.frequency + off_hz, self._leading.rate_anew()
        )
        self.command = self._command(self.command.sample, self.command.code_chips)
        self.locks = restart_phase(self.locks)
        self._carriers.restart()
        self.windows.restart()
        self._open.forget()
        self._since = self.command.sample
        self._note("false lock", f"frequency moved by {off_hz:+.0f} Hz")

    def _leave_alternating_lock(self) -> None:
        """Frequency lock blind to signs also holds ±1/2T off: go to the side acquisition saw."""
        off_hz = math.copysign(
            0.5 / self.signal.period_s, self._acquired_hz - self._carrier.frequency
        )
        self._carrier = self._carrier._replace(frequency=self._carrier.frequency + off_hz)
        self.command = self._command(self.command.sample, self.command.code_chips)
        self._hearing.forget()
        self._hearing.restart_sync()
        self._note("false lock", f"frequency moved by {off_hz:+.0f} Hz")

    def _forget_phase(self) -> None:
        """Phase continues with an unknown number of cycles and an unknown polarity.

        The symbols before tell nothing of it any more.
        """
        self.slips += 1
        self.half_cycle = None
        self.phase_valid = self.unproven = False
        self._open.drop_phase()
        self._restart_symbols()

    def _go(self, mode: Mode, reason: str) -> None:
        if mode not in TRANSITIONS[self.mode]:
            raise ValueError(f"{self.satellite}: no way from {self.mode.name} to {mode.name}")
        if mode is Mode.HOLD:
            reason += self._begin_open_loop()
        if self.mode is Mode.HOLD:
            self._end_open_loop(mode)
        keeps = {self.mode, mode} == {Mode.PHASE, Mode.HOLD} and self._vouched_for(2.0)
        if self.mode in (Mode.PHASE, Mode.HOLD) and not keeps:
            self._forget_phase()
        self.phase_valid = False
        if mode is Mode.PHASE and self.edge is not None:
            if self.mode is not Mode.HOLD:
                self._look_back(self.edge)
            self.locks = restart_phase(self.locks)
            self._carriers.restart()
        elif not self._carriers.finds_rate(mode):  # a plain frequency loop keeps no rate of its own
            self._carrier = self._carrier._replace(rate=self._leading.rate_anew())
        self.command = self._command(self.command.sample, self.command.code_chips)
        if self.mode not in (Mode.FREQUENCY, Mode.WEAK):
            self._hearing.forget()
        self.windows.restart()
        if mode is Mode.FREQUENCY:
            self._hearing.restart_sync()
        here = self.command.sample
        if self.mode is Mode.HOLD or (self.mode is Mode.WEAK and not self._code_loop.settled(here)):
            windows = mode is Mode.WEAK
            self._code_loop.restart(here, self._code_loop.settling_s(windows=windows))
        # A long average is not to begin with what was stronger, or with nothing.
        if mode is Mode.WEAK or (self.mode is Mode.HOLD and self.aided):
            self.locks = self.locks._replace(seconds=0.0)
        self.frequency_error_hz = 0.0
        self._heard = NOTHING_HEARD
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
            if not self.unproven:
                return
            self.unproven = False
            if half_cycle == self.half_cycle:
                return
            self._note("cycle slip", "symbols contradict the phase carried through an open loop")
        before, after = self.half_cycle, half_cycle
        arc, self.half_cycle = self.slips, half_cycle
        if after != (before or 0.0):
            self.slips += 1
        self.history = of_arc(self.history, arc, self.slips, half_cycle)

    # --- told from outside -----------------------------------------------------------------------

    @property
    def seconds_in_mode(self) -> float:
        """Since the last change of mode, or what counts as one."""
        return self._seconds_since(self._since)

    @property
    def lock_s(self) -> float:
        """Time after which its phase lock is believed."""
        return self._carriers.lock_s

    @property
    def aided(self) -> bool:
        """Whether predictions lead the generators."""
        return self._leading.aided

    @property
    def coasting(self) -> bool:
        """Whether the generators run on by aiding alone."""
        return self.mode is Mode.HOLD and self.aided

    def coast(self, move: Coast | None) -> None:
        """Put right a phase carried on in open loop, and the code with it.

        None: somebody looks after open loops, and has nothing to say of this channel.
        """
        coasts = move is not None and self.coasting  # else its loop sees for itself
        self._open.look_after(self.command.sample, move if coasts else None)
        if move is None or not coasts:
            return
        self._move(-move.cycles, code=True)

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
            self.history = of_arc(self.history, before, self.slips, self.half_cycle)
        if cycles is None or cycles % 1.0:  # the symbols before it may be of the other sign
            self._restart_symbols()

    def _move(self, cycles: float, *, code: bool) -> None:
        """Turn the carrier generator (+Doppler), also where it is not yet observed.

        code: it is an open loop that is put right, and the code goes along.
        """
        chips = cycles / self.signal.carrier_to_code if code else 0.0
        self._carrier = self._carrier._replace(phase=self._carrier.phase + cycles)
        self.command = turned(self.command, cycles, chips)
        self._taken[: self.filled] *= np.exp(-2j * np.pi * math.fmod(cycles, 1.0))
        self.history = [
            i._replace(command=turned(i.command, cycles, chips)) if i.coasting or not code else i
            for i in self.history
        ]
        self._carriers.turn(cycles)
        self._open.move(cycles, chips)

    def _restart_symbols(self) -> None:
        """Begin a new stretch of symbols at the next edge."""
        if self.edge is not None:
            self._stream.restart(self.periods, self.edge)

    # --- what others read --------------------------------------------------------------------

    @property
    def symbols(self) -> bytearray:
        """Hard decisions since the last phase lock, 1: negative."""
        return self._stream.decided

    @property
    def symbols_first(self) -> int:
        """Code period at which the first of them starts."""
        return self._stream.first

    def _note(self, what: str, reason: str) -> None:
        self.events.append(Event(self.command.sample, self.satellite, what, reason))

    def _interval(self) -> Interval:
        settled = self.mode in (Mode.FREQUENCY, Mode.PHASE) or (
            self.mode is Mode.WEAK and not self.windows.empty
        )
        return Interval(
            self.command,
            self.periods,
            settled and self._code_loop.settled(self.command.sample),
            self.phase_valid or (self.coasting and self._open.carried),
            self.slips,
            self._phase_since,
            self.cn0_dbhz,
            self.half_cycle,
            coasting=self.coasting,
            frequency_valid=self._seconds_since(self._returned) > self._found_again_s,
            window=self._heard,
        )

    def at(self, sample: int) -> Interval:
        """The interval that holds at a sample of the epoch just run."""
        for interval in reversed(self.history):
            if interval.command.sample <= sample:
                return interval
        return self.history[0]

    @property
    def cn0_dbhz(self) -> float:
        """C/N0 of about the last second."""
        return cn0_dbhz(self.locks, self.signal.period_s)

    @property
    def _coherent_s(self) -> float:
        """Over which correlations are added up before their power is taken."""
        if self.mode is Mode.WEAK:
            return self.windows.coherent_s
        if self.edge is None:
            return self.signal.period_s
        return min(self._full, self.signal.symbol_periods) * self.signal.period_s

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
            if self.aided
            else 0.0,
            lock_time_s=self._seconds_since(self._phase_since) if self.phase_valid else 0.0,
            coherent_s=self._coherent_s,
            carrier_bandwidth_hz=self._carriers.bandwidth_hz(self.mode),
            code_bandwidth_hz=self._code_loop.tracker.bandwidth_hz,
        )
