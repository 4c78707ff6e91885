"""The Kalman carrier loop: its filter against others, its gains, and what it makes of noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from deepgnss.core.carrier_model import carrier_covariance, transition
from deepgnss.core.loops import LoopGains, loop_gains, noise_bandwidth_hz
from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.evaluate.reproduce.correlator_model import RATE_HZ, Model, run, start
from deepgnss.receiver.kalman_loop import (
    KalmanLoop,
    Memory,
    measurement_row,
    phase_variance,
    predict,
    predict_root,
    steady_gains,
    update,
    update_root,
)
from deepgnss.receiver.modes import (
    IDEAL_OSCILLATOR,
    CarrierSettings,
    KalmanSettings,
    Mode,
    TrackingSettings,
)
from deepgnss.receiver.trackers import accumulate
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles

OCXO = Oscillator("OCXO", 2e-25, 0.0, 6e-25, 0.0)
TCXO = Oscillator("TCXO", 1e-21, 1e-21, 2e-20, 0.0)
T = 0.02
quick = settings(deadline=None, derandomize=True, max_examples=40)


def _spread(seed: int) -> FloatArray:
    """A covariance as a loop has them: states of unlike size, not diagonal."""
    A = np.random.default_rng(seed).standard_normal((3, 3))
    scale = np.array([0.01, 0.3, 5.0])
    return np.asarray(scale[:, np.newaxis] * (A @ A.T) * scale)


# --- the filter ----------------------------------------------------------------------------------


@given(seed=st.integers(0, 1000), R=st.floats(1e-7, 1e-2), fading=st.floats(1.0, 1.2))
@quick
def test_potter_is_joseph_is_kalman(seed: int, R: float, fading: float) -> None:
    P, H = _spread(seed), measurement_row(T)
    S = np.linalg.cholesky(P)
    F, Q = transition(3, T), carrier_covariance(3, T, TCXO, 1.5e9, 4.0)
    root_Q = np.linalg.cholesky(Q)
    ahead, root = predict(P, F, root_Q, fading), predict_root(S, F, root_Q, fading)
    np.testing.assert_allclose(ahead, fading * F @ P @ F.T + Q, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(root @ root.T, ahead, rtol=1e-9)
    assert np.array_equal(root, np.tril(root))

    K, after = update(ahead, H, R)
    K_root, root = update_root(root, H, R)
    gain = ahead @ H / (H @ ahead @ H + R)
    np.testing.assert_allclose(K, gain, rtol=1e-9)
    np.testing.assert_allclose(K_root, gain, rtol=1e-7)
    size = np.sqrt(np.outer(np.diag(after), np.diag(after)))
    np.testing.assert_allclose((root @ root.T - after) / size, 0.0, atol=1e-6)
    np.testing.assert_allclose(
        (after - (np.eye(3) - np.outer(gain, H)) @ ahead) / size, 0, atol=1e-6
    )


def test_potter_stays_positive_where_a_covariance_does_not() -> None:
    """A measurement a million times better than the prediction, again and again, float32."""
    H = np.array([1.0, 0.0, 0.0], dtype=np.float32)
    P = np.diag(np.array([1.0, 1.0, 1.0], dtype=np.float32))
    P[0, 1] = P[1, 0] = np.float32(0.999999)
    S = np.linalg.cholesky(P.astype(np.float64)).astype(np.float32)
    R = np.float32(1e-9)
    plain = P - np.outer(P @ H, P @ H) / (H @ P @ H + R)
    for _ in range(3):
        plain = plain - np.outer(plain @ H, plain @ H) / (H @ plain @ H + R)
        _, S = update_root(S, H, R)
    assert np.linalg.eigvalsh((S @ S.T).astype(np.float64)).min() >= -1e-12
    assert np.isfinite(S).all()


def test_the_mean_over_an_interval_is_k_21_moved_to_its_middle() -> None:
    """K(21) and its row at the beginning are the same measurement."""
    at_beginning = np.array([1.0, T / 2.0, T * T / 6.0])
    back = np.asarray(expm(-0.5 * T * np.diag([1.0, 1.0], 1)))
    np.testing.assert_allclose(at_beginning @ back, measurement_row(T), atol=1e-15)
    t = (np.arange(1000) + 0.5) / 1000.0 * T - T / 2.0
    mean = np.mean(0.3 + 2.0 * t + 0.5 * 70.0 * t * t)
    assert measurement_row(T) @ [0.3, 2.0, 70.0] == pytest.approx(mean, rel=1e-6)


# --- gains ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize("fading", [1.0, 1.05])
@pytest.mark.parametrize("oscillator", [OCXO, TCXO])
def test_gains_come_to_those_of_the_riccati_equation(
    oscillator: Oscillator, fading: float, square_root: bool
) -> None:
    loop = KalmanLoop(T, 1.0, oscillator, adaptive=False, fading=fading, square_root=square_root)
    seen = accumulate(np.full((20, 3), np.exp(0.1j)), 1e-3, True, cn0_hz=1e4)
    memory = loop.start()
    for _ in range(2000):
        memory, correction = loop.step(memory, seen)
    error = 0.1 / (2.0 * math.pi)
    steady = steady_gains(T, oscillator, 1.0, fading, phase_variance(1e4, T))
    np.testing.assert_allclose(np.array(correction) / error, steady, rtol=1e-6)


@pytest.mark.parametrize(("order", "bandwidth_hz"), [(2, 7.0), (3, 0.5), (3, 7.0), (3, 18.0)])
def test_bandwidth_of_gains(order: int, bandwidth_hz: float) -> None:
    gains = loop_gains(order, bandwidth_hz, T)
    assert noise_bandwidth_hz(gains, T) == pytest.approx(bandwidth_hz, rel=1e-9)


def test_without_an_oscillator_it_is_the_wiener_optimum() -> None:
    """Driven by the acceleration alone: the PLL of order 3 of its bandwidth, if slow enough."""
    steady = steady_gains(0.001, IDEAL_OSCILLATOR, 0.05, 1.0, phase_variance(1e4, 1e-3))
    same = loop_gains(3, noise_bandwidth_hz(steady, 0.001), 0.001)
    np.testing.assert_allclose(steady, same, rtol=0.02)
    assert isinstance(steady, LoopGains)


# --- noise ---------------------------------------------------------------------------------------


def _settings(**more: float | bool) -> TrackingSettings:
    kalman = KalmanSettings(**more)  # type: ignore[arg-type]
    return TrackingSettings(CarrierSettings("kalman", oscillator=OCXO, kalman=kalman))


@pytest.mark.parametrize("cn0_dbhz", [32.0, 45.0])
def test_errors_are_as_large_as_the_filter_says(cn0_dbhz: float) -> None:
    """NEES of phase, frequency and rate over seeds; motion and oscillator drawn from the model."""
    loop, steps, runs = KalmanLoop(T, 0.5, OCXO, adaptive=False), 400, 150
    F = transition(3, T)
    Q = carrier_covariance(3, T, OCXO, 1575.42e6, (0.5 * 1575.42e6 / 299792458.0) ** 2)
    root = np.linalg.cholesky(Q)
    rng = np.random.default_rng(7)
    cn0_hz = 10.0 ** (0.1 * cn0_dbhz)
    R = phase_variance(cn0_hz, T)
    nees, nis = [], []
    for _ in range(runs):
        x = np.array([0.1, 3.0, 30.0]) * rng.standard_normal(3) * 0.3
        memory: Memory = loop.start()
        for k in range(steps):
            if k:
                x = F @ x + root @ rng.standard_normal(3)
            turn = measurement_row(T) @ x + math.sqrt(R) * rng.standard_normal()
            seen = accumulate(np.full((1, 3), np.exp(2j * np.pi * turn)), T, True, cn0_hz=cn0_hz)
            if k > 200:
                S = predict_root(memory.spread, F, root, 1.0)
                C = float(((measurement_row(T) @ S) ** 2).sum()) + R
                nis.append(turn * turn / C)
            memory, correction = loop.step(memory, seen)
            x -= np.array(correction)
        nees.append(x @ np.linalg.solve(loop.covariance(memory), x))
    assert np.mean(nees) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / runs))
    assert np.mean(nis) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("cn0_dbhz", [30.0, 45.0])
@pytest.mark.parametrize("told_db", [-5.0, 5.0])
def test_innovations_tell_the_noise(cn0_dbhz: float, told_db: float) -> None:
    """C/N0 told wrongly by 5 dB: R comes to what it is, over seeds."""
    loop = KalmanLoop(T, 0.3, OCXO, memory_s=10.0)
    true_R = phase_variance(10.0 ** (0.1 * cn0_dbhz), T)
    told_hz = 10.0 ** (0.1 * (cn0_dbhz + told_db))
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        x, memory, F = np.zeros(3), loop.start(), transition(3, T)
        for _ in range(1500):
            x = F @ x
            turn = x[0] + math.sqrt(true_R) * rng.standard_normal()
            seen = accumulate(np.full((1, 3), np.exp(2j * np.pi * turn)), T, True, cn0_hz=told_hz)
            memory, correction = loop.step(memory, seen)
            x -= np.array(correction)
        found.append(memory.R)
    assert np.mean(found) / true_R == pytest.approx(1.0, abs=0.15)
    off = KalmanLoop(T, 0.3, OCXO, adaptive=False)
    memory, _ = off.step(off.start(), seen)
    assert phase_variance(told_hz, T) == memory.R


def test_a_steady_lag_is_not_taken_for_noise() -> None:
    """A jerk leaves a phase error that stays: innovations have a mean, and R does not grow."""
    loop = KalmanLoop(T, 0.3, OCXO, memory_s=1.0)
    R = phase_variance(1e4, T)
    rng, memory, F = np.random.default_rng(3), loop.start(), transition(3, T)
    x, jerk = np.zeros(3), np.array([T**3 / 6.0, T**2 / 2.0, T]) * 40.0  # Hz/s²
    for _ in range(500):
        x = F @ x + jerk
        turn = x[0] + math.sqrt(R) * rng.standard_normal()
        seen = accumulate(np.full((1, 3), np.exp(2j * np.pi * turn)), T, True, cn0_hz=1e4)
        memory, correction = loop.step(memory, seen)
        x -= np.array(correction)
    assert memory.seen.mean > 3.0 * math.sqrt(R)
    assert memory.R < 2.0 * R


# --- in a channel --------------------------------------------------------------------------------


@pytest.mark.parametrize("square_root", [False, True])
def test_a_channel_is_as_good_as_its_bandwidth(square_root: bool) -> None:
    """Phase σ as T(2.20) has it of the bandwidth the loop reports."""
    model = Model(lambda _t: 42.0, rate_hzps=2.0, seed=4)
    channel = start(model, _settings(square_root=square_root))
    errors: list[float] = []

    def seen(one: object) -> None:
        for interval in channel.history:
            sample = interval.command.sample
            truth = float(model.phase_cycles(np.array([sample / RATE_HZ]))[0])
            errors.append((interval.command.carrier_cycles - truth + 0.25) % 0.5 - 0.25)

    run(channel, 2.0)
    run(channel, 30.0, seen)
    assert channel.mode is Mode.PHASE
    assert channel.slips == 0 or channel.phase_valid
    bandwidth_hz = channel.report("x").carrier_bandwidth_hz
    sigma = pll_thermal_sigma_cycles(42.0, bandwidth_hz, T)
    assert np.std(errors) == pytest.approx(sigma, rel=0.2)
    assert 5.0 < bandwidth_hz < 15.0


def test_square_root_or_not_is_the_same_track() -> None:
    tracks = []
    for square_root in (False, True):
        model = Model(lambda _t: 38.0, rate_hzps=2.0, seed=4)
        channel = start(model, _settings(square_root=square_root))
        tracks.append(run(channel, 4.0, lambda one: one.command.carrier_cycles))
    np.testing.assert_allclose(*tracks, atol=1e-4)


def test_parameters_reach_the_loop() -> None:
    """More motion, a wider loop; less noise, too; a memory that fades, too."""
    base = KalmanLoop(T, 0.3, OCXO)
    assert replace(base, dynamics_mps2=3.0).settled.bandwidth_hz > 1.5 * base.settled.bandwidth_hz
    assert replace(base, fading=1.1).settled.bandwidth_hz > base.settled.bandwidth_hz
    assert replace(base, oscillator=TCXO).settled.bandwidth_hz > base.settled.bandwidth_hz
    assert base.settled.order == 3
