"""The interval under way: its correlations as they come in, command by command."""

from __future__ import annotations

import math

import numpy as np

from deepgnss.core.records import ComplexArray


class Intake:
    """Code periods of an interval: as many are in, as many until the next command."""

    def __init__(self, taps: int) -> None:
        self._taps = taps
        self.begin(1, 1)

    def begin(self, periods: int, most: int) -> None:
        """A new interval of so many code periods, `whole`, with a command for `most` of them."""
        self.taken: ComplexArray = np.empty((periods, self._taps), dtype=np.complex128)
        self.whole = periods
        self.filled = self.planned = self.commands = 0
        self.go_on(most)

    def go_on(self, most: int) -> None:
        """To the interval's next command."""
        self.begun = self.planned
        self.planned = min(self.whole, self.begun + most)
        self.commands += 1

    def take(self, correlations: ComplexArray) -> None:
        """Take the next code periods, (periods, taps)."""
        filled = self.filled + correlations.shape[0]
        self.taken[self.filled : filled] = correlations
        self.filled = filled

    @property
    def undivided(self) -> bool:
        """Whether one command holds for all of the interval."""
        return self.planned == self.whole and self.commands == 1

    def copy_to(self, room: ComplexArray) -> None:
        """Put what is in into a room of (periods, taps)."""
        room[: self.filled] = self.taken[: self.filled]

    def refill(self, correlations: ComplexArray) -> None:
        """Take the interval's code periods from its begin on anew, (periods, taps)."""
        self.filled = 0
        self.take(correlations)

    def turn(self, cycles: float) -> None:
        """The carrier generator was turned."""
        self.taken[: self.filled] *= np.exp(-2j * np.pi * math.fmod(cycles, 1.0))

    @property
    def skip(self) -> int:
        """Code periods taken under the present command."""
        return self.filled - self.begun

    @property
    def command_over(self) -> bool:
        """Whether the present command has all of its code periods."""
        return self.filled == self.planned

    @property
    def over(self) -> bool:
        """Whether the interval has all of them."""
        return self.filled == self.whole
