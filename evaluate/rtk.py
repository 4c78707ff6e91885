"""RTK of several receivers through RTKLIB: fixes, right and wrong, T table 6.17.

A fix counts as right within a stated horizontal distance of truth. Every receiver is asked at the
same instants, with the same signals, base, orbits and options.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.records import FloatArray, NavData
from deepgnss.evaluate.observables import week_seconds
from deepgnss.evaluate.observations import SIGNAL_OF_SYSTEM, epochs
from deepgnss.evaluate.positions import Instants, grid, position_errors
from deepgnss.evaluate.rtklib import FIXED, FLOAT, kinematic
from deepgnss.io.rinex_nav import write_nav
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.io.truth import Trajectory

MODES: Final = ("instantaneous", "continuous", "fix-and-hold")
"""How RTKLIB resolves ambiguities: every epoch by itself (as T), along arcs, and holding them."""

RATIO: Final = 2.0
"""Of the second best set of ambiguities to the best, from which on it counts as fixed (T)."""

RIGHT_M: Final = 0.05
"""Horizontal error up to which a fix is a right one (T)."""


class Base(NamedTuple):
    """What the receivers are positioned against."""

    observations: pd.DataFrame  # as of `read_observations`
    r_e_m: FloatArray  # (3,)
    nav: NavData


class Shares(NamedTuple):
    """What became of the instants asked for."""

    epochs: int
    right: int
    wrong: int  # fixes farther off
    floating: int  # ambiguities not resolved
    without: int  # no differential position
    right_rms_m: float  # horizontal, of the right ones; NaN without any


class Fixes(NamedTuple):
    """RTK by receiver."""

    shares: Mapping[str, Shares]
    errors: Mapping[str, pd.DataFrame]  # as of `rtk_errors`


NO_FIXES: Final = Fixes({}, {})


def rtk_fixes(
    observed: Mapping[str, pd.DataFrame],
    base: Base,
    truth: Trajectory,
    interval_s: float,
    mode: str = MODES[0],
    right_m: float = RIGHT_M,
) -> Fixes:
    """Position several receivers at the instants between their common start and end.

    Parameters: observed: by receiver, as of `read_observations`.
    Raises InputFileError: rnx2rtkp is not installed.
    """
    asked = grid(truth, interval_s)
    for table in observed.values():
        seconds = week_seconds(table, 0)
        first, last = np.round(np.array([seconds.min(), seconds.max()]) / interval_s)
        asked = asked[(asked >= first) & (asked <= last)]
    errors = {
        name: rtk_errors(rtk_positions(table, base, mode), truth, interval_s)
        for name, table in observed.items()
    }
    return Fixes(shares(errors, asked, right_m), errors)


def rtk_positions(observed: pd.DataFrame, base: Base, mode: str = MODES[0]) -> pd.DataFrame:
    """What RTKLIB makes of a receiver's observations, as of `kinematic`.

    Parameters: observed: as of `read_observations`.
    Raises InputFileError: rnx2rtkp is not installed.
    """
    with TemporaryDirectory(prefix="deepgnss-rtk-") as name:
        folder = Path(name)
        nav = folder / "nav.rnx"
        write_nav(nav, base.nav)
        return kinematic(
            _rinex(observed, folder / "rover.obs"),
            _rinex(base.observations, folder / "base.obs", base.r_e_m),
            nav,
            pos2_armode=mode,
            pos2_arthres=RATIO,
        )


def _rinex(observed: pd.DataFrame, path: Path, r_e_m: FloatArray | None = None) -> Path:
    signals = tuple(SIGNAL_OF_SYSTEM.values())
    header = ObsHeader(signals, 1.0, 60.0, position_e_m=r_e_m, name=path.name)
    with RinexObsWriter(path.parent, header) as writer:
        for epoch in epochs(observed):
            writer.write(epoch)
    return path


def rtk_errors(found: pd.DataFrame, truth: Trajectory, interval_s: float) -> pd.DataFrame:
    """Errors at the instants of a grid as of `position_errors`, with RTKLIB's quality.

    Parameters: found: as of `kinematic`.
    """
    positions = found.assign(valid=1, v_n_mps=np.nan, v_e_mps=np.nan, v_d_mps=np.nan)
    table = position_errors({"": positions}, truth, interval_s)[""]
    quality = found.set_index(_milliseconds(found["tow_s"]))["quality"]
    return table.assign(quality=quality.loc[_milliseconds(table["tow_s"])].to_numpy())


def _milliseconds(tow_s: pd.Series) -> pd.Series:
    return (tow_s * 1e3).round().astype(np.int64)


def shares(
    errors: Mapping[str, pd.DataFrame], asked: Instants, right_m: float = RIGHT_M
) -> dict[str, Shares]:
    """Fixes by receiver over the instants asked for.

    Parameters: errors: by receiver, as of `rtk_errors`.
    """
    return {name: _shares(table, asked, right_m) for name, table in errors.items()}


def _shares(table: pd.DataFrame, asked: Instants, right_m: float) -> Shares:
    own = table[np.isin(table.index.to_numpy(), asked)]
    off_m = own["horizontal_m"].to_numpy(np.float64)
    fixed = own["quality"].to_numpy() == FIXED
    right = fixed & (off_m <= right_m)
    floating = int((own["quality"] == FLOAT).sum())
    return Shares(
        epochs=len(asked),
        right=int(right.sum()),
        wrong=int((fixed & ~right).sum()),
        floating=floating,
        without=len(asked) - int(fixed.sum()) - floating,
        right_rms_m=float(np.sqrt(np.mean(off_m[right] ** 2))) if right.any() else np.nan,
    )
