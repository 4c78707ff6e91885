"""RINEX navigation files: read versions 2 and 3, write 3.05 (GPS LNAV, BeiDou D1/D2).

Why not georinex: it takes 15 s for a day of one station, gives neither leap seconds nor UTC
parameters, and stops at headers with several ionosphere sets. It is the cross-check in the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

from deepgnss.core.constants import BDT_MINUS_GPST_S, SECONDS_PER_WEEK
from deepgnss.core.errors import InputFileError, OutputError
from deepgnss.core.records import Ephemeris, Klobuchar, NavData, UtcParameters
from deepgnss.core.time import GpsTime, from_calendar, leap_seconds_at
from deepgnss.io.output import write_whole
from deepgnss.io.rinex import (
    HeaderLine,
    calendar,
    header_line,
    leap_seconds_line,
    program_line,
    read_header,
    read_text,
    version_line,
)

BDT_WEEK_OFFSET = 1356
"""GPS week of BeiDou week 0."""

_GPST_MINUS_SYSTEM_S = {"G": 0.0, "C": -BDT_MINUS_GPST_S}
_WEEK_OFFSET = {"G": 0, "C": BDT_WEEK_OFFSET}
_RECORD_LINES = 8
_UNKNOWN_TRANSMISSION_S = 9.0e8  # 0.9999E9 stands for an unknown transmission time

# Places in a record (RINEX 3.05 tables A6, A14), counted from af0; the rest may be blank.
_ORBIT = range(3, 20)
_AF, _TOE, _TRANSMISSION = slice(0, 3), 11, 27


# --- reading -------------------------------------------------------------------------------------


def read_nav(path: Path | str) -> NavData:
    """Read GPS and BeiDou ephemerides, ionosphere and UTC of a RINEX 2 or 3 file (plain or .gz).

    Records of other systems are skipped, repeated ones are given once; BeiDou times become GPST.
    All-zero ionosphere sets (written by receivers that decoded none) count as absent.

    Raises
    ------
    InputFileError: the file is missing, damaged or no navigation file; names file, line, cause.
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    version, header = read_header(path, lines, "N")
    if version < 3.0 and "GLONASS" in header[0].content:
        raise InputFileError(f"{path}: GLONASS navigation file: GPS or BeiDou is needed")
    ephemerides = _read_records(path, lines, len(header), version)
    try:
        klobuchar = _klobuchar(header)
        utc = _utc(header, ephemerides)
    except ValueError as error:
        raise InputFileError(f"{path}: header: {error}") from error
    return NavData(ephemerides=ephemerides, klobuchar=klobuchar, utc=utc)


def _read_records(
    path: Path, lines: list[str], first: int, version: float
) -> dict[str, tuple[Ephemeris, ...]]:
    found: dict[tuple[str, GpsTime, GpsTime, int, int], Ephemeris] = {}
    number = first
    while number < len(lines):
        line = lines[number]
        if line[60:].strip() == "RINEX VERSION / TYPE":  # GNSS-SDR appends file to file
            number += len(read_header(path, lines[number:], "N")[1])
            continue
        if version >= 3.0 and line[:1] not in _GPST_MINUS_SYSTEM_S:
            number += 1  # other systems, with whatever number of lines they have, and blank lines
            continue
        if not line.strip():
            number += 1
            continue
        record = lines[number : number + _RECORD_LINES]
        try:
            ephemeris = _read_record(record, version)
        except ValueError as error:
            raise InputFileError(f"{path}: line {number + 1}: {error}") from error
        key = (ephemeris.satellite, ephemeris.toe, ephemeris.toc, ephemeris.iode, ephemeris.health)
        # The same message collected by several stations: keep its earliest transmission.
        kept = found.get(key)
        if kept is None or ephemeris.transmitted < kept.transmitted:
            found[key] = ephemeris
        number += _RECORD_LINES
    by_satellite: dict[str, list[Ephemeris]] = {}
    for ephemeris in found.values():
        by_satellite.setdefault(ephemeris.satellite, []).append(ephemeris)
    return {
        satellite: tuple(sorted(by_satellite[satellite], key=lambda e: (e.toe, e.transmitted)))
        for satellite in sorted(by_satellite)
    }


def _read_record(record: list[str], version: float) -> Ephemeris:
    if len(record) < _RECORD_LINES:
        raise ValueError(f"file ends within the record of '{record[0][:23].strip()}'")
    if version < 3.0:
        satellite, clock, margin = f"G{int(record[0][:2]):02d}", 22, 3
        date = record[0][2:clock].split()
    else:
        satellite, clock, margin = f"{record[0][0]}{int(record[0][1:3]):02d}", 23, 4
        date = record[0][3:clock].split()
    values = _numbers(record[0], clock, 3)
    for line in record[1:]:
        values += _numbers(line, margin, 4)
    if any(values[place] is None for place in (*range(0, 3), *_ORBIT)):
        raise ValueError(f"a field of the {satellite} record is blank")
    return _ephemeris(satellite, _toc(date), [value or 0.0 for value in values])


