"""Differences over known geometry give the noise that was put in, and find what was done to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray, NavData
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.comparison import Yardstick, compare
from deepgnss.evaluate.double_differences import double_differences, references, satellite_table
from deepgnss.evaluate.geometry import between, modelled_errors
from deepgnss.evaluate.observations import read_observations, wavelengths_m
from deepgnss.evaluate.sources import Source, read_source
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.receiver import orbits

_BASE = "real/gnss/cssrlib-baseline/3034265G.21O"
_CODE_M, _PHASE_M = 0.5, 0.002


@pytest.fixture(scope="module")
def nav(shared_data: Path) -> NavData:
    return read_nav(shared_data / "real/gnss/cssrlib-baseline/SEPT2650.21P")


@pytest.fixture(scope="module")
def base(shared_data: Path) -> tuple[pd.DataFrame, FloatArray]:
    place = read_obs(shared_data / _BASE).position_e_m
    assert place is not None
    observed = read_observations(shared_data / _BASE)
    return observed[observed["tow_s"] < observed["tow_s"].min() + 150.0], place


def _rover(observed: pd.DataFrame, moved_m: FloatArray, seed: int = 3) -> pd.DataFrame:
    """Base observations with a change of each range, and noise of our own."""
    noise = np.random.default_rng(seed)
    size = len(observed)
    return observed.assign(
        pseudorange_m=observed["pseudorange_m"] + moved_m + noise.normal(0.0, _CODE_M, size),
        carrier_cycles=observed["carrier_cycles"]
        + (moved_m + noise.normal(0.0, _PHASE_M, size)) / wavelengths_m(observed["satellite"]),
    )


def test_noise_comes_out_as_set(base: tuple[pd.DataFrame, FloatArray], nav: NavData) -> None:
    observed, place = base
    late_m = np.full(len(observed), 1234.5)  # a clock of its own
    single = between(
        modelled_errors(_rover(observed, late_m), place, nav), modelled_errors(observed, place, nav)
    )
    table = satellite_table(double_differences(single, references(single)))
    assert len(table) >= 6 and (table["epochs"] == 150).all()
    _is_as_set(table)
    assert table["slips"].sum() == 0
    total_m = single["code_m"] + SPEED_OF_LIGHT_MPS * single["clock_s"]
    assert float(total_m.mean()) == pytest.approx(1234.5, abs=0.1)


def _is_as_set(table: pd.DataFrame) -> None:
    for name, one_m in (("code_sigma_m", _CODE_M), ("phase_sigma_m", _PHASE_M)):
        sigma_m = float(np.sqrt((table[name] ** 2).mean()))
        assert sigma_m == pytest.approx(np.sqrt(2.0) * one_m, rel=0.05)


def test_a_known_baseline_leaves_noise_as_set(
    base: tuple[pd.DataFrame, FloatArray], nav: NavData
) -> None:
    observed, place = base
    there = place + np.array([30.0, -20.0, 10.0])
    moved_m = np.zeros(len(observed))
    for _, rows in observed.reset_index(drop=True).groupby("tow_s"):
        time = GpsTime(int(rows["week"].iloc[0]), float(rows["tow_s"].iloc[0]))
        known = [orbits.select(nav, str(name), time) for name in rows["satellite"]]
        kept = [k for k, ephemeris in enumerate(known) if ephemeris is not None]
        chosen = [ephemeris for ephemeris in known if ephemeris is not None]
        here_m, there_m = (
            orbits.predict(chosen, time, r, np.zeros(3)).pseudorange_m for r in (place, there)
        )
        moved_m[rows.index[kept]] = there_m - here_m
    rover, of_base = _rover(observed, moved_m), modelled_errors(observed, place, nav)
    for antenna, largest_m in ((there, 0.25), (place, 60.0)):
        single = between(modelled_errors(rover, antenna, nav), of_base)
        table = satellite_table(double_differences(single, references(single)))
        size_m = float(table["code_mean_m"].abs().max())
        assert size_m < largest_m
        if antenna is there:
            _is_as_set(table)
    assert size_m > 5.0  # with the base's antenna the baseline shows


def test_a_slip_is_counted_and_whole_cycles_are_no_error(
    base: tuple[pd.DataFrame, FloatArray], nav: NavData
) -> None:
    observed, place = base
    rover = _rover(observed, np.zeros(len(observed)))
    single = between(modelled_errors(rover, place, nav), modelled_errors(observed, place, nav))
    satellite = next(
        name for name in sorted(set(single["satellite"])) if name not in references(single).values()
    )
    mine = rover["satellite"] == satellite
    late = mine & (rover["tow_s"] > rover["tow_s"].min() + 100.0)
    cycles = rover["carrier_cycles"].to_numpy() + 7.0 * mine + 2.0 * late
    jumped = rover.assign(carrier_cycles=cycles)
    single = between(modelled_errors(jumped, place, nav), modelled_errors(observed, place, nav))
    table = satellite_table(double_differences(single, references(single)))
    assert table["slips"].to_dict() == {name: int(name == satellite) for name in table.index}
    whole = double_differences(single, references(single))
    others = whole[whole["satellite"] != satellite]["phase_m"]
    assert float(others.abs().max()) < 0.1


@pytest.mark.parametrize(
    ("chain", "delay_m"), [("0m", -0.55), ("2m", 1.8), ("4m", 5.0), ("5m8", 7.3)]
)
def test_two_real_chains_show_their_cables(shared_data: Path, chain: str, delay_m: float) -> None:
    folder = shared_data / "real/gnss/jmfriedt-dualchain"
    first, second = (read_source(folder / f"{chain}_gps_{k}.25O") for k in (1, 2))
    found = compare(
        [second], Yardstick(base=first.observations, nav=read_nav(folder / f"{chain}_gps_1.25N"))
    )
    assert found.clocks[second.name].median_m == pytest.approx(delay_m, abs=0.3)
    assert any("zero baseline" in note for note in found.notes)
    (table,) = found.observations.values()
    if chain != "4m":  # there the reference satellite was locked 500 Hz off in one of the chains
        assert float(table["phase_sigma_m"].min()) < 0.004


def test_receivers_are_compared_on_the_same_satellites_and_instants(
    base: tuple[pd.DataFrame, FloatArray], nav: NavData
) -> None:
    observed, place = base
    nobody = pd.DataFrame()
    start_s = observed["tow_s"].min()
    half = observed[observed["tow_s"] < start_s + 50.0]
    fewer = observed[observed["satellite"] != "G05"]
    sources = [
        Source("half", "RINEX", nobody, _rover(half, np.zeros(len(half)))),
        Source("fewer", "RINEX", nobody, _rover(fewer, np.zeros(len(fewer)))),
    ]
    found = compare(sources, Yardstick(base=observed, base_r_e_m=place, nav=nav))
    for table in found.observations.values():
        assert "G05" not in table.index
        assert set(table["epochs"]) == {50}
