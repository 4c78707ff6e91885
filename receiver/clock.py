"""Receiver time: the sample counter steered to GPST.

The model says which GPST a sample was taken at. Epochs stand at whole multiples of the output
interval of that time, so the clock bias left in the observations is only the model's error (some
ns), and code, phase and Doppler of an epoch belong to one instant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import SampleInstant
from deepgnss.core.time import GpsTime

NS = 1_000_000_000
# The model never jumps: a bias is pulled in through the drift, over many seconds, so that Doppler
# (which contains the model's drift) stays the exact rate of phase and range. The drift itself
# comes from Doppler and is good.
_BIAS_S = 20.0
_DRIFT_S = 2.0
_STEERED_S = 1e-7  # uncertainty of a clock that solutions steer


def to_ns(time: GpsTime) -> int:
    """Nanoseconds of GPST since the GPS epoch, rounded."""
    return time.week * SECONDS_PER_WEEK * NS + round(time.tow_s * NS)


def from_ns(nanoseconds: int) -> GpsTime:
    """GPST of a count of nanoseconds since the GPS epoch."""
    week, rest = divmod(nanoseconds, SECONDS_PER_WEEK * NS)
    return GpsTime(week, rest / NS)


@dataclass(frozen=True, slots=True)
class ReceiverClock:
    """GPST of sample n: origin + n/rate − (bias + drift·(n/rate − since))."""

    sample_rate_hz: Fraction
    origin_ns: int
    bias_s: float = 0.0
    drift_sps: float = 0.0  # of the model
    oscillator_sps: float = 0.0  # of the sample counter itself, as solutions see it
    since_s: float = 0.0
    uncertainty_s: float = _STEERED_S  # of the origin, until a solution has steered it

    def at_rate(self, sample_rate_hz: Fraction) -> ReceiverClock:
        """The same clock for another stream, sampled from the same instant on."""
        if sample_rate_hz == self.sample_rate_hz:
            return self
        return replace(self, sample_rate_hz=sample_rate_hz)

    def error_s(self, elapsed_s: float) -> float:
        """The sample counter's advance on GPST at a nominal time since sample 0."""
        return self.bias_s + self.drift_sps * (elapsed_s - self.since_s)

    def gpst_ns(self, sample: int) -> float:
        """GPST of a sample, ns since the GPS epoch less `origin_ns`."""
        rate = self.sample_rate_hz
        elapsed_s = sample * rate.denominator / rate.numerator  # rounded once, without a Fraction
        return (elapsed_s - self.error_s(elapsed_s)) * NS

    def time(self, sample: int) -> GpsTime:
        """GPST of a sample."""
        return from_ns(self.origin_ns).plus(self.gpst_ns(sample) / NS)

    def instant(self, tag_ns: int) -> SampleInstant:
        """Where on the sample axis a GPST tag lies."""
        elapsed_ns, rate = tag_ns - self.origin_ns, self.sample_rate_hz
        tag_s = elapsed_ns / NS
        error_s = self.error_s(tag_s + self.error_s(tag_s))
        parts = NS * rate.denominator  # of a sample: in whole ones nothing is rounded
        index, rest = divmod(elapsed_ns * rate.numerator, parts)
        samples = rest / parts + error_s * (rate.numerator / rate.denominator)
        whole = math.floor(samples)
        return SampleInstant(index + whole, samples - whole)

    def lag_s(self, tag_ns: int, instant: SampleInstant) -> float:
        """Tag − origin − instant/rate, s, without the rounding of large numbers."""
        rate = self.sample_rate_hz
        ahead = (tag_ns - self.origin_ns) * rate.numerator - instant.sample * rate.denominator * NS
        return ahead / (rate.numerator * NS) - instant.fraction / (
            rate.numerator / rate.denominator
        )

    def steered(
        self, tag_ns: int, bias_s: float, drift_sps: float, *, first: bool
    ) -> ReceiverClock:
        """Model after a solution found the tag ahead of GPST by a bias, growing at a drift.

        The first solution is taken whole. Later ones bend the model without a step. The drift is
        NaN where a solution has no velocity: the model keeps its own.
        """
        elapsed_s = (tag_ns - self.origin_ns) / NS
        here_s = self.error_s(elapsed_s)
        if math.isnan(drift_sps):
            drift_sps = self.oscillator_sps - self.drift_sps
        measured_sps = self.drift_sps + drift_sps
        if first:
            return replace(
                self,
                bias_s=here_s + bias_s,
                drift_sps=measured_sps,
                oscillator_sps=measured_sps,
                since_s=elapsed_s,
                uncertainty_s=_STEERED_S,
            )
        passed_s = max(0.0, elapsed_s - self.since_s)
        oscillator_sps = self.oscillator_sps - math.expm1(-passed_s / _DRIFT_S) * (
            measured_sps - self.oscillator_sps
        )
        return replace(
            self,
            bias_s=here_s,
            drift_sps=oscillator_sps + bias_s / max(_BIAS_S, 2.0 * passed_s),
            oscillator_sps=oscillator_sps,
            since_s=elapsed_s,
            uncertainty_s=_STEERED_S,
        )
