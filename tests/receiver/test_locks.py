"""Lock detectors on prompts made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.records import ComplexArray
from deepgnss.receiver.locks import (
    NO_LOCK,
    LockState,
    cn0_dbhz,
    dark,
    false_lock_side,
    fast_cn0_dbhz,
    half_shifts,
    interval_powers,
    mean_shifted_powers,
    neighbour_powers,
    recent_cn0_dbhz,
    restart_phase,
    shifted_powers,
    update_locks,
    update_powers,
)
from deepgnss.receiver.trackers import Accumulated

PERIOD_S = 1e-3


def _seen(prompts: ComplexArray, coherent: bool = True) -> Accumulated:
    taps = np.column_stack([0.9 * prompts, prompts, 0.9 * prompts])
    early, prompt, late = taps.sum(axis=0).tolist()
    return Accumulated(taps, early, prompt, late, prompts.size * PERIOD_S, PERIOD_S, coherent)


def _intervals(
    dbhz: float,
    count: int,
    seed: int = 1,
    *,
    off_hz: float = 0.0,
    size: int = 20,
    coherent: bool = True,
    state: LockState = NO_LOCK,
) -> LockState:
    """State after symbols of random sign over noise of power 1 per period."""
    generator = np.random.default_rng(seed)
    amplitude = np.sqrt(10.0 ** (0.1 * dbhz) * PERIOD_S) if dbhz > 0.0 else 0.0
    for k in range(count):
        noise = (generator.standard_normal(size) + 1j * generator.standard_normal(size)) / 2**0.5
        turn = np.exp(2j * np.pi * off_hz * PERIOD_S * (np.arange(size) + k * size))
        signs = generator.choice([-1.0, 1.0])
        if not coherent:
            signs = np.repeat(generator.choice([-1.0, 1.0], 2), size // 2)
        state = update_locks(state, _seen(signs * amplitude * turn + noise, coherent))
    return state


@pytest.mark.parametrize("dbhz", [25.0, 30.0, 40.0, 50.0, 60.0])
@pytest.mark.parametrize("size", [4, 10, 20])
def test_cn0_is_unbiased(dbhz: float, size: int) -> None:
    """Mean over independent seconds, each its own estimate; three tenths of a dB."""
    powers = []
    for seed in range(12):
        state = _intervals(dbhz, 2000 // size, seed, size=size)
        powers.append(state.signal / (state.noise * PERIOD_S))
    assert 10.0 * np.log10(np.mean(powers)) == pytest.approx(dbhz, abs=0.35)
    assert cn0_dbhz(state, PERIOD_S) == pytest.approx(10.0 * np.log10(powers[-1]))


@pytest.mark.parametrize(("dbhz", "lost_db"), [(30.0, 0.6), (40.0, 2.1)])
def test_cn0_across_symbol_edges_is_low_and_forgotten(dbhz: float, lost_db: float) -> None:
    """Before bit sync one product of nineteen is spoilt every other time, and counts as noise."""
    states = [_intervals(dbhz, 100, seed, coherent=False) for seed in range(8)]
    seen = np.mean([cn0_dbhz(state, PERIOD_S) for state in states])
    assert seen == pytest.approx(dbhz - lost_db, abs=0.3)
    after = [_intervals(dbhz, 15, 9, state=restart_phase(state)) for state in states]
    assert np.mean([cn0_dbhz(s, PERIOD_S) for s in after]) == pytest.approx(dbhz, abs=0.5)


def test_amplitude_does_not_matter() -> None:
    plain = update_locks(NO_LOCK, _seen(np.exp(1j * np.arange(20) * 0.1) + 0.1))
    loud = update_locks(NO_LOCK, _seen(1e4 * (np.exp(1j * np.arange(20) * 0.1) + 0.1)))
    assert cn0_dbhz(loud, PERIOD_S) == pytest.approx(cn0_dbhz(plain, PERIOD_S), abs=1e-9)
    assert loud.phase == pytest.approx(plain.phase)


def test_phase_indicator() -> None:
    """cos 2φ: one in lock whatever the bits, minus one a quarter cycle off, none in noise."""
    locked = _intervals(45.0, 50)
    assert locked.phase > 0.98
    turned = NO_LOCK
    for _ in range(50):
        turned = update_locks(turned, _seen(1j * np.ones(20) + 0j))
    assert turned.phase == pytest.approx(-1.0)
    assert abs(_intervals(0.0, 400).phase) < 0.6
    assert restart_phase(locked).phase == 0.0
    assert restart_phase(locked).signal == locked.signal


@pytest.mark.parametrize(("dbhz", "symbols"), [(26.0, 25), (30.0, 10), (45.0, 10)])
@pytest.mark.parametrize("off_hz", [25.0, -25.0, 0.0])
def test_false_frequency_shows_within_symbols(off_hz: float, dbhz: float, symbols: int) -> None:
    """A Costas loop sees no difference between these."""
    seen = [false_lock_side(_intervals(dbhz, symbols, seed, off_hz=off_hz)) for seed in range(60)]
    assert np.mean(np.array(seen) == np.sign(off_hz)) > 0.98
    if off_hz == 0.0:
        assert not any(seen)


def test_short_symbols_shift_by_their_own_rate() -> None:
    """Ten symbols of 2 ms in an interval: 250 Hz."""
    t = PERIOD_S * np.arange(20)
    signs = np.repeat(np.where(np.arange(10) % 3 == 0, -1.0, 1.0), 2)
    turned = np.exp(2j * np.pi * 250.0 * t) * signs
    assert false_lock_side(update_locks(NO_LOCK, _seen(turned), symbol_periods=2)) == 1
    assert false_lock_side(update_locks(NO_LOCK, _seen(turned.conj()), symbol_periods=2)) == -1
    assert false_lock_side(update_locks(NO_LOCK, _seen(signs + 0j), symbol_periods=2)) == 0


@pytest.mark.parametrize("dbhz", [0.0, 27.0])
def test_cn0_over_short_symbols_needs_no_signs(dbhz: float) -> None:
    """Ten symbols of 2 ms in an interval, each by itself: nothing where there is nothing."""
    generator = np.random.default_rng(3)
    amplitude = np.sqrt(10.0 ** (0.1 * dbhz) * PERIOD_S) if dbhz > 0.0 else 0.0
    state = NO_LOCK
    for _ in range(400):
        noise = (generator.standard_normal(20) + 1j * generator.standard_normal(20)) / 2**0.5
        signs = np.repeat(generator.choice([-1.0, 1.0], 10), 2)
        state = update_powers(state, _seen(signs * amplitude + noise), 8.0, 2)
    assert state.signal == pytest.approx(amplitude**2, abs=0.03)
    assert state.noise == pytest.approx(1.0, abs=0.03)


def test_a_blockage_is_seen_in_a_tenth_of_a_second_and_its_end_too() -> None:
    state = _intervals(45.0, 100)
    for k in range(1, 6):
        state = _intervals(0.0, 1, 100 + k, state=state)
    assert recent_cn0_dbhz(state, PERIOD_S) < 24.0
    assert cn0_dbhz(state, PERIOD_S) > 43.0
    state = _intervals(0.0, 25, 7, state=state)
    assert fast_cn0_dbhz(state, PERIOD_S) < 24.0
    state = _intervals(45.0, 2, 8, state=state)
    assert fast_cn0_dbhz(state, PERIOD_S) > 34.0


@pytest.mark.parametrize(("fallen_dbhz", "share"), [(0.0, 1.0), (20.0, 1.0), (34.0, 0.0)])
def test_a_strong_signal_that_falls_is_dark_once_nothing_is_left(
    fallen_dbhz: float, share: float
) -> None:
    """At 34 dB-Hz a phase is known to a hundredth of a cycle, whatever it was before."""
    strong = _intervals(47.0, 100)
    told = [dark(_intervals(fallen_dbhz, 1, k, state=strong), PERIOD_S) for k in range(200)]
    assert np.mean(told) == pytest.approx(share, abs=0.02)


def test_nothing_seen_nothing_said() -> None:
    assert cn0_dbhz(NO_LOCK, PERIOD_S) == 0.0
    assert recent_cn0_dbhz(NO_LOCK, PERIOD_S) == 0.0
    assert false_lock_side(NO_LOCK) == 0
    zeros = update_locks(NO_LOCK, _seen(np.zeros(20, dtype=np.complex128)))
    assert cn0_dbhz(zeros, PERIOD_S) == 0.0
    assert zeros.phase == 0.0


@pytest.mark.kernel
@pytest.mark.parametrize("size", [1, 2, 5, 20])
def test_kernels_do_what_numpy_does(size: int) -> None:
    generator = np.random.default_rng(4)
    taps = generator.standard_normal((20, 3)) + 1j * generator.standard_normal((20, 3)) + 0.5
    prompts = taps[:, 1]
    symbols = prompts.reshape(-1, size)
    wide = np.sum(np.abs(prompts) ** 2)
    narrow = np.sum(np.abs(symbols.sum(axis=1)) ** 2) / size
    assert interval_powers(taps, size) == pytest.approx((wide, narrow), rel=1e-12)
    z = prompts[:-1].conj() * prompts[1:]
    expected = (wide, z.real.sum(), (z * z).real.sum())
    assert neighbour_powers(taps) == pytest.approx(expected, rel=1e-12)
    means = shifted_powers(symbols).mean(axis=0)
    assert mean_shifted_powers(taps, half_shifts(size)) == pytest.approx(means, rel=1e-12)
