"""What a run shows: channels and position while it goes, tables at its end.

On a terminal a live table; elsewhere a plain line every few seconds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from deepgnss.core.frames import geodetic
from deepgnss.core.records import STAGES, ChannelReport, NavSolution, SatelliteOutcome

if TYPE_CHECKING:  # pandas, which it needs, takes half a second to load
    from deepgnss.evaluate.errors import Statistics

_MODE_STYLE = {
    "PLL": "green",
    "FLL": "yellow",
    "FFT": "yellow",
    "pull-in": "cyan",
    "hold": "magenta",
    "lost": "red",
}
_LIVE_EVERY_S = 0.25
_PLAIN_EVERY_S = 5.0


class RunState(NamedTuple):
    """What there is to show after an epoch."""

    recording_s: float  # processed so far
    total_s: float  # of the whole recording
    channels: Sequence[ChannelReport]
    solution: NavSolution | None


class RunSummary(NamedTuple):
    """What the end of a run tells."""

    recording_s: float
    stages_s: Mapping[str, float]  # wall time of each stage of the work
    epochs: int  # output instants
    fixed: int  # of them with a valid position
    first_fix_s: float | None  # of recording
    last: NavSolution | None  # last valid one
    files: Sequence[Path]
    horizontal: Statistics | None = None  # error against truth, where there is one
    inertial: str = ""  # how the inertial navigation fared


class Screen:
    """Progress of one run; use it in a `with` statement.

    Parameters: where to print; a clock in s (for tests). Nothing runs in the background: the
    screen changes in `update` only, and there no more often than it can be read.
    """

    def __init__(
        self, console: Console | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.console = console or Console(stderr=True)
        self._clock = clock
        self._live: Live | None = None
        self._phase = ""
        self._phase_began = self._drawn = clock()
        self._state: RunState | None = None

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live = Live(console=self.console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live:
            self._live.stop()
            self._live = None

    def phase(self, name: str) -> None:
        """Begin a stage of the work, such as "scout pass"; × real time counts from here."""
        self._phase, self._phase_began, self._state = name, self._clock(), None
        # the first line comes soon, the next ones at leisure
        self._drawn = self._phase_began - _PLAIN_EVERY_S + 1.0

    def note(self, line: str) -> None:
        """Print a line that stays."""
        self.console.print(Text(line), soft_wrap=True)

    def update(self, state: RunState) -> None:
        """Show the state after an epoch."""
        self._state = state
        now = self._clock()
        if now - self._drawn < (_LIVE_EVERY_S if self._live else _PLAIN_EVERY_S):
            return
        self._drawn = now
        speed = state.recording_s / max(now - self._phase_began, 1e-9)
        if self._live:
            head = Text(f"{self._phase}  {_progress(state)}  {speed:.1f} × real time")
            place = Text(position_line(state.solution))
            self._live.update(Group(head, channel_table(state.channels), place), refresh=True)
        else:
            self.note(plain_line(self._phase, state, speed))


def _progress(state: RunState) -> str:
    share = 100.0 * state.recording_s / state.total_s if state.total_s > 0.0 else 0.0
    return f"{state.recording_s:.1f} of {state.total_s:.1f} s ({share:.0f} %)"


def plain_line(phase: str, state: RunState, speed: float) -> str:
    """Return one line on a run: progress, speed, channels, position."""
    modes: dict[str, int] = {}
    for channel in state.channels:
        modes[channel.mode] = modes.get(channel.mode, 0) + 1
    counted = ", ".join(f"{count} {mode}" for mode, count in sorted(modes.items())) or "none"
    return (
        f"{phase}: {_progress(state)}, {speed:.1f} × real time; channels: {counted}; "
        f"{position_line(state.solution)}"
    )


def position_line(solution: NavSolution | None) -> str:
    """Return place, speed and geometry of a solution, or why there is none."""
    if solution is None:
        return "no position yet"
    if not solution.valid:
        return f"no position: {solution.reason}"
    lat, lon, height_m = geodetic(solution.r_e_m)
    north, east = "N" if lat >= 0.0 else "S", "E" if lon >= 0.0 else "W"
    speed_mps = math.sqrt(sum(float(v) ** 2 for v in solution.v_e_mps))
    return (
        f"{abs(math.degrees(lat)):.6f}° {north} {abs(math.degrees(lon)):.6f}° {east} "
        f"{height_m:.1f} m, {speed_mps:.1f} m/s, {len(solution.used)} satellites, "
        f"HDOP {solution.dops.get('hdop', math.nan):.1f}"
    )


def channel_table(channels: Sequence[ChannelReport]) -> Table:
    """Return the table of channels, by satellite."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("sat")
    table.add_column("mode")
    table.add_column("stage")
    for name in ("C/N0 dB-Hz", "Doppler Hz", "lock", "for s"):
        table.add_column(name, justify="right")
    for channel in sorted(channels, key=lambda c: (c.satellite, c.signal)):
        table.add_row(
            channel.satellite,
            Text(channel.mode, style=_MODE_STYLE.get(channel.mode, "")),
            channel.stage,
            f"{channel.cn0_dbhz:.1f}",
            f"{channel.doppler_hz:+.1f}",
            f"{channel.carrier_lock:.2f}",
            f"{channel.lock_time_s:.1f}",
        )
    return table


