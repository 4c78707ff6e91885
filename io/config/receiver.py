"""Sections `acquisition`, `tracking` and `positioning`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from deepgnss.io.config.quantity import ExistingFile, Quantity, Section, Switch, misfit

BIT_MS = 20
MAX_LOOP_PRODUCT = 0.4
"""Limit on bandwidth × coherent time. A loop with the analogue coefficients is unstable from 0.42
(order 2) and 0.455 (order 3) on; those of core.loops would bear more."""


def _whole_ms(value: float) -> int:
    return round(value * 1e3)


def _check_coherent(coherent_s: float) -> None:
    ms = _whole_ms(coherent_s)
    if abs(coherent_s * 1e3 - ms) > 1e-6 or BIT_MS % ms:
        raise misfit("expected 0.001, 0.002, 0.004, 0.005, 0.010 or 0.020 s", "coherent")


def _check_product(bandwidth_hz: float, coherent_s: float) -> None:
    if bandwidth_hz * coherent_s > MAX_LOOP_PRODUCT:
        raise misfit(
            f"expected at most {MAX_LOOP_PRODUCT / coherent_s:g} Hz with coherent {coherent_s:g} s "
            f"(bandwidth × coherent up to {MAX_LOOP_PRODUCT:g})",
            "bandwidth",
        )


class AcquisitionConfig(Section):
    """Code search (FFT over all code phases)."""

    doppler_max: Annotated[float, Quantity(500.0, 50_000.0, "Hz")] = 6000.0
    """Half width of the Doppler window, Hz: ±5 kHz of the satellites, the rest the oscillator's."""
    false_alarm: Annotated[float, Quantity(1e-9, 0.1, "", above=True)] = 1e-3
    """Probability that the search of one absent satellite, all its cells, reports it."""
    coherent: Annotated[float, Quantity(0.001, 0.020, "s")] = 0.010
    """Coherent sum, s, whole ms."""
    noncoherent: Annotated[int, Quantity(1, 1000, "sums", whole=True)] = 2
    """Coherent sums added up as powers."""
    weak: Switch = True
    """Look for weak satellites with longer sums: predicted ones down to 22 dB-Hz, and while fewer
    than four are tracked any down to 30 dB-Hz."""
    weak_length: Annotated[float, Quantity(0.1, 4.0, "s")] = 1.0
    """Samples that the search of a weak predicted satellite adds up, s."""
    weak_interval: Annotated[float, Quantity(0.5, 3600.0, "s")] = 5.0
    """Time between such searches, one satellite each, s."""
    weak_doppler_rate: Annotated[float, Quantity(0.0, 500.0, "Hz/s")] = 0.0
    """By how much Dopplers may change in such a search, Hz/s: 5 per m/s² of the antenna; a static
    one needs 0."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if abs(self.coherent * 1e3 - _whole_ms(self.coherent)) > 1e-6:
            raise misfit("expected a whole number of ms", "coherent")
        return self


class KalmanConfig(Section):
    """Loop `kalman`: its gains follow from C/N0, from `oscillator`, and from the motion."""

    dynamics: Annotated[float, Quantity(0.001, 1000.0, "m/s²")] = 0.3
    """By how much the acceleration in the line of sight changes in a second, m/s² (1σ)."""
    adaptive: Switch = True
    """Take the noise of phases from innovations rather than from C/N0, K(22–25)."""
    memory: Annotated[float, Quantity(0.1, 60.0, "s")] = 1.0
    """Length of their running mean, s."""
    fading: Annotated[float, Quantity(1.0, 1.5, "")] = 1.0
    """Growth of the filter's covariance from step to step, K(27); 1: none."""
    square_root: Switch = True
    """Keep a root of the covariance (Potter), K(28), rather than itself (Joseph)."""


class LongUpdateConfig(Section):
    """Loop `long_update`: measured over many symbols at once, filtered by C/N0, oscillator and
    motion."""

    update: Annotated[float, Quantity(0.05, 0.4, "s")] = 0.2
    """Length of an update, s; whole symbols of it are used."""
    dynamics: Annotated[float, Quantity(0.001, 1000.0, "m/s³")] = 0.75
    """By how much the jerk in the line of sight changes in a second, m/s³ (1σ)."""


class CarrierConfig(Section):
    """Carrier loop."""

    loop: Literal["pll2", "pll3", "kalman", "long_update"] = "pll3"
    """Costas phase-lock loop of order 2 or 3; a Kalman filter of phase, frequency and rate; or long
    updates, with a filter of four states."""
    bandwidth: Annotated[float, Quantity(0.1, 200.0, "Hz")] = 7.0
    """One-sided noise bandwidth of the settled loop, Hz; of pll2 and pll3."""
    coherent: Annotated[float, Quantity(0.001, 0.020, "s")] = 0.020
    """Coherent time of the settled loop, s; a whole part of a 20 ms bit."""
    kalman: KalmanConfig = KalmanConfig()
    long_update: LongUpdateConfig = LongUpdateConfig()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_coherent(self.coherent)
        _check_product(self.bandwidth, self.coherent)
        return self


def _one_is_a_list(value: object) -> Any:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


