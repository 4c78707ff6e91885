"""NMEA 0183 version 4.11: writer of fixes and satellites, reader of logs.

The file carries no geoid: the altitude of GGA is the height above the ellipsoid and the geoid
separation is 0.0, so that their sum, which readers take, is the ellipsoidal height.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from datetime import time as time_of_day
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pynmeagps import ERR_IGNORE, NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError

from deepgnss.core.errors import InputFileError
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import Epoch, FloatArray, NavSolution, SignalId
from deepgnss.core.time import from_utc
from deepgnss.io.output import OutputFile, Writer

_MPS_PER_KNOT = 1852.0 / 3600.0
_TALKERS = {"G": "GP", "C": "GB"}
_SYSTEM_IDS = {"G": "1", "C": "4"}  # NMEA 4.11 table 19
_SIGNAL_IDS = {"GPS_L1CA": "1", "BDS_B1I": "1"}
_QUALITIES = {"A": "1", "D": "2", "E": "6"}  # of GGA, by mode indicator
_GSA_PLACES = 12
_GSV_PLACES = 4


# --- writing -------------------------------------------------------------------------------------


class NmeaWriter(Writer):
    """Writes GGA, RMC, VTG, GST, ZDA, a GSA per system and GSVs per signal at every epoch.

    Parameters
    ----------
    signals: those the receiver processes; with one system its own talker is used, else GN.
    leap_seconds: GPST − UTC as broadcast; None: from the table.
    """

    def __init__(
        self, path: Path, signals: Sequence[SignalId], leap_seconds: int | None = None
    ) -> None:
        self._file = OutputFile(path)
        self._signals = sorted(signals, key=lambda s: ("GC".index(s.system), s.rinex))
        self._systems = list(dict.fromkeys(s.system for s in self._signals))
        self._talker = _TALKERS[self._systems[0]] if len(self._systems) == 1 else "GN"
        self._leap_seconds = leap_seconds

    def write(self, solution: NavSolution, epoch: Epoch) -> None:
        """Append the sentences of one epoch, with or without a fix."""
        utc = solution.time.utc(self._leap_seconds) + timedelta(milliseconds=5)  # to nearest 10 ms
        clock = f"{utc:%H%M%S}.{utc.microsecond // 10_000:02d}"
        talker = self._talker
        sentences = [
            _sentence(f"{talker}GGA", _gga(solution, clock)),
            _sentence(f"{talker}RMC", _rmc(solution, clock, f"{utc:%d%m%y}")),
            _sentence(f"{talker}VTG", _vtg(solution)),
            *(_sentence(f"{talker}GSA", fields) for fields in self._gsa(solution)),
            *self._gsv(solution, epoch),
            _sentence(f"{talker}GST", _gst(solution, clock)),
            _sentence(f"{talker}ZDA", [clock, f"{utc:%d}", f"{utc:%m}", f"{utc:%Y}", "00", "00"]),
        ]
        if self._file is not None:
            self._file.write("".join(sentences))

    def _gsa(self, solution: NavSolution) -> Iterable[list[str]]:
        dops = [_dop(solution, name) for name in ("pdop", "hdop", "vdop")]
        mode = "3" if solution.valid else "1"
        for system in self._systems:
            used = sorted(name for name in solution.used if name[0] == system)[:_GSA_PLACES]
            places = [name[1:] for name in used] + [""] * (_GSA_PLACES - len(used))
            yield ["A", mode, *places, *dops, _SYSTEM_IDS[system]]

    def _gsv(self, solution: NavSolution, epoch: Epoch) -> Iterable[str]:
        cn0 = {(o.satellite, o.signal): o.cn0_dbhz for o in epoch.observations}
        for signal in self._signals:
            in_view = sorted(
                {name for name, _ in cn0 if name[0] == signal.system}
                | {
                    name
                    for name, (_, elevation) in solution.azimuth_elevation_rad.items()
                    if name[0] == signal.system and elevation > 0.0
                }
            )
            blocks = [
                _gsv_satellite(name, solution, cn0.get((name, signal.name))) for name in in_view
            ]
            messages = max(1, -(-len(blocks) // _GSV_PLACES))
            for k in range(messages):
                group = blocks[_GSV_PLACES * k : _GSV_PLACES * (k + 1)]
                fields = [str(messages), str(k + 1), f"{len(blocks):02d}"]
                fields += [field for block in group for field in block]
                fields.append(_SIGNAL_IDS[signal.name])
                yield _sentence(f"{_TALKERS[signal.system]}GSV", fields)


def _sentence(name: str, fields: Sequence[str]) -> str:
    body = ",".join((name, *fields))
    checksum = reduce(lambda total, byte: total ^ byte, body.encode("ascii"), 0)
    return f"${body}*{checksum:02X}\r\n"


def _gga(s: NavSolution, clock: str) -> list[str]:
    if not s.valid:
        return [clock, "", "", "", "", "0", "00", "", "", "M", "", "M", "", ""]
    lat, lon, height_m = geodetic(s.r_e_m)
    place = [*_latitude(lat), *_longitude(lon)]
    used = f"{len(s.used):02d}"
    return [
        *(clock, *place, _QUALITIES[_mode(s)], used, _dop(s, "hdop")),
        *(f"{height_m:.3f}", "M", "0.0", "M", "", ""),
    ]


def _rmc(s: NavSolution, clock: str, date: str) -> list[str]:
    if not s.valid:
        return [clock, "V", "", "", "", "", "", "", date, "", "", "N", "V"]
    lat, lon, _ = geodetic(s.r_e_m)
    speed_mps, course_deg = _speed_course(s)
    place = [*_latitude(lat), *_longitude(lon)]
    motion = [f"{speed_mps / _MPS_PER_KNOT:.3f}", f"{course_deg:.2f}"]
    # Navigational status V: this equipment gives no integrity indication (4.11).
    return [clock, "A", *place, *motion, date, "", "", _mode(s), "V"]


def _vtg(s: NavSolution) -> list[str]:
    if not s.valid:
        return ["", "T", "", "M", "", "N", "", "K", "N"]
    speed_mps, course_deg = _speed_course(s)
    knots, kmh = f"{speed_mps / _MPS_PER_KNOT:.3f}", f"{speed_mps * 3.6:.3f}"
    return [f"{course_deg:.2f}", "T", "", "M", knots, "N", kmh, "K", _mode(s)]


def _mode(s: NavSolution) -> str:
    """Mode indicator: autonomous, differential, or estimated: by dead reckoning alone."""
    return "E" if s.source == "ins" else "D" if s.differential else "A"


def _gst(s: NavSolution, clock: str) -> list[str]:
    if not s.valid:
        return [clock, *[""] * 7]
    lat, lon, _ = geodetic(s.r_e_m)
    to_n = C_ne(lat, lon)
    covariance = to_n @ s.covariance_m2[:3, :3] @ to_n.T
    variances, axes = np.linalg.eigh(covariance[:2, :2])  # ascending
    minor_m, major_m = np.sqrt(np.maximum(variances, 0.0))
    # Bearing of the semi-major axis from north, an axis and not a direction: modulo 180°.
    orientation_deg = math.degrees(math.atan2(axes[1, 1], axes[0, 1])) % 180.0
    used = [s.residuals_m[name] for name in s.used if name in s.residuals_m]
    rms = f"{math.sqrt(sum(r * r for r in used) / len(used)):.3f}" if used else ""
    sigmas = (f"{math.sqrt(max(covariance[k, k], 0.0)):.3f}" for k in range(3))
    return [clock, rms, f"{major_m:.3f}", f"{minor_m:.3f}", f"{orientation_deg:.1f}", *sigmas]


def _gsv_satellite(name: str, solution: NavSolution, cn0_dbhz: float | None) -> list[str]:
    strength = "" if cn0_dbhz is None or not math.isfinite(cn0_dbhz) else f"{cn0_dbhz:02.0f}"
    if name not in solution.azimuth_elevation_rad:
        return [name[1:], "", "", strength]
    azimuth, elevation = (math.degrees(x) for x in solution.azimuth_elevation_rad[name])
    return [name[1:], f"{elevation:02.0f}", f"{round(azimuth) % 360:03d}", strength]


def _dop(solution: NavSolution, name: str) -> str:
    value = solution.dops.get(name)
    return f"{value:.2f}" if value is not None and math.isfinite(value) else ""


def _speed_course(solution: NavSolution) -> tuple[float, float]:
    lat, lon, _ = geodetic(solution.r_e_m)
    north, east, _ = C_ne(lat, lon) @ solution.v_e_mps
    course_deg = round(math.degrees(math.atan2(east, north)) % 360.0, 2) % 360.0
    return math.hypot(north, east), course_deg


def _latitude(lat_rad: float) -> tuple[str, str]:
    return _degrees_minutes(lat_rad, 2), "N" if lat_rad >= 0.0 else "S"


def _longitude(lon_rad: float) -> tuple[str, str]:
    return _degrees_minutes(lon_rad, 3), "E" if lon_rad >= 0.0 else "W"


def _degrees_minutes(angle_rad: float, width: int) -> str:
    # In whole 1e-7 minutes (0.2 mm), so that rounding never writes 60 minutes.
    units = round(abs(math.degrees(angle_rad)) * 60 * 10**7)
    degrees, rest = divmod(units, 60 * 10**7)
    return f"{degrees:0{width}d}{rest // 10**7:02d}.{rest % 10**7:07d}"


# --- reading -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class NmeaLog:
    """Epochs of an NMEA log that have a date; arrays of one length.

    Height is above the ellipsoid (altitude + geoid separation). No fix: position is NaN.
    """

    week: NDArray[np.int64]
    tow_s: FloatArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    height_m: FloatArray
    quality: NDArray[np.int64]  # of GGA: 0 none, 1 autonomous, 2 differential, 4, 5 RTK, 6 dead
    used: NDArray[np.int64]
    speed_mps: FloatArray
    course_rad: FloatArray


_NOT_NMEA = (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError)


def read_nmea(path: Path | str) -> NmeaLog:
    """Read GGA, RMC and ZDA of any talker (GN, GP, GB, BD …); broken sentences are passed over.

    Raises
    ------
    InputFileError: the file cannot be read, or holds no dated position sentence.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            messages = [
                message
                for _, message in NMEAReader(stream, quitonerror=ERR_IGNORE)
                if getattr(message, "msgID", "") in ("GGA", "RMC", "ZDA")
            ]
    except OSError as error:
        raise InputFileError(f"{path}: cannot read: {error.strerror}") from error
    except _NOT_NMEA as error:
        raise InputFileError(f"{path}: not NMEA: {error}") from error
    rows = _rows(messages)
    if not rows:
        raise InputFileError(f"{path}: no NMEA position with a date (GGA with RMC or ZDA)")
    instants = [from_utc(instant) for instant, _ in rows]
    column = {name: np.array([row.get(name, np.nan) for _, row in rows]) for name in _COLUMNS}
    return NmeaLog(
        week=np.array([t.week for t in instants], dtype=np.int64),
        tow_s=np.array([t.tow_s for t in instants]),
        lat_rad=np.radians(column["lat"]),
        lon_rad=np.radians(column["lon"]),
        height_m=column["height"],
        quality=np.nan_to_num(column["quality"]).astype(np.int64),
        used=np.nan_to_num(column["used"]).astype(np.int64),
        speed_mps=column["speed"] * _MPS_PER_KNOT,
        course_rad=np.radians(column["course"]),
    )


