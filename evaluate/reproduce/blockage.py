"""PR-BACK: ranges a second after twenty seconds without any satellite, T 6.4.2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import Epoch, Event
from deepgnss.evaluate.reproduce.sampled_truth import SampledTruth
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded, started, with_unit

GRADES: Final = ("FSAS", "MTi-G")
LIMIT_M: Final = 0.5
_SETTINGS: Final = (
    "tracking.code={order: 2, bandwidth: [3.0, 1.0, 0.1], spacing: 0.25}",
    "output.interval=0.1",
)
_LATER_S: Final = (1, 2, 4, 8)  # whole seconds shown; the first is judged
_SEARCHED: Final = "acquired"  # the event of a satellite that a search has found


class Returns(NamedTuple):
    """What the receiver did after the blockages of a recording."""

    errors_m: dict[int, list[float]]  # by whole second after a return; NaN: no range
    searched: int  # satellites that came back and were found by a search (others always are)


def returns(recording: Recording, *settings: str) -> Returns:
    """Range errors at the whole seconds after each return of every satellite, undifferenced."""
    truth = SampledTruth(recording)
    ends_s = blockages_end_s(recording)
    names = [emitter.satellite for emitter in recording.scenario.emitters]
    epochs: dict[int, Epoch] = {}
    events: list[Event] = []
    with started(recording, *_SETTINGS, *settings) as run:
        for result in run.engine.steps():
            events += result.events
            epochs.update(
                (round(1e3 * fix.epoch.time.since(truth.start)), fix.epoch)
                for fix in result.fixes
                if fix.output
            )
    errors_m: dict[int, list[float]] = {second: [] for second in _LATER_S}
    for end_s in ends_s:
        first_ms = round(1e3 * (math.ceil(truth.start.tow_s + end_s) - truth.start.tow_s))
        for second, found in errors_m.items():
            epoch = epochs.get(first_ms + 1000 * (second - 1))
            seen = truth.errors(epoch) if epoch is not None else {}
            found += [seen[name].range_m if name in seen else math.nan for name in names]
    rate_hz = recording.scenario.streams[0].front_end.sample_rate_hz
    begun = (ends_s[0] - 1.0) * rate_hz
    searched = sum(
        event.what == _SEARCHED and event.sample > begun and event.satellite in names
        for event in events
    )
    return Returns(errors_m, searched)


def blockages_end_s(recording: Recording) -> list[float]:
    """Seconds at which the satellites come back together, the recording going on for a while."""
    scenario = recording.scenario
    steps = scenario.emitters[0].cn0_dbhz
    return [
        second
        for (_, before), (second, dbhz) in pairwise(steps)
        if math.isfinite(dbhz) > math.isfinite(before) and second + 2.0 < scenario.seconds
    ]


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Mean absolute error at the first whole second by grade; quick: one return of one seed."""
    found: dict[str, list[Returns]] = {grade: [] for grade in GRADES}
    for seed in seeds[:1] if quick else seeds:
        with recorded("blockage_return", seed, *(("seconds=63",) if quick else ())) as recording:
            for grade in GRADES[:1] if quick else GRADES:
                found[grade].append(returns(recording, *with_unit(recording, grade)))
    return [_figure(grade, runs) for grade, runs in found.items() if runs]


def _figure(grade: str, runs: Sequence[Returns]) -> Figure:
    def at(second: int) -> np.ndarray:
        return np.array([error for run in runs for error in run.errors_m[second]])

    first, searched = at(1), sum(run.searched for run in runs)
    missing = int(np.isnan(first).sum())
    mean_m = float(np.nanmean(np.abs(first))) if missing < first.size else math.inf
    later = ", ".join(
        f"{np.nanmean(np.abs(at(second))):.2f}"
        for second in _LATER_S[1:]
        if np.isfinite(at(second)).any()
    )
    return Figure(
        f"{grade}: mean |error| at the first whole second of {first.size} returns",
        f"{mean_m:.2f} m, largest {np.nanmax(np.abs(first)):.2f} m; {missing} without a range,"
        f" {searched} searched; later {later} m",
        mean_m <= LIMIT_M and not missing and not searched,
    )
