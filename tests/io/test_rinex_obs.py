import math
import warnings
from dataclasses import replace
from pathlib import Path

import georinex
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_samples import NOON, WAVELENGTH_M, epoch, observation, rtklib

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import OutputError
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Epoch, Observation
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex import calendar, long_name
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import read_truth

_BOTH = ObsHeader([BDS_B1I, GPS_L1CA], 1.0, 59.9, np.array([4e6, -7e5, 4.8e6]))

_GOLDEN = """\
     3.05           OBSERVATION DATA    M: MIXED            RINEX VERSION / TYPE
deepgnss                                20220101 120010 UTC PGM / RUN BY / DATE
DGNS                                                        MARKER NAME
GROUND_CRAFT                                                MARKER TYPE
                                                            OBSERVER / AGENCY
                    deepgnss                                REC # / TYPE / VERS
                    UNKNOWN                                 ANT # / TYPE
  4000000.0000  -700000.0000  4800000.0000                  APPROX POSITION XYZ
        0.0000        0.0000        0.0000                  ANTENNA: DELTA H/E/N
G    4 C1C L1C D1C S1C                                      SYS / # / OBS TYPES
C    4 C2I L2I D2I S2I                                      SYS / # / OBS TYPES
DBHZ                                                        SIGNAL STRENGTH UNIT
     1.000                                                  INTERVAL
  2022     1     1    12     0   28.0000000     GPS         TIME OF FIRST OBS
     0                                                      RCV CLOCK OFFS APPL
G L1C  0.00000                                              SYS / PHASE SHIFT
C L2I  0.00000                                              SYS / PHASE SHIFT
    18                                                      LEAP SECONDS
                                                            END OF HEADER
> 2022 01 01 12 00 28.0000000  0  3
G05  21234567.891   111589123.456 7     -1234.567          45.250
G31  21234567.891                       -1234.567          45.250
C21  21234567.891   111589123.45637     -1234.567          45.250
"""


def _write(folder: Path, epochs: list[Epoch], header: ObsHeader = _BOTH) -> Path:
    with RinexObsWriter(folder, header) as writer:
        for each in epochs:
            writer.write(each)
    path = writer.path
    assert path is not None
    return path


def test_golden(tmp_path: Path) -> None:
    lost = {"slip": True, "half_cycle": True}
    path = _write(
        tmp_path,
        [
            epoch(
                [
                    observation("C21", "BDS_B1I", **lost),
                    observation("G31", carrier_valid=False),
                    observation("G05"),
                ]
            )
        ],
    )
    assert path.name == "DGNS00XXX_R_20220011200_01M_01S_MO.rnx"
    assert path.read_text() == _GOLDEN


def test_no_epoch_no_file(tmp_path: Path) -> None:
    with RinexObsWriter(tmp_path / "out", _BOTH) as writer:
        pass
    assert writer.path is None
    assert not (tmp_path / "out").exists()


def test_loss_of_lock_waits_for_the_next_phase(tmp_path: Path) -> None:
    """Bit 0 belongs to the first phase after the slip, once, and to the slipped signal alone."""
    story = [
        {"slip": False},
        {"slip": True, "carrier_valid": False},
        {"carrier_valid": False},
        {"half_cycle": True},
        {"slip": True},  # polarity resolved: half a cycle may have been applied
        {},
    ]
    epochs = [
        epoch([observation("G05", **what), observation("G12")], NOON.plus(k))
        for k, what in enumerate(story)
    ]
    frame = read_obs(_write(tmp_path, epochs)).frame
    five = frame[frame["satellite"] == "G05"]
    assert five["L1C"].notna().tolist() == [True, False, False, True, True, True]
    assert five["L1C_lli"].tolist() == [0, 0, 0, 3, 1, 0]
    assert not frame[frame["satellite"] == "G12"]["L1C_lli"].any()


@pytest.mark.parametrize(("cn0", "digit"), [(3.0, "1"), (35.99, "5"), (36.0, "6"), (60.0, "9")])
def test_strength_digit(tmp_path: Path, cn0: float, digit: str) -> None:
    text = _write(tmp_path, [epoch([observation(cn0_dbhz=cn0)])]).read_text()
    assert f"111589123.456 {digit} " in text


def test_not_finite_is_blank(tmp_path: Path) -> None:
    lost = observation(doppler_hz=math.nan, cn0_dbhz=math.nan, carrier_cycles=math.inf)
    path = _write(tmp_path, [epoch([lost])])
    assert path.read_text().endswith("\nG05  21234567.891\n")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (9_999_999_999.9994, " " * 14),
        (9_999_999_999.999, "9999999999.999"),
        (-999_999_999.999, "-999999999.999"),
        (-999_999_999.9996, " " * 14),
    ],
)
def test_widest_numbers(tmp_path: Path, value: float, text: str) -> None:
    path = _write(tmp_path, [epoch([observation(doppler_hz=value)])])
    assert path.read_text().splitlines()[-1][3 + 32 : 3 + 46] == text


