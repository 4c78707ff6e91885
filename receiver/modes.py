"""What a channel can be doing, how it may change, and the parameters it goes by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from deepgnss.core.records import Oscillator


class Mode(Enum):
    """What a channel is doing."""

    PULL_IN = "pull-in"  # wide FLL and DLL on a fresh acquisition
    FREQUENCY = "FLL"  # frequency lock; phase is not kept
    PHASE = "PLL"  # phase lock on whole symbols
    WEAK = "FFT"  # frequency tracked by the spectrum of a window of symbols
    HOLD = "hold"  # signal gone: generators coast
    LOST = "lost"


# Every change of mode there is; the channel refuses any other.
TRANSITIONS: dict[Mode, frozenset[Mode]] = {
    Mode.PULL_IN: frozenset({Mode.FREQUENCY, Mode.WEAK, Mode.LOST}),
    Mode.FREQUENCY: frozenset({Mode.PHASE, Mode.WEAK, Mode.HOLD}),
    Mode.PHASE: frozenset({Mode.FREQUENCY, Mode.WEAK, Mode.HOLD}),
    Mode.WEAK: frozenset({Mode.PHASE, Mode.HOLD}),
    Mode.HOLD: frozenset({Mode.PHASE, Mode.FREQUENCY, Mode.WEAK, Mode.LOST}),
    Mode.LOST: frozenset(),
}


@dataclass(frozen=True, slots=True)
class FrequencySettings:
    """How a signal too weak for its phase is tracked, as the config's `tracking.frequency`."""

    discriminator: str = "pfft"
    bins: int = 3  # of pfft and psfft
    window_s: float = 0.32
    order: int = 2
    gain: float = 0.3  # of the frequency seen that goes to the generator; T 3.2.1: 1, order 1
    phase: bool = False  # take the phase from the peak as well


@dataclass(frozen=True, slots=True)
class KalmanSettings:
    """A Kalman carrier loop, as the config's `tracking.carrier.kalman`."""

    dynamics_mps2: float = 0.3  # by which the acceleration in the line of sight changes in 1 s, 1σ
    adaptive: bool = True
    memory_s: float = 1.0
    fading: float = 1.0
    square_root: bool = True


IDEAL_OSCILLATOR = Oscillator("ideal", 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class LongUpdateSettings:
    """Parameters of the long-update loop."""

    update_s: float = 0.2  # whole symbols
    dynamics_mps3: float = 0.75  # by which the jerk in the line of sight changes in 1 s, 1σ


@dataclass(frozen=True, slots=True)
class CarrierSettings:
    """How the phase is tracked, as the config's `tracking.carrier`."""

    loop: str = "pll3"
    bandwidth_hz: float = 7.0  # of pll2 and pll3
    coherent_s: float = 0.02  # of an interval
    oscillator: Oscillator = IDEAL_OSCILLATOR  # for loops that model it
    kalman: KalmanSettings = KalmanSettings()
    long_update: LongUpdateSettings = LongUpdateSettings()


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """Parameters of a channel, as the config's `tracking` section."""

    carrier: CarrierSettings = CarrierSettings()
    code_order: int = 2
    code_bandwidths_hz: tuple[float, ...] = (3.0, 1.0, 0.1)
    spacing_chips: float = 0.25  # early to late
    phase_threshold_dbhz: float = 28.0
    frequency_threshold_dbhz: float = 18.0
    lost_after_s: float = 3.0  # without a signal, when nothing else tells where it is …
    open_loop_s: float = 600.0  # … and with aiding, unless that says before how far off it may be
    # Up to which a phase is carried on in open loop: a Costas loop falls to the next half cycle,
    # and three σ of 0.08 are a quarter. Where symbols tell whole cycles, twice as far.
    open_loop_phase_sigma_cycles: float = 0.08
    frequency_bandwidth_hz: float = 1.5
    pull_in_bandwidth_hz: float = 8.0
    pull_in_s: float = 0.12
    record_correlations: bool = False
    frequency: FrequencySettings = FrequencySettings()


def lowest_frequency_lock_dbhz(phase_threshold_dbhz: float) -> float:
    """Below this the products of neighbouring correlations do not hold the frequency."""
    return min(24.0, phase_threshold_dbhz - 4.0)


class AidingRate(NamedTuple):
    """Predicted carrier frequency at a sample and its slope; zeros when there is no aiding.

    A closed loop takes changes of the frequency only, and finds the receiver's clock by itself;
    in open loop the clock's part of the carrier counts as well.
    """

    frequency_hz: float
    rate_hzps: float
    clock_hz: float = 0.0


class Coast(NamedTuple):
    """What somebody outside knows better of a phase carried on in open loop."""

    cycles: float  # to be added to the phase as RINEX has it: it grows with range
    sigma_cycles: float  # 1σ of the phase then, since the loop was opened


NO_AIDING = AidingRate(0.0, 0.0)
AidingSource = Callable[[int], AidingRate]


def unaided(_sample: int) -> AidingRate:
    """Aiding source of a plain receiver."""
    return NO_AIDING
