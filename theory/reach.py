"""How far off a signal may come back and still be found without a search, T 5.5.1.

Frequency: products of neighbouring sums tell it within ±1/(2T) of the generator's, T table 2.2.
Code: early and late, D apart, tell the side within ±(1 + D/2) chips, T figure 2.8. What a 1σ of
prediction may be follows from how much of a normal error is to lie within.
"""

from __future__ import annotations

from typing import Final, NamedTuple

FREQUENCY_SIGMAS: Final = 3.0
CODE_SIGMAS: Final = 2.0  # a chip off there is next to nothing to be seen already


class Reach(NamedTuple):
    """1σ of frequency and code up to which an open loop may go on."""

    frequency_hz: float
    code_chips: float


def reach(sum_s: float, spacing_chips: float) -> Reach:
    """Of a channel that adds up over `sum_s` and whose early and late lie D chips apart."""
    return Reach(0.5 / sum_s / FREQUENCY_SIGMAS, (1.0 + 0.5 * spacing_chips) / CODE_SIGMAS)
