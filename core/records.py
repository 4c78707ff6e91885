"""The records that cross walls between rooms: frozen, arrays inside, unit and frame in the name.

Signs (SPEC 1): Doppler is positive when range shrinks; carrier phase grows with range, like the
pseudorange (φ = −∫ Doppler dt); error = estimate − truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.time import GpsTime

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class SignalId(NamedTuple):
    """Name tag of a signal: what files and the navigation solution need to know of it."""

    name: str  # as in the config: "GPS_L1CA"
    system: str  # RINEX system letter: "G", "C"
    rinex: str  # RINEX 3.05 band and attribute: "1C", "2I"
    carrier_hz: float
    chip_rate_hz: float
    code_chips: int  # length of the primary code


GPS_L1CA = SignalId("GPS_L1CA", "G", "1C", 1_575.42e6, 1.023e6, 1023)
BDS_B1I = SignalId("BDS_B1I", "C", "2I", 1_561.098e6, 2.046e6, 2046)
SIGNAL_IDS: Mapping[str, SignalId] = {s.name: s for s in (GPS_L1CA, BDS_B1I)}


class Oscillator(NamedTuple):
    """Power law of an oscillator's relative frequency, S_y(f) = h0 + h₋₁/f + h₋₂/f², one-sided."""

    name: str
    h0_s: float
    h_1: float
    h_2_hz: float
    g_sensitivity: float  # relative frequency per g


# --- samples -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One stream of a recording after unpacking: spectrum upright, samples int8 or int16.

    An inverted spectrum is undone by the reader (complex: Q negated and IF negated; real: IF
    negated), so that everybody downstream sees RF `centre_hz` at `intermediate_hz`.
    """

    name: str
    sample_rate_hz: float
    centre_hz: float  # RF frequency that lies at intermediate_hz
    intermediate_hz: float
    is_complex: bool
    sample_count: int  # in the whole recording


Samples = NDArray[np.int8] | NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class PackedSamples:
    """Samples as their file packs them, each byte by itself.

    data: uint8, shape (bytes,). table: the samples of every byte, int8 or int16, shape
    (256, per byte) real or (256, per byte, 2) as I, Q. skip: samples of the first byte that come
    before these `count`.
    """

    data: NDArray[np.uint8]
    table: Samples
    skip: int
    count: int

    def unpacked(self) -> Samples:
        """The samples themselves, shape (count,) real or (count, 2)."""
        samples = self.table.take(self.data, axis=0).reshape(-1, *self.table.shape[2:])
        return samples[self.skip : self.skip + self.count]


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one stream.

    held: int8 or int16, shape (n,) real or (n, 2) as I, Q; or packed, until somebody wants
    `samples`. `first` is the index of its first sample since the start of the recording.
    """

    stream: StreamInfo
    first: int
    held: Samples | PackedSamples

    @property
    def samples(self) -> Samples:
        """The samples unpacked."""
        return self.held.unpacked() if isinstance(self.held, PackedSamples) else self.held

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.held.count if isinstance(self.held, PackedSamples) else len(self.held)


@dataclass(frozen=True, slots=True)
class RunningSums:
    """Running sum of the samples mixed to zero frequency (SPEC 4), I and Q packed in an int64.

    packed: shape (n + 1,); I and Q of samples [a, b) is packed[b] − packed[a], upper and lower 32
    bits (differences survive wrap-around), each times `scale`. With `step` > 1 only every step-th
    entry was kept. `centre_hz` is the RF frequency now at zero.
    """

    packed: NDArray[np.int64]
    first: int
    step: int
    scale: float
    sample_rate_hz: float
    centre_hz: float

    @property
    def end(self) -> int:
        """Sample after the last one summed."""
        return self.first + (self.packed.size - 1) * self.step


class SampleInstant(NamedTuple):
    """A point on the recording's own time axis: whole sample index and a fraction in [0, 1)."""

    sample: int
    fraction: float


# --- tracking ------------------------------------------------------------------------------------


class NcoCommand(NamedTuple):
    """What code and carrier generators do from a sample on.

    Carrier phase is that of the received carrier after mixing the stream to zero at the signal's
    nominal carrier frequency: it runs at +Doppler, in cycles. Code phase runs in chips at
    chip_rate·(1 + carrier_hz/carrier) + code_offset.
    """

    sample: int  # the command holds from this sample on
    carrier_cycles: float  # at `sample`
    carrier_hz: float  # at `sample`
    carrier_hzps: float
    code_chips: float  # within the code period, at `sample`
    code_hz: float  # chip rate at `sample`
    code_hzps: float  # its slope


