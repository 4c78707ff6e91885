"""Positions by a program that knows nothing of us: RTKLIB's rnx2rtkp, where it is installed."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray

FIXED: Final = 1
"""RTKLIB's quality of a position with integer ambiguities …"""

FLOAT: Final = 2
"""… and of one without; others are not differential."""

Option = str | int | float
"""Value of an option of rnx2rtkp."""

_COLUMNS: Final = ("week", "tow_s", "x_e_m", "y_e_m", "z_e_m", "quality", "satellites")
_VELOCITY: Final = ("vx_e_mps", "vy_e_mps", "vz_e_mps")
_FIRST_VELOCITY: Final = 15  # column of a line with velocities
_ALWAYS: Final[Mapping[str, Option]] = {
    "pos1-frequency": "l1",  # and B1I
    "pos1-elmask": 10,
    "pos1-navsys": 33,  # GPS and BeiDou
    "out-solformat": "xyz",
    "out-timesys": "gpst",
    "out-timeform": "tow",
    "out-timendec": 3,
}
_KINEMATIC: Final[Mapping[str, Option]] = {
    "pos1-posmode": "kinematic",
    "pos1-soltype": "forward",
    "pos1-ionoopt": "off",
    "pos1-tropopt": "off",
    "pos2-armode": "continuous",
    "pos2-arthres": 3,
    "pos2-bdsarmode": "on",
    "ant1-postype": "single",
    "ant2-postype": "rinexhead",
}
_SINGLE: Final[Mapping[str, Option]] = {
    "pos1-posmode": "single",
    "pos1-ionoopt": "brdc",
    "pos1-tropopt": "saas",
    "out-outvel": "on",
}


def installed() -> str | None:
    """Path of rnx2rtkp, None where it is not installed."""
    return shutil.which("rnx2rtkp")


def kinematic(rover: Path, base: Path, nav: Path, **options: Option) -> pd.DataFrame:
    """Position a moving receiver against a base whose header holds its place.

    Parameters
    ----------
    options: of rnx2rtkp, with _ for -, beside or instead of those of a short baseline.

    Returns: week, tow_s, x_e_m, y_e_m, z_e_m, quality (1: fixed), satellites, one row per epoch
    with a position.
    Raises InputFileError: the program is not installed.
    """
    return _table(_answer((rover, base, nav), _KINEMATIC, options))


def single(rover: Path, nav: Path, **options: Option) -> pd.DataFrame:
    """Single-point positions, broadcast ionosphere (that of GPS for all) and Saastamoinen.

    Returns: as `kinematic`, and vx_e_mps, vy_e_mps, vz_e_mps. Parameters, raises: likewise.
    """
    found = _table(_answer((rover, nav), _SINGLE, options))
    if found.empty:
        raise InputFileError(f"{rover}: rnx2rtkp gives no position")
    return found


def code_residuals(
    rover: Path, base: Path, nav: Path, r_e_m: FloatArray, base_r_e_m: FloatArray
) -> pd.DataFrame:
    """Code double differences at known places against the highest satellite of each system.

    Returns: week, tow_s, satellite, residual_m (satellite less reference: RTKLIB has it the other
    way round; the reference itself is left out).
    """
    places = {
        f"ant{number}_pos{k}": f"{x_m:.4f}"
        for number, place in ((1, r_e_m), (2, base_r_e_m))
        for k, x_m in enumerate(place, 1)
    }
    options = {"pos1_posmode": "fixed", "ant1_postype": "xyz", "ant2_postype": "xyz", **places}
    told = {"pos2_armode": "instantaneous", "out_outstat": "residual"}
    lines = _answer((rover, base, nav), _KINEMATIC, {**options, **told}, ".stat")
    rows = [line.split(",") for line in lines if line.startswith("$SAT")]
    frame = pd.DataFrame(
        {
            "week": [int(row[1]) for row in rows],
            "tow_s": [float(row[2]) for row in rows],
            "satellite": [row[3] for row in rows],
            "residual_m": [-float(row[7]) for row in rows],
        }
    )
    return frame[frame["residual_m"] != 0.0].reset_index(drop=True)


def _answer(
    files: tuple[Path, ...],
    usual: Mapping[str, Option],
    own: Mapping[str, Option],
    ending: str = "",
) -> list[str]:
    """Lines of the solution file, or of the one beside it with a further ending."""
    program = installed()
    if program is None:
        raise InputFileError("rnx2rtkp: not installed (Debian, Ubuntu: apt install rtklib)")
    chosen = {**_ALWAYS, **usual, **{key.replace("_", "-", 1): own[key] for key in own}}
    with tempfile.TemporaryDirectory(prefix="deepgnss-rtk-") as folder:
        settings, out = Path(folder) / "rtk.conf", Path(folder) / "rtk.pos"
        settings.write_text("".join(f"{key:<20}={value}\n" for key, value in chosen.items()))
        command = [program, "-k", str(settings), "-o", str(out)]
        subprocess.run([*command, *map(str, files)], capture_output=True, check=False)
        answer = Path(f"{out}{ending}")
        return answer.read_text(encoding="latin-1").splitlines() if answer.exists() else []


def _table(lines: list[str]) -> pd.DataFrame:
    rows = [line.split() for line in lines if line.strip() and not line.startswith("%")]
    moving = bool(rows) and len(rows[0]) >= _FIRST_VELOCITY + len(_VELOCITY)
    columns = [*_COLUMNS, *(_VELOCITY if moving else ())]
    taken = [*range(len(_COLUMNS)), *range(_FIRST_VELOCITY, _FIRST_VELOCITY + len(_VELOCITY))]
    values = [[row[k] for k in taken[: len(columns)]] for row in rows]
    frame = pd.DataFrame(
        np.array(values, dtype=np.float64).reshape(-1, len(columns)), columns=columns
    )
    return frame.astype({"week": int, "quality": int, "satellites": int})
