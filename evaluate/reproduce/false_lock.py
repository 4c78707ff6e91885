"""LOCK-25: a frequency lock forced ±25 Hz off is noticed and left, T 5.4.2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.evaluate.reproduce.table import Figure, percent
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import Mode, TrackingSettings

LEVELS_DBHZ = (20.0, 24.0, 30.0, 45.0)
OFF_HZ = 25.0
WITHIN_S = 2.0
_SETTLED_S = 6.0  # before the lock is forced off, at full strength for the first two thirds
_RIGHT_HZ = 5.0


def corrected(cn0_dbhz: float, off_hz: float, seed: int) -> bool:
    """Whether a channel in frequency tracking is back within two seconds.

    The satellite's Doppler jumps by ±25 Hz, which leaves the generator where a false lock has it.
    """
    at_s = _SETTLED_S + 0.01 * (seed % 32)  # anywhere within a window
    strong_s = 2.0 / 3.0 * _SETTLED_S
    model = Model(
        lambda t: 45.0 if t < strong_s else cn0_dbhz,
        rate_hzps=0.5,
        seed=seed,
        jump=(at_s, -off_hz),
    )
    # Frequency tracking at every strength: the phase loop has a detector of its own.
    settings = TrackingSettings(phase_threshold_dbhz=60.0)
    channel = start(model, settings, doppler_error_hz=3.0, code_error_chips=0.1)
    run(channel, at_s + WITHIN_S)
    return channel.mode is Mode.WEAK and abs(_error_hz(channel, model)) < _RIGHT_HZ


def _error_hz(channel: Channel, model: Model) -> float:
    t = np.array([channel.command.sample / RATE_HZ])
    return float(channel.command.carrier_hz - model.doppler_at_hz(t)[0])


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Shares of forced false locks left in time."""
    trials = 3 if quick else 100
    figures = []
    for cn0_dbhz in LEVELS_DBHZ:
        done = [
            corrected(cn0_dbhz, OFF_HZ if k % 2 else -OFF_HZ, 1000 * seed + k)
            for seed in seeds
            for k in range(trials)
        ]
        right = sum(done)
        figures.append(
            Figure(f"{cn0_dbhz:g} dB-Hz", percent(right, len(done)), right >= 0.99 * len(done))
        )
    return figures
