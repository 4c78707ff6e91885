"""What a loop, or no loop at all, makes of an aiding frequency that is wrong, T 4.4.1, T 4.5.1.

A carrier generator is fed a frequency that is off by f(t) and a loop takes the phase that comes of
it back: θ_e = H_e(s)/s·f, T(4.35); in open loop H_e = 1, T(4.73). f here is a unit error that
reaches the velocity after so many integrations: tᵏ/k!, or e^(−t/T) integrated k times. What is
drawn once gives that response itself; white noise that drives it gives √∫₀ᵗ response² dt, T(4.62).
Both follow exactly from matrix exponentials, for any loop and any correlation time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from deepgnss.core.loops import PROTOTYPES
from deepgnss.core.records import FloatArray


class Loop(NamedTuple):
    """A carrier loop updated without end: coefficients of its polynomial in s/ω, and ω.

    No coefficients but the leading 1: an open loop.
    """

    polynomial: tuple[float, ...]
    omega_radps: float

    @property
    def order(self) -> int:
        """How many derivatives of the phase it follows without lag, and one more."""
        return len(self.polynomial) - 1

    def feedback(self) -> FloatArray:
        """Errors of phase, frequency, rate (n, n) as they drive each other; input: frequency."""
        n = max(self.order, 1)
        A = np.eye(n, k=1)
        if self.order:
            A[:, 0] = [-c * self.omega_radps**k for k, c in enumerate(self.polynomial)][1:]
        return np.asarray(A)


OPEN: Final = Loop((1.0,), 0.0)
"""Nobody corrects the generator: phase is the integral of the frequency."""


@lru_cache(maxsize=64)
def bandwidth_per_omega(polynomial: tuple[float, ...]) -> float:
    """One-sided noise bandwidth ∫|H|² df over ω of a loop with this polynomial in s/ω.

    3√2/8 = 0.53 for order 2 with damping √½, 5/8 with damping 1, 5/6 for order 3 (1, 2, 2, 1); T's
    0.7845 is that of (1, 2.4, 1.1, 1), another loop.
    """
    A = Loop(polynomial, 1.0).feedback()
    gains = -A[:, :1]  # H from phase to phase has the impulse response first·e^(At)·gains
    gramian = solve_continuous_lyapunov(A, -gains @ gains.T)
    return float(gramian[0, 0]) / 2.0


def carrier_loop(order: int, bandwidth_hz: float, damping: float | None = None) -> Loop:
    """The loop of `core.loops` of this order, or of order 2 with another damping.

    Parameters: order 1–3; one-sided noise bandwidth, Hz; damping ξ of an order 2 (None: √½).
    T 4.4.3 takes 1, for which ω = 1.6·bandwidth.
    """
    if order not in PROTOTYPES:
        raise ValueError(f"loop order {order}: 1, 2 or 3")
    if damping is not None and order != 2:
        raise ValueError(f"damping {damping:g}: only a loop of order 2 has one")
    polynomial = PROTOTYPES[order] if damping is None else (1.0, 2.0 * damping, 1.0)
    return Loop(polynomial, bandwidth_hz / bandwidth_per_omega(polynomial))


class Response(NamedTuple):
    """Errors after times (n,) per unit of what drives them."""

    phase: FloatArray  # of the generator: integral of the frequency error, less what the loop took
    frequency: FloatArray  # of the generator


def drawn_response(loop: Loop, order: int, time_s: FloatArray) -> Response:
    """For f = tᵏ/k!: T(4.50–4.52) in a loop, T(4.77–4.83) without. Times (n,) rising."""
    A, first = _chain(loop, order, math.inf)
    states = np.empty((len(time_s), len(A)))
    state = np.zeros(len(A))
    state[first] = 1.0
    for k, (Phi, _) in enumerate(_steps(A, np.zeros_like(A), time_s)):
        state = Phi @ state
        states[k] = state
    return Response(states[:, 0], states @ A[0])


def white_response(
    loop: Loop, order: int, time_s: FloatArray, correlation_s: float = math.inf
) -> Response:
    """1σ for white noise w that drives f by e^(−t/T) integrated k times: T(4.63–4.65).

    E w(t)·w(t′) = δ(t − t′): a density (two-sided) of 1.

    Parameters: times (n,) rising; correlation time T, s.
    """
    A, first = _chain(loop, order, correlation_s)
    noise = np.zeros_like(A)
    noise[first, first] = 1.0
    P, variances = np.zeros_like(A), np.empty((len(time_s), 2))
    for k, (Phi, Q) in enumerate(_steps(A, noise, time_s)):
        P = Phi @ P @ Phi.T + Q
        variances[k] = P[0, 0], A[0] @ P @ A[0]
    return Response(*np.sqrt(np.maximum(variances, 0.0)).T)


def _steps(
    A: FloatArray, noise: FloatArray, time_s: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Φ and Q from each time to the next, the first from 0; equal steps are worked out once."""
    known: dict[float, tuple[FloatArray, FloatArray]] = {}
    for dt_s in np.round(np.diff(time_s, prepend=0.0), 12):
        if dt_s < 0.0:
            raise ValueError("times: expected rising ones from 0 s on")
        if dt_s not in known:
            known[dt_s] = _step(A, noise, float(dt_s))
        yield known[dt_s]


def _chain(loop: Loop, order: int, correlation_s: float) -> tuple[FloatArray, int]:
    """Loop errors, then f and its derivatives; the place of the last, where things begin."""
    feedback = loop.feedback()
    n, size = len(feedback), len(feedback) + order + 1
    A = np.zeros((size, size))
    A[:n, :n] = feedback
    A[0, n] = 1.0
    for k in range(n, size - 1):
        A[k, k + 1] = 1.0
    A[-1, -1] = -1.0 / correlation_s
    return A, size - 1


def _step(A: FloatArray, noise: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Φ and Q of a step (Van Loan 1978), doubled up from one short enough for e^(−A·dt)."""
    doublings = max(0, math.ceil(math.log2(max(float(np.abs(A).max()) * dt_s, 1e-9))))
    n = len(A)
    both = np.zeros((2 * n, 2 * n))
    both[:n, :n], both[:n, n:], both[n:, n:] = -A, noise, A.T
    parts = expm(both * (dt_s / 2.0**doublings))
    Phi = parts[n:, n:].T
    Q = Phi @ parts[:n, n:]
    for _ in range(doublings):
        Q = Q + Phi @ Q @ Phi.T
        Phi = Phi @ Phi
    return Phi, Q
