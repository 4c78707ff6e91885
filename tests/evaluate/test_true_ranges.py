"""Differences of observations against true ranges: known errors must come out as they went in."""

import numpy as np
import pandas as pd
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.evaluate.observables import (
    clock_free,
    dynamic_errors,
    range_errors,
    same_epochs,
    satellite_accuracy,
    satellite_sigmas,
    single_differences,
    thermal_sigmas,
    usual_satellites,
    with_theory,
)
from deepgnss.evaluate.observations import (
    RANGE_COLUMNS,
    read_channels,
    read_observations,
    read_ranges,
    wavelength_m,
)
from deepgnss.theory.tracking_error import dll_thermal_sigma_chips, pll_thermal_sigma_cycles

_L1_M = wavelength_m("G01")
_NAMES = ("G01", "G02", "G05", "G12", "G31")
_RATES_MPS = (-600.0, -200.0, 50.0, 300.0, 700.0)


def _ranges(seconds=20.0, week=2190, tow_s=604_790.0):
    """Five satellites on straight ranges across the end of a week; phase falls behind slowly."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    parts = []
    for k, (name, rate) in enumerate(zip(_NAMES, _RATES_MPS, strict=True)):
        total = tow_s + t
        range_m = 2.0e7 + 1e6 * k + rate * t
        parts.append(
            pd.DataFrame(
                {
                    "week": week + (total >= 604_800.0),
                    "tow_s": total % 604_800.0,
                    "satellite": name,
                    "range_m": range_m,
                    "phase_m": range_m - 0.01 * t,
                    "elevation_deg": 10.0 + 10.0 * k,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)[list(RANGE_COLUMNS)]


def _observed(ranges, clock_s=0.0, code_m=None, phase_m=None):
    """What a receiver whose clock is off by clock_s writes; errors by satellite in wide tables."""
    rate = ranges["satellite"].map(dict(zip(_NAMES, _RATES_MPS, strict=True)))
    # tag = true time + clock: the range at the tag less what it moved since reception
    moved = -rate * clock_s + SPEED_OF_LIGHT_MPS * clock_s
    frame = pd.DataFrame(
        {
            "week": ranges["week"],
            "tow_s": ranges["tow_s"],
            "satellite": ranges["satellite"],
            "pseudorange_m": ranges["range_m"] + moved,
            "carrier_cycles": (ranges["phase_m"] + moved + 0.01 * clock_s) / _L1_M,
            "doppler_hz": -rate / _L1_M,
            "cn0_dbhz": 45.0,
            "slip": False,
            "half_cycle": False,
        }
    )
    for k, name in enumerate(_NAMES):
        mine = frame["satellite"] == name
        frame.loc[mine, "carrier_cycles"] += 1000.0 * k + 0.5 * (k % 2)
        if code_m is not None:
            frame.loc[mine, "pseudorange_m"] += code_m[:, k]
        if phase_m is not None:
            frame.loc[mine, "carrier_cycles"] += phase_m[:, k] / _L1_M
    return frame


@pytest.mark.parametrize("clock_s", [0.0, 3.0e-3, -0.7e-3])
def test_receiver_clock_stands_in_tag_range_and_phase(clock_s):
    ranges = _ranges()
    errors = range_errors(_observed(ranges, clock_s), ranges)
    # an epoch whose true instant lies outside truth has no errors
    assert len(errors) == len(ranges) - (len(_NAMES) if clock_s else 0)
    assert errors["clock_s"].to_numpy() == pytest.approx(clock_s, abs=1e-15)
    assert np.abs(errors["code_m"]).max() < 1e-6
    residual = clock_free(errors, "phase_m", _NAMES)
    assert np.abs(residual.to_numpy()).max() < 1e-6


def test_sign_is_observation_minus_truth():
    ranges = _ranges()
    bias = np.zeros((201, 5))
    bias[:, 3] = 7.0
    errors = range_errors(_observed(ranges, 1e-5, code_m=bias), ranges)
    by_name = errors.groupby("satellite")["code_m"].mean()
    assert by_name["G12"] - by_name["G01"] == pytest.approx(7.0, abs=1e-6)


def test_sigmas_of_each_satellite_come_back():
    generator = np.random.default_rng(7)
    ranges = _ranges(seconds=400.0)
    code_m, phase_m = np.array([0.2, 0.4, 0.6, 0.8, 1.5]), np.array([1, 1, 2, 3, 4]) * 1e-3
    count = len(ranges) // 5
    frame = _observed(
        ranges,
        2e-4,
        code_m * generator.standard_normal((count, 5)),
        phase_m * generator.standard_normal((count, 5)),
    )
    accuracy = satellite_accuracy(range_errors(frame, ranges))
    assert list(accuracy.index) == list(_NAMES)
    assert accuracy["code_rms_m"].to_numpy() == pytest.approx(code_m, rel=0.06)
    assert accuracy["phase_sigma_m"].to_numpy() == pytest.approx(phase_m, rel=0.06)
    assert accuracy["elevation_deg"].to_numpy() == pytest.approx([10, 20, 30, 40, 50])
    assert (accuracy["slips"] == 0).all()
    assert (accuracy["arcs"] == 1).all()
    slope = accuracy["code_minus_phase_mmps"] / accuracy["code_minus_phase_sigma_mmps"]
    assert (np.abs(slope) < 4.0).all()

    pairs = single_differences(range_errors(frame, ranges), "G01")
    expected = np.hypot(code_m[1:], code_m[0])
    assert list(pairs.index) == list(_NAMES[1:])
    assert pairs["code_sigma_m"].to_numpy() == pytest.approx(expected, rel=0.05)
    assert pairs["phase_sigma_m"].to_numpy() == pytest.approx(
        np.hypot(phase_m[1:], phase_m[0]), rel=0.05
    )


def test_bias_counts_as_code_error_but_not_as_phase_error():
    residuals = pd.DataFrame(np.tile([3.0, -1.0, -1.0, -1.0], (100, 1)))
    assert satellite_sigmas(residuals).to_numpy() == pytest.approx(0.0, abs=1e-12)
    assert satellite_sigmas(residuals, about_zero=True)[0] > 2.0
    assert satellite_sigmas(residuals.iloc[:, :2]).isna().all()


def test_slips_flagged_and_not():
    ranges = _ranges()
    step = np.zeros((201, 5))
    step[100:, 1] = _L1_M
    frame = _observed(ranges, phase_m=step)
    accuracy = satellite_accuracy(range_errors(frame, ranges))
    assert accuracy["slips"].to_dict() == {"G01": 0, "G02": 1, "G05": 0, "G12": 0, "G31": 0}

    flagged = frame["satellite"].eq("G02") & (np.arange(len(frame)) % 201 == 100)
    frame.loc[flagged, "slip"] = True
    accuracy = satellite_accuracy(range_errors(frame, ranges))
    assert accuracy["slips"].sum() == 0
    assert accuracy["arcs"].to_dict() == {"G01": 1, "G02": 2, "G05": 1, "G12": 1, "G31": 1}
    assert accuracy["phase_sigma_m"].max() < 1e-6  # the cycle went with its arc


def test_a_gap_begins_a_new_arc_of_that_satellite_alone():
    ranges = _ranges()
    frame = _observed(ranges)
    gap = frame["satellite"].eq("G05") & frame["tow_s"].between(604_795.0, 604_796.0)
    errors = range_errors(frame[~gap], ranges)
    assert errors.groupby("satellite")["arc"].max().to_dict() == {
        "G01": 1,
        "G02": 1,
        "G05": 2,
        "G12": 1,
        "G31": 1,
    }
    assert usual_satellites(errors, 0.97) == ["G01", "G02", "G12", "G31"]


def test_drift_of_code_against_phase():
    ranges = _ranges()
    drift = np.zeros((201, 5))
    drift[:, 2] = 0.02 * 0.1 * np.arange(201)
    accuracy = satellite_accuracy(range_errors(_observed(ranges, code_m=drift), ranges))
    assert accuracy.loc["G05", "code_minus_phase_mmps"] == pytest.approx(20.0, rel=1e-3)
    assert accuracy.loc["G01", "code_minus_phase_mmps"] == pytest.approx(0.0, abs=1e-3)


def test_same_epochs_of_several_receivers():
    ranges = _ranges()
    frame = _observed(ranges)
    a = range_errors(frame[frame["satellite"] != "G01"], ranges)
    without = frame["satellite"].eq("G02") & (frame["tow_s"] > 604_795.0)
    b = range_errors(frame.assign(carrier_cycles=frame["carrier_cycles"].mask(without)), ranges)
    one, two = same_epochs([a, b])
    assert one[["time_ms", "satellite"]].equals(two[["time_ms", "satellite"]])
    assert set(one["satellite"]) == set(_NAMES) - {"G01"}
    assert one.groupby("satellite").size()["G02"] == 201 - 49


def test_theory_by_the_settings_of_the_time():
    ranges = _ranges()
    errors = range_errors(_observed(ranges), ranges)
    channels = pd.DataFrame(
        [
            {
                "week": week,
                "tow_s": tow_s,
                "satellite": name,
                "coherent_s": 0.02,
                "carrier_bandwidth_hz": 7.0,
                "code_bandwidth_hz": code_hz,
            }
            for week, tow_s, code_hz in ((2190, 604_799.9, 1.0), (2191, 20.0, 0.1))
            for name in _NAMES
        ]
    )
    thermal = thermal_sigmas(errors, channels, 0.25, 4.0e6)
    early = thermal["time_ms"] <= 604_799_900
    chip_m = SPEED_OF_LIGHT_MPS / 1.023e6
    for rows, code_hz in ((thermal[early], 1.0), (thermal[~early], 0.1)):
        expected = chip_m * dll_thermal_sigma_chips(45.0, code_hz, 0.02, 0.25, 4.0e6, 1.023e6)
        assert rows["code_thermal_m"].to_numpy() == pytest.approx(expected)
    phase = _L1_M * pll_thermal_sigma_cycles(45.0, 7.0, 0.02)
    joined = with_theory(satellite_accuracy(errors), thermal)
    assert joined["phase_thermal_m"].to_numpy() == pytest.approx(phase)


def test_dynamic_error_of_a_loop():
    ranges = _ranges(seconds=60.0)
    t = np.tile(np.arange(601) * 0.1, 5)
    # constant velocity: nothing; constant acceleration: a loop of order 2 lags by a / ω²
    still = dynamic_errors(ranges, 2, 5.0, 0.02)
    assert np.abs(still["phase_m"]).max() < 1e-6
    accelerated = ranges.assign(phase_m=ranges["phase_m"] + 0.5 * 2.0 * t**2)
    lag = dynamic_errors(accelerated, 2, 5.0, 0.02)["phase_m"]
    omega = 5.0 * 8.0 * np.sqrt(0.5) / (4.0 * 0.5 + 1.0)  # of the analogue loop
    assert lag.median() == pytest.approx(-2.0 / omega**2, rel=0.25)
    order3 = dynamic_errors(accelerated, 3, 5.0, 0.02)
    # truth is a polygon: its corners, where the rows are, lie a·h²/12 outside of its mean
    assert order3["phase_m"].median() == pytest.approx(2.0 * 0.1**2 / 12.0, rel=0.1)


def test_files(tmp_path):
    (tmp_path / "ranges.csv").write_text(
        "week,tow,prn,az_deg,el_deg,pseudorange_m,carrier_cycles\n2190,1.0,3,10.0,20.0,2e7,1e8\n"
    )
    ranges = read_ranges(tmp_path / "ranges.csv")
    assert ranges.loc[0, "satellite"] == "G03"
    assert ranges.loc[0, "phase_m"] == pytest.approx(1e8 * _L1_M)
    (tmp_path / "observations.csv").write_text(
        "week,tow_s,satellite,pseudorange_m,carrier_cycles,doppler_hz,cn0_dbhz,slip,half_cycle,"
        "carrier_valid\n2190,1.0,G03,2e7,1e8,1.0,45.0,1,0,1\n2190,1.0,G04,2e7,1e8,1.0,45.0,0,1,0\n"
    )
    observed = read_observations(tmp_path / "observations.csv")
    assert observed["slip"].tolist() == [True, False]
    assert observed["half_cycle"].tolist() == [False, True]
    assert observed["carrier_cycles"].isna().tolist() == [False, True]
    with pytest.raises(InputFileError, match="column 'tow' is missing"):
        read_ranges(tmp_path / "observations.csv")
    with pytest.raises(InputFileError, match="coherent_s"):
        read_channels(tmp_path / "observations.csv")
