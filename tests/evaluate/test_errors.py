from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.evaluate.errors import (
    distribution,
    errors,
    evaluate,
    read_solution,
    write_errors,
    write_statistics,
)
from deepgnss.io.truth import Trajectory

_LAT, _LON = np.radians((52.0, -3.0))
_TO_N = C_ne(_LAT, _LON)
_R_E_M = ecef(_LAT, _LON, 80.0)
_TRUE_V_N = np.array([5.0, -2.0, 0.1])


def _truth(seconds: float = 10.0) -> Trajectory:
    t = np.arange(0.0, seconds + 0.5, 0.5)
    v_e_mps = _TRUE_V_N @ _TO_N
    r_e_m = _R_E_M + t[:, None] * v_e_mps
    return Trajectory(np.full(len(t), 2190), 1000.0 + t, r_e_m, np.tile(v_e_mps, (len(t), 1)))


def _solution(tow_s, error_n_m, error_v_n_mps=(0.0, 0.0, 0.0)):  # type: ignore[no-untyped-def]
    """A solution.csv whose error is known: NaN in it means no fix."""
    tow_s, error_n_m = np.asarray(tow_s), np.atleast_2d(error_n_m)
    r_e_m = _R_E_M + (tow_s - 1000.0)[:, None] * (_TRUE_V_N @ _TO_N) + error_n_m @ _TO_N
    v_n_mps = np.tile(_TRUE_V_N + np.asarray(error_v_n_mps), (len(tow_s), 1))
    columns = np.column_stack((r_e_m, v_n_mps))
    frame = pd.DataFrame(
        columns, columns=["x_e_m", "y_e_m", "z_e_m", "v_n_mps", "v_e_mps", "v_d_mps"]
    )
    frame.insert(0, "week", 2190)
    frame.insert(1, "tow_s", tow_s)
    frame.insert(2, "valid", np.isfinite(error_n_m).all(axis=1).astype(int))
    return frame


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(-50.0, 50.0)] * 3), st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_error_is_estimate_minus_truth_in_ned(
    position: tuple[float, float, float], velocity: tuple[float, float, float]
) -> None:
    e = errors(_solution([1001.25], position, velocity), _truth())
    found = (e.north_m[0], e.east_m[0], e.down_m[0])
    assert found == pytest.approx(position, abs=2e-4)
    assert (e.v_north_mps[0], e.v_east_mps[0], e.v_down_mps[0]) == pytest.approx(velocity, abs=2e-5)
    assert e.horizontal_m[0] == pytest.approx(np.hypot(*position[:2]), abs=2e-4)


def test_statistics_of_known_errors() -> None:
    north = np.array([3.0, -3.0, 3.0, -3.0, 3.0, -3.0, 30.0, np.nan])
    n_m = np.column_stack((north, np.full(8, 4.0), np.full(8, -7.0)))
    e = errors(_solution(1000.0 + np.arange(8), n_m), _truth())
    result = evaluate(e, gross_m=10.0)
    assert (result.epochs, result.fixed_share) == (8, 7 / 8)
    assert result.gross_share == pytest.approx(1 / 7)
    h = result.of("horizontal_m")
    assert (h.median, h.largest) == pytest.approx((5.0, np.hypot(30.0, 4.0)), abs=1e-4)
    d = result.of("down_m")
    assert (d.mean, d.std, d.rms, d.percentile95) == pytest.approx((-7.0, 0.0, 7.0, 7.0), abs=1e-3)
    n = result.of("north_m")
    assert n.mean == pytest.approx(30.0 / 7.0, abs=1e-4)
    assert n.rms == pytest.approx(np.sqrt((6 * 9.0 + 900.0) / 7.0), abs=1e-4)
    assert n.rms**2 == pytest.approx(n.mean**2 + n.std**2)


def test_epochs_that_truth_does_not_cover_do_not_count() -> None:
    zero = np.zeros((4, 3))
    e = errors(_solution([999.0, 1000.0, 1010.0, 1010.5], zero), _truth())
    assert e.tow_s.tolist() == [1000.0, 1010.0]
    assert evaluate(e).fixed_share == 1.0


def test_no_fix_and_no_epoch() -> None:
    e = errors(_solution([1001.0, 1002.0], np.full((2, 3), np.nan)), _truth())
    result = evaluate(e)
    assert (result.epochs, result.fixed_share) == (2, 0.0)
    assert np.isnan(result.gross_share)
    assert np.isnan(result.of("north_m").rms)
    nothing = evaluate(errors(_solution([5.0], np.zeros((1, 3))), _truth()))
    assert nothing.epochs == 0
    assert np.isnan(nothing.fixed_share)


def test_distribution() -> None:
    size, share = distribution(np.array([-3.0, 1.0, np.nan, 2.0, -4.0]))
    assert size.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert share.tolist() == [0.25, 0.5, 0.75, 1.0]


def test_files(tmp_path: Path) -> None:
    n_m = np.array([[1.0, 2.0, 3.0], [np.nan] * 3])
    e = errors(_solution([1001.0, 1002.0], n_m), _truth())
    write_errors(tmp_path / "errors.csv", e)
    frame = pd.read_csv(tmp_path / "errors.csv")
    assert frame["east_m"].iloc[0] == pytest.approx(2.0, abs=1e-3)
    assert frame["horizontal_m"].isna().tolist() == [False, True]
    write_statistics(tmp_path / "statistics.csv", evaluate(e))
    statistics = pd.read_csv(tmp_path / "statistics.csv", index_col="quantity")
    assert statistics.loc["down_m", "rms"] == pytest.approx(3.0, abs=1e-3)
    assert statistics.loc["fixed_share", "mean"] == 0.5


def test_reading_what_is_no_solution(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputFileError, match=r"'week' is missing: not a solution\.csv"):
        read_solution(tmp_path / "a.csv")
    with pytest.raises(InputFileError, match="No such file"):
        read_solution(tmp_path / "none.csv")
