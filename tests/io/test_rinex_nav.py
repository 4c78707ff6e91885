import gzip
import warnings
from dataclasses import fields, replace
from pathlib import Path

import georinex
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_samples import rtklib

from deepgnss.core.errors import InputFileError, OutputError
from deepgnss.core.records import Ephemeris, Klobuchar, NavData, UtcParameters
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex import long_name
from deepgnss.io.rinex_nav import read_nav, write_nav

_GPS = Ephemeris(
    satellite="G07",
    toe=GpsTime(2190, 568_800.0),
    toc=GpsTime(2190, 568_800.0),
    transmitted=GpsTime(2190, 561_618.0),
    iode=45,
    iodc=301,
    af0_s=-3.1e-4,
    af1_sps=-1.1e-11,
    af2_sps2=0.0,
    group_delay_s=-1.1e-8,
    sqrt_a_rm=5153.6,
    eccentricity=0.015,
    m0_rad=-2.4,
    delta_n_radps=4.2e-9,
    omega0_rad=1.9,
    omega_rad=-2.3,
    omega_dot_radps=-8.0e-9,
    i0_rad=0.95,
    idot_radps=1.2e-10,
    cuc_rad=-1.1e-6,
    cus_rad=7.6e-6,
    crc_m=233.5,
    crs_m=-21.25,
    cic_rad=-2.0e-7,
    cis_rad=1.3e-7,
    health=0,
    accuracy_m=2.0,
)
_BDS = replace(
    _GPS, satellite="C21", sqrt_a_rm=5282.6, toe=GpsTime(2190, 14.0), toc=GpsTime(2190, 14.0),
    transmitted=GpsTime(2189, 604_790.0), group_delay2_s=3.0e-9, iodc=1, iode=1,
)  # fmt: skip
_KLOBUCHAR = Klobuchar((1.1e-8, -7.4e-9, -5.9e-8, 1.1e-7), (1.1e5, -2.4e5, -6.5e4, 1.1e6))
_UTC = UtcParameters(2.7e-9, 7.9e-15, GpsTime(2191, 147_456.0), 18, 18, 2185, 7)
_NAV = NavData({"G07": (_GPS,), "C21": (_BDS,)}, {"G": _KLOBUCHAR, "C": _KLOBUCHAR}, _UTC)


def _georinex(path: Path, use: str):  # type: ignore[no-untyped-def]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about defaults to come
        return georinex.load(path, use={use})


# --- reading what others wrote -------------------------------------------------------------------

_FILES = (
    ("independent/drive/brdc0010.22n", 32, "G"),
    ("real/if/iotgnss-flight/sxnsr_test_data_flight.12n", 32, "G"),
    ("real/gnss/snapper-ubx/w00_f9p.nav", 18, "C"),
    ("real/gnss/cssrlib-baseline/SEPT2650.21P", 23, "G"),
    ("real/gnss/rtklib-2005/07590920.05n", 28, "G"),
    ("real/gnss/jmfriedt-dualchain/4m_gps_1.25N", 6, "G"),
)

# What georinex calls the fields that need no conversion.
_NAMES = {
    "SVclockBias": "af0_s", "SVclockDrift": "af1_sps", "SVclockDriftRate": "af2_sps2",
    "Crs": "crs_m", "DeltaN": "delta_n_radps", "M0": "m0_rad", "Cuc": "cuc_rad",
    "Eccentricity": "eccentricity", "Cus": "cus_rad", "sqrtA": "sqrt_a_rm", "Cic": "cic_rad",
    "Omega0": "omega0_rad", "Cis": "cis_rad", "Io": "i0_rad", "Crc": "crc_m", "omega": "omega_rad",
    "OmegaDot": "omega_dot_radps", "IDOT": "idot_radps", "SVacc": "accuracy_m",
    "health": "health", "TGD": "group_delay_s", "IODC": "iodc", "IODE": "iode",
    "TGD1": "group_delay_s", "TGD2": "group_delay2_s", "AODE": "iode", "SatH1": "health",
}  # fmt: skip


