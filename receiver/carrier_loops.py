"""The carrier loops there are, by their names in the configuration: the only place that knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from deepgnss.receiver.chirp import ChirpLock
from deepgnss.receiver.kalman_loop import KalmanLoop
from deepgnss.receiver.long_update import LongUpdateLoop
from deepgnss.receiver.modes import CarrierSettings
from deepgnss.receiver.phase_loops import CostasLoop, PhaseLoop
from deepgnss.receiver.trackers import Tracker

_LOOPS: Mapping[str, Callable[[CarrierSettings], PhaseLoop[Any]]] = {
    "pll2": lambda settings: CostasLoop(2, settings.bandwidth_hz, settings.coherent_s),
    "pll3": lambda settings: CostasLoop(3, settings.bandwidth_hz, settings.coherent_s),
    "kalman": lambda settings: KalmanLoop(
        settings.coherent_s,
        settings.kalman.dynamics_mps2,
        settings.oscillator,
        settings.kalman.adaptive,
        settings.kalman.memory_s,
        settings.kalman.fading,
        settings.kalman.square_root,
    ),
    "long_update": lambda settings: LongUpdateLoop(
        settings.long_update.update_s, settings.long_update.dynamics_mps3, settings.oscillator
    ),
}


def carrier_loop(settings: CarrierSettings) -> PhaseLoop[Any]:
    """The loop of the settings, `tracking.carrier.loop`."""
    return _LOOPS[settings.loop](settings)


def chirp_lock(settings: CarrierSettings, faint: Tracker) -> ChirpLock | None:
    """What finds frequency and rate before phase lock, for a loop that needs both.

    faint: frequency lock for signals too weak for it.
    """
    if settings.loop != "long_update":
        return None
    return ChirpLock(faint)
