"""A scenario: everything that decides the samples, as frozen records.

Time axes: `sample_s` counts the receiver's own clock from sample 0 (n / sample rate); true time is
sample_s minus the clock error, in seconds of GPST from `Scenario.start`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import ConfigError
from deepgnss.core.records import Ephemeris, FloatArray, NavData, Oscillator, SignalId
from deepgnss.core.time import GpsTime
from deepgnss.io.formats import VALUE_BITS, ValueFormat
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import nearest_set

_DRIFT_HZ: Final = 100.0  # slips of a sample per second that smooth a code over


@dataclass(frozen=True, slots=True)
class FrontEnd:
    """From the antenna to the file. RF `centre_hz` lies at `intermediate_hz`.

    `bits` of the converter may be fewer than the container holds (2 bits in int8: ±1, ±3); None
    fills it. `bandwidth_hz` is two-sided, around zero (complex) or the IF (real); None: no filter,
    white noise over the whole sampled band.
    """

    sample_rate_hz: float
    format: ValueFormat = "int8"
    bits: int | None = None
    is_complex: bool = True
    centre_hz: float = GPS_L1CA_SIGNAL.id.carrier_hz
    intermediate_hz: float = 0.0
    bandwidth_hz: float | None = None
    filter_taps: int = 63
    inverted: bool = False  # spectrum: what lies above the centre comes out below the IF

    def __post_init__(self) -> None:
        """Refuse what no front end can do."""
        if self.format not in VALUE_BITS:
            raise ConfigError(f"format: {self.format!r} is none of {', '.join(VALUE_BITS)}")
        if self.bits is not None and not 1 <= self.bits <= min(VALUE_BITS[self.format], 16):
            raise ConfigError(f"bits: {self.bits} does not fit {self.format}")
        if not 1.0e6 <= self.sample_rate_hz <= 1.0e9:
            raise ConfigError(f"sample_rate: {self.sample_rate_hz:g} Hz is not within 1e6 to 1e9")
        if not self.is_complex and not 0.0 < self.intermediate_hz < self.sample_rate_hz / 2.0:
            raise ConfigError(
                f"intermediate_frequency: {self.intermediate_hz:g} Hz of real samples is not"
                f" within 0 to {self.sample_rate_hz / 2.0:g} Hz, half the sampling rate"
            )
        if self.filter_taps % 2 == 0 or not 3 <= self.filter_taps <= 1023:
            raise ConfigError(f"filter_taps: {self.filter_taps} is not an odd number of 3 to 1023")
        if self.bandwidth_hz is not None and not 0.0 < self.bandwidth_hz < self.usable_hz:
            raise ConfigError(
                f"bandwidth: {self.bandwidth_hz:g} Hz does not fit into the"
                f" {self.usable_hz:g} Hz around the intermediate frequency"
            )

    @property
    def sense(self) -> int:
        """+1 where a frequency rises with that of the carrier, −1 with an inverted spectrum."""
        return -1 if self.inverted else 1

    @property
    def usable_hz(self) -> float:
        """Two-sided band around the filter's middle that the sampling rate leaves, Hz."""
        if self.is_complex:
            return self.sample_rate_hz
        return 2.0 * min(self.intermediate_hz, self.sample_rate_hz / 2 - self.intermediate_hz)

    def hears(self, signal: SignalId) -> bool:
        """Whether the sampled band holds the carrier and half the chip rate on either side."""
        middle_hz = self.intermediate_hz + self.sense * (signal.carrier_hz - self.centre_hz)
        low_hz, high_hz = (middle_hz + side * signal.chip_rate_hz for side in (-0.5, 0.5))
        half_hz = self.sample_rate_hz / 2.0
        return low_hz >= (-half_hz if self.is_complex else 0.0) and high_hz <= half_hz

    def grid_m(self, signal: SignalId) -> float | None:
        """Spacing of code delays that samples can tell apart, m, where it is coarse.

        Chip edges are not smoothed before sampling: they keep their places among the samples where
        a few chips last whole samples. None: they drift through within 10 ms.
        """
        for repeat in (1, 2, 3, 4):
            samples = repeat * self.sample_rate_hz / signal.chip_rate_hz
            if abs(samples - round(samples)) * signal.chip_rate_hz < repeat * _DRIFT_HZ:
                return SPEED_OF_LIGHT_MPS / (self.sample_rate_hz * repeat)
        return None

    @property
    def bytes_per_second(self) -> float:
        """Size of a second of recording."""
        return self.sample_rate_hz * (1 + self.is_complex) * VALUE_BITS[self.format] / 8.0

    @property
    def converter_bits(self) -> int:
        """Resolution of the converter, 32 for none."""
        return self.bits or VALUE_BITS[self.format]


class Antenna(NamedTuple):
    """An antenna on the vehicle."""

    name: str = "main"
    lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # IMU → phase centre, body FRD


