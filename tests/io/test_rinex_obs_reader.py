import warnings
from pathlib import Path

import georinex
import numpy as np
import pytest
from run_samples import NOON, epoch, observation
from yardstick import cost

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import GPS_L1CA
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.io.rinex_obs_reader import read_obs


def _head(lines: list[str], count: int) -> str:
    return "\n".join(lines[:count]) + "\n"


def _cut(path: Path, epochs: int, target: Path) -> Path:
    """Copy header and first epochs: georinex needs minutes for whole files."""
    lines = path.read_text(encoding="latin-1").splitlines()
    starts = [k for k, line in enumerate(lines) if line.startswith((">", " 05  4  2"))]
    target.write_text(_head(lines, starts[epochs]), encoding="latin-1")
    return target


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        (
            "real/gnss/rtklib-2005/07590920.05o",
            {"C1": "C1C", "L1": "L1C", "L2": "L2W", "P2": "C2W"},
        ),
        ("real/gnss/cssrlib-baseline/SEPT265G.21O", {c: c for c in ("C1C", "L1C", "S1C", "L5Q")}),
        ("real/gnss/snapper-ubx/w00_f9p.obs", {c: c for c in ("C1C", "D1C", "C2I", "L2I", "D2I")}),
    ],
)
def test_agrees_with_georinex(
    shared_data: Path, tmp_path: Path, name: str, codes: dict[str, str]
) -> None:
    path = _cut(shared_data / name, 6, tmp_path / Path(name).name)
    frame = read_obs(path).frame
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about defaults to come
        theirs = georinex.load(path)
    times = theirs["time"].to_numpy()
    week_s = (times - np.datetime64("1980-01-06")) / np.timedelta64(1, "s") - 604_800.0 * frame[
        "week"
    ][0]
    compared = 0
    for their_code, our_code in codes.items():
        ours = frame.pivot(index="tow_s", columns="satellite", values=our_code)
        np.testing.assert_allclose(ours.index.to_numpy(), week_s, atol=1e-6)
        for satellite in theirs["sv"].to_numpy():
            column = theirs[their_code].sel(sv=satellite).to_numpy()
            np.testing.assert_array_equal(ours[satellite].to_numpy(), column)
            compared += int(np.isfinite(column).sum())
    assert compared > 100


def test_loss_of_lock_and_header_of_rinex2(shared_data: Path) -> None:
    obs = read_obs(shared_data / "real/gnss/rtklib-2005/07590920.05o")
    assert obs.frame.shape[0] == 948
    assert obs.interval_s == 30.0
    assert obs.position_e_m is not None
    assert obs.position_e_m.tolist() == [-3976219.5082, 3382372.5671, 3652512.9849]
    first = obs.frame.iloc[0]
    assert (first["satellite"], first["L1C"], first["C1C"]) == ("G03", 55923622.160, 24767686.375)
    assert (first["L2W"], first["L2W_lli"]) == (43647388.242, 4)
    assert (first["week"], first["tow_s"]) == (1316, 518_400.0)


def test_hatanaka_and_gzip(shared_data: Path) -> None:
    pytest.importorskip("hatanaka", reason="the Hatanaka package is not installed")
    path = shared_data / "real/gnss/esbc-2020177/ESBC00DNK_R_20201770000_01D_30S_MO.crx.gz"
    frame = read_obs(path, systems="C").frame
    assert set(frame["satellite"].str[0]) == {"C"}
    assert frame["C2I"].between(2.0e7, 4.3e7).mean() > 0.98
    assert len(frame["tow_s"].unique()) == 2880


def test_twenty_thousand_lines_within_a_second(tmp_path: Path) -> None:
    """Rather in a tenth: the limit is 20 units of some 11 ms."""
    names = [f"G{prn:02d}" for prn in range(1, 11)]
    with RinexObsWriter(tmp_path, ObsHeader([GPS_L1CA], 1.0, 1900.0)) as writer:
        for k in range(1900):
            writer.write(
                epoch([observation(n, pseudorange_m=2e7 + k) for n in names], NOON.plus(k))
            )
    assert writer.path is not None
    assert len(writer.path.read_text().splitlines()) > 20_000
    path = writer.path
    assert cost(lambda: read_obs(path), 2) < 20.0
    frame = read_obs(path).frame
    assert frame["C1C"].to_numpy().reshape(1900, 10)[:, 3].tolist() == [
        2e7 + k for k in range(1900)
    ]


