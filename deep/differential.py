"""Corrections of a base station, satellite by satellite: differential positions."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import (
    SIGNAL_IDS,
    Epoch,
    NavData,
    Observation,
    RangeCorrections,
    SampleInstant,
)
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.receiver.measured import measure, ranges_from
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.weights import ErrorModel

DIFFERENTIAL = PvtParameters(ionosphere="none", troposphere="none", errors=ErrorModel(orbit=0.0))
"""The base sees what satellites and atmosphere do, too: only what is the rover's own is left."""

_CODES = {signal.system: f"C{signal.rinex}" for signal in SIGNAL_IDS.values()}


def range_corrections(base: Path, nav: NavData) -> dict[str, RangeCorrections]:
    """How much longer the ranges in a base's RINEX file are than geometry tells, by satellite.

    The base's clock, common to all, goes into the rover's.

    Raises InputFileError when it has no position or shares no satellite with the NAV data.
    """
    read = read_obs(base)
    if read.position_e_m is None:
        raise InputFileError(f"{base}: no APPROX POSITION XYZ: a base needs to know where it is")
    open_sky = replace(DIFFERENTIAL, elevation_mask_rad=0.0)
    frame = read.frame
    first = GpsTime(int(frame["week"].iloc[0]), float(frame["tow_s"].iloc[0]))
    found: dict[str, list[tuple[float, float]]] = {}
    for _, rows in frame.groupby(["week", "tow_s"]):
        time = GpsTime(int(rows["week"].iloc[0]), float(rows["tow_s"].iloc[0]))
        observations = tuple(
            bare_observation(str(name), float(rows[code].iloc[k]), time)
            for k, name in enumerate(rows["satellite"])
            if (code := _CODES.get(str(name)[0], "")) in rows
            and math.isfinite(float(rows[code].iloc[k]))
        )
        epoch = Epoch(time, SampleInstant(0, 0.0), observations)
        seen = ranges_from(measure(epoch, nav), open_sky, read.position_e_m)
        for satellite, misfit_m in zip(seen.satellites, seen.misfit_m, strict=True):
            found.setdefault(satellite, []).append((time.since(first), float(misfit_m)))
    if not found:
        raise InputFileError(f"{base}: none of its ranges is of a satellite in the NAV data")
    return {
        name: RangeCorrections(first, columns[:, 0], columns[:, 1])
        for name, columns in ((name, np.array(pairs)) for name, pairs in found.items())
    }


def bare_observation(satellite: str, range_m: float, time: GpsTime) -> Observation:
    """A range alone, as an observation."""
    signal = next(s.name for s in SIGNAL_IDS.values() if s.system == satellite[0])
    sent = time.plus(-range_m / SPEED_OF_LIGHT_MPS)
    return Observation(
        satellite, signal, range_m, 0.0, math.nan, 45.0, 1.0, False, False, False, sent
    )
