"""Correlator outputs as frequency tracking of a weak signal leaves them: random in all they may be.

No phase is kept: it starts anywhere and turns with what the frequency loop misses, an offset, a
rate, and noise, a new value with every window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray

PERIOD_S = 1e-3
CN0_DBHZ = 20.0


@dataclass(frozen=True, slots=True)
class Residual:
    """Standard deviations of what frequency tracking at 20 dB-Hz leaves."""

    offset_hz: float = 2.0
    rate_hzps: float = 0.3  # a static receiver's satellites change by up to 0.8
    noise_hz: float = 0.5  # from window to window, once the generator's own steps are undone
    window_s: float = 0.32

    def cycles(self, count: int, step_s: float, rng: np.random.Generator) -> FloatArray:
        """Phase in the middles of `count` correlations of step_s, cycles."""
        t = step_s * (np.arange(count) + 0.5)
        window = (t // self.window_s).astype(np.int64)
        frequency_hz = (
            rng.normal(0.0, self.offset_hz)
            + rng.normal(0.0, self.rate_hzps) * (t - t[count // 2])
            + rng.normal(0.0, self.noise_hz, int(window[-1]) + 1)[window]
        )
        return np.asarray(rng.random() + np.cumsum(frequency_hz) * step_s)


def received(
    signs: FloatArray,
    step_s: float,
    rng: np.random.Generator,
    cn0_dbhz: float = CN0_DBHZ,
    residual: Residual = Residual(),
) -> ComplexArray:
    """Correlations of unit amplitude with these signs (n,), step_s long, in noise."""
    sigma = np.sqrt(0.5 / (10.0 ** (0.1 * cn0_dbhz) * step_s))
    noise = sigma * (rng.normal(size=signs.size) + 1j * rng.normal(size=signs.size))
    turn = np.exp(2j * np.pi * residual.cycles(signs.size, step_s, rng))
    return np.asarray(signs * turn + noise)
