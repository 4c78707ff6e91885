"""Our numbers beside RTKLIB's on the same observations: positions, velocities, differences.

Models of the troposphere differ: RTKLIB takes 70 % humidity in single points, and the dry part off
both ends of a baseline (5 mm a kilometre at 15° elevation, where ours leaves it in).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.evaluate import rtklib
from deepgnss.evaluate.double_differences import double_differences
from deepgnss.evaluate.geometry import between, modelled_errors
from deepgnss.evaluate.observables import week_seconds
from deepgnss.evaluate.observations import read_observations
from deepgnss.evaluate.single_point import single_point
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver import pvt

_MODELS: Final = {"klobuchar": "brdc", "saastamoinen": "saas", "none": "off"}


class SinglePoint(NamedTuple):
    """Largest differences over the epochs, ours less RTKLIB's."""

    epochs: int  # of ours
    shared: int  # of them RTKLIB's, too
    position_m: float
    velocity_mps: float


def single_points(rover: Path, nav: Path, models: pvt.PvtParameters) -> SinglePoint:
    """Single-point positions of both by the same models.

    Raises InputFileError: RTKLIB is not installed, or gives no position.
    """
    options = {
        "pos1_ionoopt": _MODELS[models.ionosphere],
        "pos1_tropopt": _MODELS[models.troposphere],
        "pos1_elmask": np.degrees(models.elevation_mask_rad),
    }
    theirs = rtklib.single(rover, nav, **options)
    ours = single_point(read_observations(rover), read_nav(nav), models)
    both = ours[ours["valid"] == 1].merge(theirs, on=["week", "tow_s"], suffixes=("", "_theirs"))
    r_e_m, v_n_mps = both[[*_POSITION]].to_numpy(), both[[*_VELOCITY]].to_numpy()
    off_m = r_e_m - both[[f"{name}_theirs" for name in _POSITION]].to_numpy()
    to_n = C_ne(*geodetic(r_e_m[0])[:2])
    off_mps = v_n_mps - both[["vx_e_mps", "vy_e_mps", "vz_e_mps"]].to_numpy() @ to_n.T
    return SinglePoint(
        len(ours),
        len(both),
        float(np.linalg.norm(off_m, axis=1).max()),
        float(np.linalg.norm(off_mps, axis=1).max()),
    )


_POSITION: Final = ("x_e_m", "y_e_m", "z_e_m")
_VELOCITY: Final = ("v_n_mps", "v_e_mps", "v_d_mps")


class Differences(NamedTuple):
    """Code double differences at a known place."""

    pairs: int
    shared: int  # of them RTKLIB's, too
    sigma_m: float  # ours
    largest_m: float  # ours less RTKLIB's


def code_differences(
    rover: Path, base: Path, nav: Path, r_e_m: FloatArray, base_r_e_m: FloatArray
) -> Differences:
    """Code double differences of antennas at rest, of both against the highest satellites.

    Raises InputFileError: RTKLIB is not installed.
    """
    broadcast = read_nav(nav)
    single = between(
        modelled_errors(read_observations(rover), r_e_m, broadcast),
        modelled_errors(read_observations(base), base_r_e_m, broadcast),
    )
    high_deg = single.groupby("satellite")["elevation_deg"].mean()
    systems = high_deg.index.str[0]
    reference = {system: str(high_deg[systems == system].idxmax()) for system in set(systems)}
    ours = double_differences(single, reference)
    ours["ms"] = (ours["time_ms"] - ours["time_ms"].min()).astype(int)
    theirs = rtklib.code_residuals(rover, base, nav, r_e_m, base_r_e_m)
    start_s = week_seconds(theirs, 0).min()
    theirs["ms"] = np.round((week_seconds(theirs, 0) - start_s) * 1e3).astype(int)
    both = ours.merge(theirs, on=["ms", "satellite"])
    off_m = both["code_m"] - both["residual_m"]
    return Differences(len(ours), len(both), float(ours["code_m"].std()), float(off_m.abs().max()))
