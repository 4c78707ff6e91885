"""Open loop: a carrier led on by aiding alone from before its signal fell, T 3.5, 4.5, 5.5.1.

A loop notices late that its signal is gone, and has followed noise since. What it was before is
kept for a while: phase and code of every command, and the mean of what its frequency differed
from the prediction. From there carrier and code run by the prediction, its clock included.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.jit import compilable
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.modes import AidingRate, Coast
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import NcoState

_KEPT_S = 1.3  # of past commands: as late as a faint signal's fall is noticed
_FAINT_S = 1.0  # before its fall is noticed
MEAN_S = 1.5  # of a phase loop's offset from the prediction …
_FAINT_MEAN_S = 3.0  # … and of a frequency's
_ENOUGH_S = 0.2  # of either before it is better than the loop's last frequency
_JUDGED_S = 1.0  # after a signal's return until its loops have shown what was off
_LOOKED_AT = 3  # updates whose symbols show the phase of a signal that is back
_SILENCE_S = 0.5  # after which nobody vouches for a phase any more


class Passed(NamedTuple):
    """A command as it was given, and what its interval showed."""

    sample: int
    carrier: NcoState
    chips: float  # since the channel's period 0
    aid: AidingRate
    offset_hz: float  # of the loop from the prediction, in the mean before
    power: float  # of the signal seen on it


class Led(NamedTuple):
    """Generators led on by aiding to a sample."""

    sample: int
    carrier: NcoState
    chips: float


@dataclass(slots=True)
class Gap:
    """An open loop, from the fall of its signal until its return has been judged."""

    fell: int  # sample
    told: int | None  # sample of the last word from outside
    carried: bool  # whether the phase goes on
    sigma_cycles: float | None = None  # 1σ of the phase, None: not told yet
    returned: int | None = None  # sample
    offset_hz: float = 0.0  # of the loop from the prediction, then
    locked: bool = False  # the phase's error is known
    phase_cycles: float = 0.0  # by which loops found the carrier behind what was led on …
    code_chips: float = 0.0  # … and the code

    def vouched(self, sample: int, rate_hz: float, limit_cycles: float) -> bool:
        """Whether somebody still vouches for the phase carried on, to a 1σ."""
        if not self.carried or self.told is None or sample - self.told > _SILENCE_S * rate_hz:
            return False
        return self.sigma_cycles is None or self.sigma_cycles <= limit_cycles

    def verdict(self, signal: Signal, rate_hz: float) -> str:
        """What became of it: errors are what was led on less what the loops then found.

        Both grow with range.
        """
        if self.returned is None:
            return ""
        length_s = (self.returned - self.fell) / rate_hz
        sigma = "not told" if self.sigma_cycles is None else f"{self.sigma_cycles:.3f} cycle"
        error = f"{self.phase_cycles:+.3f} cycle" if self.locked else "not seen"
        code_m = self.code_chips * SPEED_OF_LIGHT_MPS / signal.id.chip_rate_hz
        phase = f"phase carried on, 1σ {sigma}, error {error}" if self.carried else "new phase"
        return f"after {length_s:.2f} s: {phase}; code error {code_m:+.2f} m"


class LoopMemory:
    """What a channel's loop was in the last second, and its mean offset from the prediction."""

    def __init__(self, signal: Signal, rate_hz: float) -> None:
        self._signal = signal
        self._rate = rate_hz
        self._passed: deque[Passed] = deque()
        self._offset_hz = 0.0
        self._seconds = 0.0  # that the mean is made of

    def forget(self) -> None:
        """The loop was wrong: nothing before counts."""
        self._passed.clear()
        self._seconds = 0.0

    def remember(
        self, sample: int, carrier: NcoState, chips: float, aid: AidingRate, power: float
    ) -> None:
        """Keep a command whose interval is over."""
        offset_hz = self._offset_hz
        if not self.knows_offset:
            offset_hz = carrier.frequency - aid.frequency_hz - aid.clock_hz
        self._keep([Passed(sample, carrier, chips, aid, offset_hz, power)])

    def go_on(self, passed: Sequence[Passed], offset_hz: float, seconds: float) -> None:
        """Keep commands that were learnt from elsewhere, up to this mean of so many seconds."""
        self._offset_hz, self._seconds = offset_hz, seconds
        self._keep(passed)

    @property
    def mean(self) -> tuple[float, float]:
        """Mean offset from the prediction, Hz, and the seconds it is made of."""
        return self._offset_hz, self._seconds

    @property
    def knows_offset(self) -> bool:
        """Whether the mean is better than the loop's last frequency."""
        return self._seconds >= _ENOUGH_S

    def _keep(self, passed: Sequence[Passed]) -> None:
        self._passed.extend(passed)
        oldest = self._passed[-1].sample - _KEPT_S * self._rate
        while self._passed[0].sample < oldest:
            self._passed.popleft()

    def learn(self, offset_hz: float, seconds: float, *, faint: bool) -> None:
        """Take the loop's offset from the prediction, in the mean of an interval."""
        mean_s = _FAINT_MEAN_S if faint else MEAN_S
        self._offset_hz, self._seconds = learnt(
            self._offset_hz, self._seconds, offset_hz, seconds, mean_s
        )

    def before_fall(self, power: float) -> int:
        """Index of the last command that saw the signal whole: half its power tells."""
        k = len(self._passed) - 1
        while k > 0 and self._passed[k].power < 0.5 * power:
            k -= 1
        # Commands shorter than a symbol have the power of the last whole one.
        symbol = self._signal.update_s * self._rate
        last = self._passed[k].sample
        while k > 0 and last - self._passed[k].sample < 0.9 * symbol:
            k -= 1
        return k

    def before_faint_fall(self) -> int:
        """Index of a command before a fall that took its time to be seen."""
        return self._at(self._passed[-1].sample - int(_FAINT_S * self._rate))

    def before(self, sample: int) -> int:
        """Index of the last command before a sample."""
        return self._at(sample - 1)

    def _at(self, sample: int) -> int:
        indices = (k for k in range(len(self._passed) - 1, -1, -1))
        return next((k for k in indices if self._passed[k].sample <= sample), 0)

    def resume(self, index: int) -> None:
        """Believe the offset of a command; what comes after the gap soon counts as much."""
        self._offset_hz = self._passed[index].offset_hz
        self._seconds = _ENOUGH_S

    def move(self, cycles: float, chips: float) -> None:
        """The generators were put right."""
        self._passed = deque(
            one._replace(
                carrier=one.carrier._replace(phase=one.carrier.phase + cycles),
                chips=one.chips + chips,
            )
            for one in self._passed
        )

    @property
    def empty(self) -> bool:
        """Whether there is anything to go back to."""
        return not self._passed

    def led_on(self, index: int, sample: int, aid: AidingRate) -> list[Led]:
        """Generators led on from a command by the predictions since, up to a sample.

        One for every command after it, and one for the sample.
        """
        start = self._passed[index]
        led = [Led(start.sample, start.carrier, start.chips)]
        rest: Sequence[Passed] = list(self._passed)[index:]
        ends = [(one.sample, one.aid) for one in rest[1:]] + [(sample, aid)]
        cycles = start.carrier.phase
        for one, (end, then) in zip(rest, ends, strict=True):
            elapsed_s = (end - one.sample) / self._rate
            cycles += predicted_cycles(one.aid, elapsed_s) + start.offset_hz * elapsed_s
            since_s = (end - start.sample) / self._rate
            led.append(
                Led(
                    end,
                    NcoState(
                        cycles,
                        start.offset_hz + then.frequency_hz + then.clock_hz,
                        then.rate_hzps,
                    ),
                    start.chips
                    + since_s * self._signal.id.chip_rate_hz
                    + (cycles - start.carrier.phase) / self._signal.carrier_to_code,
                )
            )
        return led


