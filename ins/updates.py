"""Measurements fed to an estimate, each weighed by its innovation test first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_model import VELOCITY
from deepgnss.ins.error_state import Estimate, turned_along
from deepgnss.ins.filter import check_covariance, correct, innovation_limit, squared_innovation
from deepgnss.ins.measurements import Measurement


@dataclass(frozen=True, slots=True)
class Innovation:
    """What one measurement said against the prediction, and whether it was believed."""

    time: GpsTime
    kind: str
    innovation: FloatArray  # (m,)
    nis: float  # chi-square of m degrees while the filter is consistent
    accepted: bool


class Updated(NamedTuple):
    """Estimate after an instant's measurements."""

    estimate: Estimate
    x: FloatArray  # (size,) error that was taken off
    x_turning_mps: FloatArray  # (3,) that of velocity by measurements in body axes
    innovations: tuple[Innovation, ...]


class Count(NamedTuple):
    """How many measurements of a kind were tested, and how many of them refused."""

    tested: int
    rejected: int


def updated(estimate: Estimate, measurements: Iterable[Measurement], false_alarm: float) -> Updated:
    """Estimate corrected by the measurements of its instant that pass the innovation test.

    One after the other about the same prediction; a sound one is refused with probability
    `false_alarm`. Raises NumericalError when the covariance loses its footing.
    """
    x, P, x_turning = np.zeros(estimate.layout.size), estimate.P, np.zeros(3)
    innovations = []
    for kind, z, H, R, in_body, together in measurements:
        correction = correct(x, P, z, H, R)
        nis = correction.nis
        if together != 1.0:
            nis = squared_innovation(x, P, z, H, R / together)
        accepted = nis <= innovation_limit(z.size, false_alarm)
        if accepted:
            if in_body:
                x_turning += correction.x[VELOCITY] - x[VELOCITY]
            x, P = correction.x, correction.P
        innovations.append(
            Innovation(estimate.ins.time, kind, correction.innovation, nis, accepted)
        )
    if innovations:
        check_covariance(P)
    if x_turning.any():
        M = turned_along(x_turning, x.size)
        P = M @ P @ M.T
    return Updated(estimate.corrected(x, P), x, x_turning, tuple(innovations))


def counts(innovations: Iterable[Innovation]) -> Mapping[str, Count]:
    """Tested and rejected measurements by kind."""
    total: dict[str, Count] = {}
    for innovation in innovations:
        tested, rejected = total.get(innovation.kind, Count(0, 0))
        total[innovation.kind] = Count(tested + 1, rejected + (not innovation.accepted))
    return total
