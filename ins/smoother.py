"""Rauch–Tung–Striebel smoothing of a finished run.

With feedback the forward filter leaves, at every epoch, a nominal state whose error it expects to
be zero. Going back, e is the error found *later* of that state: at epoch k + 1 it is the error x
taken off there plus what was still found after, and it comes back as
e_k = C·(x_{k+1} + e_{k+1}), C = P_k·Φᵀ·P⁻_{k+1}⁻¹, with P_k − C·(P⁻_{k+1} − P_{k+1|N})·Cᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deepgnss.ins.error_state import Estimate, turned_along
from deepgnss.ins.integration import FilterEpoch


def smoothed(epochs: Sequence[FilterEpoch]) -> tuple[Estimate, ...]:
    """Estimates at the same epochs from all measurements, before and after.

    Stretches that were started anew are smoothed each by itself. Memory: that of the epochs.
    """
    found: list[Estimate] = []
    for k in range(len(epochs) - 1, -1, -1):
        estimate = epochs[k].estimate
        if k + 1 == len(epochs) or not epochs[k + 1].continues:
            error, P = np.zeros(estimate.layout.size), estimate.P
        else:
            after = epochs[k + 1]
            scale = np.sqrt(np.diagonal(after.P_predicted))  # metres beside rad/s
            factor = cho_factor(after.P_predicted / np.outer(scale, scale), lower=True)
            C = (cho_solve(factor, (after.Phi @ estimate.P) / scale[:, np.newaxis])).T / scale
            back = turned_along(-after.x_turning_mps, P.shape[0])  # about the prediction
            P = estimate.P - C @ (after.P_predicted - back @ P @ back.T) @ C.T
            error, P = C @ (after.x + back @ error), 0.5 * (P + P.T)
        found.append(estimate.corrected(error, P))
    return tuple(reversed(found))