def _numbers(line: str, start: int, count: int) -> list[float | None]:
    fields = (line[start + 19 * k : start + 19 * (k + 1)].strip() for k in range(count))
    return [_number(field) if field else None for field in fields]


def _number(field: str) -> float:
    try:
        value = float(field.replace("D", "E").replace("d", "e"))
    except ValueError:
        raise ValueError(f"'{field}' is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"'{field}' is not a finite number")
    return value


def _toc(date: list[str]) -> GpsTime:
    if len(date) != 6:
        raise ValueError(f"'{' '.join(date)}' is not a date")
    year, month, day, hour, minute = (int(field) for field in date[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    return from_calendar(datetime(year, month, day, hour, minute)).plus(float(date[5]))


def _near(tow_s: float, reference: GpsTime) -> GpsTime:
    """Return the instant with this second of week nearest to the reference."""
    week = reference.week + round((reference.tow_s - tow_s) / SECONDS_PER_WEEK)
    return GpsTime(week, 0.0).plus(tow_s)


def _ephemeris(satellite: str, toc: GpsTime, v: list[float]) -> Ephemeris:
    # The week stands in the file too, but rolled over or off by one in some: toc decides.
    system = satellite[0]
    sent_s = v[_TRANSMISSION]
    toe = _near(v[_TOE], toc)
    sent = toc if abs(sent_s) > _UNKNOWN_TRANSMISSION_S else _near(sent_s, toc)
    shift_s = _GPST_MINUS_SYSTEM_S[system]
    if not (v[10] > 0.0 and 0.0 <= v[8] < 1.0):
        raise ValueError(f"{satellite}: no orbit (√A {v[10]:g} √m, eccentricity {v[8]:g})")
    gps = system == "G"
    return Ephemeris(
        satellite=satellite,
        toe=toe.plus(shift_s),
        toc=toc.plus(shift_s),
        transmitted=sent.plus(shift_s),
        iode=int(v[3]),
        iodc=int(v[26]) if gps else int(v[28]),
        af0_s=v[0],
        af1_sps=v[1],
        af2_sps2=v[2],
        group_delay_s=v[25],
        sqrt_a_rm=v[10],
        eccentricity=v[8],
        m0_rad=v[6],
        delta_n_radps=v[5],
        omega0_rad=v[13],
        omega_rad=v[17],
        omega_dot_radps=v[18],
        i0_rad=v[15],
        idot_radps=v[19],
        cuc_rad=v[7],
        cus_rad=v[9],
        crc_m=v[16],
        crs_m=v[4],
        cic_rad=v[12],
        cis_rad=v[14],
        health=int(v[24]),
        accuracy_m=v[23],
        fit_hours=_fit_hours(v[28]) if gps else 4.0,
        group_delay2_s=0.0 if gps else v[26],
    )


def _fit_hours(field: float) -> float:
    """Fit interval; some programs write the message's flag (0: 4 h, 1: longer) instead of hours."""
    return {0.0: 4.0, 1.0: 6.0}.get(field, field)


def _klobuchar(header: list[HeaderLine]) -> dict[str, Klobuchar]:
    halves: dict[str, tuple[float, float, float, float]] = {}
    for content, label in header:
        if label in ("ION ALPHA", "ION BETA"):
            key, start = ("GPSA" if label == "ION ALPHA" else "GPSB"), 2
        elif label == "IONOSPHERIC CORR" and content[:4] in ("GPSA", "GPSB", "BDSA", "BDSB"):
            key, start = content[:4], 5
        else:
            continue
        if key not in halves:  # of several sets (BeiDou: one per hour) the first
            a, b, c, d = (
                _number(content[start + 12 * k : start + 12 * (k + 1)].strip()) for k in range(4)
            )
            halves[key] = (a, b, c, d)
    sets = {}
    for letter, name in (("G", "GPS"), ("C", "BDS")):
        alpha, beta = halves.get(name + "A"), halves.get(name + "B")
        if alpha and beta and any(alpha + beta):
            sets[letter] = Klobuchar(alpha, beta)
    return sets


def _utc(
    header: list[HeaderLine], ephemerides: Mapping[str, tuple[Ephemeris, ...]]
) -> UtcParameters | None:
    polynomial: tuple[float, float, float, int] | None = None
    leaps: list[int] = []
    for content, label in header:
        if label == "DELTA-UTC: A0,A1,T,W":
            parts = (content[3:22], content[22:41], content[41:50], content[50:59])
        elif label == "TIME SYSTEM CORR" and content[:4] == "GPUT":
            parts = (content[5:22], content[22:38], content[38:45], content[45:50])
        else:
            if label == "LEAP SECONDS" and content[24:27] != "BDS":
                leaps = [
                    int(content[k : k + 6]) for k in range(0, 24, 6) if content[k : k + 6].strip()
                ]
            continue
        a0, a1, tot, week = (_number(field.strip()) for field in parts)
        polynomial = (a0, a1, tot, int(week))
    some = next((e for records in ephemerides.values() for e in records), None)
    if some is None or (polynomial is None and not any(leaps)):
        return None
    a0, a1, tot, week = polynomial or (0.0, 0.0, some.toc.tow_s, some.toc.week)
    if not any(leaps):  # absent, or zeros of a receiver that had not decoded them
        leaps = [leap_seconds_at(some.toc.utc(0))]
    leap_s, future_s, leap_week, leap_day = (leaps + [leaps[0], 0, 0][len(leaps) - 1 :])[:4]
    # T and W name an instant; W may be rolled over (or mean nothing): nearest to the ephemerides.
    reference = GpsTime(week, 0.0).plus(tot)
    if abs(reference.since(some.toc)) > 64 * SECONDS_PER_WEEK:
        reference = _near(tot, some.toc)
    return UtcParameters(a0, a1, reference, leap_s, future_s, leap_week, leap_day)


# --- writing -------------------------------------------------------------------------------------


def write_nav(path: Path | str, nav: NavData) -> None:
    """Write a RINEX 3.05 navigation file; records ordered by satellite and time.

    Raises
    ------
    OutputError: the file cannot be written, or there is no ephemeris to write.
    """
    path = Path(path)
    records = [e for satellite in sorted(nav.ephemerides) for e in nav.ephemerides[satellite]]
    if not records:
        raise OutputError(f"{path}: no ephemeris to write")
    systems = "".join(sorted({e.satellite[0] for e in records}, key="GC".index))
    latest = max(e.transmitted for e in records)
    text = [version_line("N", systems), program_line(latest)]
    for letter, name in (("G", "GPS"), ("C", "BDS")):
        if letter in nav.klobuchar:
            for half, values in zip("AB", nav.klobuchar[letter], strict=True):
                content = f"{name}{half} " + "".join(f"{value:12.4E}" for value in values)
                text.append(header_line(content, "IONOSPHERIC CORR"))
    if nav.utc is not None:
        utc = nav.utc
        content = (
            f"GPUT {utc.a0_s:17.10E}{utc.a1_sps:16.9E}"
            f" {utc.reference.tow_s:6.0f} {utc.reference.week:4d}"
        )
        text.append(header_line(content, "TIME SYSTEM CORR"))
    text.append(leap_seconds_line(latest, nav.utc))
    text.append(header_line("", "END OF HEADER"))
    text.extend(_RECORD_WRITERS[e.satellite[0]](e) for e in records)
    write_whole(path, "".join(text))


def _gps_record(e: Ephemeris) -> str:
    sent_s = e.transmitted.since(GpsTime(e.toe.week, 0.0))
    return _record(
        e,
        (e.idot_radps, 1.0, float(e.toe.week), 0.0),
        (e.accuracy_m, float(e.health), e.group_delay_s, float(e.iodc)),
        (sent_s, e.fit_hours),
    )


def _bds_record(e: Ephemeris) -> str:
    toe = e.toe.plus(BDT_MINUS_GPST_S)
    sent_s = e.transmitted.plus(BDT_MINUS_GPST_S).since(GpsTime(toe.week, 0.0))
    return _record(
        e,
        (e.idot_radps, 0.0, float(toe.week - BDT_WEEK_OFFSET), 0.0),
        (e.accuracy_m, float(e.health), e.group_delay_s, e.group_delay2_s),
        (sent_s, float(e.iodc)),
    )


_RECORD_WRITERS: Mapping[str, Callable[[Ephemeris], str]] = {"G": _gps_record, "C": _bds_record}


def _record(e: Ephemeris, *last: tuple[float, ...]) -> str:
    shift_s = _GPST_MINUS_SYSTEM_S[e.satellite[0]]
    toc = calendar(e.toc.plus(-shift_s))
    toe_s = e.toe.plus(-shift_s).tow_s
    date = (
        f"{e.satellite} {toc.year:4d} {toc.month:02d} {toc.day:02d}"
        f" {toc.hour:02d} {toc.minute:02d} {round(toc.second):02d}"
    )
    lines = [
        (float(e.iode), e.crs_m, e.delta_n_radps, e.m0_rad),
        (e.cuc_rad, e.eccentricity, e.cus_rad, e.sqrt_a_rm),
        (toe_s, e.cic_rad, e.omega0_rad, e.cis_rad),
        (e.i0_rad, e.crc_m, e.omega_rad, e.omega_dot_radps),
        *last,
    ]
    text = [date + _fields((e.af0_s, e.af1_sps, e.af2_sps2))]
    text += ["    " + _fields(values) for values in lines]
    return "".join(line + "\n" for line in text)


def _fields(values: tuple[float, ...]) -> str:
    # An exponent of three digits would not fit; no broadcast field resolves 1e-99.
    return "".join(f"{value if abs(value) > 1e-99 else 0.0:19.12E}" for value in values)
