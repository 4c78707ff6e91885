"""PR-W215: ranges of a car at 21.5 dB-Hz, as the code loop has them and smoothed, T 6.4.1."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, Epoch, FloatArray
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.sampled_truth import SampledTruth
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started, with_unit
from deepgnss.receiver.receiver import StepResult
from deepgnss.receiver.smoothing import HatchState, smooth
from deepgnss.theory.tracking_error import dll_thermal_sigma_chips

BANDWIDTH_HZ: Final = 0.05
SPACING_CHIPS: Final = 0.25
SMOOTHED_LIMIT_M: Final[Mapping[str, float]] = {"FSAS": 1.2, "MTi-G": 1.4}  # by inertial unit
LIMIT: Final = 1.1  # of √2·σ_th
CHIP_M: Final = SPEED_OF_LIGHT_MPS / GPS_L1CA.chip_rate_hz
_CORRELATION: Final = 0.458  # ∫ρ²dτ · B of a loop of order 2 with damping √½
_SETTINGS: Final = (
    f"tracking.code={{order: 2, bandwidth: [3.0, 1.0, {BANDWIDTH_HZ}], spacing: {SPACING_CHIPS}}}",
    # Aiding leaves no steady change of frequency to follow, but in a turn of 2 g what the unit's
    # heading is wrong by: order 2, slower, falls out of the lines it searches.
    "tracking.frequency={window: 0.512, order: 1, gain: 0.7}",
    "output.interval=1.0",
)
_FORGOTTEN_S: Final = 60.0  # after the strong start: six times what the code loop averages over
_QUICK: Final = ("seconds=56", "satellites.schedule={all: [[0, 48], [22, 21.97]]}")
_QUICK_FORGOTTEN_S: Final = 15.0


class Spread(NamedTuple):
    """Sums over the epochs of one or several recordings."""

    pairs: int  # of satellites, times epochs
    squares_m2: float  # of differences between two satellites' range errors
    smoothed_m2: float  # the same, smoothed
    thermal_m2: float  # what T(2.25) says of them, by the coherent time as run
    coherent_s: float  # times pairs
    seconds: float  # of independent errors: epochs times (satellites less the common one)
    lost: int  # satellite epochs without a range

    def __add__(self, other: tuple[float, ...]) -> Spread:  # type: ignore[override]
        """Return the sums over both."""
        return Spread(*(a + b for a, b in zip(self, other, strict=True)))  # type: ignore[arg-type]


class Listener:
    """Takes a run's steps in: errors of ranges, raw and smoothed, and how they were tracked."""

    def __init__(self, recording: Recording, since_s: float) -> None:
        self._truth = SampledTruth(recording)
        self._since_s = since_s
        emitters = recording.scenario.emitters
        front_end = recording.scenario.streams[0].front_end
        self._front_end_hz = front_end.bandwidth_hz or front_end.sample_rate_hz
        self._cn0_dbhz = {e.satellite: e.cn0_dbhz[-1][1] - loss_db(front_end) for e in emitters}
        self._hatch: dict[str, HatchState] = {}
        self._coherent_s: dict[str, float] = {}
        self.total = Spread(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)

    def take(self, result: StepResult) -> None:
        """Take a step's observations in."""
        for fix in result.fixes:
            if fix.output:
                self._take(fix.epoch)
        self._coherent_s = {report.satellite: report.coherent_s for report in result.reports}

    def _take(self, epoch: Epoch) -> None:
        raw_m, smoothed_m = {}, {}
        for seen in epoch.observations:
            before = self._hatch.get(seen.satellite, HatchState())
            self._hatch[seen.satellite], better = smooth(before, seen, epoch.time, aided=True)
            missed = self._truth.missed(seen, epoch.instant)
            if missed is not None:
                raw_m[seen.satellite] = missed.range_m
                smoothed_m[seen.satellite] = (
                    missed.range_m + better.pseudorange_m - seen.pseudorange_m
                )
        if epoch.time.since(self._truth.start) < self._since_s:
            return
        names = sorted(raw_m)
        variances_m2 = [self._thermal_m2(name) for name in names]
        n = len(names)
        self.total += Spread(
            n * (n - 1) // 2,
            _pair_squares([raw_m[name] for name in names]),
            _pair_squares([smoothed_m[name] for name in names]),
            (n - 1) * sum(variances_m2),
            0.5 * (n - 1) * sum(self._coherent_s[name] for name in names),
            float(n - 1),
            len(self._cn0_dbhz) - n,
        )

    def _thermal_m2(self, name: str) -> float:
        chips = dll_thermal_sigma_chips(
            self._cn0_dbhz[name],
            BANDWIDTH_HZ,
            self._coherent_s[name],
            SPACING_CHIPS,
            self._front_end_hz,
            GPS_L1CA.chip_rate_hz,
        )
        return (CHIP_M * chips) ** 2


def _pair_squares(errors_m: Sequence[float]) -> float:
    """Sum of the squared differences of all pairs."""
    values: FloatArray = np.array(errors_m)
    return float(values.size * (values @ values) - values.sum() ** 2)


def spread(recording: Recording, grade: str, forgotten_s: float) -> Spread:
    """Differences between satellites of a run aided by a grade of inertial unit."""
    weak_s = recording.scenario.emitters[0].cn0_dbhz[-1][0]
    listener = Listener(recording, weak_s + forgotten_s)
    settings = (*_SETTINGS, *with_unit(recording, grade))
    with started(recording, *settings) as run:
        for result in run.engine.steps():
            listener.take(result)
    return listener.total


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """σ of differences, raw and smoothed, by inertial unit; quick: 19 s with the better one."""
    grades = list(SMOOTHED_LIMIT_M)[: 1 if quick else None]
    found = dict.fromkeys(grades, Spread(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0))
    for seed in seeds[:1] if quick else seeds:
        with recorded("weak_ranges", seed, *(_QUICK if quick else ())) as made:
            for grade in grades:
                found[grade] += spread(made, grade, _QUICK_FORGOTTEN_S if quick else _FORGOTTEN_S)
    return [figure for grade in grades for figure in _figures(grade, found[grade], quick)]


def _figures(grade: str, total: Spread, quick: bool) -> list[Figure]:
    raw_m = math.sqrt(total.squares_m2 / total.pairs)
    smoothed_m = math.sqrt(total.smoothed_m2 / total.pairs)
    thermal_m = math.sqrt(total.thermal_m2 / total.pairs)
    error = math.sqrt(0.5 * _CORRELATION / (BANDWIDTH_HZ * total.seconds))
    ratio = raw_m / thermal_m
    return [
        Figure(
            f"{grade}: σ of double differences, {total.seconds:.0f} s × satellites",
            f"{raw_m:.2f} m = {ratio:.3f} (± {error:.3f}) · √2 σ_th of {thermal_m:.2f} m"
            f" (coherent {1e3 * total.coherent_s / total.pairs:.0f} ms in the mean);"
            f" {total.lost} ranges missing",
            ratio <= LIMIT + (2.0 * error if quick else 0.0) and not total.lost,
        ),
        Figure(
            f"{grade}: the same, smoothed",
            f"{smoothed_m:.2f} m",
            None if quick else smoothed_m <= SMOOTHED_LIMIT_M[grade],
        ),
    ]
