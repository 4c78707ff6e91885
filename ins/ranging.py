"""Tight coupling: pseudoranges and range rates against the navigation, with the receiver clock.

Ranges arrive freed of what is known of them (satellite clock, atmosphere, group delay), satellites
at transmission, turned into the Earth-fixed frame of reception; what stays is geometry and the
receiver's clock. One satellite alone already helps: every range is its own measurement, tested
alone. SPEC signs: a range rate is positive when the range grows, minus wavelength times Doppler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.measurements import Measurement, Point


@dataclass(frozen=True, slots=True)
class RangeObservation:
    """One satellite's corrected pseudorange and range rate at the filter's instant."""

    satellite: str
    system: str  # letter, one of the layout's systems
    r_e_m: FloatArray  # (3,) satellite
    v_e_mps: FloatArray  # (3,)
    pseudorange_m: float
    pseudorange_sigma_m: float
    range_rate_mps: float | None = None
    range_rate_sigma_mps: float = 0.0
    together: float = 1.0  # so many pseudoranges in a row count as one, see `Measurement`


@dataclass(frozen=True, slots=True)
class RangeEpoch:
    """All satellites of one instant, however few."""

    time: GpsTime
    observations: tuple[RangeObservation, ...]


def ranges(
    estimate: Estimate, antenna: Point, observations: Sequence[RangeObservation]
) -> list[Measurement]:
    """Measurements of an instant: every pseudorange, then every range rate there is."""
    found = [pseudorange(estimate, antenna, observed) for observed in observations]
    for observed in observations:
        if observed.range_rate_mps is not None:
            found.append(range_rate(estimate, antenna, observed, observed.range_rate_mps))
    return found


def pseudorange(estimate: Estimate, antenna: Point, observed: RangeObservation) -> Measurement:
    """Corrected pseudorange: |satellite − antenna| + clock (+ inter-system bias)."""
    layout = estimate.layout
    range_m, los_n = _line_of_sight(estimate, antenna, observed)
    H = -los_n[np.newaxis] @ antenna.H_position
    H[0, layout.clock] = 1.0
    predicted_m = range_m + estimate.extra(layout.clock)
    between = layout.inter_system(observed.system)
    if between is not None:
        H[0, between] = 1.0
        predicted_m += estimate.extra(between)
    return Measurement(
        "pseudorange",
        np.array([predicted_m - observed.pseudorange_m]),
        H,
        np.array([[observed.pseudorange_sigma_m**2]]),
        together=observed.together,
    )


def range_rate(
    estimate: Estimate, antenna: Point, observed: RangeObservation, range_rate_mps: float
) -> Measurement:
    """Corrected range rate: relative velocity along the line of sight + clock drift."""
    layout = estimate.layout
    range_m, los_n = _line_of_sight(estimate, antenna, observed)
    to_n = C_ne(estimate.ins.lat_rad, estimate.ins.lon_rad)
    relative_n = to_n @ observed.v_e_mps - antenna.v_n_mps
    along_mps = float(los_n @ relative_n)
    across_n = relative_n - along_mps * los_n
    H = -los_n[np.newaxis] @ antenna.H_velocity - across_n / range_m @ antenna.H_position
    H[0, layout.clock + 1] = 1.0
    predicted_mps = along_mps + estimate.extra(layout.clock + 1)
    return Measurement(
        "range rate",
        np.array([predicted_mps - range_rate_mps]),
        H,
        np.array([[observed.range_rate_sigma_mps**2]]),
    )


@dataclass(frozen=True, slots=True)
class ClockNoise:
    """Random walks of the receiver clock's bias and drift and of the inter-system biases."""

    bias_m_rts: float = 0.1
    drift_mps_rts: float = 0.05
    inter_system_m_rts: float = 0.001


def extra_transition(
    layout: Layout, dt_s: float, clock: ClockNoise, odometer_rts: float
) -> tuple[FloatArray, FloatArray]:
    """Φ and Q (extras, extras) of the errors behind the inertial ones: they walk at random."""
    Phi, Q = np.eye(layout.extras), np.zeros((layout.extras, layout.extras))
    if layout.odometer:
        Q[0, 0] = odometer_rts**2 * dt_s
    if layout.systems:
        bias = layout.clock - layout.inertial
        drift = bias + 1
        Phi[bias, drift] = dt_s
        walk2 = clock.drift_mps_rts**2
        Q[bias, bias] = clock.bias_m_rts**2 * dt_s + walk2 * dt_s**3 / 3.0
        Q[bias, drift] = Q[drift, bias] = walk2 * dt_s**2 / 2.0
        Q[drift, drift] = walk2 * dt_s
        for place in range(drift + 1, layout.extras):
            Q[place, place] = clock.inter_system_m_rts**2 * dt_s
    return Phi, Q


def _line_of_sight(
    estimate: Estimate, antenna: Point, observed: RangeObservation
) -> tuple[float, FloatArray]:
    """Range, m, and unit vector (3,) in NED from antenna to satellite."""
    line_e = observed.r_e_m - antenna.r_e_m
    range_m = float(np.linalg.norm(line_e))
    return range_m, C_ne(estimate.ins.lat_rad, estimate.ins.lon_rad) @ line_e / range_m
