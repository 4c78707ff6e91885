"""Rays by decree, for laboratories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.sim.scenario import Arrivals, View
from deepgnss.sim.surroundings.sight import Sight, free_sight


@dataclass(frozen=True, slots=True)
class DecreedRay:
    """A ray of given amplitude, extra path and Doppler against the line of sight, for laboratories.

    `satellite` None means all. The extra path is `excess_m` at `start_s` and shrinks with a
    positive Doppler.
    """

    satellite: str | None
    amplitude: float
    excess_m: float
    doppler_hz: float
    start_s: float
    end_s: float

    @property
    def rays(self) -> int:
        """One."""
        return 1

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        """The free line of sight and the ray."""
        # Whole milliseconds, lest the receiver's clock error decide on which side a node lies.
        ms = np.rint(view.t_s * 1000.0)
        heard = (ms >= round(self.start_s * 1000.0)) & (ms < round(self.end_s * 1000.0))
        heard &= self.satellite in (None, view.satellite)
        closing_mps = self.doppler_hz * SPEED_OF_LIGHT_MPS / carrier_hz
        excess_m = self.excess_m - closing_mps * (view.t_s - self.start_s)
        amplitude = np.where(heard, self.amplitude, 0.0)
        return Arrivals(np.ones(view.t_s.size), amplitude[None], excess_m[None])

    def visibility(self, view: View, carrier_hz: float) -> Sight:
        """Free."""
        return free_sight(view.t_s.size)
