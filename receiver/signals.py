"""A signal is one small object: code, rates, carrier, secondary code, symbol length.

Adding a signal adds an object here and a message decoder; no loop changes.

A name of the configuration may stand for several objects (`SIGNALS`): BDS_B1I is one carrier, one
family of codes and one RINEX name, but MEO and IGSO satellites send D1 (NH code, symbols of 20 ms)
and GEO satellites D2 (no secondary code, 2 ms). What may be relied on:

- The objects of a name share `id` and `primary_code`; their `prns` are disjoint, and `signal_of`
  finds the one of a satellite.
- Code periods are 1 ms, and a symbol starts where the code periods since the GPS epoch, counted in
  satellite time (GPST), are a multiple of `symbol_periods`: BDT is 14 whole seconds behind.
- `secondary_code` is empty or has `symbol_periods` entries; its first belongs to the first code
  period of a symbol. A code period carries primary code · secondary chip · symbol.
- `message` knows the frames the symbols make up, in GPST whatever the system's time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import BDS_B1I, GPS_L1CA, FloatArray, SignalId
from deepgnss.receiver.beidou_nav import D1, D2
from deepgnss.receiver.lnav import LNAV
from deepgnss.receiver.messages import MessageFormat

_UPDATE_S: Final = 0.02


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
    message: MessageFormat
    # Codes of the same family that others send on this carrier: never received, but known for
    # what they leave in a search for weak satellites.
    relatives: tuple[int, ...] = ()

    # What follows from these, worked out once: every update of every channel asks for it.
    period_s: float = field(init=False)  # of one code period
    symbol_s: float = field(init=False)  # of one navigation symbol
    update_periods: int = field(
        init=False
    )  # of an undivided loop update: a symbol, or 20 ms of them
    update_s: float = field(init=False)
    part_periods: int = field(init=False)  # of a quarter of a symbol: shows a signal far off
    part_s: float = field(init=False)
    secondary: FloatArray = field(init=False, compare=False)  # ±1 by code period of a symbol
    carrier_to_code: float = field(init=False)  # carrier cycles per chip: 1540 for L1, 763 for B1I

    def __post_init__(self) -> None:
        def take(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        take("period_s", self.id.code_chips / self.id.chip_rate_hz)
        take("symbol_s", self.symbol_periods * self.period_s)
        take("update_periods", self.symbol_periods * max(1, round(_UPDATE_S / self.symbol_s)))
        take("update_s", self.update_periods * self.period_s)
        take("part_periods", max(1, self.symbol_periods // 4))
        take("part_s", self.part_periods * self.period_s)
        chips = np.array(self.secondary_code or (1,) * self.symbol_periods, dtype=np.float64)
        chips.flags.writeable = False
        take("secondary", chips)
        take("carrier_to_code", self.id.carrier_hz / self.id.chip_rate_hz)

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


@cache
def _shift_register(feedback: tuple[int, ...], register: tuple[int, ...]) -> NDArray[np.int8]:
    """One period of a maximal register's last stage, as logic levels; `register` is its start."""
    out = np.empty(2 ** len(register) - 1, dtype=np.int8)
    for chip in range(out.size):
        out[chip] = register[-1]
        register = (sum(register[tap - 1] for tap in feedback) % 2, *register[:-1])
    out.flags.writeable = False
    return out


def _chips(levels: NDArray[np.int8]) -> NDArray[np.int8]:
    """Read-only chips ±1 of logic levels (0 = +1)."""
    code = (1 - 2 * levels).astype(np.int8)
    code.flags.writeable = False
    return code


@cache
def ca_code(prn: int) -> NDArray[np.int8]:
    """C/A code of a PRN as ±1 (logic 0 = +1), shape (1023,) (IS-GPS-200 3.2.1.3)."""
    g1 = _shift_register((3, 10), (1,) * 10)
    g2 = np.roll(_shift_register((2, 3, 6, 8, 9, 10), (1,) * 10), _CA_DELAY_CHIPS[prn])
    return _chips(g1 ^ g2)


# Stages of the G2 register that are added up for PRN 1, 2, … 63 (BDS-SIS-ICD B1I table 4-1).
_B1I_STAGES: Final = (
    (1, 3), (1, 4), (1, 5), (1, 6), (1, 8), (1, 9), (1, 10), (1, 11), (2, 7),
    (3, 4), (3, 5), (3, 6), (3, 8), (3, 9), (3, 10), (3, 11),
    (4, 5), (4, 6), (4, 8), (4, 9), (4, 10), (4, 11),
    (5, 6), (5, 8), (5, 9), (5, 10), (5, 11), (6, 8), (6, 9), (6, 10), (6, 11),
    (8, 9), (8, 10), (8, 11), (9, 10), (9, 11), (10, 11),
    (1, 2, 7), (1, 3, 4), (1, 3, 6), (1, 3, 8), (1, 3, 10), (1, 3, 11), (1, 4, 5), (1, 4, 9),
    (1, 5, 6), (1, 5, 8), (1, 5, 10), (1, 5, 11), (1, 6, 9), (1, 8, 9), (1, 9, 10), (1, 9, 11),
    (2, 3, 7), (2, 5, 7), (2, 7, 9), (3, 4, 5), (3, 4, 9),
    (3, 5, 6), (3, 5, 8), (3, 5, 10), (3, 5, 11), (3, 6, 9),
)  # fmt: skip
_B1I_START: Final = (0, 1) * 5 + (0,)


