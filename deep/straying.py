"""How far channels in open loop may have strayed, and which of them to give up, T 4.5.

A signal that comes back further off than its channel can see needs a search, so the open loop may
as well end: as soon as 1σ of frequency or code, as the carrier phases leave the navigation and the
clock, is beyond `theory.reach`. How long that takes follows from inertial unit, oscillator, motion,
and from what else is tracked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray
from deepgnss.receiver.signals import Signal
from deepgnss.theory.open_loop import way_bound
from deepgnss.theory.reach import Reach, reach

_BACK_S: Final = 2.0  # without open loop: the signal is really back


class Unheard(NamedTuple):
    """A channel in open loop."""

    satellite: str
    signal: Signal


@dataclass(slots=True)
class _Stray:
    """What an open loop may be off by."""

    way_m: float
    last_s: float


class Straying:
    """Follows the 1σ of channels in open loop from tag to tag."""

    def __init__(self, spacing_chips: float) -> None:
        """spacing_chips: early to late."""
        self._spacing = spacing_chips
        self._strays: dict[str, _Stray] = {}

    def take(
        self, now_s: float, coasting: Sequence[Unheard], rate_sigma_mps: FloatArray
    ) -> Mapping[str, str]:
        """Go on to a tag: channels to be given up, and why.

        rate_sigma_mps: 1σ of the rates predicted for them.
        """
        kept = {
            name: one for name, one in self._strays.items() if 0.0 <= now_s - one.last_s < _BACK_S
        }
        self._strays, gone = kept, {}
        for one, sigma_mps in zip(coasting, rate_sigma_mps.tolist(), strict=True):
            stray = kept.setdefault(one.satellite, _Stray(0.0, now_s))
            stray.way_m = way_bound(stray.way_m, sigma_mps, now_s - stray.last_s)
            stray.last_s = now_s
            limit = reach(one.signal.part_s, self._spacing)
            reason = _beyond(one, stray.way_m, sigma_mps, limit)
            if reason:
                gone[one.satellite] = reason
                del kept[one.satellite]
        return gone


def _beyond(one: Unheard, way_m: float, rate_mps: float, limit: Reach) -> str:
    """Why the open loop is to end; empty: it is not."""
    signal = one.signal.id
    hz = rate_mps / SPEED_OF_LIGHT_MPS * signal.carrier_hz
    chips = way_m / SPEED_OF_LIGHT_MPS * signal.chip_rate_hz
    if hz > limit.frequency_hz:
        return f"1σ of the frequency predicted is {hz:.1f} Hz, more than {limit.frequency_hz:.1f}"
    if chips > limit.code_chips:
        return f"1σ of the code predicted is {chips:.2f} chip, more than {limit.code_chips:.2f}"
    return ""
