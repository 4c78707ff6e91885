"""Directions of a sensor's axes in the vehicle: three letters, or a rotation matrix."""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
from pydantic import AfterValidator, BeforeValidator

from deepgnss.core.records import FloatArray
from deepgnss.io.config.quantity import Quantity, misfit

_DIRECTIONS: Final = {
    "F": (1.0, 0.0, 0.0),
    "B": (-1.0, 0.0, 0.0),
    "R": (0.0, 1.0, 0.0),
    "L": (0.0, -1.0, 0.0),
    "D": (0.0, 0.0, 1.0),
    "U": (0.0, 0.0, -1.0),
}
_ROUNDING: Final = 1e-3  # of a matrix typed in by hand

Entry = Annotated[float, Quantity(-1.0, 1.0, "")]
MatrixRow = tuple[Entry, Entry, Entry]
Matrix = tuple[MatrixRow, MatrixRow, MatrixRow]


def axes_matrix(axes: str | Matrix) -> FloatArray:
    """Rotation C_bs (3, 3) from a sensor's axes s to the body's FRD: v_b = C_bs @ v_s."""
    if isinstance(axes, str):
        return np.column_stack([_DIRECTIONS[letter] for letter in axes])
    return np.array(axes, dtype=np.float64)


def _letters(value: object) -> object:
    if not isinstance(value, str):
        return value
    pairs = sorted(np.flatnonzero(_DIRECTIONS[x])[0] for x in value if x in _DIRECTIONS)
    if len(value) != 3 or pairs != [0, 1, 2]:
        raise misfit("expected three of F/B, R/L, U/D such as FRD or RFU, or a 3×3 matrix")
    return value


def _rotation(axes: str | Matrix) -> str | Matrix:
    C = axes_matrix(axes)
    if np.abs(C @ C.T - np.eye(3)).max() > _ROUNDING:
        raise misfit("expected a rotation: rows of length 1 at right angles")
    if np.linalg.det(C) < 0.0:
        raise misfit("expected right-handed axes such as FRD, RFU or FLU, not their mirror image")
    return axes


Axes = Annotated[str | Matrix, BeforeValidator(_letters), AfterValidator(_rotation)]