def summary_table(summary: RunSummary) -> Table:
    """Return what a run came to: fixes, last position, speed of each stage, files."""
    table = Table(title="Summary", show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    share = 100.0 * summary.fixed / summary.epochs if summary.epochs else 0.0
    table.add_row("recording", f"{summary.recording_s:.3f} s")
    table.add_row("epochs with a fix", f"{summary.fixed} of {summary.epochs} ({share:.1f} %)")
    if summary.first_fix_s is not None:
        table.add_row("first fix", f"at {summary.first_fix_s:.1f} s of recording")
    table.add_row("last position", position_line(summary.last))
    if summary.horizontal is not None and math.isfinite(summary.horizontal.rms):
        error = summary.horizontal
        table.add_row(
            "horizontal error",
            f"{error.rms:.2f} m RMS, 95 % within {error.percentile95:.2f} m (against truth)",
        )
    if summary.inertial:
        table.add_row("inertial navigation", summary.inertial)
    for name, wall_s in summary.stages_s.items():
        speed = f", {summary.recording_s / wall_s:.1f} × real time" if wall_s > 0.0 else ""
        table.add_row(name, f"{wall_s:.1f} s{speed}")
    folders = dict.fromkeys(path.parent for path in summary.files)
    table.add_row("written to", "\n".join(nearby(folder) for folder in folders) or "nothing")
    if summary.files:
        table.add_row("files", ", ".join(path.name for path in summary.files))
    for path in summary.files:
        if path.suffix in (".png", ".html"):
            table.add_row("to look at", nearby(path))
    return table


def nearby(path: Path) -> str:
    """A path as seen from the working directory, where it lies below that."""
    path, here = path.resolve(), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


def why_no_fix_table(outcomes: Sequence[SatelliteOutcome]) -> Table:
    """Return how far every satellite came and what held it back, the furthest first."""
    table = Table(title="Satellites: how far each came, and why no further", title_justify="left")
    for name in ("sat", "signal", "reached"):
        table.add_column(name)
    for name in ("peak", "C/N0", "epochs used"):
        table.add_column(name, justify="right")
    table.add_column("because", overflow="fold")
    ranked = sorted(
        outcomes, key=lambda o: (-STAGES.index(o.stage), -o.used_epochs, o.satellite, o.signal)
    )
    for outcome in ranked:
        table.add_row(
            outcome.satellite,
            outcome.signal,
            Text(outcome.stage, style="green" if outcome.stage == "used" else ""),
            _number(outcome.acquisition_peak),
            _number(outcome.cn0_dbhz),
            str(outcome.used_epochs) if outcome.used_epochs else "",
            outcome.reason,
        )
    return table


def why_no_position(
    outcomes: Sequence[SatelliteOutcome], recording_s: float, *, orbits_given: bool
) -> str:
    """Return in one line how far the satellites came in a run without a position.

    orbits_given: a NAV file had the ephemerides.
    """
    reached = dict.fromkeys(STAGES, 0)
    for outcome in outcomes:
        for stage in STAGES[: STAGES.index(outcome.stage) + 1]:
            reached[stage] += 1
    if not reached["acquired"]:
        return f"no satellite found in {recording_s:.1f} s of recording"
    counts = ", ".join(
        f"{reached[stage]} {words}"
        for stage, words in (
            ("acquired", "acquired"),
            ("bit sync", "with bit sync"),
            ("frame sync", "with frame sync"),
            ("ephemeris", "with an ephemeris"),
        )
    )
    if reached["bit sync"] < 4 or reached["ephemeris"] >= 4:
        wait = ""
    elif orbits_given:
        wait = "; transmit times come with the head of a subframe, every 6 s"
    else:
        wait = "; ephemerides take 18 to 36 s of recording, or a NAV file (nav)"
    return f"satellites in {recording_s:.1f} s of recording: {counts}{wait}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
