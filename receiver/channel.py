"""One channel: generators, correlator call, carrier and code trackers, and a state machine.

A step runs over one interval of whole code periods and reads like the block diagram: generate,
correlate, discriminate, filter, command, lock, decide. Updates of a phase lock in which there is
nothing to decide may be done by a kernel of the same parts (`steady_group`). What it decides by is
in `decisions`, its code loop in `code_loop`, what it does without phase lock in `hearing` and
`windows`, without its signal in `coasting`. Carrier phase runs at +Doppler here; the observables
turn its sign (see `observables`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import repeat
from typing import Any

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
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
from deepgnss.receiver.coasting import Began, Coasting
from deepgnss.receiver.code_loop import CodeLoop
from deepgnss.receiver.decisions import Go, Locked, Shift, decide
from deepgnss.receiver.frequency_tracking import tone_sigma_hz
from deepgnss.receiver.generators import Generators, Run
from deepgnss.receiver.hearing import Hearing
from deepgnss.receiver.intake import Intake
from deepgnss.receiver.interval import NOTHING_HEARD, Heard, Interval, of_arc
from deepgnss.receiver.known_symbols import KnownSymbols, signs
from deepgnss.receiver.leading import Leading
from deepgnss.receiver.locks import (
    FAINT_S,
    NO_LOCK,
    USUAL_S,
    LockState,
    cn0_dbhz,
    dark,
    restart_phase,
    strength_dbhz,
    update_locks,
    update_powers,
)
from deepgnss.receiver.modes import (
    TRANSITIONS,
    AidingSource,
    Coast,
    Mode,
    TrackingSettings,
    unaided,
)
from deepgnss.receiver.signals import Signal, code_runs, neighbour_correlation
from deepgnss.receiver.symbol_stream import SymbolStream
from deepgnss.receiver.trackers import (
    NO_CORRECTION,
    Accumulated,
    Correction,
    accumulate,
    pieces,
    smoothed_hz,
    straightened,
)
from deepgnss.receiver.updates import Updates
from deepgnss.receiver.windows import Windows

_FOUND_AGAIN_S = 0.3  # after a gap: twice the time of a frequency loop
_DOUBTED_S = 2.0  # after a wrong range: a slip is judged up to 1.5 s late
_PULLED_IN = 5.0  # over a phase loop's bandwidth: when its frequency is one


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
        self._locks = NO_LOCK
        self.cn0_dbhz = 0.0  # of about the last second
        self._correlator = correlator
        self._runs = code_runs(signal.id.name, prn)
        half = settings.spacing_chips / 2.0
        self.taps_chips: FloatArray = np.array([half, 0.0, -half])
        self.carriers = CarrierTracking(signal, settings)
        longest = self.carriers.longest
        self._settles_s = _PULLED_IN / self.carriers.settled.bandwidth_hz
        self.nco = Generators(signal, sample_rate_hz, longest, sample, code_chips, doppler_hz)
        sample_chips = signal.id.chip_rate_hz / sample_rate_hz
        # Samples that its taps reach beyond a code period.
        self.margin = 4 + int(2.0 * settings.spacing_chips / sample_chips)
        self._coded = bool(signal.secondary_code)
        self.stream = SymbolStream(signal, longest)
        self._hearing = Hearing(signal, self.carriers.remembered_s)
        self.windows = Windows(signal, settings)
        self.leading = Leading(sample_rate_hz)
        limit_cycles = settings.open_loop_phase_sigma_cycles
        self.open_loop = Coasting(signal, self.nco, self.leading, limit_cycles)
        self.unproven = False  # the polarity was carried through an open loop
        self._since = sample  # sample of the last change of mode
        self._phase_since = sample
        self._doubted_at = sample - int(1e9)  # never yet
        self.phase_valid = False
        self.frequency_error_hz = 0.0
        self._heard = NOTHING_HEARD
        self._acquired_hz = doppler_hz
        self._returned = sample - int(1e9)  # from no gap yet

        self.code_loop = CodeLoop(
            settings,
            sample_chips,
            neighbour_correlation(signal.id.name, prn),
            sample_rate_hz,
            self.windows.seconds,
        )
        self.code_loop.restart(sample, settings.pull_in_s)
        self.intake = Intake(self.taps_chips.size)
        self.nco.history.append(self._interval())
        self._plan()

    # --- the step ----------------------------------------------------------------------------

    def begin_epoch(self) -> None:
        """Forget what the epoch before has told, but the commands observables still need."""
        self.nco.forget_old()
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
        intake = self.intake
        there = self.nco.reached(end - self.margin) + intake.begun
        return min(there, intake.planned) - intake.filled

    @property
    def skip(self) -> int:
        """Code periods taken under the present command."""
        return self.intake.skip

    def take(self, correlations: ComplexArray) -> None:
        """Take the next code periods of the interval under way, (periods, taps)."""
        self.intake.take(correlations)

    @property
    def complete(self) -> bool:
        """Whether the present command is over."""
        return self.intake.command_over

    def conclude(self, aiding: AidingSource) -> None:
        """Command, and at an interval's end detect and decide; the next one begins."""
        began = self.open_loop.now()
        middle_s, end_s = self._times()
        if not self.intake.over:
            self._move_on(NO_CORRECTION, NO_CORRECTION, middle_s, end_s, aiding)
            self._remember(began)
            self.nco.history.append(self._interval())
            self.intake.go_on(self._most(self._full))
            return
        seen = self._accumulate()
        self._steer(seen, middle_s, end_s, aiding)
        fell = self._detect(seen)
        self._collect_symbols(seen)
        if self.phase_valid and fell:
            self.nco.take_back_phase(self.intake.commands)
        self._remember(began)
        self._decide(seen)
        self.nco.history.append(self._interval())
        self._plan()

    def _plan(self) -> None:
        """Length of the next interval in code periods, and whether its signs are known."""
        full = periods = self._full
        if self.edge is not None:
            to_edge = (self.edge - self.periods) % self.signal.symbol_periods
            periods = to_edge % full or full
        self._coherent = self.edge is not None
        self.intake.begin(periods, self._most(full))

    def _most(self, full: int) -> int:
        """Code periods of a command: aided, there is one for every update."""
        return self.signal.update_periods if self.aided else full

    def _times(self) -> tuple[float, float]:
        """The interval's middle and the command's end, s after the command's sample."""
        intake = self.intake
        return (
            self.nco.until_s(0.5 * intake.whole - intake.begun),
            self.nco.until_s(intake.planned - intake.begun),
        )

    def _accumulate(self) -> Accumulated:
        period_s, intake = self.signal.period_s, self.intake
        if self.settings.record_correlations:
            first = self.history[-intake.commands].command
            self.recorded.append(Correlations(first.sample, period_s, intake.taken))
        taps, coherent = intake.taken, self._coherent
        if coherent and self.edge is not None:
            first_period = self.periods - intake.begun
            taps = self.stream.stripped(taps, first_period, self.edge, self._signs)
        cn0_hz = 10.0 ** (0.1 * self.cn0_dbhz)
        return accumulate(taps, period_s, coherent, self._coded and not coherent, cn0_hz)

    def _signs(self, sums: ComplexArray) -> FloatArray:
        return self.carriers.signs(self.mode, sums)

    def _steer(
        self, seen: Accumulated, middle_s: float, end_s: float, aiding: AidingSource
    ) -> None:
        """Discriminate, filter, and give the next command."""
        carrier = code = NO_CORRECTION
        if self.mode is Mode.WEAK:
            window = self._complete_window(seen)
            if window is not None:
                carrier = self.carriers.windowed.correct(window)
                code = self.code_loop.on_windows.correct(
                    self.carriers.windowed.straightened(window)
                )
                middle_s = end_s - 0.5 * window.seconds
                self._heard = Heard(
                    self.carriers.windowed.unfollowed_hz(carrier),
                    tone_sigma_hz(self.cn0_dbhz, window),
                    window.seconds,
                )
        elif self.mode is not Mode.HOLD and 4 * seen.periods.shape[0] >= self._full:
            edge_known = self.edge is not None
            carrier = self.carriers.correct(self.mode, seen, edge_known=edge_known)
            code = self.code_loop.over(seen.seconds).correct(seen)
        self.nco.correct(self.intake.commands, carrier, middle_s, self._heard)
        updates = seen.periods.shape[0] / self.signal.update_periods
        self.frequency_error_hz = smoothed_hz(self.frequency_error_hz, carrier.frequency, updates)
        foreseen = self.carriers.foreseen(self.mode, seen.seconds)
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
        run = self.nco.run(carrier, code, foreseen, middle_s, end_s)
        self._learn(run)
        here = self.command.sample
        own_rate = self.carriers.has_own_rate(self.mode)
        led = self.leading.lead(
            run.carrier, aiding, here, run.samples, self.mode, own_rate=own_rate
        )
        if self.code_loop.narrow(here):  # a wide loop's noisy rate must not live on
            self.nco.code_offset_hz = 0.0
            code = code._replace(frequency=0.0)
            run = run._replace(shifted_chips=code.phase)
        self.nco.go_on(run, led, code, self.skip)

    def _learn(self, run: Run) -> None:
        """See what a command of the loops did beyond what was predicted of it."""
        self.open_loop.saw(run)
        if self.mode is Mode.PHASE and self.phase_valid and self.seconds_in_mode > self._settles_s:
            self.open_loop.learn_phase(run)
        elif self.mode is Mode.WEAK:
            self.open_loop.learn_frequency(run)

    # --- parts of the moment -----------------------------------------------------------------

    @property
    def _full(self) -> int:
        return self.carriers.periods(self.mode)

    def _seconds_since(self, sample: int) -> float:
        return self.nco.seconds_since(sample)

    # --- frequency tracking --------------------------------------------------------------------

    def _complete_window(self, seen: Accumulated) -> Accumulated | None:
        """Collect an update; the window it completes, None where that has no signal to follow."""
        count, size = seen.periods.shape[0], self.signal.symbol_periods
        if count % size:  # up to the first symbol edge
            return None
        return self.windows.add(
            seen.periods if count == size else self.intake.taken,
            self.periods + count,
            self.locks.noise,
            self.command.carrier_hz - self.leading.led_hz,
            self._known_signs,
        )

    def _known_signs(self, first: int, count: int) -> FloatArray | None:
        """Signs of symbols from a period of this channel's count on, where they are known."""
        if self.known is None or self.anchor is None or self.carriers.always_squares:
            return None
        return signs(self.known, self.anchor + first, count, self.signal.symbol_periods)

    # --- open loop -----------------------------------------------------------------------------

    def _remember(self, began: Began) -> None:
        """Keep a command whose interval is over; a phase nobody vouches for any more is let go."""
        self.open_loop.remember(began, self.locks.recent[-1] if self.locks.recent else 0.0)
        if (
            self.mode is Mode.HOLD
            and self.open_loop.carried
            and not self.open_loop.vouched_for(2.0)
        ):
            self._forget_phase()
        self._tell(self.open_loop.judged())

    @property
    def wide_cn0_dbhz(self) -> float:
        """C/N0 in open loop by quarters of symbols: of a signal far off in frequency."""
        return strength_dbhz(
            self.open_loop.loop.wide_signal(self.locks.noise),
            self.locks.noise,
            self.signal.period_s,
        )

    @property
    def phase_kept(self) -> bool:
        """Whether a phase carried through an open loop is right to the half cycle, or the whole."""
        return self.open_loop.kept(self.half_cycle, self._known_signs)

    def _begin_open_loop(self) -> str:
        """Go back to before the signal fell, and on from there by aiding alone."""
        if not self.aided:
            return ""
        self._tell(self.open_loop.loop.fallen())
        return self.open_loop.begin(
            None if self.mode is Mode.WEAK else self.locks.signal,
            self._phase_since if self.phase_valid and not self._doubted else None,
        )

    def _end_open_loop(self, mode: Mode) -> None:
        """The signal is back."""
        self.open_loop.end(mode, self.half_cycle, self._known_signs)
        self._returned = self.command.sample
        if mode is Mode.PHASE:
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
        symbol = self.stream.whole(seen, self.periods, self.edge)
        if symbol is not None:
            for piece in self._updates(symbol):
                self._take_power(piece)
                fell |= dark(self.locks, self.signal.period_s)
        if self.mode is Mode.HOLD and self.edge is not None:
            self.open_loop.loop.collect(self.intake.taken[:, 1], self.periods)
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
                self.locks, seen, size, self.carriers.indicator_s, self.carriers.fast_s
            )

    def _hear(self) -> None:
        """Without phase lock: find the symbols' edges."""
        prompts = self.intake.taken[:, 1]
        intervals = self.history[-self.intake.commands :]
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
        if self.intake.filled == 0:
            self._plan()

    def _look_back(self, edge: int) -> None:
        """Hand the phase of what was heard without phase lock to the phase loop."""
        nco, own = self.nco, self.carriers.finds_rate(self.mode)
        rate_hzps = nco.carrier.rate if own else self.leading.now.rate_hzps
        seen = self._hearing.look_back(edge, nco.carrier, rate_hzps)
        self.stream.look_back(seen)
        nco.change(carrier=seen.carrier)

    def _collect_symbols(self, seen: Accumulated) -> None:
        if self.mode is Mode.PHASE and self.edge is not None:
            self.stream.decide(self.intake.taken, seen, self.periods, self.edge)

    def _decide(self, seen: Accumulated) -> None:
        match decide(self, seen.period_s):
            case None:
                pass
            case Go(mode, reason):
                self._go(mode, reason)
            case Shift(off_hz):
                self._leave_false_lock(off_hz)
            case Locked(reason):
                self.phase_valid = True
                if not self.open_loop.loop.locked():
                    self._phase_since = self.command.sample
                self._note("phase lock", reason)

    def _leave_false_lock(self, off_hz: float) -> None:
        self._forget_phase()
        self.nco.change(off_hz=off_hz, rate_hzps=self.leading.rate_anew())
        self.locks = restart_phase(self.locks)
        self.carriers.restart()
        self.windows.restart()
        self.open_loop.loop.forget()
        self._since = self.command.sample
        self._note("false lock", f"frequency moved by {off_hz:+.0f} Hz")

    def _leave_alternating_lock(self) -> None:
        """Frequency lock blind to signs also holds ±1/2T off: go to the side acquisition saw."""
        missing_hz = self._acquired_hz - self.nco.carrier.frequency
        off_hz = math.copysign(0.5 / self.signal.period_s, missing_hz)
        self.nco.change(off_hz=off_hz)
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
        self.open_loop.loop.drop_phase()
        self._restart_symbols()

    def _go(self, mode: Mode, reason: str) -> None:
        if mode not in TRANSITIONS[self.mode]:
            raise ValueError(f"{self.satellite}: no way from {self.mode.name} to {mode.name}")
        if mode is Mode.HOLD:
            reason += self._begin_open_loop()
        if self.mode is Mode.HOLD:
            self._end_open_loop(mode)
        keeps = {self.mode, mode} == {Mode.PHASE, Mode.HOLD} and self.open_loop.vouched_for(2.0)
        if self.mode in (Mode.PHASE, Mode.HOLD) and not keeps:
            self._forget_phase()
        self.phase_valid = False
        if mode is Mode.PHASE and self.edge is not None:
            if self.mode is not Mode.HOLD:
                self._look_back(self.edge)
            self.locks = restart_phase(self.locks)
            self.carriers.restart()
        elif not self.carriers.finds_rate(mode):  # a plain frequency loop keeps no rate of its own
            self.nco.change(rate_hzps=self.leading.rate_anew())
        if self.mode not in (Mode.FREQUENCY, Mode.WEAK):
            self._hearing.forget()
        self.windows.restart()
        if mode is Mode.FREQUENCY:
            self._hearing.restart_sync()
        here = self.command.sample
        if self.mode is Mode.HOLD or (self.mode is Mode.WEAK and not self.code_loop.settled(here)):
            # A code that was carried on with its phase counts at once.
            settling_s = self.code_loop.settling_s(windows=mode is Mode.WEAK)
            self.code_loop.restart(here, 0.0 if keeps else settling_s)
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
        self.nco.history = of_arc(self.history, arc, self.slips, half_cycle)

    # --- updates elsewhere (`steady_group`) ----------------------------------------------------

    @property
    def settled(self) -> bool:
        """Whether it is a phase lock between whole updates that nothing is left to be learnt of."""
        return (
            self.mode is Mode.PHASE
            and self.phase_valid
            and self.seconds_in_mode > self._settles_s
            and self._seconds_since(self._returned) > self._found_again_s
            and self.open_loop.loop.accounted
            and self.edge is not None
            and self._full == self.signal.update_periods
            and self.intake.undivided
            and self.intake.whole == self._full
            and self.stream.even
            and self._correlator is correlate
            and not self.settings.record_correlations
        )

    def pass_on(self, updates: Updates, code_offset_hz: float) -> None:
        """Take updates done elsewhere: what `conclude` leaves for those who look back."""
        history, count = self.nco.history, len(updates.commands)
        under_way = history.pop()
        periods = range(under_way.periods, under_way.periods + (count + 1) * self._full, self._full)
        history.append(
            under_way._replace(
                correction=updates.corrections[0],
                middle_s=updates.middles_s[0],
                window=self._heard,
            )
        )
        # Every field for all that follow.
        alike: Any = Interval._make(map(repeat, self._interval()))
        following = alike._replace(
            command=updates.commands,
            periods=periods[1:],
            cn0_dbhz=updates.cn0s_dbhz,
            correction=(*updates.corrections[1:], NO_CORRECTION),
            middle_s=(*updates.middles_s[1:], 0.0),
        )
        history.extend(map(Interval, *following))
        self.nco.resume(updates.commands[-1], code_offset_hz, periods[-1])

    def resume(self, locks: LockState, error_hz: float, symbols: bytes) -> None:
        """Go on after them: what the last one leaves, and the symbols of all."""
        self.locks, self.frequency_error_hz = locks, error_hz
        self.stream.decided.extend(symbols)
        self._plan()

    # --- told from outside -----------------------------------------------------------------------

    @property
    def seconds_in_mode(self) -> float:
        """Since the last change of mode, or what counts as one."""
        return self._seconds_since(self._since)

    @property
    def lock_s(self) -> float:
        """Time after which its phase lock is believed."""
        return self.carriers.lock_s

    @property
    def aided(self) -> bool:
        """Whether predictions lead the generators."""
        return self.leading.aided

    @property
    def coasting(self) -> bool:
        """Whether the generators run on by aiding alone."""
        return self.mode is Mode.HOLD and self.aided

    def coast(self, move: Coast | None) -> None:
        """Put right a phase carried on in open loop, and the code with it.

        None: somebody looks after open loops, and has nothing to say of this channel.
        """
        coasts = move is not None and self.coasting  # else its loop sees for itself
        self.open_loop.look_after(move if coasts else None)
        if move is None or not coasts:
            return
        self._move(-move.cycles, code=True)

    def doubt_code(self) -> None:
        """The range is known to be wrong: what the code loop has averaged is not worth keeping.

        As long as it is told so it stays wide, so that a reflection is left as soon as it ends, and
        keeps no rate, by which it would go too far. Nor is the phase the satellite's own: nothing
        of it is carried through an open loop, or put right by whole or half cycles.

        A signal too weak for its phase is refused for its noise, most likely, of which a wide loop
        has more than any range may be off: it stays as it is.
        """
        if self.mode is not Mode.WEAK:
            self.code_loop.widen(self.command.sample)
        self.nco.code_offset_hz = 0.0
        self._doubted_at = self.command.sample

    def put_code_right(self, off_m: float, *, reflected: bool) -> None:
        """The range is known to be so much too long, and its code loop need not find it anew.

        reflected: because it follows a reflection, so that its phase is in doubt.
        """
        if reflected:
            self._doubted_at = self.command.sample
        self.nco.shift_code(off_m * self.signal.id.chip_rate_hz / SPEED_OF_LIGHT_MPS)
        self.code_loop.settle()

    def rejoin(self, half_cycle: float) -> None:
        """The arc before the present one tells its polarity (0 or ½), until symbols do."""
        if self.phase_valid and self.half_cycle is None:
            self.set_polarity(half_cycle)
            self.unproven = True

    @property
    def _doubted(self) -> bool:
        """Whether the range was wrong of late."""
        return self._seconds_since(self._doubted_at) < _DOUBTED_S

    def mend(self, cycles: float | None, reason: str, *, told: bool) -> None:
        """A slip found from outside: `cycles` (RINEX) are missing, None: nobody knows how many.

        told: phases that miss them have been put out.
        """
        if self._doubted:
            cycles, reason = None, f"{reason}, of a reflection"
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
            self.nco.history = of_arc(self.history, before, self.slips, self.half_cycle)
        if cycles is None or cycles % 1.0:  # the symbols before it may be of the other sign
            self._restart_symbols()

    def _move(self, cycles: float, *, code: bool) -> None:
        """Turn the carrier generator (+Doppler), also where it is not yet observed.

        code: it is an open loop that is put right, and the code goes along.
        """
        chips = self.nco.move(cycles, code=code)
        self.intake.turn(cycles)
        self.carriers.turn(cycles)
        self.open_loop.loop.move(cycles, chips)

    def _restart_symbols(self) -> None:
        """Begin a new stretch of symbols at the next edge."""
        if self.edge is not None:
            self.stream.restart(self.periods, self.edge)

    # --- what others read --------------------------------------------------------------------

    @property
    def command(self) -> NcoCommand:
        """What its generators do."""
        return self.nco.command

    @property
    def periods(self) -> int:
        """Code periods it had gone through when its command began."""
        return self.nco.periods

    @property
    def history(self) -> list[Interval]:
        """Its intervals, as far back as observables need them; the last one is under way."""
        return self.nco.history

    @property
    def filled(self) -> int:
        """Code periods of the interval under way that are in."""
        return self.intake.filled

    @property
    def symbols(self) -> bytearray:
        """Hard decisions since the last phase lock, 1: negative."""
        return self.stream.decided

    @property
    def symbols_first(self) -> int:
        """Code period at which the first of them starts."""
        return self.stream.first

    def _note(self, what: str, reason: str) -> None:
        self.events.append(Event(self.command.sample, self.satellite, what, reason))

    def _interval(self) -> Interval:
        settled = self.mode in (Mode.FREQUENCY, Mode.PHASE) or (
            self.mode is Mode.WEAK and not self.windows.empty
        )
        return Interval(
            self.command,
            self.periods,
            settled and self.code_loop.settled(self.command.sample),
            self.phase_valid or (self.coasting and self.open_loop.carried),
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
        return self.nco.at(sample)

    @property
    def locks(self) -> LockState:
        """What its lock detectors say."""
        return self._locks

    @locks.setter
    def locks(self, state: LockState) -> None:
        self._locks = state
        self.cn0_dbhz = cn0_dbhz(state, self.signal.period_s)

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
            aiding_minus_loop_hz=self.leading.now.frequency_hz
            + self.leading.now.clock_hz
            - self.command.carrier_hz
            if self.aided
            else 0.0,
            lock_time_s=self._seconds_since(self._phase_since) if self.phase_valid else 0.0,
            coherent_s=self._coherent_s,
            carrier_bandwidth_hz=self.carriers.bandwidth_hz(self.mode),
            code_bandwidth_hz=self.code_loop.tracker.bandwidth_hz,
        )
