"""Carrier loops in phase lock: what a channel asks of one, and the Costas loops of fixed gains.

How to plug one in: write a frozen dataclass of its parameters that fits `PhaseLoop`, give it a
name in `carrier_loops`, its parameters a record in `modes.CarrierSettings` and a section in
`io.config.receiver`. Nothing else knows its name.

What a loop remembers from step to step is a record of its own, its *memory*; the channel keeps it
and hands it back. The carrier itself is no part of it: phase, frequency and rate are the
generator's state, and a loop sees what is left of them in its correlations. So

- aiding never gets here: it moves the generator, and the loop sees the residual;
- a memory begins with `start` where phase lock begins (fresh, back from an open loop, or moved
  away from a false lock) and ends with it;
- whole and half cycles put right from outside come by `turned`: correlations a loop has kept turn
  with the generator.

A step sees an interval of `interval_s`: a part of a symbol, or whole symbols. Its correction counts
at the interval's middle, and for all of it: observables are taken after it. A loop that corrects
only every so often has two ways: ask for a long interval (decisions of a channel come as seldom;
aided, it runs on a command for every 20 ms of it); or stay at a symbol, keep each `seen.periods` in
its memory, answer NO_CORRECTION until it has enough, and move its estimate to the middle of the
last interval with `advance`. `seen.periods` are correlations by code period, (n, taps), secondary
code and, in an interval of several symbols, signs stripped: those the loop has decided itself,
`signs`, since it knows best where the phase is. What it knows to change in the next interval goes
by `foreseen`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

from deepgnss.core.loops import LoopGains, loop_gains
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.discriminators import costas_arctan
from deepgnss.receiver.sync import decided_signs
from deepgnss.receiver.trackers import NO_CORRECTION, Accumulated, Correction

M = TypeVar("M")


class Settled(NamedTuple):
    """What a loop comes to on a plain signal, as a loop of fixed gains."""

    order: int  # 3: it has a frequency rate of its own
    bandwidth_hz: float  # one-sided, of noise
    interval_s: float


class PhaseLoop(Protocol[M]):
    """A strategy of carrier tracking in phase lock: parameters, never changed."""

    @property
    def interval_s(self) -> float:
        """Length of what a step sees: a whole part of a symbol, or whole symbols."""

    @property
    def settled(self) -> Settled:
        """What it comes to, for those who reckon with its noise and lag."""

    def start(self) -> M:
        """Memory of a loop just closed."""

    def step(self, memory: M, seen: Accumulated) -> tuple[M, Correction]:
        """Memory after an interval, and the correction at the interval's middle."""

    def turned(self, memory: M, cycles: float) -> M:
        """Memory after the generator was put forward by a phase."""

    def bandwidth_hz(self, memory: M) -> float:
        """One-sided noise bandwidth as it is now."""

    def signs(self, memory: M, sums: ComplexArray, interval_s: float) -> FloatArray:
        """Signs ±1 of the symbol sums (n,) of an interval, up to a common one."""

    def foreseen(self, memory: M, seconds: float) -> Correction:
        """Change of the generator at the end of an interval, beyond its own frequency and rate."""


class PlainLoop:
    """What loops have in common that see little in advance: to be inherited."""

    __slots__ = ()

    def signs(self, memory: Any, sums: ComplexArray, interval_s: float) -> FloatArray:
        """Next to the phase the sums show themselves."""
        return decided_signs(sums)

    def foreseen(self, memory: Any, seconds: float) -> Correction:
        """Nothing."""
        return NO_CORRECTION


@dataclass(frozen=True, slots=True)
class CostasLoop(PlainLoop):
    """PLL of order 2 or 3 on the coherent sum; it remembers nothing."""

    order: int
    noise_bandwidth_hz: float
    interval_s: float = 0.020
    discriminator: Callable[[complex], float] = costas_arctan

    @property
    def settled(self) -> Settled:
        """Itself."""
        return Settled(self.order, self.noise_bandwidth_hz, self.interval_s)

    def start(self) -> None:
        """Nothing to remember."""

    def step(self, memory: None, seen: Accumulated) -> tuple[None, Correction]:
        """Phase, frequency and rate from the phase of the prompt sum."""
        error = self.discriminator(seen.prompt)
        gains = self.gains(seen.seconds)
        return memory, Correction(gains.phase * error, gains.frequency * error, gains.rate * error)

    def gains(self, seconds: float) -> LoopGains:
        """Of an update so long."""
        return loop_gains(self.order, self.noise_bandwidth_hz, seconds)

    def turned(self, memory: None, cycles: float) -> None:
        """Nothing it knows of."""

    def bandwidth_hz(self, memory: None) -> float:
        """As asked for."""
        return self.noise_bandwidth_hz