@pytest.mark.parametrize(("name", "satellites", "system"), _FILES)
def test_agrees_with_georinex(shared_data: Path, name: str, satellites: int, system: str) -> None:
    path = shared_data / name
    nav = read_nav(path)
    assert len(nav.ephemerides) == satellites
    theirs = _georinex(path, system)
    shift_s = 14.0 if system == "C" else 0.0
    compared = 0
    for satellite, records in nav.ephemerides.items():
        if satellite[0] != system:
            continue
        for e in records:
            toc = np.datetime64(e.toc.plus(-shift_s).calendar())
            row = theirs.sel(sv=satellite, time=toc)
            for their_name, our_name in _NAMES.items():
                if their_name in row:
                    compared += 1
                    assert getattr(e, our_name) == float(row[their_name]), (satellite, their_name)
            assert e.toe.plus(-shift_s).tow_s == float(row["Toe"])
    assert compared > 20 * satellites / 2


def test_ionosphere_and_utc_of_the_header(shared_data: Path) -> None:
    nav = read_nav(shared_data / "independent/drive/brdc0010.22n")
    assert nav.klobuchar == {
        "G": Klobuchar(
            (1.211e-8, -7.451e-9, -5.960e-8, 1.192e-7), (1.167e5, -2.458e5, -6.554e4, 1.114e6)
        )
    }
    assert nav.utc is not None
    assert nav.utc[:4] == (2.79396772385e-9, 7.9936057773e-15, GpsTime(2191, 147_456.0), 18)
    sent = nav.ephemerides["G01"][0]
    assert (sent.toe, sent.transmitted) == (GpsTime(2190, 518_400.0), GpsTime(2190, 511_218.0))


def test_beidou_times_become_gpst(shared_data: Path) -> None:
    nav = read_nav(shared_data / "independent/dual/ESBC00DNK_R_20201770000_01D_MN.rnx.gz")
    first = next(e for e in nav.ephemerides["C05"] if e.toe == GpsTime(2111, 385_214.0))
    assert first.toc == first.toe
    assert first.transmitted == GpsTime(2111, 385_241.6)
    assert (first.group_delay_s, first.group_delay2_s) == (1.0e-10, -9.3e-9)


def test_several_ionosphere_sets_and_concatenated_files(shared_data: Path) -> None:
    nav = read_nav(shared_data / "real/nav/tarc1030.23b")  # georinex stops at this header
    assert len(nav.ephemerides) == 44
    assert nav.klobuchar["C"].alpha == (3.260e-8, 4.172e-7, -2.861e-6, 3.993e-6)
    glued = read_nav(shared_data / "real/gnss/jmfriedt-dualchain/2m_gps_1.25N")
    assert len(glued.ephemerides) >= 6


# --- round trips ---------------------------------------------------------------------------------


def test_written_file_reads_back_alike(tmp_path: Path) -> None:
    write_nav(tmp_path / "n.rnx", _NAV)
    again = read_nav(tmp_path / "n.rnx")
    assert again == _NAV


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("nav")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    week=st.integers(1000, 3000),
    tow_s=st.integers(0, 604_799 // 16).map(lambda n: 16.0 * n),
    before_s=st.integers(-3600, 7200),
    values=st.tuples(*[st.floats(-1.0, 1.0, allow_subnormal=False)] * 4),
    satellite=st.sampled_from(["G01", "G32", "C05", "C63"]),
)
def test_any_ephemeris_survives(
    folder: Path,
    week: int,
    tow_s: float,
    before_s: int,
    values: tuple[float, float, float, float],
    satellite: str,
) -> None:
    toe = GpsTime(week, tow_s)
    written = replace(
        _GPS, satellite=satellite, toe=toe, toc=toe, transmitted=toe.plus(-before_s), iodc=45,
        group_delay2_s=values[0] if satellite[0] == "C" else 0.0,
        af0_s=values[0], m0_rad=values[1], crs_m=values[2] * 1e3, idot_radps=values[3] * 1e-9,
    )  # fmt: skip
    path = folder / "n.rnx"
    write_nav(path, NavData({satellite: (written,)}))
    (read,) = read_nav(path).ephemerides[satellite]
    for field in fields(Ephemeris):
        was, now = getattr(written, field.name), getattr(read, field.name)
        if isinstance(was, float):
            assert now == pytest.approx(was, rel=1e-12, abs=1e-30), field.name
        else:
            assert now == was, field.name


