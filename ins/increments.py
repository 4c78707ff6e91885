"""Increments over the stretch that is asked for: cut at instants, gaps found and bridged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import FloatArray, ImuBlock

SAME_INSTANT_S: Final = 1e-8
"""Instants closer than this are one: float64 seconds of a week resolve 1e-10 s."""

LONGEST_BRIDGE_S: Final = 1.0
"""Longest gap that is bridged."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch without increments, seconds since the block's origin."""

    start_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """Length of the gap."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class Reading:
    """One increment as the sensors gave it."""

    dt_s: float
    dtheta_b_rad: FloatArray  # (3,)
    dv_b_mps: FloatArray  # (3,)


def rows(block: ImuBlock, first: int, end: int) -> ImuBlock:
    """Increments first … end − 1 of a block."""
    return ImuBlock(
        block.origin,
        block.time_s[first:end],
        block.dt_s[first:end],
        block.dtheta_b_rad[first:end],
        block.dv_b_mps[first:end],
    )


def joined(*blocks: ImuBlock) -> ImuBlock:
    """Blocks of one origin, one after the other."""
    return ImuBlock(
        blocks[0].origin,
        np.concatenate([block.time_s for block in blocks]),
        np.concatenate([block.dt_s for block in blocks]),
        np.concatenate([block.dtheta_b_rad for block in blocks]),
        np.concatenate([block.dv_b_mps for block in blocks]),
    )


def between(block: ImuBlock, start_s: float, end_s: float = np.inf) -> ImuBlock:
    """Increments from start to end (seconds since the origin); those at the ends by their share."""
    first = int(np.searchsorted(block.time_s, start_s + SAME_INSTANT_S, side="right"))
    end = int(np.searchsorted(block.time_s, end_s - SAME_INSTANT_S, side="left"))
    if end < block.time_s.size and block.time_s[end] - block.dt_s[end] < end_s - SAME_INSTANT_S:
        end += 1  # reaches up to the end or across it
    part = rows(block, first, max(first, end))
    if part.time_s.size == 0:
        return part
    columns = part.time_s, part.dt_s, part.dtheta_b_rad, part.dv_b_mps
    return ImuBlock(block.origin, *_cut(*columns, start_s, end_s))


@brief_kernel
def _cut(
    time_s: FloatArray,
    dt_s: FloatArray,
    dtheta_b_rad: FloatArray,
    dv_b_mps: FloatArray,
    start_s: float,
    end_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Columns of a block whose first and last increment count by their share of a stretch."""
    until_s, kept_s = time_s.copy(), dt_s.copy()
    turned, gained = dtheta_b_rad.copy(), dv_b_mps.copy()
    last = time_s.size - 1
    if until_s[last] > end_s + SAME_INSTANT_S:
        until_s[last] = end_s
    for row in range(0, last + 1, max(last, 1)):  # the first and the last
        since_s = time_s[row] - dt_s[row]
        if row == 0 and since_s < start_s - SAME_INSTANT_S:
            since_s = start_s
        share = min(1.0, (until_s[row] - since_s) / dt_s[row])
        kept_s[row] *= share
        turned[row] *= share
        gained[row] *= share
    return until_s, kept_s, turned, gained


def gaps(block: ImuBlock, start_s: float, usual_s: float) -> list[tuple[int, Gap]]:
    """Gaps since `start_s`, each with the row that follows it.

    A stretch counts from half the usual interval on; less is the jitter of time stamps.
    """
    return [
        (int(row), Gap(float(before_s), float(before_s + missing_s)))
        for row, before_s, missing_s in zip(
            *_missing(block.time_s, block.dt_s, start_s, 0.5 * usual_s), strict=True
        )
    ]


@brief_kernel
def _missing(
    time_s: FloatArray, dt_s: FloatArray, start_s: float, least_s: float
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Rows ahead of which more than the least is missing, since when, and how long."""
    before_s = np.append(start_s, time_s)[: time_s.size]
    missing_s = time_s - dt_s - before_s
    rows = np.flatnonzero(missing_s > least_s)
    return rows, before_s[rows], missing_s[rows]


def bridge(block: ImuBlock, row: int, gap: Gap, before: Reading | None) -> ImuBlock:
    """Increments for a gap ahead of a row: rates linear between those on either side.

    Without a reading before, those of the row go on unchanged.
    """
    after = Reading(block.dt_s[row], block.dtheta_b_rad[row], block.dv_b_mps[row])
    before = after if before is None else before
    count = max(1, round(gap.length_s / after.dt_s))
    dt_s = gap.length_s / count
    way = ((np.arange(count) + 0.5) / count)[:, np.newaxis]

    def filled(one: FloatArray, other: FloatArray) -> FloatArray:
        return ((1.0 - way) * one / before.dt_s + way * other / after.dt_s) * dt_s

    return ImuBlock(
        block.origin,
        np.linspace(gap.start_s, gap.end_s, count + 1)[1:],
        np.full(count, dt_s),
        filled(before.dtheta_b_rad, after.dtheta_b_rad),
        filled(before.dv_b_mps, after.dv_b_mps),
    )