class CodeConfig(Section):
    """Code loop, aided by the carrier loop."""

    order: Literal[1, 2] = 2
    """Order of the loop."""
    bandwidth: Annotated[
        tuple[Annotated[float, Quantity(0.001, 50.0, "Hz")], ...],
        Field(min_length=1, max_length=4),
        BeforeValidator(_one_is_a_list),
    ] = (3.0, 1.0, 0.1)
    """One-sided noise bandwidths, Hz, wide to narrow, switched as the loop settles T(5.22)."""
    spacing: Annotated[float, Quantity(0.02, 1.0, "chips")] = 0.25
    """Distance D from early to late, chips (1: half a chip either side of prompt)."""
    coherent: Annotated[float, Quantity(0.001, 0.020, "s")] = 0.020
    """Coherent time of the settled loop, s; a whole part of a 20 ms bit."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_coherent(self.coherent)
        _check_product(max(self.bandwidth), self.coherent)
        if any(b >= a for a, b in zip(self.bandwidth, self.bandwidth[1:], strict=False)):
            raise misfit("expected falling bandwidths, such as [3.0, 1.0, 0.1]", "bandwidth")
        return self


class FrequencyConfig(Section):
    """Frequency tracking of signals too weak for their phase (T 3.2–3.4)."""

    discriminator: Literal[
        "fft", "sfft", "pfft", "psfft", "early_late", "refinement", "two_stage"
    ] = "pfft"
    """Spectrum of a window of symbols: all its lines (fft, sfft), the few about zero (pfft, psfft)
    or three close ones (early_late, refinement, two_stage). Symbols known beforehand are stripped,
    others squared away; sfft and psfft always square."""
    bins: Annotated[int, Quantity(1, 25, "lines", whole=True)] = 3
    """Lines searched by pfft and psfft, an odd number; each is 1/window wide, half that squared."""
    window: Annotated[float, Quantity(0.064, 0.512, "s")] = 0.320
    """Length of a window, s; whole symbols of it are used."""
    order: Literal[1, 2] = 2
    """1: frequency; 2: frequency and its rate, no lag behind steady changes."""
    gain: Annotated[float, Quantity(0.0, 1.0, "", above=True)] = 0.3
    """Share of the frequency seen that goes to the generator; T 3.2.1: 1 with order 1."""
    phase: Switch = False
    """Take the phase from the peak as well T(3.8); carrier phases stay invalid all the same."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.bins % 2 == 0:
            raise misfit("expected an odd number: as many lines above zero as below", "bins")
        return self


class ThresholdsConfig(Section):
    """When a channel changes its mode (T figures 5.2, 5.3)."""

    phase: Annotated[float, Quantity(10.0, 60.0, "dB-Hz")] = 28.0
    """T3: the phase is tracked above, dB-Hz."""
    frequency: Annotated[float, Quantity(5.0, 60.0, "dB-Hz")] = 18.0
    """T4: the frequency is tracked above, dB-Hz (before bit sync not below 24)."""
    lost_after: Annotated[float, Quantity(0.0, 600.0, "s", above=True)] = 3.0
    """T2: a signal gone for this long is searched anew, s."""
    open_loop: Annotated[float, Quantity(0.0, 36000.0, "s", above=True)] = 600.0
    """The same with aiding, unless 1σ of its frequency or code is beyond reach before, s."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.frequency > self.phase:
            raise misfit(f"expected at most `phase`, {self.phase:g} dB-Hz", "frequency")
        return self


class TrackingConfig(Section):
    """Tracking loops and their switching."""

    carrier: CarrierConfig = CarrierConfig()
    code: CodeConfig = CodeConfig()
    frequency: FrequencyConfig = FrequencyConfig()
    thresholds: ThresholdsConfig = ThresholdsConfig()


class OutliersConfig(Section):
    """Test of ranges against the predicted ones T(5.23–5.25)."""

    enabled: Switch = True
    """Leave flagged ranges out of the position (they stay in the log)."""
    alpha: Annotated[float, Quantity(0.0, 1.0, "", above=True)] = 0.05
    """Share of a lasting difference that the slow value takes over in a second."""
    threshold: Annotated[float, Quantity(0.0, 1000.0, "m", above=True)] = 6.0
    """Difference that refuses a range, m, widened by 3σ of the prediction."""


class PositioningConfig(Section):
    """Position, velocity and time from the observations."""

    elevation_mask: Annotated[float, Quantity(0.0, 89.0, "deg")] = 10.0
    """Satellites below are left out, deg."""
    raim: Switch = True
    """Find and exclude ranges that contradict the others."""
    smoothing: Switch = False
    """Use carrier-smoothed ranges."""
    ionosphere: Literal["klobuchar", "none"] = "klobuchar"
    """Ionosphere model, from broadcast coefficients."""
    troposphere: Literal["saastamoinen", "none"] = "saastamoinen"
    """Troposphere model."""
    outliers: OutliersConfig = OutliersConfig()
    base: ExistingFile | None = None
    """RINEX observations of a base station: its corrections make positions differential, without
    models of the atmosphere. Needs `nav`."""
    inertial: Switch = True
    """Positions of an aided run take the inertial navigation as a measurement."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if 0.0 < self.elevation_mask < 1.0:
            raise misfit("expected 0, or 1 to 89 deg (looks like radians)", "elevation_mask")
        return self