def test_georinex_reads_what_we_write(tmp_path: Path) -> None:
    path = tmp_path / "n.rnx"
    write_nav(path, _NAV)
    theirs = _georinex(path, "G")
    row = theirs.sel(sv="G07", time=np.datetime64("2022-01-01T14:00:00"))
    assert (float(row["Toe"]), float(row["GPSWeek"])) == (568_800.0, 2190.0)
    assert float(row["TransTime"]) == 561_618.0
    assert float(row["Crc"]) == 233.5
    assert theirs.attrs["ionospheric_corr_GPS"].tolist() == [*_KLOBUCHAR.alpha, *_KLOBUCHAR.beta]
    beidou = _georinex(path, "C")
    assert float(beidou["Toe"].squeeze()) == 0.0
    assert float(beidou["BDTWeek"].squeeze()) == 2190 - 1356
    assert beidou["time"].to_numpy()[0] == np.datetime64("2021-12-26T00:00:00")


def test_rtklib_reads_what_we_write(tmp_path: Path) -> None:
    name = long_name("N", "GC", GpsTime(2190, 561_628.0), 60.0)
    write_nav(tmp_path / name, _NAV)
    out = tmp_path / "again.nav"
    stderr = rtklib("convbin", "-r", "rinex", "-v", "3.04", "-n", out, tmp_path / name)
    assert "error" not in stderr.lower()
    again = read_nav(out)
    assert set(again.ephemerides) == {"G07", "C21"}
    for satellite, (ours,) in _NAV.ephemerides.items():
        (theirs,) = again.ephemerides[satellite]
        assert (theirs.toe, theirs.toc, theirs.transmitted) == (
            ours.toe, ours.toc, ours.transmitted,
        )  # fmt: skip
        assert theirs.sqrt_a_rm == ours.sqrt_a_rm
        assert (theirs.group_delay_s, theirs.health) == (ours.group_delay_s, ours.health)


def test_same_data_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_nav(tmp_path / name, _NAV)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_nothing_to_write(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no ephemeris"):
        write_nav(tmp_path / "n.rnx", NavData())
    assert list(tmp_path.iterdir()) == []


# --- broken files --------------------------------------------------------------------------------


def _text(tmp_path: Path) -> str:
    write_nav(tmp_path / "good.rnx", _NAV)
    return (tmp_path / "good.rnx").read_text()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda t: "", "file is empty"),
        (lambda t: "hello\n", "not a RINEX file"),
        (lambda t: "\0" * 100, "binary data"),
        (lambda t: t.replace("END OF HEADER", "END"), "no END OF HEADER"),
        (lambda t: t.replace("N: GNSS", "O: GNSS"), "is no navigation file"),
        (lambda t: t.replace("     3.05", "     4.00"), "versions 2 and 3"),
        (lambda t: t[: t.rindex("\n", 0, -1)], "line 18: file ends within the record of 'G07"),
        (lambda t: t.replace("5.1536", "5.1x36"), "'5.1x36.*' is not a number"),
        (lambda t: t.replace("2.335000000000E+02", " " * 18), "a field of the C21 record is blank"),
        (lambda t: t.replace("5.153600000000E+03", "0.000000000000E+00"), "no orbit"),
        (lambda t: t.replace("G07 2022 01", "G07 2022 13"), "month must be in 1..12"),
        (lambda t: t.replace("-7.4000E-09", "-7.4???E-09"), "header: '-7.4"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, damage, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "bad.rnx"
    path.write_text(damage(_text(tmp_path)))
    with pytest.raises(InputFileError, match=message) as caught:
        read_nav(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gzip_whole_and_cut(tmp_path: Path) -> None:
    packed = gzip.compress(_text(tmp_path).encode())
    (tmp_path / "a.rnx.gz").write_bytes(packed)
    assert read_nav(tmp_path / "a.rnx.gz") == _NAV
    (tmp_path / "a.rnx.gz").write_bytes(packed[:-20])
    with pytest.raises(InputFileError, match="damaged gzip file"):
        read_nav(tmp_path / "a.rnx.gz")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="No such file"):
        read_nav(tmp_path / "none.rnx")
