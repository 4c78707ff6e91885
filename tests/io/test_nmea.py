import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import ERR_RAISE, VALCKSUM, NMEAReader
from run_samples import NOON, epoch, no_solution, observation, solution

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Epoch, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.io.nmea import NmeaWriter, read_nmea

_BOTH = (GPS_L1CA, BDS_B1I)


def _write(path: Path, *pairs: tuple[NavSolution, Epoch], signals=(GPS_L1CA,)) -> Path:  # type: ignore[no-untyped-def]
    with NmeaWriter(path, signals) as writer:
        for fix, observed in pairs:
            writer.write(fix, observed)
    return path


def _parse(path: Path):  # type: ignore[no-untyped-def]
    with path.open("rb") as stream:
        reader = NMEAReader(stream, validate=VALCKSUM, quitonerror=ERR_RAISE)
        return [message for _, message in reader]


_GOLDEN = """\
$GPGGA,120010.00,4800.0000000,N,01130.0000000,E,1,04,1.10,512.250,M,0.0,M,,*64
$GPRMC,120010.00,A,4800.0000000,N,01130.0000000,E,9.719,53.13,010122,,,A,V*2B
$GPVTG,53.13,T,,M,9.719,N,18.000,K,A*36
$GPGSA,A,3,05,12,25,31,,,,,,,,,2.00,1.10,1.60,1*19
$GPGSV,2,1,05,05,57,006,45,12,29,000,,22,23,115,38,25,14,172,,1*63
$GPGSV,2,2,05,31,43,286,,1*58
$GPGST,120010.00,1.000,2.000,1.000,0.0,2.000,1.000,3.000*57
$GPZDA,120010.00,01,01,2022,00,00*66
"""


def test_golden(tmp_path: Path) -> None:
    observed = epoch([observation("G05"), observation("G22", cn0_dbhz=38.2)])
    path = _write(tmp_path / "a.nmea", (solution(), observed))
    assert path.read_bytes().decode() == _GOLDEN.replace("\n", "\r\n")


def test_pynmeagps_understands_every_sentence(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.nmea", (solution(), epoch([observation()])))
    by_kind = {m.msgID: m for m in _parse(path)}
    assert set(by_kind) == {"GGA", "RMC", "VTG", "GSA", "GSV", "GST", "ZDA"}
    gga, rmc, gst = by_kind["GGA"], by_kind["RMC"], by_kind["GST"]
    assert (gga.lat, gga.lon, gga.alt, gga.sep) == (48.0, 11.5, 512.25, 0.0)
    assert (gga.quality, gga.numSV, gga.HDOP) == (1, 4, 1.1)
    assert rmc.spd * 1852.0 / 3600.0 == pytest.approx(5.0, abs=5e-4)
    assert rmc.cog == pytest.approx(math.degrees(math.atan2(4.0, 3.0)), abs=0.006)
    assert f"{rmc.date} {rmc.time}" == "2022-01-01 12:00:10"
    assert by_kind["VTG"].sogk == pytest.approx(18.0, abs=5e-4)
    # σ north 2 m, east 1 m: the major axis points north.
    assert (gst.stdMajor, gst.stdMinor, gst.orient) == (2.0, 1.0, 0.0)
    assert (gst.stdLat, gst.stdLong, gst.stdAlt, gst.rangeRms) == (2.0, 1.0, 3.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "quality", "mode"),
    [
        ({"source": "gnss+ins"}, 1, "A"),
        ({"differential": True}, 2, "D"),
        ({"source": "ins", "differential": True, "used": (), "dops": {}}, 6, "E"),
    ],
)
def test_a_fix_says_what_it_is_made_of(
    changes: dict[str, Any], quality: int, mode: str, tmp_path: Path
) -> None:
    path = _write(tmp_path / "a.nmea", (replace(solution(), **changes), epoch([observation()])))
    by_kind = {m.msgID: m for m in _parse(path)}
    assert by_kind["GGA"].quality == quality
    assert (by_kind["RMC"].posMode, by_kind["VTG"].posMode) == (mode, mode)


