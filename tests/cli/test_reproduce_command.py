"""The table of figures: rows, verdicts, exit code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.core.errors import ConfigError
from deepgnss.evaluate.reproduce import ROWS, Figure, measured, percent, rows, rows_named, verdict
from deepgnss.evaluate.reproduce.table import QUICK_S


def test_ids_are_unique_and_rows_are_chosen_by_them() -> None:
    assert len({row.id for row in ROWS}) == len(ROWS)
    assert [row.id for row in rows_named(["FRAME-20", "BIT-20", "FRAME-20"])] == [
        "FRAME-20",
        "BIT-20",
    ]
    assert rows_named([]) == ROWS
    with pytest.raises(ConfigError, match="--only XX: expected one of CP-S48"):
        rows_named(["BIT-20", "XX"])


def test_figures_for_comparison_are_not_judged() -> None:
    assert verdict([Figure("a", "1", True), Figure("b", "2", None)])
    assert not verdict([Figure("a", "1", True), Figure("b", "2", False)])
    assert percent(995, 1000) == "99.50 % of 1000"


@pytest.mark.parametrize(("met", "code"), [(True, 0), (False, 1)])
def test_a_missed_row_shows_and_sets_the_exit_code(
    monkeypatch: pytest.MonkeyPatch, met: bool, code: int
) -> None:
    asked: list[tuple[bool, list[int]]] = []

    def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
        asked.append((quick, list(seeds)))
        return [Figure("GPS", "42 m", met)]

    some = (replace(ROWS[0], measure=measure), replace(ROWS[1], measure=None))
    monkeypatch.setattr(rows, "ROWS", some)
    run = CliRunner().invoke(cli, ["reproduce", "--quick", "--seeds", "2"])
    assert run.exit_code == code
    assert asked == [(True, [1, 2])]
    assert "42 m" in run.output
    assert ("missed: CP-S48" in run.output) is not met
    assert "CP-D47" in run.output.split("not yet")[1]


def test_figures_and_their_order_do_not_depend_on_the_number_of_processes() -> None:
    some = rows_named(["FFT-PD", "BIT-20"])
    alone, beside = (list(measured(some, True, [1], jobs)) for jobs in (1, 2))
    assert [one.row.id for one in beside] == ["FFT-PD", "BIT-20"]
    assert [one.figures for one in alone] == [one.figures for one in beside]
    assert all(one.cpu_s > 0.0 for one in alone + beside)


def test_rows_that_measure_the_machine_come_last_and_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
        return [Figure("a", "1", None)]

    some = [
        replace(ROWS[0], measure=measure, alone=True),
        replace(ROWS[1], measure=None),
        replace(ROWS[2], measure=measure),
    ]
    found = measured(some, True, [1], 4)
    assert [one.row.id for one in found] == [ROWS[2].id, ROWS[0].id]


def test_quick_is_quick() -> None:
    """Every row says what its quick version may take; together less than 5 minutes of two cores."""
    there = [row for row in ROWS if row.measure is not None]
    assert all(row.quick_s > 0.0 for row in there)
    alone_s = sum(row.quick_s for row in there if row.alone)
    assert alone_s + sum(row.quick_s for row in there if not row.alone) / 2.0 < QUICK_S
