"""What the last tenths of a second did to the error of velocity, for what was measured before them.

A velocity measured a while ago and carried on by the increments since has in it what those were
wrong by, as the navigation has. So the difference of the two is the navigation's error of then,
less what corrections of its velocity have taken off since. With steps k = 1 … n from then to now,
of transition Φ_k, a correction x_k at the end of each, and the error δ_n before that of now, whose
other parts (attitude, biases) hardly change within a second,

    z = δv_n − Σ G_k·(δ_n + X_k),   G_k = (Φ_k − I) rows of velocity,   X_k = x_k + … + x_{n−1}

so that z + Σ G_k·X_k is measured of δ_n with the slope H_n − Σ G_k. Where a manoeuvre begins it
matters which increments those were: a heading off by φ does to the velocity what was accelerated
since, φ·Σ a_k·Δt_k, and not what the acceleration of now would have done in that time.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray
from deepgnss.ins.error_model import VELOCITY
from deepgnss.ins.measurements import Measurement
from deepgnss.ins.trajectory import Trajectory

KEPT_S: Final = 1.5
"""For which steps are remembered: the oldest Doppler of the longest windows is as old as that."""

_SPREAD2: Final = 1.0 / 12.0  # variance of ages within ± half of what they are in the mean


class _Step(NamedTuple):
    """The way to a tag and what was corrected there."""

    length_s: float
    Phi: FloatArray  # (states, states)
    x: FloatArray  # (size,) error that was taken off


class Past:
    """The last steps of a navigation, newest first."""

    def __init__(self) -> None:
        self._steps: deque[_Step] = deque()
        self._kept_s = 0.0

    def note(self, trajectory: Trajectory, x: FloatArray) -> None:
        """Keep a step (its Φ) and the errors (size,) taken off at its end."""
        step = _step(trajectory, x)
        if step.length_s <= 0.0:
            return
        self._steps.appendleft(step)
        self._kept_s += step.length_s
        while self._kept_s - self._steps[-1].length_s > KEPT_S:
            self._kept_s -= self._steps.pop().length_s

    def aged(
        self, velocity: Measurement, age_s: float, trajectory: Trajectory, P: FloatArray
    ) -> Measurement:
        """A velocity measured so long ago in the mean, and carried on.

        P: covariance of the errors now. trajectory: the step that led to now. Before the first
        step that is known, its like is assumed. Every satellite's Doppler has an age of its own,
        half as much to half as much again: what the velocity's error has grown by is known no
        better than that.
        """
        if age_s == 0.0:
            return velocity
        z, H = velocity.z.copy(), velocity.H.copy()
        grown = np.zeros(H.shape)
        left_s, since = age_s, np.zeros(H.shape[1])
        steps = (_step(trajectory, since), *self._steps)
        for k, (length_s, Phi, x) in enumerate(steps):
            states = Phi.shape[0]
            since = since + x
            share = left_s / length_s if k + 1 == len(steps) else min(left_s / length_s, 1.0)
            G = share * (Phi[VELOCITY] - np.eye(states)[VELOCITY])
            grown[:, :states] += G
            z += G @ since[:states]
            left_s -= length_s
            if left_s <= 0.0:
                break
        R = velocity.R + _SPREAD2 * grown @ P @ grown.T
        return velocity._replace(z=z, H=H - grown, R=R)


def _step(trajectory: Trajectory, x: FloatArray) -> _Step:
    return _Step(float(trajectory.time_s[-1] - trajectory.time_s[0]), trajectory.Phi, x)