@dataclass(frozen=True, slots=True)
class Correlations:
    """Complex correlations of consecutive code periods with the local signal of one command.

    taps: complex128, shape (periods, taps), carrier wiped off, sums over one code period; first
    tap early, then prompt, late, then extras, at `spacing_chips` from prompt (early positive).
    """

    first: int  # first sample of the first period
    seconds: float  # length of one period
    taps: ComplexArray


class ChannelReport(NamedTuple):
    """State of one channel at the end of a navigation epoch."""

    satellite: str
    signal: str
    stage: str  # furthest stage reached: searched … used
    mode: str  # PULL_IN, FLL, PLL, … the state machine's present state
    cn0_dbhz: float
    doppler_hz: float
    carrier_lock: float  # cos 2φ indicator, 1 = locked
    aiding_minus_loop_hz: float
    lock_time_s: float
    coherent_s: float
    carrier_bandwidth_hz: float
    code_bandwidth_hz: float


@dataclass(frozen=True, slots=True)
class SatelliteOutcome:
    """How far a satellite came in a run, and what held it back: a line of the why-no-fix table."""

    satellite: str
    signal: str
    stage: str  # one of STAGES
    acquisition_peak: float | None  # peak over noise floor of its best search, None: not searched
    cn0_dbhz: float | None  # highest seen while tracked
    used_epochs: int  # of the navigation solution
    reason: str  # why it came no further, or was rejected; empty when used throughout


STAGES = (
    "not searched",
    "searched",
    "acquired",
    "pulled in",
    "bit sync",
    "frame sync",
    "ephemeris",
    "used",
)
"""What a satellite goes through, in order."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line in the log: a transition with its reason."""

    sample: int
    satellite: str
    what: str
    reason: str


class Observation(NamedTuple):
    """One signal's observables at an output instant (receiver time steered to GPST)."""

    satellite: str  # "G05"
    signal: str  # SignalId.name
    pseudorange_m: float
    carrier_cycles: float  # grows with range; whole cycles so that it starts near the pseudorange
    doppler_hz: float
    cn0_dbhz: float
    lock_time_s: float
    slip: bool  # RINEX LLI bit 0: lock lost, or polarity changed, since the previous output
    half_cycle: bool  # RINEX LLI bit 1: polarity unknown, phase may be off by half a cycle
    carrier_valid: bool  # False: no phase is written
    transmit: GpsTime  # satellite clock reading when the signal left
    arc: int = 0  # stretch of phase without a possible slip; never the same again for a signal
    doppler_sigma_hz: float = math.nan  # NaN: as C/N0 has it
    doppler_s: float = 0.0  # for which one measurement of it stands, carried on by aiding


class Counter(NamedTuple):
    """The sample counter against the tags, which solutions steer to GPST.

    What is added to ranges (times c) and to their rates makes them those of the oscillator alone.
    """

    ahead_s: float  # counter − tag
    drift_sps: float  # its rate; Dopplers are of tags that run so much slower


