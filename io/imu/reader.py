"""Inertial logs of every format as one stream of increments in body axes, on GPST."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK, STANDARD_GRAVITY_MPS2
from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.io.config.aids import ImuConfig
from deepgnss.io.config.axes import axes_matrix
from deepgnss.io.imu.novatel import read_novatel
from deepgnss.io.imu.repair import Repair, Stretch
from deepgnss.io.imu.rows import Faults, Rows
from deepgnss.io.imu.tables import read_hdf5
from deepgnss.io.imu.tag import TagLine, fit_tags
from deepgnss.io.imu.text import read_csv, read_kfgins

_GYRO_UNITS: Final = {"rad": 1.0, "rad/s": 1.0, "deg": math.pi / 180, "deg/s": math.pi / 180}
_ACCEL_UNITS: Final = {"m/s": 1.0, "m/s^2": 1.0, "g": STANDARD_GRAVITY_MPS2}
_HALF_WEEK_S: Final = SECONDS_PER_WEEK / 2.0


class ImuLog:
    """An inertial log; iterating reads it once from its start, block by block, in flat memory.

    Parameters
    ----------
    config: the section `imu`.
    recording: HDF5 recording that holds the log where the config names no file.
    near: an instant within half a week of the log, for seconds of week without a week; None: the
        log's own weeks, or week 0.
    sample_zero, sample_rate_hz: GPST of sample 0 of the recording and its rate, with
        `time: sample`.
    time_offset_s: instead of the config's (which may be `auto`).
    """

    def __init__(
        self,
        config: ImuConfig,
        *,
        recording: Path | None = None,
        near: GpsTime | None = None,
        sample_zero: GpsTime | None = None,
        sample_rate_hz: float | None = None,
        time_offset_s: float | None = None,
    ) -> None:
        path = config.file or recording
        if path is None:
            raise ConfigError("imu.file: found nothing; expected the IMU's log")
        if config.time == "sample" and (sample_zero is None or not sample_rate_hz):
            raise ConfigError("imu.time: found sample; it needs a recording that samples count")
        self.path = path
        self.faults = Faults(path)
        self.outages: list[tuple[float, float]] = []
        """Gaps of more than a second in what was read so far, from and to, s since the origin."""
        self.rate_hz: float | None = None
        """Rows per second as found; None before the first block is read."""
        self._config = config
        self._near = near
        self._sample_zero = sample_zero
        self._sample_s = 1.0 / sample_rate_hz if sample_rate_hz else math.nan
        if time_offset_s is None:
            time_offset_s = 0.0 if config.time_offset == "auto" else config.time_offset
        self._offset_s = time_offset_s

    def __iter__(self) -> Iterator[ImuBlock]:
        """Blocks of increments in order.

        Raises
        ------
        InputFileError: the log cannot be read, is not what the config says, or its time goes back.
        """
        self.faults = Faults(self.path)
        pieces = self._pieces()
        first = next(pieces, None)
        if first is None:
            raise InputFileError(f"{self.path}: holds no data")
        origin, time_of = self._clock(first)
        first_s = time_of(first)
        interval_s = self._interval(first_s)
        self.rate_hz = 1.0 / interval_s
        repair = Repair(self.faults, self._config.kind == "rates", interval_s)
        self.outages = repair.outages
        late_s = self._offset_s + (interval_s if self._config.stamp == "start" else 0.0)
        C_bs = axes_matrix(self._config.axes)
        gyro = C_bs.T * _GYRO_UNITS[self._config.units.gyro]
        accel = C_bs.T * _ACCEL_UNITS[self._config.units.accel]
        timed = chain([(first, first_s)], ((rows, time_of(rows)) for rows in pieces))
        for rows, time_s in timed:
            stretch = Stretch(rows.line, time_s + late_s, rows.gyro @ gyro, rows.accel @ accel)
            increments = repair(stretch)
            if increments.end_s.size:
                yield ImuBlock(origin, *increments)

    def _pieces(self) -> Iterator[Rows]:
        config = self._config
        if config.format == "csv":
            return read_csv(self.path, config.columns, config.units)
        if config.format == "kfgins":
            return read_kfgins(self.path)
        if config.format == "novatel_rawimu":
            if config.model is None:
                raise ConfigError("imu.model: found nothing; expected the unit of the NovAtel log")
            return read_novatel(self.path, config.model, self.faults)
        return read_hdf5(self.path, config.kind, config.units)

    def _interval(self, time_s: FloatArray) -> float:
        """Usual length of an interval: the mean of the steps near their median."""
        steps_s = np.diff(time_s[np.isfinite(time_s)])
        steps_s = steps_s[steps_s > 0.0]
        if steps_s.size == 0:
            if self._config.rate is not None:
                return 1.0 / self._config.rate
            raise InputFileError(
                f"{self.path}: no two rows with a time and another; wrong columns?"
            )
        usual_s = np.median(steps_s)
        return float(np.mean(steps_s[np.abs(steps_s - usual_s) < 0.5 * usual_s]))

    # --- time ------------------------------------------------------------------------------------

    def _clock(self, first: Rows) -> tuple[GpsTime, Callable[[Rows], FloatArray]]:
        """Origin of the blocks' seconds, and what makes these of a piece of rows."""
        config = self._config
        if config.time == "sample" and self._sample_zero is not None:
            return self._sample_zero, lambda rows: rows.time * self._sample_s
        if config.time == "tick" and config.tick is not None:
            if config.tag_file is not None:
                line = self._tag_line(config.tag_file, config.tick)
                return line.opened, lambda rows: line.seconds(rows.time)
            tick_s, start_s = config.tick, config.start or 0.0
            return GpsTime(self._week(start_s), start_s), lambda rows: rows.time * tick_s
        good = np.flatnonzero(np.isfinite(first.time))
        if good.size == 0:
            raise InputFileError(f"{self.path}: no row of the first has a time; wrong columns?")
        seconds = float(first.time[good[0]])
        if not 0.0 <= seconds < SECONDS_PER_WEEK:
            raise InputFileError(
                f"{self.path}:{first.line[good[0]]}: time {seconds:.10g} is no GPST second of week;"
                " expected imu.time: sample, or tick with tick and start or tag_file"
            )
        week = self._week(seconds) if first.week is None else int(first.week[good[0]])
        origin = GpsTime(week, float(math.floor(seconds)))
        return origin, _WeekClock(origin)

    def _week(self, tow_s: float) -> int:
        if self._near is None:
            return 0
        return self._near.week + round((self._near.tow_s - tow_s) / SECONDS_PER_WEEK)

    def _tag_line(self, tag_file: Path, tick_s: float) -> TagLine:
        pieces = [(rows.line, rows.time) for rows in self._pieces()]
        lines, ticks = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        self.faults = Faults(self.path)
        good = np.isfinite(ticks)
        return fit_tags(tag_file, self.path, lines[good], ticks[good], tick_s)


class _WeekClock:
    """Seconds since an origin of seconds of week, through turns of the week."""

    def __init__(self, origin: GpsTime) -> None:
        self._origin = origin
        self._turns = 0
        self._last_s = origin.tow_s

    def __call__(self, rows: Rows) -> FloatArray:
        seconds = rows.time - self._origin.tow_s
        if rows.week is not None:
            return seconds + (rows.week - self._origin.week) * SECONDS_PER_WEEK
        good = np.flatnonzero(np.isfinite(rows.time))
        if good.size:
            turns = np.diff(rows.time[good], prepend=self._last_s) < -_HALF_WEEK_S
            weeks = np.zeros(rows.time.size)
            weeks[good] = self._turns + np.cumsum(turns)
            self._turns, self._last_s = int(weeks[good[-1]]), float(rows.time[good[-1]])
            seconds = seconds + weeks * SECONDS_PER_WEEK
        return seconds
