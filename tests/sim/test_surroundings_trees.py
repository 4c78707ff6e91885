"""Foliage: where it attenuates, by how much, and how it fades."""

from __future__ import annotations

import math

import numpy as np
import pytest
from street_views import ANTENNA_M, direct, northward, surrounded, view

from deepgnss.core.records import FloatArray
from deepgnss.sim.surroundings.foliage import gaussian_field

LONG_M = 40_000.0


def _alley(seed: int = 1, length_m: float = LONG_M, **changes: object) -> dict[str, object]:
    return {"trees": {"from": 0, "to": length_m, "distance": 0, "depth": 10} | changes}


def _loss_db(amplitude: FloatArray) -> FloatArray:
    return np.asarray(-20.0 * np.log10(amplitude))


def test_crowns_attenuate_only_what_passes_them() -> None:
    """Seen across the road a row begins at its near lower edge and ends at its upper edges."""
    around = surrounded(
        {
            "trees": {
                "from": 100,
                "to": 900,
                "side": "right",
                "distance": 3,
                "depth": 6,
                "bottom": 4,
                "top": 12,
                "attenuation": 10,
                "deviation": 0,
            }
        }
    )
    elevation = np.arange(1.0, 90.0, 0.25)
    loss = _loss_db(direct(around, view(90.0, elevation)))
    low = math.degrees(math.atan((4 - ANTENNA_M) / 9))
    high = math.degrees(math.atan((12 - ANTENNA_M) / 3))
    assert (loss[(elevation < low) | (elevation > high)] == 0.0).all()
    # in full but for rays that only brush the crowns' edges
    assert loss[(elevation > low + 3) & (elevation < high - 3)] == pytest.approx(10.0)
    assert np.abs(np.diff(loss)).max() < 3.0
    assert (direct(around, view(-90.0, elevation)) == 1.0).all()
    assert direct(around, view(90.0, 45.0, north_m=50.0)) == 1.0


def test_mean_deviation_and_distribution() -> None:
    """Decibels are normal about the mean: 20 000 coherence lengths."""
    around = surrounded(_alley(attenuation=9, deviation=3, coherence=2), road=northward(LONG_M))
    loss = _loss_db(direct(around, view(90.0, 60.0, north_m=np.arange(1.0, LONG_M - 1.0, 0.5))))
    assert loss.mean() == pytest.approx(9.0, abs=0.1)
    assert loss.std() == pytest.approx(3.0, rel=0.02)
    normal = (loss - loss.mean()) / loss.std()
    assert np.mean(normal**3) == pytest.approx(0.0, abs=0.08)
    assert np.mean(normal**4) == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize("coherence_m", [0.7, 5.0])
def test_coherence_length(coherence_m: float) -> None:
    """Correlation 1/e at the coherence length, whatever the course."""
    road = northward(LONG_M)
    around = surrounded(_alley(coherence=coherence_m, deviation=2), road=road)
    step_m = coherence_m / 10.0
    north = np.arange(10.0, min(8000.0 * coherence_m, LONG_M - 10.0), step_m)
    loss = _loss_db(direct(around, view(90.0, 60.0, north_m=north)))
    fading = (loss - loss.mean()) / loss.std()
    correlation = [np.mean(fading[:-lag] * fading[lag:]) for lag in (5, 10, 20)]
    assert correlation == pytest.approx([math.exp(-0.25), math.exp(-1), math.exp(-4)], abs=0.05)


def test_the_field_is_the_same_in_all_directions() -> None:
    steps = np.arange(0.0, 20_000.0, 0.1)
    for angle in (0.0, 0.5, math.pi / 4, 2.0):
        field = gaussian_field(np.outer(steps, [math.cos(angle), math.sin(angle)]), 99)
        assert field.std() == pytest.approx(1.0, abs=0.03)
        at_1 = np.mean(field[:-12] * field[12:])
        assert at_1 == pytest.approx(math.exp(-((1.2 / 1.155) ** 2)), abs=0.05)


def test_the_field_has_no_steps() -> None:
    """Across the lattice's lines, negative coordinates included."""
    field = gaussian_field(np.outer(np.arange(-20.0, 20.0, 1e-4), [1.0, -0.7]), 4)
    assert np.abs(np.diff(field)).max() < 1e-3


def test_any_order_gives_the_same_values() -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-50.0, 50.0, (500, 2))
    shuffle = random.permutation(500)
    assert (gaussian_field(points[shuffle], 8) == gaussian_field(points, 8)[shuffle]).all()


def test_a_car_at_rest_sees_no_fading_and_a_moving_one_does() -> None:
    around = surrounded(_alley(length_m=1000))
    t_s = np.arange(0.0, 5.0, 1e-3)
    rest = direct(around, view(90.0, 60.0, t_s=t_s))
    assert np.ptp(rest) == 0.0
    moving = direct(around, view(90.0, 60.0, north_m=500.0 + 10.0 * t_s, t_s=t_s))
    assert np.ptp(_loss_db(moving)) > 3.0


def test_satellites_seeds_and_rows_fade_apart() -> None:
    north = np.arange(10.0, 3990.0, 0.5)
    road = northward(4000.0)

    def fading(seed: int, satellite: str, azimuth: float, first: float = 0.0) -> FloatArray:
        trees = {"from": first, "to": 4000.0, "distance": 0, "depth": 10}
        around = surrounded({"trees": trees}, road=road, seed=seed)
        seen = view(azimuth, 60.0, north_m=north, satellite=satellite)
        loss = _loss_db(direct(around, seen))
        return np.asarray((loss - loss.mean()) / loss.std())

    base = fading(1, "G05", 90.0)
    assert (fading(1, "G05", 90.0) == base).all()
    for other in (fading(2, "G05", 90.0), fading(1, "G06", 90.0), fading(1, "G05", -90.0)):
        assert abs(np.mean(base * other)) < 0.1


def test_more_trees_do_not_change_the_fading_of_others() -> None:
    first = {"trees": {"from": 0, "to": 100}}
    second = {"trees": {"from": 500, "to": 600}}
    seen = view(80.0, 50.0, north_m=np.arange(0.0, 100.0, 0.3))
    assert (direct(surrounded(first), seen) == direct(surrounded(first, second), seen)).all()
