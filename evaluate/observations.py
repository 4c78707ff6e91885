"""Observations and true ranges as tables of one shape, whichever file they come from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Epoch, Observation, SampleInstant, SignalId
from deepgnss.core.time import GpsTime
from deepgnss.io.input import reading
from deepgnss.io.rinex_obs_reader import read_obs

SIGNAL_OF_SYSTEM: Final[Mapping[str, SignalId]] = {"G": GPS_L1CA, "C": BDS_B1I}
"""The signal that is compared, by system letter."""

OBSERVATION_COLUMNS: Final = (
    *("week", "tow_s", "satellite", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz"),
    *("slip", "half_cycle"),
)
"""Of `read_observations`: NaN where missing; `slip`, `half_cycle` bool, the bits 0 and 1 of LLI."""

_USUAL_DBHZ: Final = 40.0  # of receivers that do not tell it

RANGE_COLUMNS: Final = ("week", "tow_s", "satellite", "range_m", "phase_m", "elevation_deg")
"""Of `read_ranges`: pseudorange and carrier phase (growing with range) of a perfect receiver."""


def wavelength_m(satellite: str) -> float:
    """Carrier wavelength of a satellite's signal."""
    return SPEED_OF_LIGHT_MPS / SIGNAL_OF_SYSTEM[satellite[0]].carrier_hz


def wavelengths_m(satellites: pd.Series) -> pd.Series:
    """Carrier wavelength row by row."""
    return satellites.map({name: wavelength_m(name) for name in satellites.unique()}).astype(float)


def read_observations(path: Path | str) -> pd.DataFrame:
    """Read an observations.csv of ours or a RINEX observation file (2, 3) of anybody's.

    Returns: columns OBSERVATION_COLUMNS, one row per epoch and satellite.
    Raises InputFileError: the file cannot be read, or is neither.
    """
    path = Path(path)
    if path.suffix != ".csv":
        return _from_rinex(read_obs(path, "".join(SIGNAL_OF_SYSTEM)).frame)
    frame = _table(path, ("week", "tow_s", "satellite", "pseudorange_m", "carrier_cycles"))
    valid = frame["carrier_valid"] == 1
    return frame.assign(
        carrier_cycles=frame["carrier_cycles"].where(valid),
        slip=frame["slip"] == 1,
        half_cycle=frame["half_cycle"] == 1,
    )[list(OBSERVATION_COLUMNS)]


def _from_rinex(frame: pd.DataFrame) -> pd.DataFrame:
    parts = []
    for system, signal in SIGNAL_OF_SYSTEM.items():
        rows = frame[frame["satellite"].str[0] == system]
        if rows.empty or f"C{signal.rinex}" not in rows:
            continue
        phase = f"L{signal.rinex}"
        blank = pd.Series(np.nan, rows.index)
        lli = rows.get(f"{phase}_lli", pd.Series(0, rows.index))
        parts.append(
            pd.DataFrame(
                {
                    "week": rows["week"],
                    "tow_s": rows["tow_s"],
                    "satellite": rows["satellite"],
                    "pseudorange_m": rows[f"C{signal.rinex}"],
                    "carrier_cycles": rows.get(phase, blank),
                    "doppler_hz": rows.get(f"D{signal.rinex}", blank),
                    "cn0_dbhz": rows.get(f"S{signal.rinex}", blank),
                    "slip": (lli & 1) > 0,
                    "half_cycle": (lli & 2) > 0,
                }
            )
        )
    if not parts:
        return pd.DataFrame(columns=list(OBSERVATION_COLUMNS))
    return pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)


def epochs(observed: pd.DataFrame) -> Iterator[Epoch]:
    """Observations as the receiver's own records, epoch by epoch; those without a range left out.

    Parameters: observed: as of `read_observations`.
    """
    for _, rows in observed.groupby(["week", "tow_s"], sort=True):
        time = GpsTime(int(rows["week"].iloc[0]), float(rows["tow_s"].iloc[0]))
        yield Epoch(time, SampleInstant(0, 0.0), _records(time, rows))


def _records(time: GpsTime, rows: pd.DataFrame) -> tuple[Observation, ...]:
    known = rows[np.isfinite(rows["pseudorange_m"])]
    ranges_m, cycles, dopplers_hz, cn0_dbhz = (
        known[name].to_numpy(np.float64)
        for name in ("pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz")
    )
    slips, halves = (known[name].to_numpy(np.bool_) for name in ("slip", "half_cycle"))
    return tuple(
        Observation(
            satellite=satellite,
            signal=SIGNAL_OF_SYSTEM[satellite[0]].name,
            pseudorange_m=float(ranges_m[k]),
            carrier_cycles=float(cycles[k]),
            doppler_hz=float(dopplers_hz[k]),
            cn0_dbhz=float(cn0_dbhz[k]) if cn0_dbhz[k] > 0.0 else _USUAL_DBHZ,
            lock_time_s=0.0,
            slip=bool(slips[k]),
            half_cycle=bool(halves[k]),
            carrier_valid=math.isfinite(cycles[k]),
            transmit=time.plus(-float(ranges_m[k]) / SPEED_OF_LIGHT_MPS),
        )
        for k, satellite in enumerate(known["satellite"].astype(str))
    )


def read_ranges(path: Path | str) -> pd.DataFrame:
    """Read a ranges.csv of the simulator: what a perfect receiver and clock measure.

    Where it has no `carrier_cycles` the phase follows the pseudorange (an ionosphere of one sign
    on both); where it names no `satellite` its `prn` are those of GPS. Rows of satellites out of
    sight (`visible` 0) are left out.

    Returns: columns RANGE_COLUMNS, one row per epoch and satellite.
    Raises InputFileError: the file cannot be read, or is not one.
    """
    path = Path(path)
    frame = _table(path, ("week", "tow", "prn", "el_deg", "pseudorange_m"))
    if "visible" in frame:
        frame = frame[frame["visible"] == 1].reset_index(drop=True)
    if "satellite" not in frame:
        frame["satellite"] = [f"G{prn:02d}" for prn in frame["prn"]]
    range_m = frame["pseudorange_m"]
    phase_m = range_m
    if "carrier_cycles" in frame:
        phase_m = frame["carrier_cycles"] * wavelengths_m(frame["satellite"])
    return pd.DataFrame(
        {
            "week": frame["week"],
            "tow_s": frame["tow"],
            "satellite": frame["satellite"],
            "range_m": range_m,
            "phase_m": phase_m,
            "elevation_deg": frame["el_deg"],
        }
    )


def read_channels(path: Path | str) -> pd.DataFrame:
    """Read a channels.csv of ours; rows before time is known are left out."""
    path = Path(path)
    needed = ("week", "tow_s", "satellite", "coherent_s", "carrier_bandwidth_hz")
    return _table(path, (*needed, "code_bandwidth_hz")).dropna(subset=["week", "tow_s"])


def _table(path: Path, needed: tuple[str, ...]) -> pd.DataFrame:
    with reading(path):
        frame = pd.read_csv(path)
    for name in needed:
        if name not in frame:
            raise InputFileError(f"{path}: column '{name}' is missing: not a {path.name}")
    return frame
