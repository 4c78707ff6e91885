"""Double differences over known geometry: what code and carrier are worth, T 6.3, 6.4.

Single differences to a base (`geometry.between`) still hold both clocks; the difference of a
satellite against the reference satellite of its system does not. Its carrier then is a whole number
of cycles off, the same one throughout an arc.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.evaluate.observations import wavelength_m

SLIP_CYCLES: Final = 0.25
"""A step of a double difference within an arc that is no noise."""

_USUAL: Final = 0.8  # share of the epochs a reference satellite has


def common(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Only the satellites and instants that all tables have.

    Parameters, returns: single differences by name.
    """
    keys = [pd.MultiIndex.from_frame(_instants(table)) for table in tables.values()]
    shared = keys[0]
    for other in keys[1:]:
        shared = shared.intersection(other)
    return {
        name: table[own.isin(shared)].reset_index(drop=True)
        for (name, table), own in zip(tables.items(), keys, strict=True)
    }


def _instants(table: pd.DataFrame) -> pd.DataFrame:
    """Satellite and instant: tags of receivers that steer by milliseconds meant for one instant."""
    tick_ms = 50
    rounded = (table["time_ms"] / tick_ms).round().astype(np.int64)
    return table[["satellite"]].assign(instant=rounded)


def references(differences: pd.DataFrame, elevation_mask_deg: float = 0.0) -> dict[str, str]:
    """Satellite of highest C/N0 by system, of those that have most epochs."""
    chosen = {}
    high = differences[differences["elevation_deg"] >= elevation_mask_deg]
    for system, own in high.groupby(high["satellite"].str[0]):
        counts = own.groupby("satellite").size()
        usual = counts[counts >= _USUAL * own["time_ms"].nunique()].index
        if len(usual):
            means = own[own["satellite"].isin(usual)].groupby("satellite")["cn0_dbhz"].mean()
            chosen[str(system)] = str(means.idxmax())
    return chosen


def double_differences(differences: pd.DataFrame, reference: Mapping[str, str]) -> pd.DataFrame:
    """Every satellite against the reference of its system, over the epochs that have both.

    Parameters: single differences; reference satellites by system.

    Returns: time_ms, satellite, reference, code_m, phase_m (its whole cycles removed: those of the
    arc's median; NaN without phase), arc.
    """
    parts = []
    for satellite in sorted(set(differences["satellite"])):
        other = reference.get(satellite[0])
        if other is None or other == satellite:
            continue
        pair = [satellite, other]
        own = differences[differences["satellite"].isin(pair)]
        code, phase, arc = (
            wide_with_gaps(own, name, pair) for name in ("code_m", "phase_m", "arc")
        )
        both = code.dropna().index
        if not len(both):
            continue
        arcs = arc.loc[both].groupby(pair).ngroup()
        raw_m = (phase[satellite] - phase[other]).loc[both]
        cycle_m = wavelength_m(satellite)
        whole = (raw_m.groupby(arcs).transform("median") / cycle_m).round()
        parts.append(
            pd.DataFrame(
                {
                    "time_ms": both,
                    "satellite": satellite,
                    "reference": other,
                    "code_m": (code[satellite] - code[other]).loc[both].to_numpy(),
                    "phase_m": (raw_m - whole * cycle_m).to_numpy(),
                    "arc": arcs.to_numpy(),
                }
            )
        )
    columns = ["time_ms", "satellite", "reference", "code_m", "phase_m", "arc"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def wide_with_gaps(frame: pd.DataFrame, column: str, satellites: Sequence[str]) -> pd.DataFrame:
    """One row per epoch, one column per satellite, NaN where it has none."""
    table = frame.pivot(index="time_ms", columns="satellite", values=column)
    return table.reindex(columns=list(satellites))


def satellite_table(doubled: pd.DataFrame) -> pd.DataFrame:
    """What the double differences of each satellite come to.

    Returns: index satellite; reference, epochs, code_sigma_m, code_mean_m, phase_epochs,
    phase_sigma_m (about each arc's mean), phase_max_m (magnitude, of those), slips.
    """
    rows = {}
    for satellite, own in doubled.groupby("satellite"):
        phase = own.dropna(subset=["phase_m"])
        centred = phase["phase_m"] - phase.groupby("arc")["phase_m"].transform("mean")
        steps = phase["phase_m"].diff()[phase["arc"].diff() == 0]
        rows[str(satellite)] = {
            "reference": own["reference"].iloc[0],
            "epochs": len(own),
            "code_sigma_m": own["code_m"].std(),
            "code_mean_m": own["code_m"].mean(),
            "phase_epochs": len(phase),
            "phase_sigma_m": centred.std(),
            "phase_max_m": centred.abs().max(),
            "slips": int((steps.abs() > SLIP_CYCLES * wavelength_m(str(satellite))).sum()),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def usual_sigma(table: pd.DataFrame, column: str) -> float:
    """Root mean square of a column over the satellites, by their epochs."""
    known = table.dropna(subset=[column])
    weights = known["epochs"]
    return float(np.sqrt((known[column] ** 2 * weights).sum() / weights.sum()))
