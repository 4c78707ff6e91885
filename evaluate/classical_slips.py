"""The classical tests S 2 compares with, on double differences against one reference satellite.

*Pseudorange–phase*: the change of phase less pseudorange, in cycles, rounded. *Ionospheric
residual*: the change of the phases' difference between two frequencies, in metres, against 0.1 m;
it does not tell on which frequency the slip was, and pairs such as 3 and 2 cycles escape it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import BoolArray, IntArray
from deepgnss.evaluate.antenna_pair import AntennaPair

RESIDUAL_LIMIT_M: Final = 0.1
"""S 2."""

_USUAL: Final = 0.8  # of the epochs that the satellite most seen has


class Classical(NamedTuple):
    """Changes from the epoch before, (n, m); NaN where one is missing."""

    reference: tuple[str, ...]  # satellite of each signal's double difference …
    column: IntArray  # … and the number of that satellite's signal
    code_cycles: FloatArray  # phase less pseudorange
    residual_m: FloatArray  # first frequency less second: the same for both signals
    check_m: FloatArray  # S's v of what rounding makes of code_cycles

    @property
    def told_by_code(self) -> FloatArray:
        """Whole cycles by pseudorange and phase."""
        return np.asarray(np.round(np.nan_to_num(self.code_cycles)), np.float64)

    @property
    def told_by_residual(self) -> BoolArray:
        """Where the residual jumps, bool."""
        return np.asarray(np.abs(np.nan_to_num(self.residual_m)) > RESIDUAL_LIMIT_M)


def classical(pair: AntennaPair) -> Classical:
    """Both tests over the whole pair."""
    wavelength_m = pair.wavelength_m
    phase_m = pair.second.phase_m - pair.first.phase_m
    code_m = pair.second.code_m - pair.first.code_m
    references, columns = _references(pair)
    phase_m, code_m = phase_m - phase_m[:, columns], code_m - code_m[:, columns]
    code_cycles = _changes(phase_m - code_m) / wavelength_m
    own = columns == np.arange(columns.size)
    code_cycles[:, own] = np.nan
    changes_m = _changes(phase_m)
    residual_m, check_m = np.full_like(phase_m, np.nan), np.full_like(phase_m, np.nan)
    for one, two in couples(pair):
        if own[one] or own[two]:
            continue
        residual = changes_m[:, one] - changes_m[:, two]
        repaired = [np.round(code_cycles[:, k]) * wavelength_m[k] for k in (one, two)]
        for k in (one, two):
            residual_m[:, k] = residual
            check_m[:, k] = repaired[0] - repaired[1] - residual
    return Classical(references, columns, code_cycles, residual_m, check_m)


def _references(pair: AntennaPair) -> tuple[tuple[str, ...], IntArray]:
    """The satellite highest on average, by system, of those seen nearly throughout."""
    there = np.isfinite(pair.first.phase_m + pair.second.phase_m)
    share = there.mean(axis=0)
    height = np.where(there, pair.first.height, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    place = {(signal.satellite, signal.band): k for k, signal in enumerate(pair.signals)}
    chosen: dict[str, str] = {}
    for system in {signal.satellite[0] for signal in pair.signals}:
        mine = np.array([signal.satellite[0] == system for signal in pair.signals])
        usual = mine & (share >= _USUAL * share[mine].max())
        chosen[system] = pair.signals[int(np.argmax(np.where(usual, height, -1.0)))].satellite
    names = tuple(chosen[signal.satellite[0]] for signal in pair.signals)
    bands = (signal.band for signal in pair.signals)
    return names, np.array([place[key] for key in zip(names, bands, strict=True)])


def couples(pair: AntennaPair) -> list[tuple[int, int]]:
    """Both signals of each satellite that has two."""
    names = [signal.satellite for signal in pair.signals]
    return [(k, k + 1) for k in range(len(names) - 1) if names[k] == names[k + 1]]


def _changes(values: FloatArray) -> FloatArray:
    return np.vstack([np.full((1, values.shape[1]), np.nan), np.diff(values, axis=0)])
