from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest

from deepgnss.core.errors import OutputError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.evaluate import overview
from deepgnss.evaluate.overview import Run, draw_overview
from deepgnss.io.truth import Trajectory

_LAT, _LON = np.radians((52.0, -3.0))
_R_E_M = ecef(_LAT, _LON, 80.0)
_TO_N = C_ne(_LAT, _LON)


def _run(satellites: int = 24, epochs: int = 120, fixed: bool = True) -> Run:
    rng = np.random.default_rng(4)
    names = [f"{'GC'[k % 2]}{k // 2 + 1:02d}" for k in range(satellites)]
    tow_s = 561_628.0 + np.arange(epochs)
    track_n = np.column_stack(
        (3.0 * np.arange(epochs), 40 * np.sin(np.arange(epochs) / 20), 0 * tow_s)
    )
    noise = rng.normal(size=(epochs, 3)) * 1.5
    noise[epochs // 2] = 400.0  # one gross error
    r_e_m = _R_E_M + (track_n + noise) @ _TO_N
    valid = np.full(epochs, int(fixed))
    valid[: epochs // 10] = 0
    r_e_m[valid == 0] = np.nan
    solution = pd.DataFrame(r_e_m, columns=["x_e_m", "y_e_m", "z_e_m"])
    solution = solution.assign(
        week=2190, tow_s=tow_s, valid=valid, v_n_mps=0.0, v_e_mps=0.0, v_d_mps=0.0,
        used=np.where(valid, 8 + (tow_s % 3), 0), hdop=np.where(valid, 1.2, np.nan),
        pdop=np.where(valid, 2.2, np.nan),
    )  # fmt: skip
    rows, sky = [], []
    for k, name in enumerate(names):
        for n in range(epochs):
            if (n + 5 * k) % epochs > 0.9 * epochs:
                continue  # a gap at another time for each
            cn0 = 28.0 + 20.0 * ((k * 7) % satellites) / satellites + rng.normal()
            rows.append((float(n) + 3.0, 2190, tow_s[n], name, cn0))
            place = (15.0 * k + 0.05 * n, 8.0 + (k * 37) % 80)
            sky.append((2190, tow_s[n], name, *place, int(k % 3 > 0)))
    columns = ["week", "tow_s", "satellite"]
    return Run(
        "a recording.bin",
        solution,
        pd.DataFrame(sky, columns=[*columns, "azimuth_deg", "elevation_deg", "used"]),
        pd.DataFrame(rows, columns=["recording_s", *columns, "cn0_dbhz"]),
    )


def _truth(epochs: int = 120) -> Trajectory:
    t = np.arange(epochs)
    track_n = np.column_stack((3.0 * t, 40 * np.sin(t / 20), 0.0 * t))
    return Trajectory(np.full(epochs, 2190), 561_628.0 + t, _R_E_M + track_n @ _TO_N)


def test_figure_is_drawn_and_deterministic(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_overview(tmp_path / name, _run(), _truth())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    image = matplotlib.image.imread(tmp_path / "a.png")
    assert image.shape[0] > 900
    assert image.std() > 0.05
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]


@pytest.mark.parametrize("satellites", [0, 1, 6])
def test_runs_that_came_to_little(tmp_path: Path, satellites: int) -> None:
    draw_overview(tmp_path / "a.png", _run(satellites, epochs=12, fixed=False), _truth(12))
    draw_overview(tmp_path / "b.png", _run(satellites, epochs=12))
    empty = _run(satellites, epochs=12)
    nothing = Run("x", empty.solution[:0], empty.satellites[:0], empty.channels[:0])
    draw_overview(tmp_path / "c.png", nothing)
    assert len(list(tmp_path.glob("*.png"))) == 3


def test_labels_keep_their_distance() -> None:
    heights = overview._spread(np.array([0.2, 0.2, 0.21, 0.9, 0.99, 1.0]), 0.05)
    assert np.diff(heights).min() >= 0.05 - 1e-12
    assert heights.max() <= 1.0
    assert abs(heights[0] - 0.2) < 0.06


def test_lines_break_where_a_satellite_was_lost() -> None:
    time_s, values = overview._with_gaps(np.array([0.0, 1, 2, 60, 61]), np.arange(5.0))
    assert np.isnan(time_s).tolist() == [False, False, False, True, False, False]
    assert np.isnan(values).sum() == 1


def test_folder_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        draw_overview(tmp_path / "file" / "a.png", _run(2, epochs=12))