UNSTEERED: Final = Counter(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Epoch:
    """All observations at one instant; `time` is the receiver's (steered) tag in GPST."""

    time: GpsTime
    instant: SampleInstant
    observations: tuple[Observation, ...]
    counter: Counter = UNSTEERED


# --- navigation data -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ephemeris:
    """Broadcast Keplerian ephemeris and clock of one satellite (IS-GPS-200 20.3.3, BDS ICD 5.2.4).

    Times of BeiDou messages are converted to GPST on reading.
    """

    satellite: str
    toe: GpsTime
    toc: GpsTime
    transmitted: GpsTime  # time of transmission of the message
    iode: int
    iodc: int
    af0_s: float
    af1_sps: float
    af2_sps2: float
    group_delay_s: float  # TGD (GPS), TGD1 (BDS)
    sqrt_a_rm: float
    eccentricity: float
    m0_rad: float
    delta_n_radps: float
    omega0_rad: float
    omega_rad: float
    omega_dot_radps: float
    i0_rad: float
    idot_radps: float
    cuc_rad: float
    cus_rad: float
    crc_m: float
    crs_m: float
    cic_rad: float
    cis_rad: float
    health: int  # 0: healthy
    accuracy_m: float  # URA
    fit_hours: float = 4.0
    group_delay2_s: float = 0.0  # TGD2 (BDS)


class Klobuchar(NamedTuple):
    """Broadcast ionosphere coefficients (IS-GPS-200 20.3.3.5.1.7), s and semicircle units."""

    alpha: tuple[float, float, float, float]
    beta: tuple[float, float, float, float]


class UtcParameters(NamedTuple):
    """GPST − UTC of the broadcast (IS-GPS-200 20.3.3.5.1.6)."""

    a0_s: float
    a1_sps: float
    reference: GpsTime
    leap_s: int
    leap_future_s: int
    leap_week: int
    leap_day: int


class RangeCorrections(NamedTuple):
    """By how much a satellite's ranges are too long, as a base station measured; linear between.

    The base's clock, common to all, is in it.
    """

    origin: GpsTime
    time_s: FloatArray  # (n,) since `origin`
    range_m: FloatArray  # (n,)

    def at(self, time: GpsTime) -> float:
        """Correction to be taken off a range, m."""
        return float(np.interp(time.since(self.origin), self.time_s, self.range_m))


@dataclass(frozen=True, slots=True)
class NavData:
    """All navigation data at hand: decoded from the signals or read from a NAV file.

    corrections: of a base station, by satellite; None: there is none. With them, ranges of
    satellites that it does not see are of no use.
    """

    ephemerides: Mapping[str, tuple[Ephemeris, ...]] = field(default_factory=dict)  # by satellite
    klobuchar: Mapping[str, Klobuchar] = field(default_factory=dict)  # by system letter
    utc: UtcParameters | None = None
    corrections: Mapping[str, RangeCorrections] | None = None


# --- solution ------------------------------------------------------------------------------------


Source = Literal["gnss", "gnss+ins", "ins"]
"""Whether a position is made of ranges, of ranges and the inertial navigation, or of that alone."""


@dataclass(frozen=True, slots=True)
class NavSolution:
    """Position, velocity and clock at one epoch (ECEF), or the reason there is none."""

    time: GpsTime
    valid: bool
    reason: str  # empty when valid
    r_e_m: FloatArray  # (3,) antenna position
    v_e_mps: FloatArray  # (3,)
    clock_s: float  # receiver clock − GPST
    drift_sps: float
    isb_s: Mapping[str, float]  # inter-system bias against GPS by system letter
    covariance_m2: FloatArray  # (4, 4) of position (ECEF) and clock·c
    velocity_covariance_m2ps2: FloatArray  # (4, 4) of velocity and drift·c
    dops: Mapping[str, float]  # gdop pdop hdop vdop tdop
    used: tuple[str, ...]
    rejected: Mapping[str, str]  # satellite → why it was left out
    residuals_m: Mapping[str, float]  # pseudorange residuals of all with a range
    azimuth_elevation_rad: Mapping[str, tuple[float, float]]
    isb_sigma_s: Mapping[str, float] = field(default_factory=dict)  # of isb_s, learnt over time
    source: Source = "gnss"
    differential: bool = False  # ranges less the corrections of a base station


# --- inertial ------------------------------------------------------------------------------------


class ImuGrade(NamedTuple):
    """Error model of an inertial unit (T table 4.1), the same for its three axes, 1σ or density.

    Bias and scale are drawn once per run; the drift is a first-order Gauss–Markov process driven
    by white noise of the given density (its σ in the steady state is density·√(T/2)); noise is
    white on the rate, so that its integral walks with noise·√t.
    """

    name: str
    gyro_bias_radps: float
    gyro_drift_radps2_rthz: float  # rad/s² per √Hz
    gyro_drift_time_s: float
    gyro_noise_rad_rts: float  # angle random walk, rad/√s
    gyro_scale: float
    accel_bias_mps2: float
    accel_drift_mps3_rthz: float  # m/s³ per √Hz
    accel_drift_time_s: float
    accel_noise_mps_rts: float  # velocity random walk, m/s/√s
    accel_scale: float
    velocity_mps: float  # initial errors of a navigation with it, 1σ: horizontal velocity
    tilt_rad: float
    heading_rad: float


@dataclass(frozen=True, slots=True)
class ImuBlock:
    """Consecutive inertial increments in body axes FRD.

    Row k holds the integrals of ω_ib and of the specific force over the interval of length
    `dt_s[k]` that ends at `time_s[k]`, seconds of GPST since `origin`; all arrays float64.
    """

    origin: GpsTime
    time_s: FloatArray  # (n,) rising
    dt_s: FloatArray  # (n,)
    dtheta_b_rad: FloatArray  # (n, 3)
    dv_b_mps: FloatArray  # (n, 3)


@dataclass(frozen=True, slots=True)
class InsState:
    """Navigation state of the IMU: position (WGS-84), velocity in NED, attitude, sensor errors.

    q_nb: unit quaternion, scalar first, that turns body FRD into NED (v_n = C_nb @ v_b). Sensor
    errors are what the sensors read too much: reading = (1 + scale)·true + bias.
    """

    time: GpsTime
    lat_rad: float
    lon_rad: float
    height_m: float
    v_n_mps: FloatArray  # (3,)
    q_nb: FloatArray  # (4,)
    gyro_bias_radps: FloatArray  # (3,)
    accel_bias_mps2: FloatArray  # (3,)
    gyro_scale: FloatArray  # (3,)
    accel_scale: FloatArray  # (3,)
