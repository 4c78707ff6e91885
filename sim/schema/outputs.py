"""Sections on what is written beside the samples: truth, base station, perfect rover."""

from __future__ import annotations

from typing import Annotated

from deepgnss.io.config.quantity import Quantity, Section

Far = Annotated[float, Quantity(-1e5, 1e5, "m")]
Interval = Annotated[float, Quantity(0.01, 3600.0, "s")]


class TruthConfig(Section):
    """How densely the truth is written."""

    rate: Annotated[float, Quantity(1.0, 2000.0, "Hz")] = 50.0
    """Rows of truth.csv and clock.csv per second."""
    ranges: Interval = 0.1
    """Time between rows of a satellite in ranges.csv, s."""


class MeasurementNoise(Section):
    """White noise on the observations of a receiver that tracks without loops."""

    code_noise: Annotated[float, Quantity(0.0, 100.0, "m")] = 0.0
    """Of a pseudorange, 1σ, m."""
    phase_noise: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.0
    """Of a carrier phase, 1σ, m."""
    doppler_noise: Annotated[float, Quantity(0.0, 100.0, "Hz")] = 0.0
    """Of a Doppler, 1σ, Hz."""


class RoverConfig(MeasurementNoise):
    """The perfect rover: rover.obs, what the antenna sees with integer ambiguities."""

    interval: Interval = 1.0
    """Time between epochs, s; they fall on its integer multiples of GPST."""


class BaseConfig(MeasurementNoise):
    """A base station at rest under an open sky: base.obs."""

    offset: tuple[Far, Far, Far] = (0.0, 0.0, 0.0)
    """m north, east and down from `place`, in its tangent plane."""
    interval: Interval
    """Time between epochs, s; they fall on its integer multiples of GPST."""
    code_noise: Annotated[float, Quantity(0.0, 100.0, "m")] = 0.3
    """Of a pseudorange, 1σ, m."""
    phase_noise: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.002
    """Of a carrier phase, 1σ, m."""
    doppler_noise: Annotated[float, Quantity(0.0, 100.0, "Hz")] = 0.05
    """Of a Doppler, 1σ, Hz."""
