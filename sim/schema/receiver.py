"""Sections on the receiver's hardware: antennas, streams of samples, clock."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from deepgnss.io.config.quantity import Quantity, Section, misfit
from deepgnss.io.formats import VALUE_BITS, SampleKind, Spectrum, ValueFormat
from deepgnss.sim.scenario import FrontEnd

Name = Annotated[str, Field(min_length=1, max_length=32, pattern=r"^[\w.+-]+$")]
Metres = Annotated[float, Quantity(-100.0, 100.0, "m")]
LeverArm = tuple[Metres, Metres, Metres]


class AntennaConfig(Section):
    """An antenna on the vehicle."""

    name: Name = "main"
    """Name for `streams[].antenna`."""
    lever_arm: LeverArm = (0.0, 0.0, 0.0)
    """m, from the IMU (the point that follows the trajectory) to the phase centre, body FRD."""


class SampleStreamConfig(Section):
    """One stream of samples, written to a file of its own: keys as `recording.streams[]`."""

    name: Name = "L1"
    """Name in reports, and of the file where there are several."""
    format: ValueFormat = "int8"
    """Number format of a value; bits1, bits2, bits4 are packed, sign and magnitude, msb first."""
    bits: Annotated[int, Quantity(1, 16, "bits", whole=True)] | None = None
    """Resolution of the converter, no more than the format holds; omitted: what it holds."""
    samples: SampleKind = "iq"
    """Complex (two values per sample) or real (one)."""
    sample_rate: Annotated[float, Quantity(1e6, 1e9, "Hz")] = 4.0e6
    """Samples (complex pairs count once) per second, Hz."""
    centre_frequency: Annotated[float, Quantity(1.0e9, 2.0e9, "Hz")] = 1575.42e6
    """RF frequency that lies at `intermediate_frequency`, Hz."""
    intermediate_frequency: Annotated[float, Quantity(-5e8, 5e8, "Hz")] = 0.0
    """Where the centre frequency lies in the samples, Hz; for real samples inside (0, rate/2)."""
    spectrum: Spectrum = "upright"
    """Inverted: RF frequencies above the centre lie below the intermediate frequency."""
    bandwidth: Annotated[float, Quantity(0.0, 1e9, "Hz", above=True)] | None = None
    """Of the front end's filter, two-sided about the intermediate frequency, Hz; omitted: none,
    white noise over the whole sampled band."""
    filter_taps: Annotated[int, Quantity(3, 1023, "", whole=True)] = 63
    """Length of that filter, odd."""
    antenna: Name | None = None
    """Name of the antenna it comes from; omitted: the first."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        held = min(VALUE_BITS[self.format], 16)
        if self.bits is not None and self.bits > held:
            raise misfit(f"expected 1 to {held} bits, which {self.format} holds", "bits")
        half_hz, if_hz = self.sample_rate / 2.0, self.intermediate_frequency
        if self.samples == "real" and not 0.0 < if_hz < half_hz:
            raise misfit(
                f"expected above 0 and below {half_hz:.10g} Hz, half the sample_rate of real"
                " samples",
                "intermediate_frequency",
            )
        if abs(if_hz) > half_hz:
            raise misfit(
                f"expected within ±{half_hz:.10g} Hz, half the sample_rate",
                "intermediate_frequency",
            )
        if self.filter_taps % 2 == 0:
            raise misfit("expected an odd number", "filter_taps")
        usable_hz = self.sample_rate if self.samples == "iq" else 2.0 * min(if_hz, half_hz - if_hz)
        if self.bandwidth is not None and self.bandwidth >= usable_hz:
            raise misfit(
                f"expected below {usable_hz:.10g} Hz, the band around the intermediate frequency",
                "bandwidth",
            )
        return self

    def front_end(self) -> FrontEnd:
        """Return the record the generator works with."""
        return FrontEnd(
            sample_rate_hz=self.sample_rate,
            format=self.format,
            bits=self.bits,
            is_complex=self.samples == "iq",
            centre_hz=self.centre_frequency,
            intermediate_hz=self.intermediate_frequency,
            bandwidth_hz=self.bandwidth,
            filter_taps=self.filter_taps,
            inverted=self.spectrum == "inverted",
        )


class ClockConfig(Section):
    """The receiver's clock at sample 0; its noise comes from `oscillator`."""

    offset: Annotated[float, Quantity(-0.1, 0.1, "s")] = 0.0
    """Clock reading − GPST at sample 0, s."""
    drift: Annotated[float, Quantity(-1e-4, 1e-4, "s/s")] = 0.0
    """Its slope, s/s."""
