"""How far off a signal may come back and still be found without a search, T 5.5.1.

Frequency: products of neighbouring sums tell it within ±1/(2T) of the generator's, T table 2.2.
Code: early and late, D apart, tell the side within ±(1 + D/2) chips, T figure 2.8. An open loop is
worth its while as long as both are within twice their 1σ: one in twenty comes back beyond.
"""

from __future__ import annotations

from typing import Final, NamedTuple

SIGMAS: Final = 2.0


class Reach(NamedTuple):
    """1σ of frequency and code up to which an open loop may go on."""

    frequency_hz: float
    code_chips: float


def reach(sum_s: float, spacing_chips: float) -> Reach:
    """Of a channel that adds up over `sum_s` and whose early and late lie D chips apart."""
    return Reach(0.5 / sum_s / SIGMAS, (1.0 + 0.5 * spacing_chips) / SIGMAS)
