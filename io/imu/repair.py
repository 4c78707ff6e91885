"""From rows of readings to increments over intervals: duplicates, gaps, times that go back.

An increment after a gap is that of its own interval alone; the gap stays between the intervals,
for the navigator to bridge as far as it may. Everything found is counted and said.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray
from deepgnss.io.imu.rows import Faults

SHORT_GAP_S: Final = 1.0
_GAP: Final = 1.5  # intervals: a longer step lacks rows
_SAME_S: Final = 1e-6


class Stretch(NamedTuple):
    """Consecutive rows in SI units and body axes, ends of intervals in s since an origin."""

    line: NDArray[np.int64]
    end_s: FloatArray  # (n,)
    gyro: FloatArray  # (n, 3) rad or rad/s
    accel: FloatArray  # (n, 3) m/s or m/s²

    def only(self, kept: NDArray[np.bool_]) -> Stretch:
        """The rows where `kept`."""
        return Stretch(self.line[kept], self.end_s[kept], self.gyro[kept], self.accel[kept])


class Increments(NamedTuple):
    """Ends and lengths of intervals, and increments over them."""

    end_s: FloatArray
    dt_s: FloatArray
    dtheta_rad: FloatArray
    dv_mps: FloatArray


class Repair:
    """Carries what one stretch leaves to the next.

    Parameters
    ----------
    is_rate: readings are rates, not increments.
    interval_s: the usual length of an interval.
    """

    def __init__(self, faults: Faults, is_rate: bool, interval_s: float) -> None:
        self._faults = faults
        self._is_rate = is_rate
        self._interval_s = interval_s
        self._last_s: float | None = None
        self.outages: list[
            tuple[float, float]
        ] = []  # s since the origin: from, to, longer than SHORT_GAP_S

    def __call__(self, stretch: Stretch) -> Increments:
        """Increments of the next rows.

        Raises
        ------
        InputFileError: time goes back.
        """
        stretch = self._finite(stretch)
        stretch, steps_s = self._rising(stretch)
        n = steps_s.size
        if n == 0:
            return Increments(steps_s, steps_s, np.empty((0, 3)), np.empty((0, 3)))
        is_gap = steps_s > _GAP * self._interval_s
        self._say(stretch, np.flatnonzero(is_gap), steps_s)
        dt_s = np.where(is_gap, self._interval_s, steps_s)
        span_s = dt_s[:, np.newaxis] if self._is_rate else 1.0
        self._last_s = float(stretch.end_s[-1])
        return Increments(stretch.end_s, dt_s, stretch.gyro * span_s, stretch.accel * span_s)

    def _say(self, stretch: Stretch, at: NDArray[np.intp], steps_s: FloatArray) -> None:
        for k in at.tolist():
            missing_s, line = float(steps_s[k]) - self._interval_s, int(stretch.line[k])
            if missing_s <= SHORT_GAP_S:
                self._faults.add("gaps of up to 1 s", line, seconds=missing_s)
            else:
                self._faults.add("outages of more than 1 s", line, seconds=missing_s)
                to_s = float(stretch.end_s[k]) - self._interval_s
                self.outages.append((to_s - missing_s, to_s))

    def _finite(self, stretch: Stretch) -> Stretch:
        good = np.asarray(np.isfinite(np.column_stack(stretch[1:])).all(axis=1), np.bool_)
        if not good.all():
            bad = int(np.flatnonzero(~good)[0])
            what = "rows that are not six numbers and a time left out"
            self._faults.add(what, int(stretch.line[bad]), int((~good).sum()))
        return stretch.only(good)

    def _rising(self, stretch: Stretch) -> tuple[Stretch, FloatArray]:
        """The rows without those whose time stands there already, and steps from row to row."""
        if stretch.end_s.size == 0:
            return stretch, np.empty(0)
        start_s = stretch.end_s[0] - self._interval_s if self._last_s is None else self._last_s
        steps_s = np.diff(stretch.end_s, prepend=start_s)
        back = np.flatnonzero(steps_s < -_SAME_S)
        if back.size:
            line = int(stretch.line[back[0]])
            raise InputFileError(
                f"{self._faults.path}:{line}: time goes back by {-steps_s[back[0]]:.6g} s"
            )
        same = steps_s <= _SAME_S
        if same.any():
            line = int(stretch.line[np.flatnonzero(same)[0]])
            what = "rows with the time of the row before left out"
            self._faults.add(what, line, int(same.sum()))
            stretch = stretch.only(~same)
            steps_s = np.diff(stretch.end_s, prepend=start_s)
        return stretch, steps_s
