"""What is known beside the satellites' ranges: rows of their own in the adjustment of a position.

Biases between time systems as solutions before left them, and the antenna's place by somebody who
does not know it from this epoch: an inertial navigation. Both are measurements with their σ, by
which few satellites, or many in one direction, still make a position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.linear import whitening
from deepgnss.core.records import FloatArray, NavSolution
from deepgnss.core.time import GpsTime

_BETWEEN_M_RTS = 0.005  # random walk of the biases between systems


class Place(NamedTuple):
    """Antenna (ECEF) as predicted for the epoch, errors independent of the epoch's own."""

    r_e_m: FloatArray  # (3,)
    v_e_mps: FloatArray  # (3,)
    covariance_m2: FloatArray  # (3, 3)
    velocity_covariance_m2ps2: FloatArray  # (3, 3)


class Beside(NamedTuple):
    """What is known; between: biases against GPS and their 1σ, m, by system."""

    between_m: Mapping[str, tuple[float, float]]
    place: Place | None = None


class Rows(NamedTuple):
    """Rows beside those of the satellites: H·x = values ± sigma.

    x: a step of the position (3), then a clock per system.
    """

    H: FloatArray
    values: FloatArray
    sigma: FloatArray


def between_systems(time: GpsTime, previous: NavSolution | None) -> dict[str, tuple[float, float]]:
    """Biases against GPS and their 1σ, m, as a solution before left them."""
    if previous is None or not previous.valid:
        return {}
    walked_m = _BETWEEN_M_RTS * np.sqrt(abs(time.since(previous.time)))
    return {
        system: (
            SPEED_OF_LIGHT_MPS * previous.isb_s[system],
            float(np.hypot(SPEED_OF_LIGHT_MPS * sigma_s, walked_m)),
        )
        for system, sigma_s in previous.isb_sigma_s.items()
    }


def rows_beside(systems: Sequence[str], known: Beside, r_e_m: FloatArray) -> Rows:
    """Rows "clock of a system − clock of GPS = bias", for those known, then the place.

    r_e_m: (3,) where the step begins. The place's rows are whitened: L⁻¹·step = L⁻¹·(place − r)
    with its covariance LLᵀ.
    """
    told = [s for s in systems[1:] if s in known.between_m] if systems[:1] == ["G"] else []
    count = len(told) + (3 if known.place is not None else 0)
    rows = Rows(np.zeros((count, 3 + len(systems))), np.zeros(count), np.ones(count))
    for row, system in enumerate(told):
        rows.H[row, 3], rows.H[row, 3 + systems.index(system)] = -1.0, 1.0
        rows.values[row], rows.sigma[row] = known.between_m[system]
    if known.place is not None:
        white = whitening(known.place.covariance_m2)
        rows.H[len(told) :, :3] = white
        rows.values[len(told) :] = white @ (known.place.r_e_m - r_e_m)
    return rows
