"""RTK by a program that knows nothing of us: RTKLIB's rnx2rtkp, where it is installed."""

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

FIXED: Final = 1
"""RTKLIB's quality of a position with integer ambiguities."""

_COLUMNS: Final = ("week", "tow_s", "x_e_m", "y_e_m", "z_e_m", "quality", "satellites")
_OPTIONS: Final[Mapping[str, str | int | float]] = {
    "pos1-posmode": "kinematic",
    "pos1-frequency": "l1",
    "pos1-soltype": "forward",
    "pos1-elmask": 10,
    "pos1-ionoopt": "off",
    "pos1-tropopt": "off",
    "pos1-navsys": 33,  # GPS and BeiDou
    "pos2-armode": "continuous",
    "pos2-arthres": 3,
    "pos2-bdsarmode": "on",
    "out-solformat": "xyz",
    "out-timesys": "gpst",
    "out-timeform": "tow",
    "out-timendec": 3,
    "ant1-postype": "single",
    "ant2-postype": "rinexhead",
}


def installed() -> str | None:
    """Path of rnx2rtkp, None where it is not installed."""
    return shutil.which("rnx2rtkp")


def kinematic(rover: Path, base: Path, nav: Path, **options: str | int | float) -> pd.DataFrame:
    """Position a moving receiver against a base whose header holds its place.

    Parameters
    ----------
    options: of rnx2rtkp, with _ for -, beside or instead of those of a short baseline.

    Returns: week, tow_s, x_e_m, y_e_m, z_e_m, quality (1: fixed), satellites, one row per epoch.
    Raises InputFileError: the program is not installed, or gives no position.
    """
    program = installed()
    if program is None:
        raise InputFileError("rnx2rtkp: not installed (Debian, Ubuntu: apt install rtklib)")
    chosen = {**_OPTIONS, **{key.replace("_", "-", 1): value for key, value in options.items()}}
    with tempfile.TemporaryDirectory(prefix="deepgnss-rtk-") as folder:
        settings, out = Path(folder) / "rtk.conf", Path(folder) / "rtk.pos"
        settings.write_text("".join(f"{key:<20}={value}\n" for key, value in chosen.items()))
        command = [program, "-k", str(settings), "-o", str(out)]
        subprocess.run(
            [*command, str(rover), str(base), str(nav)], capture_output=True, check=False
        )
        lines = out.read_text(encoding="latin-1").splitlines() if out.exists() else []
    rows = [line.split()[:7] for line in lines if line.strip() and not line.startswith("%")]
    if not rows:
        raise InputFileError(f"{rover}: rnx2rtkp gives no position against {base}")
    frame = pd.DataFrame(np.array(rows, dtype=np.float64), columns=list(_COLUMNS))
    return frame.astype({"week": int, "quality": int, "satellites": int})