def test_seconds_never_reach_sixty() -> None:
    assert calendar(GpsTime(2190, 561_659.99999999)) == (2022, 1, 1, 12, 1, 0.0)
    assert calendar(GpsTime(2190, 604_799.99999999)) == (2022, 1, 2, 0, 0, 0.0)
    assert calendar(GpsTime(2190, 561_628.1)).second == 28.1


@pytest.mark.parametrize(
    ("duration_s", "interval_s", "name"),
    [
        (0.1, 0.02, "DGNS00XXX_R_20220011200_01M_50Z_GO.rnx"),
        (41.0, 0.1, "DGNS00XXX_R_20220011200_01M_10Z_GO.rnx"),
        (3600.0, 1.0, "DGNS00XXX_R_20220011200_01H_01S_GO.rnx"),
        (8000.0, 30.0, "DGNS00XXX_R_20220011200_03H_30S_GO.rnx"),
        (86_400.0, 60.0, "DGNS00XXX_R_20220011200_01D_01M_GO.rnx"),
        (60.0, 0.005, "DGNS00XXX_R_20220011200_01M_02C_GO.rnx"),
        (60.0, 0.3, "DGNS00XXX_R_20220011200_01M_00U_GO.rnx"),
    ],
)
def test_long_name(duration_s: float, interval_s: float, name: str) -> None:
    assert long_name("O", "G", NOON, duration_s, interval_s) == name


def test_station_that_would_leave_the_folder() -> None:
    with pytest.raises(OutputError, match="9 capitals or digits"):
        long_name("O", "G", NOON, 60.0, 1.0, station="../../etc")


_number = st.floats(-9e8, 9e9)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    values=st.lists(
        st.tuples(_number, _number, _number, st.floats(0.1, 70.0)), min_size=1, max_size=9
    ),
    tow=st.integers(0, 604_799_9999),
)
def test_any_value_survives(
    tmp_path_factory: pytest.TempPathFactory, values: list[tuple[float, ...]], tow: int
) -> None:
    folder = tmp_path_factory.getbasetemp() / "obs"
    time = GpsTime(2190, tow / 10_000)
    observations = [
        observation(f"G{k + 1:02d}", pseudorange_m=c, carrier_cycles=p, doppler_hz=d, cn0_dbhz=s)
        for k, (c, p, d, s) in enumerate(values)
    ]
    frame = read_obs(_write(folder, [epoch(observations, time)])).frame
    assert frame["satellite"].tolist() == [o.satellite for o in observations]
    for row, o in zip(frame.itertuples(), observations, strict=True):
        assert (row.week, row.tow_s) == (time.week, pytest.approx(time.tow_s, abs=6e-8))
        for read, was in (
            (row.C1C, o.pseudorange_m),
            (row.L1C, o.carrier_cycles),
            (row.D1C, o.doppler_hz),
            (row.S1C, o.cn0_dbhz),
        ):
            read = 0.0 if math.isnan(read) else read  # 0.000 counts as missing
            assert read == pytest.approx(was, abs=0.000501, rel=1e-15)


# --- geometry: an independent simulator's exact ranges -------------------------------------------


def _drive_epochs(shared_data: Path) -> list[Epoch]:
    """Exact pseudoranges of `drive` every 5 s; phase and Doppler follow from their change."""
    table = pd.read_csv(shared_data / "independent/drive/ranges.csv")
    table = table[table["el_deg"] > 10.0]
    satellites: dict[float, list[Observation]] = {}
    for prn, rows in table.groupby("prn"):
        range_m = rows["pseudorange_m"].to_numpy()
        rate_mps = np.gradient(range_m, rows["tow"].to_numpy())
        for tow, c, rate in zip(rows["tow"], range_m, rate_mps, strict=True):
            satellites.setdefault(round(tow, 1), []).append(
                observation(
                    f"G{int(prn):02d}",
                    pseudorange_m=c,
                    carrier_cycles=c / WAVELENGTH_M - 1000.0 * int(prn),
                    doppler_hz=-rate / WAVELENGTH_M,
                    transmit=NOON.plus(tow - NOON.tow_s - c / SPEED_OF_LIGHT_MPS),
                )
            )
    times = sorted(satellites)[9::50]
    return [epoch(satellites[tow], GpsTime(2190, tow)) for tow in times]


