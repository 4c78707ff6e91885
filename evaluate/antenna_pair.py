"""Two receivers' observations of one vehicle as phases that an INS and orbits have been taken off.

Ranges are those of both antennas at their own places, at the instants their own clocks had truly
reached (by pseudorange), so that clocks which differ by a millisecond do no harm. Carrier phase
grows with range; differences are second − first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepgnss.core.bands import CARRIERS_HZ, band_wavelength_m
from deepgnss.core.constants import SECONDS_PER_WEEK, SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import FloatArray, NavData
from deepgnss.deep.slips import BoolArray, IntArray, Phases
from deepgnss.evaluate.geometry import APART_MS, Sights, sights
from deepgnss.io.rinex_obs_reader import ObsFile
from deepgnss.io.truth import Trajectory

_APART: Final = 0.4  # of the interval between epochs that tags of one instant may differ by
_BANDS: Final = 2  # of a system that are used

Place = Trajectory | FloatArray
Places = tuple[Place, Place]
"""The ways of both antennas, or where they are at rest, (3,) each in ECEF."""


class Signal(NamedTuple):
    """A phase that is followed."""

    satellite: str
    band: str
    codes: tuple[str, str]  # "L1C" of each receiver

    @property
    def wavelength_m(self) -> float:
        """Of its carrier."""
        return band_wavelength_m(self.satellite[0], self.band)

    @property
    def name(self) -> str:
        """As `G07 L1`."""
        return f"{self.satellite} L{self.band}"


@dataclass(frozen=True, slots=True)
class Side:
    """One antenna's observations, n epochs of m signals."""

    row: IntArray  # (n, m) of the file's frame, −1 where there is none
    phase_m: FloatArray  # (n, m) less range and its clock, NaN without phase
    code_m: FloatArray  # (n, m) likewise
    lost: BoolArray  # (n, m)
    half: BoolArray  # (n, m)
    unit_e: FloatArray  # (n, m, 3) to the satellite
    height: FloatArray  # (n, m) sine of the elevation


@dataclass(frozen=True, slots=True)
class AntennaPair:
    """Both antennas over the epochs both have."""

    week: NDArray[np.int64]  # (n,) and seconds: the first receiver's tags
    tow_s: FloatArray
    time_s: FloatArray  # (n,) since the first epoch
    signals: tuple[Signal, ...]  # (m,)
    first: Side
    second: Side
    baseline_e_m: FloatArray  # (n, 3) second − first by the INS
    corrected_rad2: FloatArray  # (n,) what the attitude's 1σ² fell by so far where it fell

    @property
    def wavelength_m(self) -> FloatArray:
        """(m,)."""
        return np.array([signal.wavelength_m for signal in self.signals])

    def between(self) -> Phases:
        """Differences second − first, which an error of the attitude disturbs.

        A small turn φ of the baseline b changes the difference of range along u by φ·(u × b).
        """
        a, b = self.first, self.second
        arm = np.cross(a.unit_e, self.baseline_e_m[:, np.newaxis])
        return self._phases(
            b.phase_m - a.phase_m,
            np.nan_to_num(arm),
            a.lost | b.lost,
            a.half | b.half,
            self.corrected_rad2,
        )

    def alone(self, side: Side) -> Phases:
        """Phases of one antenna, which an error of its way disturbs."""
        still = np.zeros_like(self.time_s)
        return self._phases(side.phase_m, np.nan_to_num(side.unit_e), side.lost, side.half, still)

    def _phases(
        self,
        value_m: FloatArray,
        arm: FloatArray,
        lost: BoolArray,
        half: BoolArray,
        corrected: FloatArray,
    ) -> Phases:
        names = sorted({signal.satellite for signal in self.signals})
        number = np.array([names.index(signal.satellite) for signal in self.signals])
        height = np.nan_to_num(self.first.height)
        wavelength_m = self.wavelength_m
        return Phases(
            self.time_s, number, wavelength_m, value_m, arm, lost, half, height, corrected
        )