@cache
def b1i_code(prn: int) -> NDArray[np.int8]:
    """B1I code of a PRN as ±1 (logic 0 = +1), shape (2046,) (BDS-SIS-ICD B1I 4.2.2).

    A Gold code of 2047 chips without its last one; a stage shows what the last stage shows later.
    """
    g1 = _shift_register((1, 7, 8, 9, 10, 11), _B1I_START)
    g2 = _shift_register((1, 2, 3, 4, 5, 8, 9, 11), _B1I_START)
    selected = [np.roll(g2, stage - 11) for stage in _B1I_STAGES[prn - 1]]
    return _chips(np.bitwise_xor.reduce([g1, *selected])[: BDS_B1I.code_chips])


NH20: Final = (1, 1, 1, 1, 1, -1, 1, 1, -1, -1, 1, -1, 1, -1, 1, 1, -1, -1, -1, 1)
"""Neumann–Hoffman code of D1, a chip per code period (BDS-SIS-ICD B1I 5.1.2)."""

_GEO_PRNS: Final = (*range(1, 6), *range(59, 64))  # BDS-SIS-ICD B1I table 4-1
_MEO_IGSO_PRNS: Final = tuple(range(6, 59))

GPS_L1CA_SIGNAL = Signal(
    id=GPS_L1CA,
    prns=tuple(range(1, 33)),
    primary_code=ca_code,
    secondary_code=(),
    symbol_periods=20,
    message=LNAV,
    relatives=(*range(120, 159), *range(193, 203)),
)

BDS_B1I_D1 = Signal(
    id=BDS_B1I,
    prns=_MEO_IGSO_PRNS,
    primary_code=b1i_code,
    secondary_code=NH20,
    symbol_periods=20,
    message=D1,
    relatives=_GEO_PRNS,
)
"""B1I of the BeiDou satellites in medium and inclined geosynchronous orbits."""

BDS_B1I_D2 = Signal(
    id=BDS_B1I,
    prns=_GEO_PRNS,
    primary_code=b1i_code,
    secondary_code=(),
    symbol_periods=2,
    message=D2,
    relatives=_MEO_IGSO_PRNS,
)
"""B1I of the geostationary BeiDou satellites."""

SIGNALS: Mapping[str, tuple[Signal, ...]] = {
    GPS_L1CA.name: (GPS_L1CA_SIGNAL,),
    BDS_B1I.name: (BDS_B1I_D1, BDS_B1I_D2),
}
"""Objects by the name of a signal in the configuration."""


def signal_of(signal_name: str, prn: int) -> Signal:
    """The object of a name that a satellite (or a relative of the family) sends."""
    candidates = SIGNALS[signal_name]
    return next((signal for signal in candidates if prn in signal.prns), candidates[0])


@cache
def neighbour_correlation(signal_name: str, prn: int) -> float:
    """Correlation of a satellite's primary code with itself one chip off, against that at zero."""
    code = signal_of(signal_name, prn).primary_code(prn).astype(np.float64)
    return float(code @ np.roll(code, 1)) / code.size


@cache
def code_runs(signal_name: str, prn: int) -> CodeRuns:
    """Primary code of a satellite as runs of equal chips."""
    code = signal_of(signal_name, prn).primary_code(prn)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
    edges = np.append(starts, code.size).astype(np.float64)
    return CodeRuns(edges, code[starts].astype(np.float64))


class CodeTable(NamedTuple):
    """The codes of a signal's satellites as runs (`CodeRuns`), row by row."""

    rows: Mapping[int, int]  # by PRN
    edges: FloatArray  # (rows, most runs + 1)
    signs: FloatArray  # (rows, most runs)
    runs: NDArray[np.int64]  # (rows,): how many of them count


@cache
def code_table(signal_name: str) -> CodeTable:
    """All codes of a signal."""
    prns = [prn for signal in SIGNALS[signal_name] for prn in signal.prns]
    codes = [code_runs(signal_name, prn) for prn in prns]
    most = max(code.signs.size for code in codes)
    edges, signs = np.zeros((len(codes), most + 1)), np.zeros((len(codes), most))
    for row, code in enumerate(codes):
        edges[row, : code.edges.size], signs[row, : code.signs.size] = code
    runs = np.array([code.signs.size for code in codes])
    return CodeTable({prn: row for row, prn in enumerate(prns)}, edges, signs, runs)
