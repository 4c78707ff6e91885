"""Logs of u-blox receivers (UBX): raw observations (RXM-RAWX) and positions (NAV-PVT)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pymap3d
from pyubx2 import (
    ERR_IGNORE,
    UBX_PROTOCOL,
    UBXMessageError,
    UBXParseError,
    UBXReader,
    UBXStreamError,
    UBXTypeError,
)

from deepgnss.core.errors import InputFileError
from deepgnss.core.time import from_utc
from deepgnss.io.input import reading

OBSERVATIONS: Final = (
    *("week", "tow_s", "satellite", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz"),
    *("slip", "half_cycle"),
)
"""Columns of `UbxLog.observations`; phase grows with range, Doppler when it shrinks, as RINEX."""

POSITIONS: Final = (
    *("week", "tow_s", "valid", "x_e_m", "y_e_m", "z_e_m", "v_n_mps", "v_e_mps", "v_d_mps"),
    *("satellites", "carrier"),
)
"""Columns of `UbxLog.positions`; carrier: 0 none, 1 float, 2 fixed."""

# gnssId and sigId, interface description of the F9, "GNSS identifiers", "Signal identifiers"
_LETTERS: Final = {0: "G", 3: "C"}
_SIGNALS: Final = {0: (0,), 3: (0, 1)}  # L1 C/A; B1I D1, D2
_NOT_UBX: Final = (UBXMessageError, UBXParseError, UBXStreamError, UBXTypeError)
_NAMES: Final = ("RXM-RAWX", "NAV-PVT")


@dataclass(frozen=True, slots=True)
class UbxLog:
    """What a log holds of GPS L1 C/A and BeiDou B1I, and its positions; either may be empty."""

    observations: pd.DataFrame  # OBSERVATIONS
    positions: pd.DataFrame  # POSITIONS


def read_ubx(path: Path | str) -> UbxLog:
    """Read a log; damaged messages are passed over.

    Raises InputFileError: it cannot be read, or holds neither observations nor positions.
    """
    path = Path(path)
    observed: list[tuple[Any, ...]] = []
    positions: list[tuple[Any, ...]] = []
    locks: dict[str, tuple[int, int]] = {}
    with reading(path), path.open("rb") as stream:
        try:
            for message in _messages(stream):
                if message.identity == "NAV-PVT":
                    positions.append(_position(message))
                else:
                    observed.extend(_observations(message, locks))
        except _NOT_UBX as error:
            raise InputFileError(f"{path}: not UBX: {error}") from error
    if not observed and not positions:
        raise InputFileError(f"{path}: neither RXM-RAWX nor NAV-PVT in it")
    return UbxLog(
        pd.DataFrame(observed, columns=list(OBSERVATIONS)),
        pd.DataFrame([row for row in positions if row], columns=list(POSITIONS)),
    )


def _messages(stream: Any) -> Iterator[Any]:
    for _, message in UBXReader(stream, protfilter=UBX_PROTOCOL, quitonerror=ERR_IGNORE):
        if getattr(message, "identity", "") in _NAMES:
            yield message


def _observations(message: Any, locks: dict[str, tuple[int, int]]) -> Iterator[tuple[Any, ...]]:
    """Rows of an epoch; `locks` remembers lock time and half-cycle state of each satellite."""
    for k in range(1, message.numMeas + 1):

        def field(name: str, row: int = k) -> Any:
            return getattr(message, f"{name}_{row:02d}")

        system = field("gnssId")
        if system not in _LETTERS or field("sigId") not in _SIGNALS[system]:
            continue
        name = f"{_LETTERS[system]}{field('svId'):02d}"
        lock_ms, subtracted = field("locktime"), field("subHalfCyc")
        before = locks.get(name)
        slip = before is None or lock_ms == 0 or lock_ms < before[0] or subtracted != before[1]
        carrier = field("cpMes") if field("cpValid") else math.nan
        if field("cpValid"):
            locks[name] = (lock_ms, subtracted)
        yield (
            message.week,
            message.rcvTow,
            name,
            field("prMes") if field("prValid") else math.nan,
            carrier,
            field("doMes"),
            float(field("cno")),
            slip,
            not field("halfCyc"),
        )


def _position(message: Any) -> tuple[Any, ...]:
    """A row of NAV-PVT, none without a date."""
    if not (message.validDate and message.validTime):
        return ()
    clock = (message.hour, message.min, min(message.second, 59))
    whole = datetime(message.year, message.month, message.day, *clock, tzinfo=UTC)
    late_s = message.second - clock[2] + 1e-9 * message.nano
    time = from_utc(whole + timedelta(0)).plus(late_s)
    place = pymap3d.geodetic2ecef(message.lat, message.lon, 1e-3 * message.height)
    velocity = (1e-3 * message.velN, 1e-3 * message.velE, 1e-3 * message.velD)
    valid = int(message.gnssFixOk and message.fixType in (2, 3, 4))
    return (
        time.week,
        time.tow_s,
        valid,
        *map(float, place),
        *velocity,
        message.numSV,
        message.carrSoln,
    )
