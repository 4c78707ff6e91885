"""UBX logs against what another program made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.errors import InputFileError
from deepgnss.evaluate.observations import read_observations
from deepgnss.io.ubx import OBSERVATIONS, POSITIONS, UbxLog, read_ubx


@pytest.fixture(scope="module")
def log(shared_data: Path) -> UbxLog:
    return read_ubx(shared_data / "real/gnss/snapper-ubx/COM6_211122_123733.ubx")


def test_observations_are_those_of_convbin(log: UbxLog, shared_data: Path) -> None:
    theirs = read_observations(shared_data / "real/gnss/snapper-ubx/w00_f9p.obs")
    both = log.observations.merge(
        theirs.assign(tow_s=theirs["tow_s"].round(3)),
        left_on=["week", log.observations["tow_s"].round(3), "satellite"],
        right_on=["week", "tow_s", "satellite"],
    )
    assert set(log.observations["satellite"].str[0]) == {"G", "C"}
    assert len(both) == len(log.observations) > 6500
    for name in ("pseudorange_m", "carrier_cycles", "doppler_hz"):
        off = (both[f"{name}_x"] - both[f"{name}_y"]).dropna()
        assert len(off) > 6500 and off.abs().max() < 0.001  # they write three decimals


def test_positions_lie_at_whole_seconds_and_move_as_they_say(log: UbxLog) -> None:
    positions = log.positions
    assert tuple(positions.columns) == POSITIONS and len(positions) == 389
    assert (positions["tow_s"] - positions["tow_s"].round()).abs().max() < 0.001
    assert (positions["carrier"] == 2).mean() > 0.5  # its own RTK, while it lasted
    place = positions[["x_e_m", "y_e_m", "z_e_m"]].to_numpy()
    speed = np.linalg.norm(positions[["v_n_mps", "v_e_mps", "v_d_mps"]].to_numpy(), axis=1)
    moved = np.linalg.norm(np.diff(place, axis=0), axis=1)
    assert np.median(np.abs(moved - 0.5 * (speed[1:] + speed[:-1]))) < 0.1


def test_what_is_damaged_is_passed_over_or_refused(shared_data: Path, tmp_path: Path) -> None:
    whole = (shared_data / "real/gnss/snapper-ubx/COM6_211122_123733.ubx").read_bytes()[:60_000]
    broken = tmp_path / "broken.ubx"
    broken.write_bytes(whole[:30_000] + bytes(200) + whole[30_300:])
    found = read_ubx(broken)
    assert tuple(found.observations.columns) == OBSERVATIONS and len(found.observations) > 100
    (tmp_path / "none.ubx").write_bytes(b"no UBX at all\n" * 20)
    with pytest.raises(InputFileError, match=r"none\.ubx: neither RXM-RAWX nor NAV-PVT"):
        read_ubx(tmp_path / "none.ubx")
    with pytest.raises(InputFileError, match=r"gone\.ubx"):
        read_ubx(tmp_path / "gone.ubx")
