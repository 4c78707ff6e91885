"""The screen: what stands in its lines and tables, and how often it changes."""

import io
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from deepgnss.cli.screen import (
    RunState,
    RunSummary,
    Screen,
    channel_table,
    position_line,
    summary_table,
    why_no_fix_table,
)
from deepgnss.core.frames import ecef
from deepgnss.core.records import ChannelReport, NavSolution, SatelliteOutcome
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.errors import Statistics


class Clock:
    """A clock that is set by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def channel(satellite: str, mode: str = "PLL") -> ChannelReport:
    return ChannelReport(
        satellite, "GPS_L1CA", "ephemeris", mode, 45.25, -1234.5, 0.97, 0.0, 12.5, 0.02, 7.0, 1.0
    )


def solution(valid: bool = True, lat: float = 52.0, lon: float = 10.5) -> NavSolution:
    return NavSolution(
        time=GpsTime(2290, 1.0),
        valid=valid,
        reason="" if valid else "3 satellites, 4 needed",
        r_e_m=ecef(math.radians(lat), math.radians(lon), 120.0),
        v_e_mps=np.array([3.0, 4.0, 0.0]),
        clock_s=0.0,
        drift_sps=0.0,
        isb_s={},
        covariance_m2=np.eye(4),
        velocity_covariance_m2ps2=np.eye(4),
        dops={"hdop": 1.25},
        used=("G01", "G02", "G03", "G04"),
        rejected={},
        residuals_m={},
        azimuth_elevation_rad={},
    )


def printed(renderable: object) -> str:
    console = Console(file=io.StringIO(), width=120)
    console.print(renderable)
    return console.file.getvalue()


def screen(terminal: bool) -> tuple[Screen, Clock, io.StringIO]:
    text, clock = io.StringIO(), Clock()
    console = Console(file=text, force_terminal=terminal, width=100)
    return Screen(console, clock), clock, text


def state(recording_s: float) -> RunState:
    return RunState(recording_s, 40.0, [channel("G05"), channel("G07", "FLL")], solution())


def test_position_line():
    assert position_line(None) == "no position yet"
    assert position_line(solution(valid=False)) == "no position: 3 satellites, 4 needed"
    assert position_line(solution()) == (
        "52.000000° N 10.500000° E 120.0 m, 5.0 m/s, 4 satellites, HDOP 1.2"
    )
    assert "33.500000° S 70.250000° W" in position_line(solution(lat=-33.5, lon=-70.25))


def test_plain_lines_come_every_few_seconds_only():
    shown, clock, text = screen(terminal=False)
    with shown:
        shown.phase("processing")
        for tick in range(1, 121):  # 12 s of wall time, twice as fast as real time
            clock.now = tick / 10.0
            shown.update(state(tick / 5.0))
    lines = text.getvalue().splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("processing: 2.0 of 40.0 s (5 %), 2.0 × real time; ")
    assert "channels: 1 FLL, 1 PLL; 52.000000° N" in lines[0]


def test_live_table_on_a_terminal():
    shown, clock, text = screen(terminal=True)
    with shown:
        shown.phase("scout pass")
        clock.now = 10.0
        shown.update(state(20.0))
        shown.note("a note")
    for part in (
        "scout pass",
        "G05",
        "-1234.5",
        "45.2",
        "0.97",
        "FLL",
        "2.0 × real time",
        "a note",
    ):
        assert part in text.getvalue()


def test_live_screen_is_left_when_a_run_fails():
    shown, _, text = screen(terminal=True)
    with pytest.raises(KeyboardInterrupt), shown:
        raise KeyboardInterrupt
    hide, show = "\x1b[?25l", "\x1b[?25h"
    assert text.getvalue().rindex(show) > text.getvalue().rindex(hide)  # the cursor is back


def test_channels_are_ordered_by_satellite():
    text = printed(channel_table([channel("G21"), channel("G03")]))
    assert text.index("G03") < text.index("G21")


def test_summary():
    text = printed(
        summary_table(
            RunSummary(40.0, {"scout pass": 4.0, "processing": 8.0}, 40, 38, 2.5, solution(), ())
        )
    )
    for part in ("38 of 40 (95.0 %)", "at 2.5 s", "10.0 × real time", "5.0 × real time", "nothing"):
        assert part in text


def test_summary_names_folder_files_picture_and_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = [tmp_path / "out" / "solution.csv", tmp_path / "out" / "overview.png"]
    error = Statistics("horizontal_m", 0.5, 0.1, 0.62, 0.4, 1.08, 2.0)
    text = printed(summary_table(RunSummary(40.0, {}, 40, 38, 2.5, solution(), files, error)))
    assert "0.62 m RMS, 95 % within 1.08 m" in text
    assert "solution.csv, overview.png" in text and "out/overview.png" in text
    assert str(tmp_path) not in text
    elsewhere = printed(summary_table(RunSummary(40.0, {}, 1, 0, None, None, [Path("/a/b.csv")])))
    assert "/a" in elsewhere and "horizontal" not in elsewhere and "to look at" not in elsewhere


def test_summary_of_an_empty_run():
    text = printed(summary_table(RunSummary(0.0, {"processing": 0.0}, 0, 0, None, None, ())))
    assert "0 of 0" in text and "no position yet" in text and "first fix" not in text


def test_why_no_fix_puts_the_furthest_first_and_gives_reasons():
    text = printed(
        why_no_fix_table(
            [
                SatelliteOutcome("G09", "GPS_L1CA", "searched", 3.1, None, 0, "no peak"),
                SatelliteOutcome("G22", "GPS_L1CA", "ephemeris", 20.0, 47.0, 0, "unhealthy"),
                SatelliteOutcome("G05", "GPS_L1CA", "used", 30.0, 48.0, 400, ""),
            ]
        )
    )
    assert text.index("G05") < text.index("G22") < text.index("G09")
    assert "unhealthy" in text and "no peak" in text and "3.1" in text and "400" in text
