"""navbits.csv: the navigation symbols every satellite sent, frame piece by frame piece."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from deepgnss.core.time import GpsTime
from deepgnss.sim.output.columns import ColumnTable
from deepgnss.sim.rows import symbols_of
from deepgnss.sim.scenario import Scenario

_SUBFRAME: Final = 300  # symbols of an LNAV, D1 or D2 subframe
_COLUMNS: Final[Mapping[str, int | None]] = {
    **{"satellite": None, "signal": None, "gps_week": None, "gps_tow_s": 3, "bits_hex": None},
}


def write_navbits(path: Path, scenario: Scenario) -> None:
    """One row per satellite and subframe of 300 bits, the first bit the hex number's highest.

    The time is the satellite's own (GPST) at which the subframe begins; it reaches the antenna
    some 70 ms later. Bits are those on the air: NH code taken off, parity and interleaving on.
    """
    with ColumnTable(path, _COLUMNS) as table:
        for emitter in scenario.emitters:
            sent = symbols_of(scenario, emitter)
            bits = (np.asarray(sent.values) < 0).astype(np.uint8)
            starts = range(0, bits.size - _SUBFRAME + 1, _SUBFRAME)
            times = [
                GpsTime(scenario.start.week, 0.0).plus((sent.first + k) * emitter.signal.symbol_s)
                for k in starts
            ]
            table.write(
                [emitter.satellite] * len(times),
                [emitter.signal.id.name] * len(times),
                [time.week for time in times],
                [time.tow_s for time in times],
                [_hex(bits[k : k + _SUBFRAME]) for k in starts],
            )


def _hex(bits: np.ndarray) -> str:
    return f"{int(''.join(map(str, bits)), 2):0{_SUBFRAME // 4}x}"
