"""Satellites that are back: half cycles and codes by their arcs before, on exact ranges."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from exact_tags import LOOP, Tags, Told

from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.deep.bridging import Bridge
from deepgnss.deep.integers import nearest_integers
from deepgnss.io.config.imu_grade import imu_grade

TCXO = Oscillator("TCXO", 1e-21, 1e-21, 2e-20, 0.0)
GONE_S, BACK_S = 10.05, 16.95


def _drive(seed: int = 1, satellites: int = 10) -> Tags:
    return Tags(
        20.0,
        cn0_dbhz=45.0,
        oscillator=TCXO,
        grade=imu_grade("MTi-G"),
        satellites=satellites,
        seed=seed,
        wheels_mps=0.05,
    )


def _names(tags: Tags) -> list[str]:
    return [emitter.satellite for emitter in tags.scenario.emitters]


def _gone(time_s: float) -> bool:
    return GONE_S < time_s < BACK_S


def _heard(told: list[Told]) -> dict[str, float]:
    """When which polarity was told."""
    return {s: one.time_s for one in told for s in one.bridged.halves}


@pytest.mark.parametrize("seed", range(1, 6))
def test_behind_a_tunnel_all_polarities_follow_from_some(seed: int) -> None:
    """The clock is off by many cycles, and the way by some."""
    tags = _drive(seed)
    known = _names(tags)[:4]
    told = tags.run(Bridge(TCXO, LOOP), lost=lambda _, t: _gone(t), upright=known)
    heard = _heard(told)
    assert heard.keys() == set(_names(tags)) - set(known)
    assert max(heard.values()) < BACK_S + 0.5
    np.testing.assert_allclose([x % 1.0 for x in told[-1].off_cycles.values()], 0.0, atol=1e-9)


def test_behind_a_tunnel_no_polarity_follows_from_none() -> None:
    """A step of the clock by half a cycle would explain as much."""
    tags = _drive()
    assert not _heard(tags.run(Bridge(TCXO, LOOP), lost=lambda _, t: _gone(t)))


@pytest.mark.parametrize("seed", range(1, 6))
def test_one_that_was_hidden_is_known_at_once_and_so_is_its_range(seed: int) -> None:
    tags = _drive(seed)
    hidden = _names(tags)[2]
    off_m = -6.0
    told = tags.run(
        Bridge(TCXO, LOOP),
        lost=lambda s, t: s == hidden and _gone(t),
        code_off_m=lambda s, t: off_m * (s == hidden and t > BACK_S),
    )
    assert _heard(told)[hidden] == pytest.approx(BACK_S + 0.05)
    assert told[-1].off_cycles[hidden] % 1.0 == 0.0
    (at,) = [one for one in told if hidden in one.bridged.halves]
    assert at.bridged.joined_m == pytest.approx({hidden: off_m}, abs=0.05)


def test_a_phase_that_was_carried_has_its_code_with_it() -> None:
    """The loop that took it up again knows less."""
    tags = _drive()
    hidden = _names(tags)[2]
    told = tags.run(
        Bridge(TCXO, LOOP),
        blocked=lambda s, t: s == hidden and _gone(t),
        code_off_m=lambda s, t: 0.8 * (s == hidden and t > BACK_S),
    )
    first, *later = [one for one in told if one.time_s > BACK_S]
    assert first.bridged.joined_m == pytest.approx({hidden: 0.8}, abs=0.05)
    assert not first.bridged.bent_m
    assert not any(one.bridged.joined_m for one in later)


def test_a_reflection_is_not_the_arc_before() -> None:
    tags = _drive()
    hidden = _names(tags)[2]
    told = tags.run(
        Bridge(TCXO, LOOP),
        lost=lambda s, t: s == hidden and _gone(t),
        reflections_cycles={hidden: 0.17},
    )
    assert not _heard(told)


def test_a_code_that_leaves_its_phase_is_called_back() -> None:
    tags = _drive()
    bent = _names(tags)[3]
    told = tags.run(
        Bridge(TCXO, LOOP), code_off_m=lambda s, t: 2.0 * max(0.0, t - 12.0) * (s == bent)
    )
    off = {one.time_s: one.bridged.bent_m for one in told}
    assert not any(codes for t, codes in off.items() if t < 12.4)
    assert off[max(off)] == pytest.approx({bent: 2.0 * (max(off) - 12.0)}, abs=0.2)


def _fits(x: FloatArray, Q: FloatArray, margin: float) -> FloatArray:
    """Distances of all near integers by trying them."""
    tried = np.array(list(itertools.product(range(-14, 15), repeat=x.size))) - x
    distances = np.einsum("ki,ij,kj->k", tried, np.linalg.inv(Q), tried)
    return np.sort(distances[distances <= distances.min() + margin])


@pytest.mark.parametrize("size", [1, 2, 3])
def test_integers_are_those_found_by_trying_all(size: int) -> None:
    random = np.random.default_rng(size)
    for _ in range(20):
        A = random.standard_normal((size, size))
        Q, x = 0.4 * A @ A.T + 0.01 * np.eye(size), random.uniform(-3.0, 3.0, size)
        found = nearest_integers(x, Q, 6.0, 10_000)
        assert found is not None
        numbers, distances = found
        np.testing.assert_allclose(distances, _fits(x, Q, 6.0), rtol=1e-6, atol=1e-9)
        off = numbers - x
        own = np.einsum("ki,ij,kj->k", off, np.linalg.inv(Q), off)
        np.testing.assert_allclose(own, distances, rtol=1e-6, atol=1e-9)


def test_too_many_integers_are_none() -> None:
    assert nearest_integers(np.zeros(2), 100.0 * np.eye(2), 9.0, 50) is None
