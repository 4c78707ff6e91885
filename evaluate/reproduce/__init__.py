"""Figures to reproduce, and to beat: published ones beside those measured here.

To add one: write `def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]` in a module of
its own here and name it in the row of `rows.ROWS`.
"""

from deepgnss.evaluate.reproduce.rows import ROWS, rows_named
from deepgnss.evaluate.reproduce.table import Figure, Measure, Row, percent, verdict
from deepgnss.evaluate.reproduce.together import Measured, measured

__all__ = [
    "ROWS",
    "Figure",
    "Measure",
    "Measured",
    "Row",
    "measured",
    "percent",
    "rows_named",
    "verdict",
]