def test_rtklib_finds_the_place_the_ranges_were_made_for(shared_data: Path, tmp_path: Path) -> None:
    epochs = _drive_epochs(shared_data)
    nav = read_nav(shared_data / "independent/drive/brdc0010.22n")
    header = ObsHeader([GPS_L1CA], 5.0, 60.0, utc=nav.utc)
    obs_path, nav_path = _write(tmp_path, epochs, header), tmp_path / "n.rnx"
    write_nav(nav_path, nav)
    (tmp_path / "rtk.conf").write_text(  # the simulator made an ionosphere and no troposphere
        "pos1-posmode=single\npos1-ionoopt=brdc\npos1-tropopt=off\npos1-elmask=10\nout-outvel=on\n"
    )
    out = tmp_path / "out.pos"
    rtklib("rnx2rtkp", "-k", tmp_path / "rtk.conf", "-o", out, obs_path, nav_path)
    found = read_truth(out, "rtklib_pos")
    assert len(found.week) == len(epochs) == 12
    truth = read_truth(shared_data / "independent/drive/truth.csv")
    r_e_m, v_e_mps = truth.at(found.week, found.tow_s)
    to_n = C_ne(*geodetic(r_e_m[0])[:2])
    error_n_m = (found.r_e_m - r_e_m) @ to_n.T
    assert np.abs(error_n_m[:, :2]).max() < 0.15
    assert np.abs(error_n_m[:, 2]).max() < 0.3
    assert found.v_e_mps is not None
    # Doppler of the right sign and scale: speeds to 10 m/s come out within cm/s.
    assert np.linalg.norm(v_e_mps, axis=1).max() > 5.0
    assert np.abs(found.v_e_mps - v_e_mps).max() < 0.1


def test_rtklib_converts_our_file_without_loss(tmp_path: Path) -> None:
    epochs = [
        epoch([observation("G05"), observation("C21", "BDS_B1I")], NOON.plus(0.1 * k))
        for k in range(5)
    ]
    path = _write(tmp_path, epochs, replace(_BOTH, interval_s=0.1))
    out = tmp_path / "again.obs"
    stderr = rtklib("convbin", "-r", "rinex", "-v", "3.04", "-od", "-os", "-o", out, path)
    assert "error" not in stderr.lower()
    ours, theirs = read_obs(path).frame, read_obs(out).frame
    for code in ("C1C", "L1C", "D1C", "S1C", "C2I", "L2I", "D2I", "S2I"):
        a, b = (f.sort_values(["tow_s", "satellite"])[code].to_numpy() for f in (ours, theirs))
        np.testing.assert_allclose(a, b, atol=0.0006)


def test_signs_in_the_file(shared_data: Path, tmp_path: Path) -> None:
    """Phase grows with range and dL/dt = −D, on a satellite that comes and one that goes."""
    epochs = _drive_epochs(shared_data)
    frame = read_obs(_write(tmp_path, epochs, ObsHeader([GPS_L1CA], 5.0, 60.0))).frame
    signs = set()
    for _, rows in frame.groupby("satellite"):
        if len(rows) < 12:
            continue
        t = rows["tow_s"].to_numpy()
        d_range = np.diff(rows["C1C"].to_numpy())
        d_phase = np.diff(rows["L1C"].to_numpy())
        assert d_phase * WAVELENGTH_M == pytest.approx(d_range, abs=0.002)
        doppler = rows["D1C"].to_numpy()
        mean_doppler = (doppler[1:] + doppler[:-1]) / 2.0
        assert d_phase / np.diff(t) == pytest.approx(-mean_doppler, abs=8.0)
        signs.add(bool(d_range[0] > 0.0))
    assert signs == {True, False}


def test_georinex_reads_what_we_write(tmp_path: Path) -> None:
    epochs = [
        epoch(
            [observation("G05", pseudorange_m=2.1e7 + k), observation("C21", "BDS_B1I")],
            NOON.plus(k),
        )
        for k in range(3)
    ]
    path = _write(tmp_path, epochs)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about defaults to come
        theirs = georinex.load(path)
    assert theirs["C1C"].sel(sv="G05").to_numpy().tolist() == [2.1e7, 2.1e7 + 1, 2.1e7 + 2]
    assert theirs["L2I"].sel(sv="C21").to_numpy().tolist() == [111_589_123.456] * 3
    assert theirs["time"].to_numpy()[0] == np.datetime64("2022-01-01T12:00:28")


def test_same_epochs_same_bytes(tmp_path: Path) -> None:
    forward = [observation("G05"), observation("G12"), observation("C21", "BDS_B1I")]
    a = _write(tmp_path / "a", [epoch(forward)])
    b = _write(tmp_path / "b", [epoch(forward[::-1])])
    assert a.read_bytes() == b.read_bytes()