def test_no_fix_says_so_and_still_lists_signals(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.nmea", (no_solution(), epoch([observation("G05")])))
    by_kind = {m.msgID: m for m in _parse(path)}
    assert (by_kind["GGA"].quality, by_kind["GGA"].lat) == (0, "")
    assert (by_kind["RMC"].status, by_kind["RMC"].posMode) == ("V", "N")
    assert by_kind["GSA"].navMode == 1
    assert (by_kind["GSV"].numSV, by_kind["GSV"].cno_01) == (1, 45)


def test_two_systems_have_their_talkers_and_ids(tmp_path: Path) -> None:
    fix = solution(used=("G05", "G12", "C21", "C22", "C59"))
    observed = epoch([observation("G05"), observation("C21", "BDS_B1I", cn0_dbhz=39.0)])
    messages = _parse(_write(tmp_path / "a.nmea", (fix, observed), signals=_BOTH))
    gsa = [m for m in messages if m.msgID == "GSA"]
    assert [(m.talker, m.systemId) for m in gsa] == [("GN", "1"), ("GN", "4")]
    assert [m.svid_01 for m in gsa] == [5, 21]
    gsv = [m for m in messages if m.msgID == "GSV"]
    assert {(m.talker, m.signalID) for m in gsv} == {("GP", "1"), ("GB", "1")}
    beidou = next(m for m in gsv if m.talker == "GB")
    assert (beidou.svid_01, beidou.cno_01) == (21, 39)
    assert {m.talker for m in messages if m.msgID in ("GGA", "RMC", "GST", "ZDA")} == {"GN"}


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    lat=st.floats(-89.99, 89.99),
    lon=st.floats(-179.999, 179.999),
    height=st.floats(-400.0, 9000.0),
    north=st.floats(-300.0, 300.0),
    east=st.floats(-300.0, 300.0),
    centiseconds=st.integers(0, 604_799_99),
)
def test_what_is_read_is_what_was_written(
    tmp_path_factory: pytest.TempPathFactory,
    lat: float,
    lon: float,
    height: float,
    north: float,
    east: float,
    centiseconds: int,
) -> None:
    path = tmp_path_factory.getbasetemp() / "round.nmea"
    time = GpsTime(2190, centiseconds / 100.0)
    fix = solution(lat, lon, height, (north, east, 0.0), time)
    log = read_nmea(_write(path, (fix, epoch([], time))))
    assert GpsTime(int(log.week[0]), float(log.tow_s[0])).since(time) == pytest.approx(
        0.0, abs=1e-6
    )
    assert math.degrees(log.lat_rad[0]) == pytest.approx(lat, abs=1e-8)
    assert math.degrees(log.lon_rad[0]) == pytest.approx(lon, abs=1e-8)
    assert log.height_m[0] == pytest.approx(height, abs=6e-4)
    assert log.speed_mps[0] == pytest.approx(math.hypot(north, east), abs=4e-4)
    if math.hypot(north, east) > 1.0:
        turn = log.course_rad[0] - math.atan2(east, north)
        assert math.remainder(turn, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-4)


def test_time_rounds_across_midnight(tmp_path: Path) -> None:
    just_before = GpsTime(2190, 18.0 - 0.004)  # 2021-12-25 23:59:59.996 UTC
    text = _write(tmp_path / "a.nmea", (solution(time=just_before), epoch([]))).read_text()
    assert "$GPRMC,000000.00,A" in text
    assert ",261221," in text


_LOG = b"""\
$BDGGA,235959.50,5130.0,N,00030.0,W,4,12,0.8,100.0,M,47.5,M,,*00
$BDRMC,235959.50,A,5130.0,N,00030.0,W,10.0,90.0,311221,,,A*00
garbage \xff\xfe line
$GNGGA,000000.00,5130.1,N,00030.0,W,1,07,0.9,101.0,M,47.5,M,,*00
$GNGGA,000000.50,,,,,0,00,,,M,,M,,*00
"""


def _with_checksums(log: bytes) -> bytes:
    lines = []
    for line in log.splitlines():
        if line.startswith(b"$"):
            body = line[1 : line.index(b"*")]
            line = b"$" + body + b"*%02X" % np.bitwise_xor.reduce(np.frombuffer(body, np.uint8))
        lines.append(line + b"\r\n")
    return b"".join(lines)


def test_log_of_another_receiver(tmp_path: Path) -> None:
    """BD talker, date from RMC carried over midnight, noise between, an epoch without fix."""
    path = tmp_path / "a.nmea"
    path.write_bytes(_with_checksums(_LOG))
    log = read_nmea(path)
    assert log.week.tolist() == [2190] * 3
    leap = 18.0
    start = 6 * 86_400.0 + leap  # Saturday 2022-01-01 00:00 UTC
    assert log.tow_s.tolist() == [start - 0.5, start, start + 0.5]
    assert log.height_m[:2].tolist() == [147.5, 148.5]
    assert log.quality.tolist() == [4, 1, 0]
    assert np.degrees(log.lon_rad[0]) == -0.5
    assert np.isnan(log.lat_rad[2])
    assert log.speed_mps[0] == pytest.approx(5.1444, abs=1e-4)


def test_reading_what_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    path.write_bytes(b"nothing of the kind\n" * 5)
    with pytest.raises(InputFileError, match="no NMEA position with a date"):
        read_nmea(path)
    with pytest.raises(InputFileError, match="No such file"):
        read_nmea(tmp_path / "none")


def test_time_tags_with_50_hz(tmp_path: Path) -> None:
    times = [NOON.plus(0.02 * k) for k in range(60)]
    path = _write(tmp_path / "a.nmea", *((solution(time=t), epoch([], t)) for t in times))
    log = read_nmea(path)
    assert np.diff(log.tow_s) == pytest.approx(0.02, abs=1e-6)
