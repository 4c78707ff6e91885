"""Oscillator noise: Allan deviation, free-running phase, and what a phase-lock loop leaves of it.

S_y(f) = h0 + h₋₁/f + h₋₂/f² is the one-sided density of relative frequency. A phase of x cycles
obeys dx/dt = f0·y, hence S_x(f) = f0²·S_y(f) / (2πf)².
"""

from __future__ import annotations

import math

from deepgnss.core.records import Oscillator
from deepgnss.theory.loop_response import carrier_loop


def allan_deviation(oscillator: Oscillator, tau_s: float) -> float:
    """Allan deviation σ_y(τ): √(h0/2τ + 2 ln2·h₋₁ + (2π²/3)·τ·h₋₂)."""
    return math.sqrt(
        oscillator.h0_s / (2.0 * tau_s)
        + 2.0 * math.log(2.0) * oscillator.h_1
        + 2.0 / 3.0 * math.pi**2 * tau_s * oscillator.h_2_hz
    )


def free_running_phase_sigma_cycles(
    oscillator: Oscillator, carrier_hz: float, tau_s: float
) -> float:
    """Spread of carrier phase, cycles, τ after phase and frequency were known exactly.

    f0·√(h0·τ/2 + 2π²·h₋₂·τ³/3): a Wiener process of phase and one of frequency; flicker noise,
    which has no such model, is left out.
    """
    return carrier_hz * math.sqrt(
        oscillator.h0_s * tau_s / 2.0 + 2.0 / 3.0 * math.pi**2 * oscillator.h_2_hz * tau_s**3
    )


def free_running_frequency_sigma_hz(
    oscillator: Oscillator, carrier_hz: float, tau_s: float
) -> float:
    """Spread of the oscillator's frequency at the carrier, Hz, τ after it was known: random walk.

    f0·√(2π²·h₋₂·τ); the mean over any later interval adds white noise to it.
    """
    return carrier_hz * math.sqrt(2.0 * math.pi**2 * oscillator.h_2_hz * tau_s)


def pll_oscillator_sigma_cycles(
    order: int, bandwidth_hz: float, carrier_hz: float, oscillator: Oscillator
) -> float:
    """Phase error, cycles, that a loop of order 2 or 3 leaves of its oscillator's noise.

    √(∫ |1 − H|²·S_φ df) in closed form (K(7)). K(8) is the same for order 2 except that it has
    half of the h₋₂ term.
    """
    return _residual_sigma_cycles(
        order,
        bandwidth_hz,
        carrier_hz,
        (oscillator.h0_s, oscillator.h_1, oscillator.h_2_hz),
    )


def pll_vibration_sigma_cycles(
    order: int,
    bandwidth_hz: float,
    carrier_hz: float,
    g_sensitivity: float,
    vibration_g2phz: float,
) -> float:
    """Phase error, cycles, from vibration of the oscillator, T(2.21), T(2.22).

    Parameters: relative frequency per g; one-sided vibration density, g²/Hz, flat over all
    frequencies. T(2.22) as printed has π where the integral gives π².
    """
    white = g_sensitivity**2 * vibration_g2phz
    return _residual_sigma_cycles(order, bandwidth_hz, carrier_hz, (white, 0.0, 0.0))


def allan_phase_sigma_cycles(carrier_hz: float, coherent_s: float, deviation: float) -> float:
    """Phase, cycles, that an Allan deviation at the coherent time adds up to over it, T(2.23)."""
    return carrier_hz * coherent_s * deviation


def _residual_sigma_cycles(
    order: int, bandwidth_hz: float, carrier_hz: float, h: tuple[float, float, float]
) -> float:
    # Error responses of the prototypes are |1 − H|² = ω²ⁿ / (ω²ⁿ + ω_L²ⁿ), and
    # ∫ ω^(p−1)/(ω²ⁿ + ω_L²ⁿ) dω over ω > 0 is π / (2n·sin(p·π/2n)) · ω_L^(p − 2n).
    omega = carrier_loop(order, bandwidth_hz).omega_radps
    variance = 0.0
    for k, coefficient in enumerate(h):
        power = 2 * order - 1 - k
        integral = math.pi / (2 * order * math.sin(power * math.pi / (2 * order)))
        variance += (
            coefficient * (2.0 * math.pi) ** (k - 1) * integral * omega ** (power - 2 * order)
        )
    return carrier_hz * math.sqrt(variance)