@dataclass(frozen=True, slots=True)
class Stream:
    """One front end behind one antenna, which fills one file."""

    name: str
    front_end: FrontEnd
    antenna: int = 0  # of Scenario.antennas


@dataclass(frozen=True, slots=True)
class ReceiverClock:
    """Clock reading − GPST = offset + drift·t + the oscillator's noise, t in s of its own count.

    The oscillator also feels specific force along `axis_b`, a unit vector in body axes: its
    relative frequency rises by the g-sensitivity times what exceeds the force at rest and level.
    """

    offset_s: float = 0.0
    drift_sps: float = 0.0
    oscillator: Oscillator | None = None
    axis_b: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Emitter:
    """One signal of one satellite; C/N0 as steps (from second, dB-Hz) in order, first from 0.0."""

    satellite: str  # "G05"
    cn0_dbhz: tuple[tuple[float, float], ...]
    signal: Signal = GPS_L1CA_SIGNAL

    def __post_init__(self) -> None:
        """Refuse a schedule that leaves a second without a value."""
        starts = [second for second, _ in self.cn0_dbhz]
        if starts[:1] != [0.0] or starts != sorted(set(starts)):
            raise ConfigError(f"{self.satellite}: cn0: expected rising seconds that start at 0")

    @property
    def prn(self) -> int:
        """Number within the system."""
        return int(self.satellite[1:])

    def cn0_at(self, t_s: float) -> float:
        """C/N0 at a second of the recording, dB-Hz."""
        return [value for second, value in self.cn0_dbhz if second <= max(t_s, 0.0)][-1]


class View(NamedTuple):
    """A satellite as an antenna sees it at true times (n,): what surroundings decide upon."""

    satellite: str
    t_s: FloatArray  # (n,) since the start
    r_n_m: FloatArray  # (n, 3) antenna in the local NED frame of the vehicle's place
    azimuth_rad: FloatArray  # (n,) in the same frame
    elevation_rad: FloatArray


class Arrivals(NamedTuple):
    """What is left of a signal on its ways to an antenna, at the times of a View.

    Amplitudes are factors on that of the free line of sight. A reflected ray's carrier is turned
    by π besides its extra path; its excess only matters where its amplitude is not zero.
    """

    direct: FloatArray  # (n,) line of sight: 0 blocked, 1 free
    ray_amplitude: FloatArray  # (rays, n)
    ray_excess_m: FloatArray  # (rays, n) extra path


class Surroundings(Protocol):
    """Everything around the vehicle that stands in a signal's way or reflects it."""

    @property
    def rays(self) -> int:
        """Greatest number of reflected rays of a satellite."""

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        """What arrives: a function of its arguments alone, whatever is asked before."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What is simulated. Same scenario, same samples, for any number of threads."""

    name: str
    start: GpsTime  # what the receiver's clock reads at sample 0
    seconds: float
    vehicle: Vehicle
    emitters: tuple[Emitter, ...]
    nav: NavData  # true orbits and clocks, and what is broadcast
    streams: tuple[Stream, ...]
    antennas: tuple[Antenna, ...] = (Antenna(),)
    clock: ReceiverClock = field(default_factory=ReceiverClock)
    surroundings: Surroundings | None = None
    ionosphere: bool = True  # Klobuchar of `nav`: delays the code, advances the carrier
    troposphere: bool = True  # Saastamoinen
    noise: bool = True
    seed: int = 1

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        if not self.seconds > 0.0:
            raise ConfigError(f"seconds: {self.seconds:g} is not positive")
        missing = [e.satellite for e in self.emitters if not self.nav.ephemerides.get(e.satellite)]
        if missing:
            raise ConfigError(f"satellites: no ephemeris of {', '.join(missing)} in the NAV data")
        if self.ionosphere and not self.nav.klobuchar:
            raise ConfigError("ionosphere: the NAV data hold no Klobuchar coefficients")
        for stream in self.streams:
            if not 0 <= stream.antenna < len(self.antennas):
                raise ConfigError(f"streams: {stream.name}: there is no antenna {stream.antenna}")
        unheard = {
            e.signal.id.name: f"{e.signal.id.carrier_hz / 1e6:g} MHz ± half the chip rate"
            for e in self.emitters
            if self.streams and not any(s.front_end.hears(e.signal.id) for s in self.streams)
        }
        for signal, where in unheard.items():
            raise ConfigError(f"streams: none samples the band of {signal}, {where}")

    def orbit_set(self, satellite: str) -> Ephemeris:
        """The ephemeris that is both the truth and the message: toe nearest to the middle.

        One set serves the whole recording, so that the truth has no step at a change of sets.
        """
        middle = self.start.plus(self.seconds / 2.0)
        return nearest_set(self.nav.ephemerides[satellite], middle)

    def sample_count(self, stream: Stream) -> int:
        """Whole samples in a stream, rounded down to a multiple of 8 (whole bytes)."""
        return int(self.seconds * stream.front_end.sample_rate_hz) // 8 * 8