class OpenLoop:
    """What lets a channel run on without its signal and come back: memory, trust, and account."""

    def __init__(self, signal: Signal, rate_hz: float, limit_cycles: float) -> None:
        """limit_cycles: 1σ up to which a phase carried on is right to the half cycle."""
        self._signal = signal
        self._rate = rate_hz
        self._limit = limit_cycles
        self.memory = LoopMemory(signal, rate_hz)
        self._gap: Gap | None = None
        self._looked_after: int | None = None  # sample at which somebody last did
        # Sums of the last symbols, by the code period each lot begins at.
        self.symbols: deque[tuple[int, ComplexArray]] = deque(maxlen=_LOOKED_AT)
        # The same in quarters: a signal too far off in frequency for whole symbols.
        self._quarters: deque[tuple[float, complex]] = deque(maxlen=_LOOKED_AT)

    # --- trust -------------------------------------------------------------------------------

    @property
    def accounted(self) -> bool:
        """Whether there is no gap whose end is still to be judged."""
        return self._gap is None

    @property
    def carried(self) -> bool:
        """Whether a phase is carried on, or was until the signal came back."""
        return self._gap is not None and self._gap.carried

    def vouched(self, sample: int, share: float) -> bool:
        """Whether somebody vouches for that phase, to so many times the limit."""
        gap = self._gap
        return gap is not None and gap.vouched(sample, self._rate, share * self._limit)

    def look_after(self, sample: int, move: Coast | None) -> None:
        """Somebody looks after open loops, and has moved this one or has nothing to say of it."""
        self._looked_after = sample
        if move is not None and self._gap is not None:
            self._gap.told, self._gap.sigma_cycles = sample, move.sigma_cycles

    def drop_phase(self) -> None:
        """The phase does not go on."""
        if self._gap is not None:
            self._gap.carried = False

    def move(self, cycles: float, chips: float) -> None:
        """The generators were put right."""
        self.memory.move(cycles, chips)
        for _, sums in self.symbols:
            sums *= cmath.rect(1.0, -math.tau * math.fmod(cycles, 1.0))

    # --- memory ------------------------------------------------------------------------------

    def forget(self) -> None:
        """Nothing before counts: the loop was wrong, or nothing was predicted."""
        self.memory.forget()

    def remember(
        self, sample: int, carrier: NcoState, chips: float, aid: AidingRate, power: float
    ) -> None:
        """Keep a command whose interval is over."""
        self.memory.remember(sample, carrier, chips, aid, power)

    def learn_phase(self, turned_cycles: float, aid: AidingRate, seconds: float) -> None:
        """Take what a phase loop turned the carrier by into its mean offset."""
        self.memory.learn(offset_of(turned_cycles, aid, seconds), seconds, faint=False)

    def learn_frequency(self, frequency_hz: float, aid: AidingRate, seconds: float) -> None:
        """The same of a loop that follows the frequency alone."""
        self.memory.learn(frequency_hz - aid.frequency_hz - aid.clock_hz, seconds, faint=True)

    # --- the way out and back ------------------------------------------------------------------

    def fallen(self) -> str:
        """The signal is gone (again): what became of the gap before, unless it still goes on."""
        gap = self._gap
        if gap is None or (gap.returned is not None and not gap.locked):
            return ""
        self._gap = None
        return gap.verdict(self._signal, self._rate)

    def begin(
        self, sample: int, aid: AidingRate, power: float | None, phase_since: int | None
    ) -> list[Led]:
        """Generators led on to a sample from before the signal fell; empty if nothing is known.

        power: of the signal in its mean, None: it was faint. phase_since: sample of phase lock.
        """
        memory, gap = self.memory, self._gap
        if memory.empty:
            self._gap = None
            return []
        if gap is not None and gap.returned is not None:  # it was not back: the gap goes on
            index = memory.before(gap.returned)
            self._gap = replace(gap, returned=None, phase_cycles=0.0, code_chips=0.0)
        else:
            index = memory.before_faint_fall() if power is None else memory.before_fall(power)
        led = memory.led_on(index, sample, aid)
        memory.resume(index)
        if self._gap is None:
            carried = phase_since is not None and phase_since <= led[0].sample
            self._gap = Gap(led[0].sample, self._looked_after, carried)
        self.symbols.clear()
        self._quarters.clear()
        return led

    def collect(self, prompts: ComplexArray, end: int) -> None:
        """Keep an update's symbols, up to a code period: they may be the first of the signal."""
        size = self._signal.symbol_periods
        if prompts.size % size == 0:
            stripped = prompts.reshape(-1, size) * self._signal.secondary
            self.symbols.append((end - prompts.size, stripped.sum(axis=1)))
            parts = self._signal.part_periods
            quarters = stripped.reshape(stripped.shape[0], -1, parts).sum(axis=2)
            power = float(np.vdot(quarters, quarters).real) / quarters.size
            turn = complex(np.vdot(quarters[:, :-1], quarters[:, 1:]))
            self._quarters.append((power, turn))

    def wide_signal(self, noise: float) -> float:
        """Least power of the last updates' signal by quarters of symbols, as of a code period.

        noise: its power in a code period.
        """
        if len(self._quarters) < _LOOKED_AT:
            return 0.0
        power = min(one for one, _ in self._quarters)
        parts = self._signal.part_periods
        return (power / parts - noise) / parts

    @property
    def off_hz(self) -> float:
        """By how much the carrier is above the generator's frequency, as quarters show it."""
        turn = sum(one for _, one in self._quarters)
        return cmath.phase(turn) / (math.tau * self._signal.part_s)

    def end(self, sample: int, frequency_hz: float, aid: AidingRate) -> None:
        """The signal is back."""
        if self._gap is not None:
            self._gap.returned = sample
            self._gap.offset_hz = frequency_hz - aid.frequency_hz - aid.clock_hz

    def seen_cycles(self, signs: Sequence[FloatArray] | None) -> float:
        """By how much the signal's first symbols are ahead of the phase carried on."""
        turn = phase_of([sums for _, sums in self.symbols], signs)
        if self._gap is not None:
            self._gap.phase_cycles = turn
        return turn

    def saw(
        self, turned_cycles: float, shifted_chips: float, aid: AidingRate, seconds: float
    ) -> None:
        """Count what loops do that are closed again, beyond what would have been led on."""
        gap = self._gap
        if gap is None or gap.returned is None:
            return
        gap.code_chips += shifted_chips
        if not gap.locked:
            led_cycles = predicted_cycles(aid, seconds) + gap.offset_hz * seconds
            gap.phase_cycles += turned_cycles - led_cycles

    def locked(self) -> bool:
        """The phase counts from here on; whether it is the one carried on."""
        if self._gap is not None:
            self._gap.locked = True
        return self.carried

    def judged(self, sample: int) -> str:
        """What the gap came to, once its return was long enough ago."""
        gap = self._gap
        if gap is None or gap.returned is None or sample - gap.returned < _JUDGED_S * self._rate:
            return ""
        self._gap = None
        return gap.verdict(self._signal, self._rate)


