"""Integers nearest to correlated estimates: all that fit about as well as the best.

(x − k)ᵀ Q⁻¹ (x − k) is least over integers k where no other vector can be, but x of satellites that
share a way and a clock are so alike that neighbours in one of them alone say nothing. So they are
made less alike first, by integer combinations (Lenstra, Lenstra and Lovász), and the tree of those
is searched from its firmest branch on (Schnorr and Euchner).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import FloatArray

_LOVASZ: Final = 0.75

IntArray = NDArray[np.int64]


def nearest_integers(
    x: FloatArray, Q: FloatArray, margin: float, most: int
) -> tuple[IntArray, FloatArray] | None:
    """Integer vectors (m, n) and their distances (m,) up to a margin beyond the least, best first.

    Parameters: x (n,), its covariance Q (n, n).
    Returns: None where there are more than `most`.
    """
    # Columns of B span the lattice: |B (x − k)|² is the distance.
    B = np.linalg.inv(np.linalg.cholesky(Q))
    Z = _reduced(B)
    R = _triangle(B @ Z)
    target = R @ np.linalg.solve(Z.astype(np.float64), x)
    found = _near(R, target, margin, most)
    if found is None:
        return None
    k, distance = found
    order = np.argsort(distance, kind="stable")
    kept = order[distance[order] <= distance[order[0]] + margin]
    return k[kept] @ Z.T, distance[kept]


def _reduced(B: FloatArray) -> IntArray:
    """Integer combinations Z (n, n) that make the columns of B Z short and all but square."""
    size = B.shape[1]
    Z = np.eye(size, dtype=np.int64)
    k = 1
    R = _triangle(B)
    while k < size:
        for j in range(k - 1, -1, -1):
            times = int(np.rint(R[j, k] / R[j, j]))
            if times:
                Z[:, k] -= times * Z[:, j]
                R[:, k] -= times * R[:, j]
        if R[k, k] ** 2 >= (_LOVASZ - (R[k - 1, k] / R[k - 1, k - 1]) ** 2) * R[k - 1, k - 1] ** 2:
            k += 1
            continue
        Z[:, [k - 1, k]] = Z[:, [k, k - 1]]
        R = _triangle(R[:, [*range(k - 1), k, k - 1, *range(k + 1, size)]])
        k = max(k - 1, 1)
    return Z


def _triangle(B: FloatArray) -> FloatArray:
    """R of B = QR."""
    return np.linalg.qr(B)[1]


def _near(
    R: FloatArray, target: FloatArray, margin: float, most: int
) -> tuple[IntArray, FloatArray] | None:
    """Integer vectors k with |R k − target|² within a margin of the least; None: too many."""
    size = target.size
    found: list[tuple[float, IntArray]] = []
    best = np.inf
    k = np.zeros(size, dtype=np.int64)

    def descend(level: int, so_far: float) -> bool:
        nonlocal best, found
        rest = target[level] - R[level, level + 1 :] @ k[level + 1 :]
        middle = rest / R[level, level]
        first = int(np.rint(middle))
        side = 1 if middle > first else -1
        step = 0
        while True:
            k[level] = first + side * ((step + 1) // 2) * (1 if step % 2 else -1)
            distance = so_far + (rest - R[level, level] * k[level]) ** 2
            if distance > best + margin:
                return True
            if level:
                if not descend(level - 1, distance):
                    return False
            else:
                best = min(best, distance)
                found = [one for one in found if one[0] <= best + margin]
                found.append((distance, k.copy()))
                if len(found) > most:
                    return False
            step += 1

    if not descend(size - 1, 0.0):
        return None
    return np.array([one for _, one in found]), np.array([one for one, _ in found])
