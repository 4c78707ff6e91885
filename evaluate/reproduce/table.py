"""What a row of the table of figures is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple


class Figure(NamedTuple):
    """One number measured here, and whether it reaches its target."""

    what: str  # which of the row's figures, e.g. "GPS"
    ours: str  # with its unit and the trials it comes from
    met: bool | None  # None: shown for comparison, not judged


QUICK_S = 300.0
"""What the quick version of the whole table may take, on two cores."""

Measure = Callable[[bool, Sequence[int]], list[Figure]]
"""(quick, seeds) → figures; `quick` is a version that a test run can afford."""


@dataclass(frozen=True, slots=True)
class Row:
    """A published figure, the one to reach, and how to measure it."""

    id: str
    scenario: str
    published: str
    target: str
    measure: Measure | None = None  # None: not yet
    quick_s: float = 10.0  # CPU time that its quick version may take, on a machine at rest
    alone: bool = False  # it measures the machine: nothing else may run

    @property
    def module(self) -> str:
        """Where it is measured: rows of one module may share recordings."""
        return self.measure.__module__ if self.measure is not None else ""


def verdict(figures: Sequence[Figure]) -> bool:
    """Whether every figure that is judged reaches its target."""
    return all(figure.met is not False for figure in figures)


def percent(hits: int, trials: int) -> str:
    """A share with its trials: "99.53 % of 3000"."""
    return f"{100.0 * hits / trials:.2f} % of {trials}"
