"""What receivers heard: satellites, strengths, slips, over the time at which all were running."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.observables import week_seconds
from deepgnss.evaluate.sources import Source

_SAME_S: Final = 0.05  # tags of receivers that steer by milliseconds


class Heard(NamedTuple):
    """What one receiver observed."""

    epochs: int
    ranges: float  # per epoch
    phases: float  # per epoch
    cn0_dbhz: float  # mean
    slips: int  # possible ones, as the receiver itself told them


def heard(sources: Sequence[Source]) -> dict[str, Heard]:
    """By receiver, of those with observations; epochs and satellites are each one's own."""
    tables = {s.name: s.observations for s in sources if len(s.observations)}
    times = {name: week_seconds(table, 0) for name, table in tables.items()}
    return {name: _one(table) for name, table in _while_all(tables, times).items()}


def strength(source: Source) -> pd.DataFrame:
    """C/N0 over time: week, tow_s, satellite, cn0_dbhz, and mode for a run of ours."""
    if source.channels is not None:
        return source.channels[["week", "tow_s", "satellite", "cn0_dbhz", "mode"]]
    return source.observations[["week", "tow_s", "satellite", "cn0_dbhz"]]


def _while_all(
    tables: Mapping[str, pd.DataFrame], times: Mapping[str, FloatArray]
) -> dict[str, pd.DataFrame]:
    if not tables:
        return {}
    first = max(float(t.min()) for t in times.values())
    last = min(float(t.max()) for t in times.values())
    return {
        name: t[(times[name] >= first - _SAME_S) & (times[name] <= last + _SAME_S)]
        for name, t in tables.items()
    }


def _one(observed: pd.DataFrame) -> Heard:
    epochs = len(observed[["week", "tow_s"]].drop_duplicates())
    phases = observed["carrier_cycles"].notna()
    return Heard(
        epochs,
        len(observed) / max(epochs, 1),
        int(phases.sum()) / max(epochs, 1),
        float(observed["cn0_dbhz"].mean()),
        int((observed["slip"] & phases).sum()),
    )
