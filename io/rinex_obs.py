"""Streaming writer of RINEX 3.05 observation files.

Signs (SPEC 1): carrier phase grows with range, in the same direction as the pseudorange; Doppler
is positive when range shrinks, dL/dt = −D. One receiver clock, that of the time tag, underlies
range and phase.

Loss of lock stands on phase only: bit 0 where cycles may have slipped since the last phase
written for the signal (also when the slip fell on an epoch without phase), bit 1 while the
polarity is unknown. The signal-strength digit min(max(⌊C/N0 / 6⌋, 1), 9) stands on phase, as in
the standard's own example (RINEX 3.05 5.7 and table A8); C/N0 itself is S.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deepgnss.core.records import (
    SIGNAL_IDS,
    Epoch,
    FloatArray,
    Observation,
    SignalId,
    UtcParameters,
)
from deepgnss.core.time import GpsTime
from deepgnss.io.output import OutputFile, Writer
from deepgnss.io.rinex import (
    PROGRAM,
    STATION,
    calendar,
    header_line,
    leap_seconds_line,
    long_name,
    program_line,
    version_line,
)

_BLANK = " " * 16
_SMALLEST, _LARGEST = -999_999_999.9994, 9_999_999_999.9994  # that F14.3 holds


@dataclass(frozen=True, slots=True)
class ObsHeader:
    """What the header says beyond the observations.

    position_e_m: approximate antenna position, (3,) ECEF, left out of the header when None (it
    is optional for a moving antenna). duration_s enters the file name, unless `name` is given.
    """

    signals: Sequence[SignalId]
    interval_s: float
    duration_s: float
    position_e_m: FloatArray | None = None
    utc: UtcParameters | None = None
    marker: str = "DGNS"
    marker_type: str = "GROUND_CRAFT"
    receiver_version: str = ""
    station: str = STATION
    name: str | None = None  # of the file; None: the long name of the standard


class RinexObsWriter(Writer):
    """Writes epochs as they come; the file is opened by the first one, which gives it its name."""

    def __init__(self, folder: Path, header: ObsHeader) -> None:
        self._folder = folder
        self._header = header
        self._systems = _by_system(header.signals)
        self._slipped: set[tuple[str, str]] = set()  # slips not yet told, for lack of phase

    def write(self, epoch: Epoch) -> None:
        """Append one epoch; observations of signals that the header does not name are left out."""
        satellites: dict[str, dict[str, Observation]] = {}
        for observation in epoch.observations:
            if observation.signal in self._systems.get(observation.satellite[0], {}):
                of_satellite = satellites.setdefault(observation.satellite, {})
                of_satellite[observation.signal] = observation
        if self._file is None:
            self._file = self._open(epoch.time)
        lines = [_epoch_line(epoch.time, len(satellites))]
        for satellite in sorted(satellites, key=lambda name: ("GC".index(name[0]), name)):
            fields = [
                self._signal_fields(satellites[satellite].get(signal), (satellite, signal))
                for signal in self._systems[satellite[0]]
            ]
            lines.append((satellite + "".join(fields)).rstrip() + "\n")
        self._file.write("".join(lines))

    def _signal_fields(self, observation: Observation | None, key: tuple[str, str]) -> str:
        if observation is None:
            return _BLANK * 4
        if observation.slip:
            self._slipped.add(key)
        phase = _BLANK
        if observation.carrier_valid and _fits(observation.carrier_cycles):
            loss = (key in self._slipped) + 2 * observation.half_cycle
            self._slipped.discard(key)
            phase = f"{observation.carrier_cycles:14.3f}{loss or ' '}{_strength(observation)}"
        return (
            _field(observation.pseudorange_m)
            + phase
            + _field(observation.doppler_hz)
            + _field(observation.cn0_dbhz)
        )

    def _open(self, first: GpsTime) -> OutputFile:
        h = self._header
        systems = "".join(self._systems)
        standard = long_name("O", systems, first, h.duration_s, h.interval_s, h.station)
        file = OutputFile(self._folder / (h.name or standard))
        file.write(_header_text(h, self._systems, first))
        return file


def _by_system(signals: Sequence[SignalId]) -> dict[str, dict[str, SignalId]]:
    """Signals by system letter (GPS first) and name, in RINEX order of their codes."""
    systems: dict[str, dict[str, SignalId]] = {}
    for signal in sorted(signals, key=lambda s: ("GC".index(s.system), s.rinex)):
        systems.setdefault(signal.system, {})[signal.name] = SIGNAL_IDS.get(signal.name, signal)
    return systems


def _header_text(h: ObsHeader, systems: dict[str, dict[str, SignalId]], first: GpsTime) -> str:
    c = calendar(first)
    start = f"{c.year:6d}{c.month:6d}{c.day:6d}{c.hour:6d}{c.minute:6d}{c.second:13.7f}     GPS"
    lines = [
        version_line("O", "".join(systems)),
        program_line(first),
        header_line(h.marker, "MARKER NAME"),
        header_line(h.marker_type, "MARKER TYPE"),
        header_line("", "OBSERVER / AGENCY"),
        header_line(f"{'':20}{PROGRAM:<20}{h.receiver_version:<20.20}", "REC # / TYPE / VERS"),
        header_line(f"{'':20}{'UNKNOWN':<20}", "ANT # / TYPE"),
    ]
    if h.position_e_m is not None:
        position = "".join(f"{x:14.4f}" for x in h.position_e_m)
        lines.append(header_line(position, "APPROX POSITION XYZ"))
    lines.append(header_line(f"{0.0:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N"))
    for system, signals in systems.items():
        types = [kind + signal.rinex for signal in signals.values() for kind in "CLDS"]
        for k in range(0, len(types), 13):
            start_of_line = f"{system}  {len(types):3d}" if k == 0 else " " * 6
            content = start_of_line + "".join(" " + code for code in types[k : k + 13])
            lines.append(header_line(content, "SYS / # / OBS TYPES"))
    lines.append(header_line("DBHZ", "SIGNAL STRENGTH UNIT"))
    lines.append(header_line(f"{h.interval_s:10.3f}", "INTERVAL"))
    lines.append(header_line(start, "TIME OF FIRST OBS"))
    lines.append(header_line(f"{0:6d}", "RCV CLOCK OFFS APPL"))
    for system, signals in systems.items():
        lines += [
            header_line(f"{system} L{signal.rinex} {0.0:8.5f}", "SYS / PHASE SHIFT")
            for signal in signals.values()
        ]
    lines.append(leap_seconds_line(first, h.utc))
    lines.append(header_line("", "END OF HEADER"))
    return "".join(lines)


def _epoch_line(time: GpsTime, satellites: int) -> str:
    c = calendar(time)
    date = f"{c.year:4d} {c.month:02d} {c.day:02d} {c.hour:02d} {c.minute:02d}{c.second:11.7f}"
    return f"> {date}  0{satellites:3d}\n"


def _fits(value: float) -> bool:
    return _SMALLEST < value < _LARGEST


def _field(value: float) -> str:
    return f"{value:14.3f}  " if _fits(value) else _BLANK


def _strength(observation: Observation) -> str:
    cn0 = observation.cn0_dbhz
    return str(min(max(int(cn0 / 6.0), 1), 9)) if math.isfinite(cn0) and cn0 > 0.0 else " "
