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
from dataclasses import dataclass, field
from typing import NamedTuple

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.modes import AidingRate
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import NcoState

_KEPT_S = 1.3  # of past commands: as late as a faint signal's fall is noticed
_FAINT_S = 1.0  # before its fall is noticed
_MEAN_S = 1.5  # of a phase loop's offset from the prediction …
_FAINT_MEAN_S = 3.0  # … and of a frequency's
_ENOUGH_S = 0.2  # of either before it is better than the loop's last frequency
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
    symbols: deque[tuple[int, ComplexArray]] = field(default_factory=lambda: deque(maxlen=3))

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
        if self._seconds < _ENOUGH_S:
            offset_hz = carrier.frequency - aid.frequency_hz - aid.clock_hz
        self._passed.append(Passed(sample, carrier, chips, aid, offset_hz, power))
        while sample - self._passed[0].sample > _KEPT_S * self._rate:
            self._passed.popleft()

    def learn(self, offset_hz: float, seconds: float, *, faint: bool) -> None:
        """Take the loop's offset from the prediction, in the mean of an interval."""
        self._seconds += seconds
        share = seconds / min(self._seconds, _FAINT_MEAN_S if faint else _MEAN_S)
        self._offset_hz += share * (offset_hz - self._offset_hz)

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
