"""The carrier loops there are, by their names in the configuration: the only place that knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from deepgnss.receiver.kalman_loop import KalmanLoop
from deepgnss.receiver.modes import CarrierSettings
from deepgnss.receiver.phase_loops import CostasLoop, PhaseLoop

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
}


def carrier_loop(settings: CarrierSettings) -> PhaseLoop[Any]:
    """The loop of the settings, `tracking.carrier.loop`."""
    return _LOOPS[settings.loop](settings)
