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
at the interval's middle. A loop that corrects only every so often has two ways: ask for a long
interval, which runs on one command (aiding's curvature inside it is not followed, and the decisions
of a channel come as seldom); or stay at a symbol, keep each `seen.periods` in its memory, answer
NO_CORRECTION until it has enough, and move its estimate to the middle of the last interval with
`advance`. `seen.periods` are correlations by code period, (n, taps), secondary code and, in an
interval of several symbols, decided signs stripped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

from deepgnss.core.loops import loop_gains
from deepgnss.receiver.discriminators import costas_arctan
from deepgnss.receiver.trackers import Accumulated, Correction

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


@dataclass(frozen=True, slots=True)
class CostasLoop:
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
        gains = loop_gains(self.order, self.noise_bandwidth_hz, seen.seconds)
        return memory, Correction(gains.phase * error, gains.frequency * error, gains.rate * error)

    def turned(self, memory: None, cycles: float) -> None:
        """Nothing it knows of."""

    def bandwidth_hz(self, memory: None) -> float:
        """As asked for."""
        return self.noise_bandwidth_hz
