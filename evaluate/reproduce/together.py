"""Rows measured side by side, and what each of them took.

Rows of one module may share recordings, so one process takes them all; rows that measure the
machine itself come last, and alone. A row's figures do not depend on who measures beside it.
"""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

from deepgnss.evaluate.reproduce.rows import rows_named
from deepgnss.evaluate.reproduce.table import Figure, Row


class Measured(NamedTuple):
    """A row's figures and the CPU time behind them, child processes included."""

    row: Row
    figures: list[Figure]
    cpu_s: float


def measured(
    rows: Sequence[Row], quick: bool, seeds: Sequence[int], jobs: int
) -> Iterator[Measured]:
    """Measure rows in up to `jobs` processes; they come in the order given, as they are ready.

    Rows without a measure are passed over, those to be measured alone come after the others.
    """
    asked = [row for row in rows if row.measure is not None]
    beside, alone = ([row for row in asked if row.alone is which] for which in (False, True))
    groups: dict[str, list[str]] = {}
    for row in beside:
        groups.setdefault(row.module, []).append(row.id)
    if jobs == 1 or len(groups) < 2:
        alone = beside + alone
    else:
        yield from _side_by_side(beside, groups, quick, seeds, jobs)
    for row in alone:
        yield _measure(row, quick, seeds)


def _side_by_side(
    rows: Sequence[Row],
    groups: Mapping[str, Sequence[str]],
    quick: bool,
    seeds: Sequence[int],
    jobs: int,
) -> Iterator[Measured]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(groups)), context) as executor:
        try:
            futures = {
                name: executor.submit(_measure_group, ids, quick, tuple(seeds))
                for name, ids in groups.items()
            }
            for row in rows:
                figures, cpu_s = futures[row.module].result()[row.id]
                yield Measured(row, figures, cpu_s)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


def _measure_group(
    ids: Sequence[str], quick: bool, seeds: Sequence[int]
) -> dict[str, tuple[list[Figure], float]]:
    return {one.row.id: one[1:] for one in (_measure(row, quick, seeds) for row in rows_named(ids))}


def _measure(row: Row, quick: bool, seeds: Sequence[int]) -> Measured:
    if row.measure is None:
        raise ValueError(f"{row.id}: not yet")
    before_s = _cpu_s()
    figures = row.measure(quick, seeds)
    return Measured(row, figures, _cpu_s() - before_s)


def _cpu_s() -> float:
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in spent)
