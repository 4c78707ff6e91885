"""CITY-PR, CITY-EXIT: corrections have their sign, tunnels their ends, shares their epochs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.records import Epoch, SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.deep.differential import DIFFERENTIAL, bare_observation, range_corrections
from deepgnss.evaluate.reproduce import city
from deepgnss.evaluate.reproduce.city_rtk import added
from deepgnss.evaluate.reproduce.whole_receiver import recorded
from deepgnss.evaluate.rtk import Shares
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.receiver import pvt

_EXACT = ("seconds=3", "base={offset: [500, 400, -3], interval: 1, code_noise: 0}")


def test_a_perfect_rover_is_found_by_corrections_alone() -> None:
    """Without them, and without models, it would be metres off."""
    with recorded("city", 1, *_EXACT) as given:
        nav = read_nav(given.folder / "nav.rnx")
        corrections = range_corrections(given.folder / "base.obs", nav)
        truth = city._truth(given)
        rover = read_obs(given.folder / "rover.obs").frame
    (week, tow_s), rows = next(iter(rover.groupby(["week", "tow_s"])))
    time = GpsTime(int(week), float(tow_s))
    observations = tuple(
        bare_observation(str(name), float(rows[code].iloc[k]), time)
        for k, name in enumerate(rows["satellite"])
        for code in [{"G": "C1C", "C": "C2I"}[str(name)[0]]]
        if np.isfinite(rows[code].iloc[k])
    )
    epoch = Epoch(time, SampleInstant(0, 0.0), observations)
    found = pvt.solve(epoch, replace(nav, corrections=corrections), DIFFERENTIAL)
    assert found.valid, found.reason
    assert found.differential
    off_m = found.r_e_m - truth.loc[round(tow_s * 10)].to_numpy()
    assert np.linalg.norm(off_m) < 0.1
    bare = replace(DIFFERENTIAL, raim=False)
    assert np.linalg.norm(pvt.solve(epoch, nav, bare).r_e_m - found.r_e_m) > 2.0
    unseen = dict(list(corrections.items())[1:])
    fewer = pvt.solve(epoch, replace(nav, corrections=unseen), DIFFERENTIAL)
    assert fewer.rejected == {next(iter(corrections)): "no correction of the base's"}


def _drive(fixed: list[bool], north_m: list[float], unblocked: list[int]) -> city.Drive:
    tags = pd.RangeIndex(1000, 1000 + len(fixed))
    run = pd.DataFrame({"used": 4 * np.array(fixed), "north_m": north_m, "east_m": 0.0}, index=tags)
    return city.Drive(pd.Series(unblocked, index=tags), dict.fromkeys(city.RUNS, run))


def test_the_wait_counts_from_the_first_tag_with_enough_in_sight() -> None:
    unblocked = [8] * 5 + [0] * 30 + [2] * 3 + [4] * 12 + [0] * 10 + [8] * 5
    fixed = [True] * 5 + [False] * 40 + [True] * 20
    drive = _drive(fixed, [0.0] * 65, unblocked)
    assert city.exits_s(drive, city.FULL) == pytest.approx([0.7])  # the second one is a bridge


def test_no_fix_at_all_is_an_endless_wait() -> None:
    drive = _drive([False] * 40, [np.nan] * 40, [0] * 30 + [8] * 10)
    assert city.exits_s(drive, city.FULL) == [np.inf]


def test_spreads_count_epochs_with_enough_satellites() -> None:
    """Of ten epochs two lack satellites, one of the others has no position, one is gross."""
    north_m = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, np.nan, 99.0, 99.0]
    drive = _drive([True] * 10, north_m, [8] * 8 + [3, 3])
    found = city.spreads([drive])[city.FULL]
    assert found.fixed == pytest.approx(7 / 8)
    assert found.gross == pytest.approx(1 / 7)
    assert found.north_m == pytest.approx(np.std(north_m[:7], ddof=1))
    assert found.cep_m == 0.0


def test_the_verdict_needs_every_ratio_every_column_and_the_share_of_fixes() -> None:
    plain = city.Spread(4.0, 2.0, 1.0, 0.10, 0.9)
    full = city.Spread(2.0, 1.5, 0.8, 0.05, 0.99)
    good = city.Spread(0.8, 1.0, 0.7, 0.03, 0.999)
    assert city._judged(good, plain, full)[1]
    for worse in (
        good._replace(north_m=0.95),
        good._replace(east_m=1.3),
        good._replace(cep_m=0.79),
        good._replace(gross=0.04),
        good._replace(fixed=0.99),
    ):
        assert not city._judged(worse, plain, full)[1]
    assert not city._judged(good, plain, full._replace(cep_m=0.6))[1]


def test_right_fixes_of_all_seeds_are_held_against_the_unaided_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """13 of 10 is just enough; where RTKLIB is not there nothing is judged."""
    none = pd.Series(dtype=int)
    alone, aided = Shares(50, 5, 1, 4, 40, 0.02), Shares(50, 6, 0, 4, 40, 0.01)
    rtk = {city.FULL: alone, city.AIDED[0]: aided, city.AIDED[1]: aided._replace(right=7)}
    first = city.Drive(none, {}, rtk)
    second = city.Drive(none, {}, {**rtk, city.AIDED[0]: aided._replace(right=7)})
    monkeypatch.setattr(city, "drive", lambda seed, quick: [first, second][seed - 1])
    figures = city.measure_rtk(False, [1, 2])
    assert [figure.met for figure in figures] == [None, True, True]
    assert figures[0].ours == "right 10 of 12 fixes, 100 tags"
    assert figures[1].ours == "right 13 of 13 fixes, 100 tags; 1.30 × unaided"
    assert [figure.met for figure in city.measure_rtk(False, [1])] == [None, False, True]
    unfixed = dict.fromkeys((city.FULL, *city.AIDED), Shares(50, 0, 0, 0, 50, np.nan))
    monkeypatch.setattr(city, "drive", lambda seed, quick: city.Drive(none, {}, unfixed))
    assert [figure.met for figure in city.measure_rtk(False, [1])] == [None, False, False]
    bare = city.Drive(none, {}, dict.fromkeys(city.RUNS))
    monkeypatch.setattr(city, "drive", lambda seed, quick: bare)
    (figure,) = city.measure_rtk(True, [1])
    assert figure.met is None and "apt install rtklib" in figure.ours


def test_seeds_add_up() -> None:
    found = added([Shares(10, 3, 1, 2, 4, 0.01), Shares(20, 1, 0, 9, 10, 0.03)])
    assert found[:5] == (30, 4, 1, 11, 14)
    assert found.right_rms_m == pytest.approx(np.sqrt((3 * 1e-4 + 9e-4) / 4.0))
    assert np.isnan(added([Shares(10, 0, 1, 2, 7, np.nan)]).right_rms_m)