_COLUMNS = ("lat", "lon", "height", "quality", "used", "speed", "course")


def _rows(messages: Iterable[Any]) -> list[tuple[datetime, dict[str, float]]]:
    """One row per time of day; its date is that of its RMC or ZDA, or else of the last one."""
    rows: list[tuple[datetime | None, time_of_day, dict[str, float]]] = []
    for message in messages:
        clock = message.time
        if not isinstance(clock, time_of_day):
            continue
        if not rows or rows[-1][1] != clock:
            before = rows[-1] if rows else None
            date = _day_after(before[0], before[1], clock) if before else None
            rows.append((date, clock, {}))
        date, _, row = rows[-1]
        if message.msgID == "RMC" and message.date:
            date = datetime.combine(message.date, clock)
        elif message.msgID == "ZDA" and message.year:
            date = datetime(message.year, message.month, message.day) + (
                datetime.combine(datetime.min, clock) - datetime.min
            )
        row.update(_values(message))
        rows[-1] = (date, clock, row)
    return [(date, row) for date, _, row in rows if date is not None]


def _day_after(date: datetime | None, before: time_of_day, clock: time_of_day) -> datetime | None:
    if date is None:
        return None
    days = 1 if (before.hour, clock.hour) == (23, 0) else 0
    return datetime.combine(date.date() + timedelta(days=days), clock)


def _values(message: Any) -> dict[str, float]:
    if message.msgID == "GGA":
        numbers = {
            "quality": _float(message.quality),
            "used": _float(message.numSV),
            "lat": _float(message.lat),
            "lon": _float(message.lon),
            "height": _float(message.alt) + (0.0 if message.sep in ("", None) else message.sep),
        }
    elif message.msgID == "RMC":
        numbers = {
            "lat": _float(message.lat),
            "lon": _float(message.lon),
            "speed": _float(message.spd),
            "course": _float(message.cog),
        }
    else:
        numbers = {}
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


def _float(value: Any) -> float:
    return float(value) if value not in ("", None) else math.nan
