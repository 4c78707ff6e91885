"""White noise against its definition, its distribution and itself."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from deepgnss.sim.noise import normal_pairs
from deepgnss.sim.seeds import random_stream, seed_sequence

pytestmark = pytest.mark.kernel

KNOWN = [[0xBD381C57, 0xBF9CC6EC, 0x3F2A7F0F], [0xBED19F82, 0x3F514544, 0x3F5513F0]]


def _split_mix(key: int, n: NDArray[np.int64]) -> NDArray[np.uint64]:
    """64 bits of each counter, in Python's unbounded integers."""
    out = []
    for counter in n.tolist():
        z = (key + counter * 0x9E3779B97F4A7C15) % 2**64
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB % 2**64
        out.append(z ^ (z >> 31))
    return np.array(out, dtype=np.uint64)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(key=st.integers(0, 2**64 - 1), first=st.integers(-1000, 2**50), count=st.integers(1, 1100))
def test_pairs_are_those_of_box_and_muller(key: int, first: int, count: int) -> None:
    """In double precision and numpy's own functions; single precision is good to a few 1e-6."""
    bits = _split_mix(key, first + np.arange(count))
    uniform = ((bits >> np.uint64(33)).astype(np.float64) + 0.5) / 2.0**31
    quarter = ((bits >> np.uint64(31)) & np.uint64(3)).astype(np.float64)
    within = ((bits & np.uint64(2**31 - 1)).astype(np.float64) + 0.5) / 2.0**31 - 0.5
    angle = (quarter + within) * math.pi / 2.0
    expected = np.sqrt(-2.0 * np.log(uniform)) * np.array([np.cos(angle), np.sin(angle)])
    # near zero radius the logarithm itself is of the size of the rounding of 31·ln 2
    np.testing.assert_allclose(normal_pairs(key, first, count), expected, rtol=0.0, atol=2.5e-3)
    large = np.hypot(*expected) > 0.1
    np.testing.assert_allclose(
        normal_pairs(key, first, count)[:, large], expected[:, large], rtol=0.0, atol=4e-5
    )


def test_known_values() -> None:
    """The same on every machine, compiled or not."""
    bits = normal_pairs(1, -1, 3).view(np.uint32).tolist()
    assert bits == KNOWN


def test_any_stretch_is_a_cut_of_the_whole() -> None:
    whole = normal_pairs(77, -20, 1500)
    for first, count in ((-20, 1), (0, 513), (511, 2), (1100, 380)):
        np.testing.assert_array_equal(
            normal_pairs(77, first, count), whole[:, first + 20 :][:, :count]
        )


@pytest.mark.parametrize("key", [0, 2**63 + 12345])
def test_moments_distribution_and_whiteness(key: int) -> None:
    n = 1 << (12 if numba.config.DISABLE_JIT else 20)
    pairs = normal_pairs(key, 5, n).astype(np.float64)
    values = pairs.ravel()
    five = 5.0 / math.sqrt(values.size)
    assert abs(values.mean()) < five
    for power, moment, spread in (
        (2, 1.0, 2.0),
        (3, 0.0, 15.0),
        (4, 3.0, 96.0),
        (6, 15.0, 10170.0),
    ):
        assert np.mean(values**power) == pytest.approx(moment, abs=five * math.sqrt(spread))
    assert scipy.stats.kstest(values, "norm").pvalue > 1e-4
    # tails: counts beyond 3, 4 and 4.5 σ
    for sigma in (3.0, 4.0, 4.5):
        expected = values.size * math.erfc(sigma / math.sqrt(2.0))
        assert abs(np.sum(np.abs(values) > sigma) - expected) < 5.0 * math.sqrt(expected) + 1.0
    z = pairs[0] + 1j * pairs[1]
    for lag in (1, 2, 3, 64, 512, 1024):
        assert abs(np.mean(z[lag:] * np.conj(z[:-lag]))) < 2.0 * 5.0 / math.sqrt(n - lag)
        assert abs(np.mean(np.abs(z[lag:]) ** 2 * np.abs(z[:-lag]) ** 2) - 4.0) < 60.0 / math.sqrt(
            n
        )
    assert abs(np.mean(pairs[0] * pairs[1])) < 5.0 / math.sqrt(n)
    power = np.abs(np.fft.fft(z[: n // 256 * 256].reshape(-1, 256))) ** 2
    spectrum = power.mean(axis=0) / 512.0
    assert np.abs(spectrum - 1.0).max() < 5.0 / math.sqrt(n // 256)


def test_streams_of_a_seed_are_distinct() -> None:
    parts = [("a", ()), ("b", ()), ("a", (0,)), ("a", (1,)), ("a", (0, 0))]
    for seeds in ((1, 2), (0, 2**32)):
        drawn = {
            tuple(seed_sequence(seed, purpose, *index).generate_state(2))
            for seed in seeds
            for purpose, index in parts
        }
        assert len(drawn) == 2 * len(parts)
    first, second = (random_stream(1, p).standard_normal(1000) for p in ("a", "b"))
    assert abs(np.mean(first * second)) < 5.0 / math.sqrt(1000)
