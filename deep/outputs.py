"""All files of a run, fed with step results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from deepgnss.core.records import Epoch, NavData, SatelliteOutcome
from deepgnss.core.time import GpsTime
from deepgnss.deep.consistency import CodeMinusCarrier
from deepgnss.deep.coupled import Navigated
from deepgnss.deep.loose_outputs import write_state
from deepgnss.deep.setup import RunPlan
from deepgnss.io.config import Config
from deepgnss.io.correlations import CorrelationWriter
from deepgnss.io.inertial_tables import InnovationTable, TrajectoryTable
from deepgnss.io.nmea import NmeaWriter
from deepgnss.io.output import Closing
from deepgnss.io.rinex import STATION, long_name
from deepgnss.io.rinex_nav import write_nav
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.io.summary import write_summary
from deepgnss.io.tables import (
    ChannelTable,
    EventTable,
    ObservationTable,
    SatelliteTable,
    SolutionTable,
)
from deepgnss.io.tracks import GeoJsonTrack, GpxTrack, KmlTrack
from deepgnss.receiver.receiver import Fix, Knowledge, StepResult

FILES = (
    f"{STATION}_R_*_?O.rnx",
    f"{STATION}_R_*_?N.rnx",
    "solution.nmea",
    *(f"{name}.csv" for name in ("solution", "satellites", "channels", "observations", "events")),
    *(f"{name}.csv" for name in ("errors", "statistics", "trajectory", "innovations")),
    "stretches.csv",
    *(f"track.{kind}" for kind in ("kml", "gpx", "geojson")),
    "correlations.h5",
    *("overview.png", "report.html"),
    "summary.json",
)
"""Names of all files a run may write, as shell patterns."""


_W = TypeVar("_W", bound=Closing)


@dataclass(slots=True)
class Tally:
    """Counts for the summary."""

    epochs: int = 0  # output instants from the first observations on
    fixed: int = 0
    first_fix_s: float | None = None
    last: Fix | None = None
    last_valid: Fix | None = None
    start: Fix | None = None


class Outputs:
    """Writers of one run; use it in a `with` statement.

    Every file is `<name>.part` until the run has ended in order.
    """

    def __init__(self, config: Config, plan: RunPlan, knowledge: Knowledge) -> None:
        """Open the files the config asks for, in a folder that is there."""
        self.folder = Path(config.output.directory)
        self.tally = Tally()
        self.code_minus_carrier = CodeMinusCarrier()
        self._stack = ExitStack()
        self._config = config
        self._plan = plan
        self._rate = plan.stream.sample_rate_hz
        self._writers: list[Closing] = []
        self._flushed = plan.first
        self._last_epoch: Epoch | None = None
        with ExitStack() as opening:
            self._open(opening, knowledge)
            self._stack = opening.pop_all()

    def _open(self, stack: ExitStack, knowledge: Knowledge) -> None:
        output, plan, folder = self._config.output, self._plan, self.folder

        def enter(writer: _W) -> _W:
            stack.enter_context(writer)
            self._writers.append(writer)
            return writer

        signals = tuple(covered.id for covered in plan.covered)
        duration_s = plan.seconds
        utc = knowledge.nav.utc
        self._obs: RinexObsWriter | None = None
        self._nmea: NmeaWriter | None = None
        self._correlations: CorrelationWriter | None = None
        self._tracks: tuple[Any, ...] = ()
        self._inertial: tuple[TrajectoryTable, InnovationTable] | None = None
        if output.rinex:
            header = ObsHeader(signals, output.interval, duration_s, knowledge.position_e_m, utc)
            self._obs = enter(RinexObsWriter(folder, header))
        if output.nmea:
            leap = utc.leap_s if utc is not None else None
            self._nmea = enter(NmeaWriter(folder / "solution.nmea", signals, leap))
        if output.csv:
            self._solutions = enter(SolutionTable(folder / "solution.csv"))
            self._satellites = enter(SatelliteTable(folder / "satellites.csv"))
            self._channels = enter(ChannelTable(folder / "channels.csv"))
            self._observations = enter(ObservationTable(folder / "observations.csv"))
            self._events = enter(EventTable(folder / "events.csv", self._rate))
            if self._config.imu is not None and self._config.deep.enabled:
                self._inertial = (
                    enter(TrajectoryTable(folder / "trajectory.csv")),
                    enter(InnovationTable(folder / "innovations.csv")),
                )
        if output.report:
            self._tracks = (
                enter(KmlTrack(folder / "track.kml", "deepgnss")),
                enter(GpxTrack(folder / "track.gpx", "deepgnss")),
                enter(GeoJsonTrack(folder / "track.geojson", "deepgnss")),
            )
        if output.correlations:
            half = plan.settings.tracking.spacing_chips / 2.0
            self._correlations = enter(
                CorrelationWriter(
                    folder / "correlations.h5",
                    {signal.name: (half, 0.0, -half) for signal in signals},
                )
            )

    def write(self, result: StepResult, navigated: Navigated | None = None) -> None:
        """Put one step into all files."""
        if navigated is not None and self._inertial is not None:
            trajectory, innovations = self._inertial
            for state in navigated.states:
                write_state(trajectory, state)
            for i in navigated.innovations:
                innovations.write(i.time, i.kind, i.innovation, i.nis, i.accepted)
        for fix in result.fixes:
            if fix.solution.valid and self.tally.first_fix_s is None:
                self.tally.first_fix_s = fix.epoch.instant.sample / self._rate
            if fix.output:
                self._write_fix(fix)
        if self._config.output.csv:
            self._channels.write(result.end / self._rate, self._time_at_end(result), result.reports)
            self._events.write(result.events)
        if result.end >= self._flushed + self._rate:  # what is on disk is never older than 1 s
            self._flushed = result.end
            for writer in self._writers:
                writer.flush()
        if self._correlations is not None:
            signals = {report.satellite: report.signal for report in result.reports}
            for satellite, records in result.correlations.items():
                for record in records:
                    self._correlations.write(satellite, signals[satellite], record)

    def _time_at_end(self, result: StepResult) -> GpsTime | None:
        """GPST at a step's end, carried on from the last epoch; None before the first."""
        if result.fixes:
            self._last_epoch = result.fixes[-1].epoch
        if self._last_epoch is None:
            return None
        instant = self._last_epoch.instant
        return self._last_epoch.time.plus(
            (result.end - instant.sample - instant.fraction) / self._rate
        )

    def _write_fix(self, fix: Fix) -> None:
        tally, solution = self.tally, fix.solution
        tally.epochs += 1
        tally.last = fix
        self.code_minus_carrier.add(fix.epoch)
        tally.start = tally.start or fix
        if solution.valid:
            tally.fixed += 1
            tally.last_valid = fix
        if self._obs is not None:
            self._obs.write(fix.epoch)
        if self._nmea is not None:
            self._nmea.write(solution, fix.epoch)
        if self._config.output.csv:
            self._solutions.write(solution)
            self._satellites.write(solution)
            self._observations.write(fix.epoch)
        if solution.valid:
            for track in self._tracks:
                track.write(solution)

    def finish(
        self, nav: NavData, outcomes: Sequence[SatelliteOutcome], more: Mapping[str, Any]
    ) -> None:
        """Close all files under their final names; write NAV file and summary."""
        self._stack.close()
        start = self.tally.start
        if self._config.output.rinex and start is not None and nav.ephemerides:
            systems = "".join(covered.id.system for covered in self._plan.covered)
            name = long_name("N", systems, start.epoch.time, self._plan.seconds)
            write_nav(self.folder / name, nav)
        write_summary(self.folder / "summary.json", self._summary(outcomes, more))

    def _summary(
        self, outcomes: Sequence[SatelliteOutcome], more: Mapping[str, Any]
    ) -> dict[str, Any]:
        tally = self.tally
        valid = tally.last_valid
        return {
            "signals": [covered.id.name for covered in self._plan.covered],
            "recording_s": self._plan.seconds,
            "epochs": tally.epochs,
            "epochs_fixed": tally.fixed,
            "first_fix_s": tally.first_fix_s,
            "code_minus_carrier_mps": self.code_minus_carrier.drift_mps,
            "last_position_e_m": valid.solution.r_e_m if valid is not None else None,
            **more,
            "satellites": [outcome for outcome in outcomes if outcome.stage != "not searched"],
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)
