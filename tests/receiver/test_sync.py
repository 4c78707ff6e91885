"""Symbol edges and the demodulator that looks back, on prompts made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.sync import (
    BitSync,
    Edge,
    add_prompts,
    decided_signs,
    demodulate,
    start_bit_sync,
    symbol_edge,
)

PERIOD_S = 1e-3


def _prompts(
    cn0_dbhz: float,
    symbols: int,
    edge: int,
    seed: int,
    off_hz: float = 0.0,
    secondary: FloatArray = GPS_L1CA_SIGNAL.secondary,
) -> ComplexArray:
    """Unit amplitude prompts of random bits whose symbols start at period `edge`."""
    generator = np.random.default_rng(seed)
    bits = generator.choice([-1.0, 1.0], symbols + 2)
    size = secondary.size
    count = symbols * size
    signs = np.outer(bits, secondary).ravel()[size - edge : size - edge + count]
    sigma = np.sqrt(0.5 / (10.0 ** (0.1 * cn0_dbhz) * PERIOD_S))
    noise = sigma * (generator.standard_normal(count) + 1j * generator.standard_normal(count))
    turn = np.exp(2j * np.pi * (off_hz * PERIOD_S * np.arange(count) + generator.uniform()))
    return np.asarray(signs * turn + noise)


def _sync(
    prompts: ComplexArray,
    cn0_dbhz: float,
    signal_power: float = 1.0,
    piece: int = 20,
    signal: Signal = GPS_L1CA_SIGNAL,
) -> tuple[Edge | None, BitSync]:
    state = start_bit_sync(signal.secondary, coded=bool(signal.secondary_code))
    noise_power = 1.0 / (10.0 ** (0.1 * cn0_dbhz) * PERIOD_S)
    for first in range(0, prompts.size, piece):
        state = add_prompts(state, prompts[first : first + piece], signal_power, noise_power)
        found = symbol_edge(state)
        if found is not None:
            return found, state
    return None, state


@pytest.mark.parametrize("edge", [0, 1, 7, 19])
def test_edges_of_a_strong_signal_within_a_second(edge: int) -> None:
    for seed in range(10):
        found, state = _sync(_prompts(40.0, 100, edge, seed), 40.0)
        assert found == Edge(edge, False)
        assert state.symbols <= 50


@pytest.mark.parametrize(("cn0_dbhz", "most"), [(30.0, 100), (25.0, 300)])
def test_no_wrong_edge_of_weak_signals(cn0_dbhz: float, most: int) -> None:
    """Found in time, and never wrong, also a few hertz off."""
    for seed in range(20):
        found, _ = _sync(_prompts(cn0_dbhz, most, seed % 20, seed, 2.0), cn0_dbhz)
        assert found == Edge(seed % 20, False)


def test_noise_or_constant_bits_have_no_edge() -> None:
    for seed in range(5):
        generator = np.random.default_rng(seed)
        noise = generator.standard_normal(4000) + 1j * generator.standard_normal(4000)
        assert _sync(noise, 27.0, signal_power=0.05)[0] is None
    assert _sync(np.ones(4000, dtype=np.complex128), 45.0)[0] is None


def test_edges_do_not_depend_on_the_pieces() -> None:
    prompts = _prompts(33.0, 60, 11, 3)
    states = []
    for piece in (7, 20, 1200):
        state = start_bit_sync(np.ones(20), coded=False)
        for first in range(0, prompts.size, piece):
            state = add_prompts(state, prompts[first : first + piece], 1.0, 0.5)
        states.append(state)
    for state in states[1:]:
        np.testing.assert_array_equal(state.likelihood, states[0].likelihood)
        assert state.symbols == states[0].symbols


@pytest.mark.parametrize("off_hz", [0.0, 2.0, 500.0, -498.0])
def test_secondary_code_shows_edges_without_bits_and_a_frequency_half_a_rate_off(
    off_hz: float,
) -> None:
    signal = BDS_B1I_D1
    for seed in range(5):
        prompts = _prompts(33.0, 60, seed * 4, seed, off_hz, signal.secondary)
        found, state = _sync(prompts, 33.0, signal=signal)
        assert found == Edge(seed * 4, abs(off_hz) > 250.0)
        assert state.symbols <= 20
    constant = np.resize(signal.secondary, 400).astype(np.complex128)
    assert _sync(constant, 45.0, signal=signal)[0] == Edge(0, False)


@pytest.mark.parametrize("edge", [0, 1])
def test_edges_of_short_symbols(edge: int) -> None:
    signal = BDS_B1I_D2
    for seed in range(5):
        prompts = _prompts(36.0, 600, edge, seed, 5.0, signal.secondary)
        assert _sync(prompts, 36.0, signal=signal)[0] == Edge(edge, False)


# --- demodulation --------------------------------------------------------------------------------


@pytest.mark.parametrize("off_hz", [0.0, 3.0, -7.0, 11.0])
def test_symbols_phase_and_rotation(off_hz: float) -> None:
    generator = np.random.default_rng(5)
    bits = generator.integers(0, 2, 60)
    start = 0.13
    phase = start + off_hz * 0.02 * np.arange(60)
    noise = 0.08 * (generator.standard_normal(60) + 1j * generator.standard_normal(60))
    seen = demodulate((1.0 - 2.0 * bits) * np.exp(2j * np.pi * phase) + noise)
    assert seen.step_cycles == pytest.approx(off_hz * 0.02, abs=0.005)
    turned = np.mod(seen.phase_cycles - phase[-1] + 0.25, 1.0) - 0.25
    half = round(2.0 * turned)  # polarity is that of the phase it ends with
    assert half in (0, 1)
    assert turned - 0.5 * half == pytest.approx(0.0, abs=0.03)
    assert np.array_equal(np.frombuffer(bytes(seen.symbols), dtype=np.int8), bits ^ half)


@pytest.mark.parametrize("off_hz", [0.0, 40.0, -90.0])
def test_signs_of_symbols_within_an_interval(off_hz: float) -> None:
    generator = np.random.default_rng(3)
    for _ in range(20):
        signs = generator.choice([-1.0, 1.0], 10)
        turn = np.exp(2j * np.pi * (off_hz * 2e-3 * np.arange(10) + generator.uniform()))
        noise = 0.1 * (generator.standard_normal(10) + 1j * generator.standard_normal(10))
        decided = decided_signs(signs * turn + noise)
        assert abs(decided @ signs) == 10.0


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_few_symbols_are_enough(count: int) -> None:
    sums = np.exp(2j * np.pi * (0.3 + 0.04 * np.arange(count)))
    seen = demodulate(sums)
    assert len(seen.symbols) == count
    turned = np.mod(seen.phase_cycles - 0.3 - 0.04 * (count - 1) + 0.25, 0.5) - 0.25
    assert turned == pytest.approx(0.0, abs=0.01)


def test_a_changing_frequency_is_followed() -> None:
    """50 Hz/s: a car's hardest braking."""
    t = 0.02 * np.arange(50)
    phase = 0.5 * 50.0 * (t - t[-1]) ** 2 * -1.0
    bits = np.random.default_rng(1).integers(0, 2, 50)
    seen = demodulate((1.0 - 2.0 * bits) * np.exp(2j * np.pi * phase))
    wrong = np.frombuffer(bytes(seen.symbols), dtype=np.int8)[-20:] != bits[-20:]
    assert wrong.all() or not wrong.any()


def test_nothing_gives_nothing() -> None:
    seen = demodulate(np.empty(0, dtype=np.complex128))
    assert (bytes(seen.symbols), seen.step_cycles) == (b"", 0.0)