_HEADER = (
    "     3.02           OBSERVATION DATA    M                   RINEX VERSION / TYPE\n"
    "C    4 C1I L1I D1I S1I                                      SYS / # / OBS TYPES \n"
    "G    2 C1C L1C                                              SYS / # / OBS TYPES \n"
    "  2022     1     1    12     0   28.0000000     {system}         TIME OF FIRST OBS   \n"
    "                                                            END OF HEADER       \n"
)
_EPOCH = (
    "> 2022 01 01 12 00 28.0000000  0  2\n"
    "C21  21234567.891 5 111589123.45617         0.000          45.250\n"
    "G 5         0.000      -12345.678 3\n"
)


def _read(tmp_path: Path, text: str):  # type: ignore[no-untyped-def]
    path = tmp_path / "o.rnx"
    path.write_text(text)
    return read_obs(path)


def test_old_names_blanks_signs_and_zeros(tmp_path: Path) -> None:
    frame = _read(tmp_path, _HEADER.format(system="GPS") + _EPOCH).frame
    c, g = (frame.iloc[k] for k in (0, 1))
    assert (c["C2I"], c["L2I"], c["L2I_lli"], c["D2I"]) == (21234567.891, 111589123.456, 1, 0.0)
    assert (g["satellite"], g["L1C"]) == ("G05", -12345.678)
    assert np.isnan(g["C1C"])  # 0.000: missing
    assert np.isnan(g["C2I"])


def test_beidou_time_becomes_gpst(tmp_path: Path) -> None:
    frame = _read(tmp_path, _HEADER.format(system="BDT") + _EPOCH).frame
    assert frame["tow_s"].tolist() == [561_642.0] * 2


def test_events_are_passed_over(tmp_path: Path) -> None:
    event = (
        "> 2022 01 01 12 00 29.0000000  4  1\n"
        "a remark that is no observation                             COMMENT\n"
    )
    later = _EPOCH.replace("12 00 28", "12 00 30")
    frame = _read(tmp_path, _HEADER.format(system="GPS") + _EPOCH + event + later).frame
    assert frame["tow_s"].tolist() == [561_628.0] * 2 + [561_630.0] * 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_HEADER.format(system="GPS") + _EPOCH[:-40], "line 6: file ends within the epoch"),
        (
            _HEADER.format(system="GPS") + _EPOCH.replace("67.891", "6x.891"),
            "line 7: .* is not a number in F14.3",
        ),
        (_HEADER.format(system="GPS") + _EPOCH.replace("G 5 ", "G 5"), "line 8: .* in F14.3"),
        (_HEADER.format(system="GPS") + _EPOCH.replace("G 5", "R05"), "line 8: system 'R'"),
        (_HEADER.format(system="GPS") + _EPOCH.replace("G 5", "G?5"), "'G\\?5' is not a satellite"),
        (_HEADER.format(system="GPS") + _EPOCH[1:], "line 6: an epoch line"),
        (
            _HEADER.format(system="GPS") + _HEADER.format(system="GPS").replace("C1C", "C1P"),
            "two files glued together",
        ),
        (_HEADER.replace("SYS /", "???"), "no observation types"),
        (_EPOCH, "not a RINEX file"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputFileError, match=message) as caught:
        _read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_of_files_glued_together_the_later_counts(tmp_path: Path, shared_data: Path) -> None:
    whole = _HEADER.format(system="GPS") + _EPOCH
    frame = _read(tmp_path, whole + whole.replace("67.891", "68.891")).frame
    assert len(frame) == len(_read(tmp_path, whole).frame)
    assert frame["C2I"].iloc[0] == _read(tmp_path, whole).frame["C2I"].iloc[0] + 1.0
    # The first part of this recording of one chain is a copy of the other's.
    folder = shared_data / "real/gnss/jmfriedt-dualchain"
    first, second = (
        read_obs(folder / f"2m_gps_{chain}.25O").frame.set_index(["tow_s", "satellite"])["C1C"]
        for chain in (1, 2)
    )
    assert not first.index.duplicated().any()
    assert 1.5 < float((second - first).median()) < 2.3
