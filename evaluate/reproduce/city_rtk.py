"""CITY-RTK: right fixes of the drive through a city, by RTKLIB, T table 6.17.

As in T, RTKLIB resolves the ambiguities of every epoch by itself ("instantaneous"), calls them
fixed from a ratio of 2 on, and a fix is right up to 5 cm from truth. Every tag of the recording
counts, for all runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from deepgnss.core.records import SIGNAL_IDS
from deepgnss.evaluate import rtklib
from deepgnss.evaluate.positions import grid
from deepgnss.evaluate.rtk import MODES, RATIO, Shares, rtk_errors, shares
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.io.truth import read_truth
from deepgnss.receiver.receiver import Fix


def counted(folder: Path, fixes: Sequence[Fix], interval_s: float) -> Shares | None:
    """What RTKLIB makes of a run's tags against the base beside its recording.

    None: RTKLIB is not installed.
    """
    if rtklib.installed() is None:
        return None
    rover = folder / "rtk.obs"
    header = ObsHeader(tuple(SIGNAL_IDS.values()), interval_s, 60.0, name=rover.name)
    with RinexObsWriter(folder, header) as writer:
        for fix in fixes:
            writer.write(fix.epoch)
    files = (rover, folder / "base.obs", folder / "nav.rnx")
    found = rtklib.kinematic(*files, pos2_armode=MODES[0], pos2_arthres=RATIO)
    truth = read_truth(folder / "truth.csv")
    errors = rtk_errors(found, truth, interval_s)
    return shares({"": errors}, grid(truth, interval_s))[""]


def added(parts: Sequence[Shares]) -> Shares:
    """Several recordings as one."""
    right = sum(one.right for one in parts)
    square_m2 = sum(one.right * one.right_rms_m**2 for one in parts if one.right)
    return Shares(
        epochs=sum(one.epochs for one in parts),
        right=right,
        wrong=sum(one.wrong for one in parts),
        floating=sum(one.floating for one in parts),
        without=sum(one.without for one in parts),
        right_rms_m=math.sqrt(square_m2 / right) if right else math.nan,
    )
