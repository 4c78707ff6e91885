"""Delay and Doppler of milliseconds: unbiased, as good as stated, false alarms as stated."""

from __future__ import annotations

import numpy as np
import pytest
from noisy_sky import Sent, info, sky

from deepgnss.core.records import SampleBlock
from deepgnss.receiver.precise import (
    correlate_samples,
    correlate_snapshot,
    half_band_hz,
    look,
    measure,
    replica,
)
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL as L1CA
from deepgnss.receiver.signals import ca_code
from deepgnss.receiver.symbols import fit_symbols


def wrapped(chips: float) -> float:
    return (chips + 511.5) % 1023.0 - 511.5


def random_satellite(rng: np.random.Generator, cn0_dbhz: float) -> Sent:
    return Sent(
        int(rng.integers(1, 33)),
        float(rng.uniform(-5e3, 5e3)),
        float(rng.uniform(0, 1023)),
        cn0_dbhz,
        int(rng.integers(20)),
    )


@pytest.mark.parametrize(
    ("rate_hz", "intermediate_hz", "is_complex", "cn0_dbhz"),
    [(2.6e6, 0.0, True, 45.0), (5.3e6, 20e3, True, 40.0), (9.7e6, 2.5e6, False, 42.0)],
)
def test_errors_are_the_stated_ones(
    rate_hz: float, intermediate_hz: float, is_complex: bool, cn0_dbhz: float
) -> None:
    rng = np.random.default_rng(1)
    stream = info(rate_hz, is_complex, intermediate_hz)
    code, doppler, strength = [], [], []
    for _ in range(24):
        sent = random_satellite(rng, cn0_dbhz)
        seen = measure(
            sky(stream, [sent], 0.012, rng),
            L1CA,
            sent.prn,
            sent.doppler_hz + rng.uniform(-8, 8),
            (sent.code_chips + rng.uniform(-0.25, 0.25)) % 1023.0,
        )
        code.append(wrapped(seen.code_chips - sent.code_chips) / seen.code_sigma_chips)
        doppler.append((seen.doppler_hz - sent.doppler_hz) / seen.doppler_sigma_hz)
        strength.append(seen.cn0_dbhz - cn0_dbhz)
    for normalized in (code, doppler):
        assert 0.6 < np.std(normalized) < 1.45
        assert abs(np.mean(normalized)) < 0.7
    assert np.mean(strength) == pytest.approx(-0.2, abs=0.4)


def test_noise_is_not_taken_for_a_satellite() -> None:
    rng = np.random.default_rng(2)
    block = sky(info(4.0e6), [], 0.012, rng)
    seen = [
        look(block, L1CA, prn, rng.uniform(-4e3, 4e3), rng.uniform(0, 1023), 15.0, 1.5, 0.05)
        for prn in range(1, 33)
    ]
    assert sum(one is not None for one in seen) <= 5


def test_narrow_look_finds_a_weak_satellite_beside_the_prediction() -> None:
    rng = np.random.default_rng(3)
    sent = Sent(8, 1234.0, 0.4, 38.0, edge=4)
    block = sky(info(4.1e6), [sent], 0.012, rng)
    seen = look(block, L1CA, 8, 1240.0, 1022.5, 15.0, 1.5)
    assert seen is not None
    assert wrapped(seen.code_chips - 0.4) == pytest.approx(0.0, abs=0.2)
    assert seen.doppler_hz == pytest.approx(1234.0, abs=12.0)


def test_replica_is_the_code_without_its_far_spectrum() -> None:
    local = replica("GPS_L1CA", 5, 10e6)
    chips = ca_code(5)
    # In the middle of a chip the band-limited code stands near the chip itself.
    middle = local.table[16:-1:32]
    assert np.mean(middle * chips) == pytest.approx(1.0, abs=0.02)
    assert local.energy == pytest.approx(1.0, abs=0.03)
    narrow = replica("GPS_L1CA", 5, 1.023e6)
    assert narrow.energy == pytest.approx(0.903, abs=0.01)  # main lobe of sinc²
    assert narrow.slope < local.slope


def test_kernel_twin() -> None:
    rng = np.random.default_rng(4)
    samples = rng.integers(-50, 50, (6000, 2)).astype(np.int16)
    table, length = replica("GPS_L1CA", 3, 2e6).table, 1023
    offsets = np.array([-0.3, 0.0, 0.4])
    out, counts = np.zeros((3, 3), np.complex128), np.zeros(3)
    correlate_samples(samples, 0.0123, 700.2, 0.2551, length, table, offsets, out, counts)
    n = np.arange(6000)
    chips = 700.2 + n * 0.2551
    turned = (samples @ np.array([1.0, 1.0j])) * np.exp(-2j * np.pi * 0.0123 * n)
    for tap, offset in enumerate(offsets):
        local = np.interp((chips + offset) % length * 32, np.arange(table.size), table)
        for period in range(3):
            inside = (chips // length) == period
            assert counts[period] == np.count_nonzero(inside)
            np.testing.assert_allclose(
                out[period, tap], np.sum((turned * local)[inside]), rtol=1e-6
            )


def test_first_period_is_cut_where_the_code_starts() -> None:
    stream = info(4.0e6)
    block = SampleBlock(stream, 0, np.ones((8000, 2), np.int8))
    seen = correlate_snapshot(block, L1CA, 1, 0.0, 1000.0, np.zeros(1))
    # 23 chips to go, then a whole period of 1 ms, then the rest.
    assert seen.times_s[0] == pytest.approx(23 / 2 / 1.023e6, abs=3e-7)
    assert np.diff(seen.times_s)[1] == pytest.approx(0.5e-3 + 0.5 * (1e-3 - 23 / 1.023e6), abs=1e-6)
    assert half_band_hz(block) == pytest.approx(1.9e6)


def test_symbols_do_not_pass_for_doppler() -> None:
    """A change of sign in the middle moves no frequency by ±1/2T."""
    times_s = np.arange(20) * 1e-3
    signs = np.where(np.arange(20) < 10, 1.0, -1.0)
    turned = signs * np.exp(2j * np.pi * (3.0 * times_s + 0.1))
    fit = fit_symbols(turned, times_s, np.ones(20), 60.0)
    assert fit.doppler_hz == pytest.approx(3.0, abs=0.3)
    assert list(fit.starts) == [0, 10]
    assert list(fit.signs) == [1.0] * 10 + [-1.0] * (times_s.size - 10)
    stripped = fit.strip(signs * np.exp(2j * np.pi * 3.0 * times_s), times_s)
    assert abs(stripped.sum()) == pytest.approx(20.0, abs=0.1)