@compilable
def learnt(
    mean_hz: float, mean_seconds: float, offset_hz: float, seconds: float, mean_s: float
) -> tuple[float, float]:
    """A loop's mean offset from the prediction with that of an interval, and what it is made of."""
    mean_seconds += seconds
    return mean_hz + seconds / min(mean_seconds, mean_s) * (offset_hz - mean_hz), mean_seconds


@compilable
def offset_of(turned_cycles: float, aid: AidingRate, seconds: float) -> float:
    """Mean frequency by which a loop turned the carrier beyond the prediction, Hz."""
    return (turned_cycles - predicted_cycles(aid, seconds)) / seconds


@compilable
def predicted_cycles(aid: AidingRate, seconds: float) -> float:
    """What a prediction adds to the carrier over an update, the receiver's clock included."""
    mean_hz = aid.frequency_hz + aid.clock_hz + 0.5 * seconds * aid.rate_hzps
    return mean_hz * seconds


def phase_of(symbols: Sequence[ComplexArray], signs: Sequence[FloatArray] | None) -> float:
    """Phase of symbol sums against the generator, cycles: within ± ½ by their signs, else ± ¼."""
    if signs is not None:
        total = sum(complex(one @ sign) for one, sign in zip(symbols, signs, strict=True))
        return cmath.phase(total) / math.tau
    total = sum(complex((one * one).sum()) for one in symbols)
    return 0.5 * cmath.phase(total) / math.tau
