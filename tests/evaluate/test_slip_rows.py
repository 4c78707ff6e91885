"""The short versions of SLIP-95 and SLIP-ATT reach their targets."""

from __future__ import annotations

import pytest

from deepgnss.evaluate.reproduce import slips
from deepgnss.evaluate.reproduce.table import verdict


@pytest.mark.slow
def test_hard_slips_all_found_none_false() -> None:
    figures = slips.measure_slips(True, [5])
    print(*figures, sep="\n")
    assert verdict(figures)
    assert sum(figure.met is True for figure in figures) == 2


@pytest.mark.slow
def test_attitude_error_does_what_theory_says() -> None:
    figures = slips.measure_attitude(True, [5])
    print(*figures, sep="\n")
    assert verdict(figures)
    assert all(figure.met for figure in figures)
