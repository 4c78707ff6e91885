"""A signal is one small object: code, rates, carrier, secondary code, symbol length.

Adding a signal adds an object here and a message decoder; no loop changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import GPS_L1CA, FloatArray, SignalId


class CodeRuns(NamedTuple):
    """A primary code as runs of equal chips (SPEC 4).

    edges: float64 (runs + 1,) chip index where each run starts, last the code length;
    signs: float64 (runs,) ±1.
    """

    edges: FloatArray
    signs: FloatArray


@dataclass(frozen=True, slots=True)
class Signal:
    """A GNSS signal as the receiver needs it."""

    id: SignalId
    prns: tuple[int, ...]
    primary_code: Callable[[int], NDArray[np.int8]]  # PRN → ±1 chips, logic 0 = +1
    secondary_code: tuple[int, ...]  # ±1, one per code period; empty: none
    symbol_periods: int  # code periods per navigation symbol
    # Codes of the same family that others send on this carrier: never received, but known for
    # what they leave in a search for weak satellites.
    relatives: tuple[int, ...] = ()

    @property
    def period_s(self) -> float:
        """Length of one code period, s."""
        return self.id.code_chips / self.id.chip_rate_hz

    @property
    def symbol_s(self) -> float:
        """Length of one navigation symbol, s."""
        return self.symbol_periods * self.period_s

    @property
    def carrier_to_code(self) -> float:
        """Carrier cycles per chip: 1540 for GPS L1, 763 for B1I."""
        return self.id.carrier_hz / self.id.chip_rate_hz

    def satellite(self, prn: int) -> str:
        """RINEX satellite name of a PRN, e.g. G05."""
        return f"{self.id.system}{prn:02d}"


# Delays of the G2 register in chips: GPS 1–32 (IS-GPS-200 table 3-Ia), SBAS 120–158 (DO-229
# table A-1), QZSS 193–202 (IS-QZSS-PNT table 3.2.2-2).
_CA_DELAY_CHIPS = dict(zip((*range(1, 33), *range(120, 159), *range(193, 203)), (
    5, 6, 7, 8, 17, 18, 139, 140, 141, 251, 252, 254, 255, 256, 257, 258,
    469, 470, 471, 472, 473, 474, 509, 512, 513, 514, 515, 516, 859, 860, 861, 862,
    145, 175, 52, 21, 237, 235, 886, 657, 634, 762, 355, 1012, 176, 603, 130, 359, 595, 68, 386,
    797, 456, 499, 883, 307, 127, 211, 121, 118, 163, 628, 853, 484, 289, 811, 202, 1021, 463, 568,
    904,
    339, 208, 711, 189, 263, 537, 663, 942, 173, 900,
), strict=True))  # fmt: skip


def _shift_register(feedback: tuple[int, ...]) -> NDArray[np.int8]:
    """One period of a 10-stage maximal register started from all ones, as logic levels."""
    register = [1] * 10
    out = np.empty(1023, dtype=np.int8)
    for chip in range(1023):
        out[chip] = register[9]
        register = [sum(register[tap - 1] for tap in feedback) % 2, *register[:9]]
    return out


@cache
def ca_code(prn: int) -> NDArray[np.int8]:
    """C/A code of a PRN as ±1 (logic 0 = +1), shape (1023,) (IS-GPS-200 3.2.1.3)."""
    g1 = _shift_register((3, 10))
    g2 = np.roll(_shift_register((2, 3, 6, 8, 9, 10)), _CA_DELAY_CHIPS[prn])
    code = (1 - 2 * (g1 ^ g2)).astype(np.int8)
    code.flags.writeable = False
    return code


GPS_L1CA_SIGNAL = Signal(
    id=GPS_L1CA,
    prns=tuple(range(1, 33)),
    primary_code=ca_code,
    secondary_code=(),
    symbol_periods=20,
    relatives=(*range(120, 159), *range(193, 203)),
)

SIGNALS: Mapping[str, Signal] = {GPS_L1CA.name: GPS_L1CA_SIGNAL}


@cache
def code_runs(signal_name: str, prn: int) -> CodeRuns:
    """Primary code of a satellite as runs of equal chips."""
    code = SIGNALS[signal_name].primary_code(prn)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
    edges = np.append(starts, code.size).astype(np.float64)
    return CodeRuns(edges, code[starts].astype(np.float64))
