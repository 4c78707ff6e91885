"""clock.csv: the receiver's clock against GPST."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.sim.clock import NODES_PER_SECOND, ClockError, clock_error
from deepgnss.sim.output.columns import TIME_COLUMNS, ColumnTable, instants, time_columns
from deepgnss.sim.scenario import Scenario

_COLUMNS: Final[Mapping[str, int | None]] = {**TIME_COLUMNS, "offset_s": 15, "drift_sps": 15}
_SPAN_S: Final = 0.1  # over which the drift is the mean slope


def write_clock(path: Path, scenario: Scenario, rate_hz: float) -> None:
    """Clock reading − GPST at true times, and its mean slope over the 0.1 s about each."""
    error = clock_error(scenario.clock, scenario.seed, scenario.vehicle)
    chunk = max(int(rate_hz), 1)
    with ColumnTable(path, _COLUMNS) as table:
        for t_s in instants(scenario.start, scenario.seconds, 1.0 / rate_hz, chunk):
            half_s = _SPAN_S / 2.0
            now, before, after = _at(error, np.stack([t_s, t_s - half_s, t_s + half_s]))
            table.write(*time_columns(scenario.start, t_s), now, (after - before) / _SPAN_S)


def _at(error: ClockError, t_s: FloatArray) -> FloatArray:
    """Clock error at true times of any shape, straight between the nodes of its own count."""
    first, last = math.floor(t_s.min() - 0.2), math.floor(t_s.max() + 0.2)
    numbers = range(max(first, -2), last + 1)
    error_s = np.concatenate([error(number) for number in numbers])
    reading_s = numbers[0] + np.arange(error_s.size) / NODES_PER_SECOND
    return np.asarray(np.interp(t_s, reading_s - error_s, error_s))
