"""The two-antenna method on a pair of receivers: what slipped, and what repairs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import (
    Judgement,
    Limits,
    Shares,
    State,
    judge,
    shares,
    sure,
)
from deepgnss.evaluate.antenna_pair import AntennaPair
from deepgnss.evaluate.classical_slips import Classical, classical
from deepgnss.io.rinex_obs_reader import ObsFile
from deepgnss.io.rinex_repair import PhaseChange


class Expected(NamedTuple):
    """What phases and navigation are expected to be worth, 1σ."""

    phase_m: float = 0.003  # of one phase, multipath within it
    attitude_radps: float = (
        2.6e-3  # change of the attitude's error over a second, by axis; 0: at rest
    )
    way_mps: float = 0.02  # change of the position's error over a second
    longest_s: float = 30.0  # gap across which a phase is still repaired


@dataclass(frozen=True, slots=True)
class Slips:
    """What was found in a pair."""

    pair: AntennaPair
    between: Judgement
    shares: Shares
    classical: Classical


def find_slips(pair: AntennaPair, expected: Expected) -> Slips:
    """Detect and repair, and tell which antenna's phase it was."""
    root = np.sqrt(2.0)
    limits = Limits(root * expected.phase_m, expected.attitude_radps, expected.longest_s)
    own = Limits(expected.phase_m, expected.way_mps, expected.longest_s)
    between = judge(pair.between(), limits)
    first, second = (judge(pair.alone(side), own) for side in (pair.first, pair.second))
    return Slips(pair, between, shares(between, first, second), classical(pair))


SLIP_COLUMNS: Final = (
    *("week", "tow_s", "satellite", "band", "state", "cycles", "value_cycles", "sigma_cycles"),
    *("antenna", "first_cycles", "second_cycles", "check_m", "gap_s", "lost_lock"),
)
"""Of `slip_table`: antenna is first, second, both, or unknown (then the second is repaired)."""


def slip_table(found: Slips) -> pd.DataFrame:
    """Every slip, and every phase of which it cannot be told, in order of time."""
    state, told = found.between.state, found.shares
    odd = (told.first != 0.0) | (told.second != 0.0) | (state == State.UNDECIDED)
    epoch, number = np.nonzero(odd)
    pair, at = found.pair, (epoch, number)
    signals = [pair.signals[k] for k in number]
    slipped = (told.first != 0.0) | (told.second != 0.0)
    names = np.where(told.first[at] != 0.0, "first", "second").astype(object)
    names[(told.first[at] != 0.0) & (told.second[at] != 0.0)] = "both"
    names[~told.known[at] | ~slipped[at]] = "unknown"
    flagged = pair.first.lost | pair.second.lost
    return pd.DataFrame(
        {
            "week": pair.week[epoch],
            "tow_s": pair.tow_s[epoch],
            "satellite": [signal.satellite for signal in signals],
            "band": [signal.band for signal in signals],
            "state": np.where(slipped[at], "repaired", "undecided"),
            "cycles": found.between.cycles[at],
            "value_cycles": found.between.value_cycles[at],
            "sigma_cycles": found.between.sigma_cycles[at],
            "antenna": names,
            "first_cycles": told.first[at],
            "second_cycles": told.second[at],
            "check_m": found.between.check_m[at],
            "gap_s": found.between.gap_s[at],
            "lost_lock": flagged[at].astype(np.int64),
        },
        columns=list(SLIP_COLUMNS),
    )


# --- repair --------------------------------------------------------------------------------------


def repairs_cycles(found: Slips) -> tuple[FloatArray, FloatArray]:
    """Cycles to add to the phases of either antenna, (n, m): those slipped since the arc began."""
    return _sums(found, found.shares.first), _sums(found, found.shares.second)


def _sums(found: Slips, slipped: FloatArray) -> FloatArray:
    total = np.zeros(slipped.shape[1])
    sums = np.zeros_like(slipped)
    begins = (found.between.state == State.NEW) | (found.between.state == State.UNDECIDED)
    for k in range(slipped.shape[0]):
        total = np.where(begins[k], 0.0, total - slipped[k])
        sums[k] = total
    return sums


def phase_changes(found: Slips, which: int, file: ObsFile) -> list[PhaseChange]:
    """What to write into the file of the first (0) or second (1) receiver.

    A phase that was held against its past is told continuous, one that is undecided or came back
    after too long is told lost; others keep their flag.
    """
    side = (found.pair.first, found.pair.second)[which]
    cycles, state = repairs_cycles(found)[which], found.between.state
    lost = side.lost & ~sure(found.between) | (state == State.UNDECIDED)
    seen = np.cumsum(state != State.ABSENT, axis=0) > 1
    lost |= seen & (state == State.NEW)
    other = (cycles != 0.0) | (lost != side.lost)
    changes = []
    for k, m in zip(*np.nonzero(other & (side.row >= 0) & np.isfinite(side.phase_m)), strict=True):
        signal = found.pair.signals[m]
        code = signal.codes[which]
        changes.append(
            PhaseChange(
                int(side.row[k, m]),
                signal.satellite[0],
                code,
                float(cycles[k, m]),
                bool(lost[k, m]),
            )
        )
    return changes
