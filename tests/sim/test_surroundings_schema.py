"""The section `surroundings`: what is read, and what is refused in one line."""

from __future__ import annotations

import pytest
from pydantic import TypeAdapter, ValidationError
from street_views import L1_HZ, northward, surrounded, view

from deepgnss.core.errors import ConfigError
from deepgnss.sim.surroundings.schema import ObstacleConfig, build_surroundings

ALL: list[dict[str, object]] = [
    {"tunnel": {"from": 100, "to": 250}},
    {"footbridge": {"at": 400, "width": 4, "height": 6}},
    {"viaduct": {"from": 500, "to": 600, "offset": 8, "pillars": {"spacing": 20}}},
    {
        "canyon": {
            "from": 600,
            "to": 700,
            "left": {"distance": 9, "height": 20, "reflectivity": 0.4, "gaps": [[620, 630]]},
            "right": None,
        }
    },
    {"trees": {"from": 700, "to": 800}},
    {"barrier": {"from": 800, "to": 900, "side": "left", "attenuation": 10}},
    {"wall": {"position": [10, 30], "length": 40, "height": 20, "reflectivity": 0.5}},
    {"ground": {"depth": 1.7}},
    {"ray": {"delay": 30}},
    {"edges": "sharp"},
]


def test_everything_together() -> None:
    around = surrounded(*ALL)
    arrivals = around.arrivals(view(90.0, 40.0, north_m=180.0), L1_HZ)
    assert around.rays == len(arrivals.ray_amplitude) == 2 + 1 + 1 + 1
    assert arrivals.direct == 0.0  # in the tunnel
    assert arrivals.ray_amplitude[:, 0].tolist() == [0.0, 0.0, 0.0, 0.0, 0.5]  # the decreed ray
    sight = around.visibility(view(90.0, 40.0, north_m=180.0), L1_HZ)
    assert sight.names[sight.cause[0]] == "tunnel 1"
    assert "canyon 1 left" in sight.names
    assert "canyon 1 right" not in sight.names


def test_the_section_survives_its_own_dump() -> None:
    """What `extra: forbid` and aliases write, they read."""
    reader = TypeAdapter(tuple[ObstacleConfig, ...])
    read = reader.validate_python(ALL)
    dumped = [one.model_dump(by_alias=True, exclude_none=True) for one in read]
    assert [one.key for one in reader.validate_python(dumped)] == [one.key for one in read]


def test_nothing_around_is_none() -> None:
    built = build_surroundings(
        [ObstacleConfig(edges="sharp")], road=None, seed=1, seconds=1.0, antenna_height_m=0.0
    )
    assert built is None


@pytest.mark.parametrize(
    ("obstacle", "text"),
    [
        ({"tunnel": {"from": 200, "to": 200}}, "expected more than `from`, 200 m"),
        ({"trees": {"from": 0, "to": 9, "top": 2}}, "expected more than `bottom`, 3 m"),
        (
            {"canyon": {"from": 0, "to": 90, "left": {"gaps": [[80, 95]]}}},
            "expected gaps in order, within 0 to 90 m",
        ),
        ({"canyon": {"from": 0, "to": 90, "left": {"gaps": [[8, 5]]}}}, "from before to"),
        ({"tunnel": {"from": 1, "to": 2}, "ground": {}}, "expected one of tunnel, footbridge"),
        ({}, "expected one of tunnel, footbridge"),
        ({"tunnel": None}, "expected one of tunnel, footbridge"),
        ({"bridge": {"at": 3}}, "Extra inputs"),
        ({"wall": {"position": [0, 0], "length": 9, "height": -20}}, "expected more than `foot`"),
        ({"wall": {"position": [0, 0], "length": 9, "height": 5, "reflectivity": 1.2}}, "0 to 1"),
        ({"ray": {"delay": 30, "satellite": "5"}}, "expected a satellite such as G05, or all"),
        ({"ray": {"delay": 30, "from": 5, "to": 5}}, "expected more than `from`, 5 s"),
        ({"footbridge": {"at": 10, "height": -3}}, "expected above 0"),
        ({"barrier": {"from": 1, "to": 5, "side": "up"}}, "'left' or 'right'"),
    ],
)
def test_a_misfit_is_refused_when_read(obstacle: dict[str, object], text: str) -> None:
    with pytest.raises(ValidationError) as refusal:
        ObstacleConfig.model_validate(obstacle)
    assert text in str(refusal.value)


@pytest.mark.parametrize(
    ("obstacle", "text"),
    [
        (
            {"tunnel": {"from": 900, "to": 1100}},
            "surroundings[0].tunnel: 900 to 1100 m lies beyond the road, 0 to 1000.0 m",
        ),
        ({"footbridge": {"at": 1}}, "surroundings[0].footbridge: -1 to 3 m lies beyond"),
        (
            {"footbridge": {"at": 100, "height": 1.4}},
            "surroundings[0].footbridge: height: 1.4 m is not above the antenna, 1.5 m",
        ),
        ({"tunnel": {"from": 1, "to": 9, "height": 1}}, "not above the antenna"),
        ({"viaduct": {"from": 1, "to": 9, "height": 1.5}}, "not above the antenna"),
        ({"viaduct": {"from": 1, "to": 9, "pillars": {}}}, "pillars: they stand on the road"),
        ({"ray": {"delay": 1, "doppler": 10}}, "surroundings[0].ray: doppler: 10 Hz brings"),
    ],
)
def test_what_cannot_stand_there_is_refused_when_built(
    obstacle: dict[str, object], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        surrounded(obstacle, road=northward())
    assert text in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_without_a_road_only_what_needs_none() -> None:
    for one in ALL[:6]:
        with pytest.raises(ConfigError, match="expected a trajectory with a road"):
            surrounded(one, local=True)
    assert surrounded(*ALL[6:9], local=True).rays == 3


def test_ground_and_edges_stand_once() -> None:
    with pytest.raises(ConfigError, match=r"surroundings\[1\].ground: stands twice"):
        surrounded({"ground": {}}, {"ground": {}})