def antenna_pair(
    first: ObsFile, second: ObsFile, places: Places, nav: NavData, mask_deg: float = 10.0
) -> AntennaPair:
    """Match two receivers' epochs and take ranges, by orbits and known places, off both.

    Raises InputFileError: nothing in common.
    """
    signals = _signals(first, second)
    if not signals:
        raise InputFileError("the two observation files have no satellite with phase in common")
    seen = [
        sights(_observed(file, signals, k), place, nav)
        for k, (file, place) in enumerate(zip((first, second), places, strict=True))
    ]
    tags = [np.unique(one.frame["_s"].to_numpy(np.float64)) for one in seen]
    weeks = [int(file.frame["week"].iloc[0]) for file in (first, second)]  # that `_s` counts from
    pairs = _matched(tags[0], tags[1] + (weeks[1] - weeks[0]) * float(SECONDS_PER_WEEK))
    if not len(pairs):
        raise InputFileError("the two observation files have no epoch in common")
    one, two = (
        _side(file, sight, signals, k, _numbers(tags[k], pairs[:, k]), mask_deg)
        for k, (file, sight) in enumerate(zip((first, second), seen, strict=True))
    )
    tag_s = tags[0][pairs[:, 0]]
    week = weeks[0] + (tag_s // SECONDS_PER_WEEK).astype(np.int64)
    tow_s = tag_s % SECONDS_PER_WEEK
    return AntennaPair(
        week,
        tow_s,
        tag_s - tag_s[0],
        signals,
        one,
        two,
        _baseline(places, week, tow_s),
        _corrected_rad2(places[0], week, tow_s),
    )


def _numbers(tags_s: FloatArray, matched: IntArray) -> tuple[FloatArray, IntArray]:
    """A receiver's tags, and the number of the matched epoch each is (−1: none)."""
    numbers = np.full(len(tags_s), -1, np.int64)
    numbers[matched] = np.arange(len(matched))
    return tags_s, numbers


def _baseline(places: Places, week: NDArray[np.int64], tow_s: FloatArray) -> FloatArray:
    one, two = (
        place.at(week, tow_s)[0] if isinstance(place, Trajectory) else place for place in places
    )
    return np.asarray(np.broadcast_to(two - one, (len(tow_s), 3)))


def _corrected_rad2(place: Place, week: NDArray[np.int64], tow_s: FloatArray) -> FloatArray:
    """By how much corrections have moved the attitude: where its 1σ falls, the error jumps.

    An optimal correction takes σ² from before to after, and is itself of the difference.
    """
    if not isinstance(place, Trajectory) or place.attitude_sigma_rad is None:
        return np.zeros(len(tow_s))
    falls = np.maximum(-np.diff(place.attitude_sigma_rad**2, axis=0), 0.0).max(axis=1)
    known_s = place.seconds(place.week, place.tow_s)
    total = np.concatenate([[0.0], np.cumsum(falls)])
    return np.asarray(np.interp(place.seconds(week, tow_s), known_s, total))


def _signals(first: ObsFile, second: ObsFile) -> tuple[Signal, ...]:
    """Up to two bands of every satellite both have, the system's first signal first."""
    found = []
    frames = (first.frame, second.frame)
    satellites = sorted(set(first.frame["satellite"]) & set(second.frame["satellite"]))
    for system, bands in CARRIERS_HZ.items():
        own = [name for name in satellites if name[0] == system]
        rows = [frame[frame["satellite"].isin(own)] for frame in frames]
        codes = {band: [_best(part, f"L{band}") for part in rows] for band in bands}
        usable = [band for band in bands if all(codes[band])][:_BANDS]
        for name in own:
            for band in usable:
                one, two = map(str, codes[band])
                found.append(Signal(name, band, (one, two)))
    return tuple(found)


def _best(rows: pd.DataFrame, start: str) -> str | None:
    """The observation code that most rows have, of those that begin so."""
    names = [name for name in map(str, rows) if name.startswith(start) and len(name) == 3]
    counts = {name: int(rows[name].notna().sum()) for name in names}
    best = max(counts, key=lambda name: counts[name], default=None)
    return best if best is not None and counts[best] else None


def _observed(file: ObsFile, signals: Sequence[Signal], k: int) -> pd.DataFrame:
    """What `sights` needs of one file: ranges of each system's first signal."""
    codes: dict[str, str] = {}
    for signal in signals:
        codes.setdefault(signal.satellite[0], _best_code(file, signal, k))
    frame = file.frame
    range_m = np.full(len(frame), np.nan)
    for system, code in codes.items():
        if code in frame:
            mine = (frame["satellite"].str[0] == system).to_numpy()
            range_m[mine] = frame[code].to_numpy(np.float64)[mine]
    return frame[["week", "tow_s", "satellite"]].assign(
        pseudorange_m=range_m, _row=np.arange(len(frame))
    )


def _best_code(file: ObsFile, signal: Signal, k: int) -> str:
    """Pseudorange of the same channel as a phase, or else of the same band."""
    same = "C" + signal.codes[k][1:]
    if same in file.frame and file.frame[same].notna().any():
        return same
    return _best(file.frame, f"C{signal.band}") or same


def _matched(first_s: FloatArray, second_s: FloatArray) -> IntArray:
    """Epochs of one instant, (n, 2): tags nearest to each other, within a part of the interval."""
    if not (len(first_s) and len(second_s)):
        return np.zeros((0, 2), np.int64)
    steps = np.concatenate([np.diff(first_s), np.diff(second_s)])
    usual_s = float(np.median(steps)) if len(steps) else 1.0
    limit_s = min(APART_MS * 1e-3, _APART * usual_s)
    after = np.clip(np.searchsorted(second_s, first_s), 1, max(len(second_s) - 1, 1))
    after = np.minimum(after, len(second_s) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(
        np.abs(second_s[before] - first_s) <= np.abs(second_s[after] - first_s), before, after
    )
    close = np.abs(second_s[nearer] - first_s) <= limit_s
    pairs = np.column_stack([np.flatnonzero(close), nearer[close]])
    return pairs[np.unique(pairs[:, 1], return_index=True)[1]]


def _side(
    file: ObsFile,
    seen: Sights,
    signals: Sequence[Signal],
    k: int,
    tags: tuple[FloatArray, IntArray],
    mask_deg: float,
) -> Side:
    """Tables of one receiver over matched epochs."""
    shape = (int(tags[1].max()) + 1, len(signals))
    row = np.full(shape, -1, np.int64)
    phase_m, code_m, height = (np.full(shape, np.nan) for _ in range(3))
    lost, half = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    unit_e = np.full((*shape, 3), np.nan)
    columns: Mapping[str, FloatArray] = {
        name: file.frame[name].to_numpy(np.float64)
        for name in map(str, file.frame)
        if name not in ("week", "tow_s", "satellite")
    }
    epochs = tags[1][np.searchsorted(tags[0], seen.frame["_s"].to_numpy(np.float64))]
    own_row = seen.frame["_row"].to_numpy(np.int64)
    high = seen.elevation_rad >= np.radians(mask_deg)
    groups = seen.frame.groupby("satellite", sort=False).indices
    for number, signal in enumerate(signals):
        mine = groups[signal.satellite]
        mine = mine[high[mine] & (epochs[mine] >= 0)]
        epoch = epochs[mine]
        expected_m = seen.range_m[mine] + SPEED_OF_LIGHT_MPS * seen.clock_s[mine]
        rows = own_row[mine]
        code = signal.codes[k]
        row[epoch, number] = rows
        phase_m[epoch, number] = columns[code][rows] * signal.wavelength_m - expected_m
        code_m[epoch, number] = columns[_best_code(file, signal, k)][rows] - expected_m
        flags = columns.get(f"{code}_lli", np.zeros(len(file.frame)))[rows].astype(np.int64)
        lost[epoch, number], half[epoch, number] = (flags & 1) > 0, (flags & 2) > 0
        unit_e[epoch, number] = seen.unit_e[mine]
        height[epoch, number] = np.sin(seen.elevation_rad[mine])
    return Side(row, phase_m, code_m, lost, half, unit_e, height)
