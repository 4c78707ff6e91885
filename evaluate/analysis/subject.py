"""What an error budget is drawn up for: unit, oscillator, loops, signal and motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS, STANDARD_GRAVITY_MPS2
from deepgnss.core.records import GPS_L1CA, FloatArray, ImuGrade, Oscillator, SignalId
from deepgnss.io.config import Config, grade_of, oscillator_of
from deepgnss.theory.loop_response import Loop, carrier_loop
from deepgnss.theory.phase_budget import Stress

_ALL_LINES: Final = frozenset({"fft", "sfft"})


@dataclass(frozen=True, slots=True)
class Subject:
    """Everything the budgets ask for; each of them uses its part."""

    grade: ImuGrade = field(default_factory=lambda: grade_of("MTi-G"))
    oscillator: Oscillator = field(default_factory=lambda: oscillator_of("OCXO"))
    signal: SignalId = GPS_L1CA
    cn0_dbhz: float = 45.0
    satellites: int = 8  # whose phases tell the clock before the loop opens
    # carrier loop
    order: int = 3
    bandwidth_hz: float = 7.0
    coherent_s: float = 0.020
    damping: float | None = None  # of order 2; None: √½
    # code loop
    code_bandwidth_hz: float = 0.1
    spacing_chips: float = 0.25
    code_coherent_s: float = 0.020
    front_end_hz: float = math.inf  # two-sided
    # frequency discriminator
    interval_s: float = 0.020
    window_s: float = 0.320
    lines: int | None = None  # searched; None: all
    # motion of the vehicle, level; the line of sight points along it, raised by the elevation
    across_mps2: float = 0.0
    along_mps2: float = 0.0
    jerk_mps3: float = 0.0  # along the line of sight
    elevation_rad: float = 0.0
    vibration_g2phz: float = 0.0

    @property
    def wavelength_m(self) -> float:
        """Of the carrier."""
        return SPEED_OF_LIGHT_MPS / self.signal.carrier_hz

    @property
    def force_n_mps2(self) -> FloatArray:
        """Specific force (3,): north is along, east across."""
        return np.array([self.along_mps2, self.across_mps2, -STANDARD_GRAVITY_MPS2])

    @property
    def sight_n(self) -> FloatArray:
        """Unit vector (3,) to the satellite."""
        return np.array([math.cos(self.elevation_rad), 0.0, -math.sin(self.elevation_rad)])

    @property
    def rate_hzps(self) -> float:
        """Frequency rate by the acceleration towards the satellite."""
        return self.along_mps2 * math.cos(self.elevation_rad) / self.wavelength_m

    @property
    def loop(self) -> Loop:
        """The carrier loop updated without end."""
        return carrier_loop(self.order, self.bandwidth_hz, self.damping)

    def stress(self, cn0_dbhz: float | None = None) -> Stress:
        """What the unaided carrier loop has to bear: the derivative that it lags behind."""
        by_order = {2: self.rate_hzps, 3: self.jerk_mps3 / self.wavelength_m}
        return Stress(
            self.cn0_dbhz if cn0_dbhz is None else cn0_dbhz,
            self.coherent_s,
            self.signal.carrier_hz,
            self.oscillator,
            self.vibration_g2phz,
            by_order.get(self.order, 0.0),
        )


def subject_of(config: Config) -> Subject:
    """What a run with this configuration relies on; motion and C/N0 are left at their defaults."""
    tracking, usual = config.tracking, Subject()
    loop = str(tracking.carrier.loop)
    frequency = tracking.frequency
    return Subject(
        grade=usual.grade if config.imu is None else config.imu.grade.build(),
        oscillator=config.oscillator.oscillator(),
        order=int(loop[-1]) if loop[-1].isdigit() else usual.order,
        bandwidth_hz=tracking.carrier.bandwidth,
        coherent_s=tracking.carrier.coherent,
        code_bandwidth_hz=tracking.code.bandwidth[-1],
        spacing_chips=tracking.code.spacing,
        code_coherent_s=tracking.code.coherent,
        window_s=frequency.window,
        lines=None if frequency.discriminator in _ALL_LINES else frequency.bins,
    )
