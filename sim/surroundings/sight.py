"""Surroundings that tell what hides a satellite, and how parts of them combine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from deepgnss.sim.scenario import Arrivals, Surroundings, View

STATES: Final = ("free", "attenuated", "diffracted", "blocked")
"""What a line of sight can be, from best to worst."""


class Sight(NamedTuple):
    """State of a line of sight for truth files."""

    state: NDArray[np.int8]  # (n,) index into STATES
    cause: NDArray[np.int16]  # (n,) index into names, −1 when free
    names: tuple[str, ...]


def free_sight(count: int) -> Sight:
    """Nothing in the way at `count` times."""
    return Sight(np.zeros(count, dtype=np.int8), np.full(count, -1, dtype=np.int16), ())


@runtime_checkable
class Seen(Surroundings, Protocol):
    """Surroundings that can tell what hides a satellite."""

    def visibility(self, view: View, carrier_hz: float) -> Sight:
        """State of the line of sight."""


@dataclass(frozen=True, slots=True)
class Together:
    """Parts that know nothing of each other: lines of sight multiply, rays add up."""

    parts: tuple[Seen, ...]

    @property
    def rays(self) -> int:
        """Of all parts."""
        return sum(part.rays for part in self.parts)

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        """What arrives through all parts."""
        direct = np.ones(view.t_s.size)
        amplitude, excess_m = [np.empty((0, direct.size))], [np.empty((0, direct.size))]
        for part in self.parts:
            one = part.arrivals(view, carrier_hz)
            direct = direct * one.direct
            amplitude.append(one.ray_amplitude)
            excess_m.append(one.ray_excess_m)
        return Arrivals(direct, np.concatenate(amplitude), np.concatenate(excess_m))

    def visibility(self, view: View, carrier_hz: float) -> Sight:
        """The worst that any part does to the line of sight."""
        worst = free_sight(view.t_s.size)
        for part in self.parts:
            one = part.visibility(view, carrier_hz)
            worse = one.state > worst.state
            worst = Sight(
                np.where(worse, one.state, worst.state),
                np.where(worse, one.cause + np.int16(len(worst.names)), worst.cause),
                worst.names + one.names,
            )
        return worst
