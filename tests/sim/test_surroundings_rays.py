"""Reflections against explicit geometry, and rays by decree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from street_views import ANTENNA_M, L1_HZ, WAVELENGTH_M, northward, surrounded, view

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.road import Waypoint, lay_road
from deepgnss.sim.scenario import View
from deepgnss.sim.surroundings.scene import directions
from deepgnss.sim.surroundings.sight import Seen

SHARP: dict[str, object] = {"edges": "sharp"}
FAR_M = 1.0e9
# Along the meridian 20 m east of the place, 200 m long, 30 m high.
WALL: dict[str, object] = {
    "wall": {"position": [-100, 20], "length": 200, "height": 30, "reflectivity": 0.6}
}


def _ray(around: Seen, seen: View, row: int = 0) -> tuple[FloatArray, FloatArray]:
    arrivals = around.arrivals(seen, L1_HZ)
    assert (
        arrivals.ray_amplitude.shape == arrivals.ray_excess_m.shape == (around.rays, len(seen[1]))
    )
    return arrivals.ray_amplitude[row], arrivals.ray_excess_m[row]


def _explicit_excess(seen: View, east_wall_m: float) -> FloatArray:
    """Satellite at a great distance: by its mirror image, against straight."""
    satellite = FAR_M * directions(seen.azimuth_rad, seen.elevation_rad)
    mirrored = satellite * [1.0, -1.0, 1.0] + [0.0, 2.0 * east_wall_m, 0.0]
    return np.linalg.norm(mirrored - seen.r_n_m, axis=1) - np.linalg.norm(
        satellite - seen.r_n_m, axis=1
    )


def test_excess_path_against_the_mirrored_satellite() -> None:
    around = surrounded(WALL, SHARP, local=True)
    seen = view(
        np.array([-90.0, -60.0, -110.0, -45.0]),
        np.array([10.0, 25.0, 40.0, 30.0]),
        north_m=np.array([0.0, 3.0, 5.0, -8.0]),
        east_m=np.array([0.0, 2.0, -4.0, 5.0]),
    )
    amplitude, excess_m = _ray(around, seen)
    assert (amplitude == 0.6).all()
    assert excess_m == pytest.approx(_explicit_excess(seen, 20.0), abs=1e-5)
    assert excess_m[0] == pytest.approx(2.0 * 20.0 * math.cos(math.radians(10.0)))


def test_a_wall_reflects_only_what_meets_it() -> None:
    """Specular point on the wall: not for a source behind it, too high, or past its end."""
    around = surrounded(WALL, SHARP, local=True)
    top_deg = math.degrees(math.atan((30 - ANTENNA_M) / 20))
    end_deg = math.degrees(math.atan(100 / 20))
    for azimuth, elevation, there in (
        (-90.0, top_deg - 0.1, True),
        (-90.0, top_deg + 0.1, False),
        (-90.0 + end_deg - 0.1, 5.0, True),
        (-90.0 + end_deg + 0.1, 5.0, False),
        (90.0, 10.0, False),
        (90.0, 70.0, False),
    ):
        amplitude, _ = _ray(around, view(azimuth, elevation, north_m=0.0))
        assert (amplitude[0] > 0.0) == there, (azimuth, elevation)
    behind = view(-90.0, 10.0, north_m=0.0, east_m=30.0)  # shaded by the wall, nothing to mirror
    assert _ray(around, behind)[0][0] == 0.0
    other_side = view(90.0, 10.0, north_m=0.0, east_m=30.0)
    amplitude, excess_m = _ray(around, other_side)
    assert amplitude[0] == 0.6
    assert excess_m[0] == pytest.approx(2.0 * 10.0 * math.cos(math.radians(10.0)))


def test_a_reflection_fades_at_the_end_of_its_wall() -> None:
    """Half of the amplitude when the specular point is on the edge."""
    around = surrounded(WALL, local=True)
    top_deg = math.degrees(math.atan((30 - ANTENNA_M) / 20))
    elevation = np.arange(top_deg - 25.0, top_deg + 8.0, 0.01)
    amplitude, _ = _ray(around, view(-90.0, elevation, north_m=0.0))
    assert np.abs(np.diff(amplitude)).max() < 0.01
    assert np.interp(top_deg, elevation, amplitude) == pytest.approx(0.3, abs=0.002)
    assert amplitude[0] > 0.58
    assert amplitude[-1] == 0.0


def test_doppler_of_the_ray_of_a_wall_ahead() -> None:
    """Towards the wall with the satellite behind, the ray's path shrinks by 2·v·cos(elevation)."""
    ahead: dict[str, object] = {
        "wall": {
            "position": [300, -50],
            "heading": 90,
            "length": 100,
            "height": 60,
            "reflectivity": 1,
        }
    }
    around = surrounded(ahead, SHARP, local=True)
    speed_mps, t_s = 12.0, np.arange(0.0, 1.0, 1e-3)
    seen = view(180.0, 15.0, north_m=200.0 + speed_mps * t_s, t_s=t_s)
    amplitude, excess_m = _ray(around, seen)
    assert (amplitude == 1.0).all()
    rate_mps = np.diff(excess_m) / 1e-3
    assert rate_mps == pytest.approx(-2.0 * speed_mps * math.cos(math.radians(15.0)))
    assert excess_m[0] == pytest.approx(200.0 * math.cos(math.radians(15.0)))
    # Away from the satellite the direct signal's Doppler is negative, the ray's as much positive.
    direct_mps = -speed_mps * directions(seen.azimuth_rad, seen.elevation_rad)[0, 0]
    assert direct_mps + rate_mps[0] == pytest.approx(-direct_mps)


def test_what_stands_in_the_ways_of_a_ray_takes_it_away() -> None:
    near: dict[str, object] = {"wall": {"position": [-5, 10], "length": 10, "height": 12}}
    across: dict[str, object] = {"wall": {"position": [-50, -10], "length": 100, "height": 6}}
    seen = view(-90.0, 20.0, north_m=0.0)
    assert _ray(surrounded(WALL, SHARP, local=True), seen)[0][0] == 0.6
    # Between antenna and wall.
    assert _ray(surrounded(WALL, near, SHARP, local=True), seen)[0][0] == 0.0
    # Above the way back but in the line of sight: the ray comes in over it (20 + 30 m of 20°).
    both = surrounded(WALL, across, SHARP, local=True).arrivals(
        view(-90.0, 20.0, north_m=0.0), L1_HZ
    )
    blocked_deg = math.degrees(math.atan((6 - ANTENNA_M) / 10))
    assert blocked_deg > 20.0
    assert both.direct[0] == 0.0
    assert both.ray_amplitude[0, 0] == 0.6
    # A high one between wall and sky takes both.
    across = {"wall": {"position": [-50, -10], "length": 100, "height": 40}}
    both = surrounded(WALL, across, SHARP, local=True).arrivals(seen, L1_HZ)
    assert both.direct[0] == 0.0
    assert both.ray_amplitude[0, 0] == 0.0


def test_a_canyon_hands_its_ray_on_without_a_jump() -> None:
    """In a bend a ray goes from facet to facet; where it sounds its path is continuous."""
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(200.0, 0.0), Waypoint(200.0, 200.0)], radius_m=80.0
    )
    facade = {"distance": 12, "height": 25, "reflectivity": 0.5, "rays": 2}
    around = surrounded(
        {"canyon": {"from": 0, "to": road.length_m, "left": facade, "right": None}}, road=road
    )
    assert around.rays == 2
    t_s = np.arange(0.0, 20.0, 1e-3)
    speed_mps = 15.0
    r_n_m = road.centreline(10.0 + speed_mps * t_s).r_n_m
    seen = view(95.0, 30.0, north_m=r_n_m[:, 0], east_m=r_n_m[:, 1], t_s=t_s)
    whole = around.arrivals(seen, L1_HZ)
    assert (whole.ray_amplitude.max(axis=1) > 0.4).all()
    for amplitude, excess_m in zip(whole.ray_amplitude, whole.ray_excess_m, strict=True):
        assert np.abs(np.diff(amplitude)).max() < 0.02
        sounds = np.minimum(amplitude[1:], amplitude[:-1]) > 0.002
        # at most the way driven, to and fro
        assert np.abs(np.diff(excess_m))[sounds].max() <= 2.0 * speed_mps * 1e-3 * (1.0 + 1e-9)


def test_any_cut_of_the_times_gives_the_same() -> None:
    facade = {"distance": 12, "height": 25, "reflectivity": 0.5, "gaps": [[300, 310]]}
    around = surrounded(
        {"canyon": {"from": 0, "to": 1000, "left": facade, "right": facade}},
        {"trees": {"from": 200, "to": 320}},
        {"footbridge": {"at": 310}},
        {"ray": {"delay": 50, "doppler": 2}},
        {"ground": {}},
    )
    t_s = np.arange(0.0, 4.0, 1e-3)
    seen = view(-80.0, 40.0, north_m=280.0 + 12.0 * t_s, t_s=t_s)
    whole = around.arrivals(seen, L1_HZ)
    assert around.rays == len(whole.ray_amplitude) == 2 * 2 + 1 + 1
    for step in (1000, 777):
        for first in reversed(range(0, t_s.size, step)):
            cut = slice(first, first + step)
            part = around.arrivals(View(seen.satellite, *(x[cut] for x in seen[1:])), L1_HZ)
            assert part.direct == pytest.approx(whole.direct[cut], rel=1e-12)
            assert part.ray_amplitude == pytest.approx(whole.ray_amplitude[:, cut], rel=1e-12)
            sounds = part.ray_amplitude > 0.0
            assert part.ray_excess_m[sounds] == pytest.approx(
                whole.ray_excess_m[:, cut][sounds], rel=1e-12
            )


def test_ground() -> None:
    around = surrounded({"ground": {"depth": 2.0, "reflectivity": 0.3}}, local=True)
    amplitude, excess_m = _ray(around, view(0.0, np.array([30.0, 90.0])))
    assert (amplitude == 0.3).all()
    assert excess_m == pytest.approx([2.0, 4.0])
    dark = surrounded({"ground": {}}, {"tunnel": {"from": 400, "to": 600}}, SHARP)
    assert _ray(dark, view(0.0, 60.0))[0][0] == 0.0


def test_a_decreed_ray_is_what_it_says() -> None:
    around = surrounded(
        {
            "ray": {
                "satellite": "G05",
                "amplitude": 0.5,
                "delay": 30,
                "doppler": 0.1,
                "from": 2,
                "to": 4,
            }
        },
        local=True,
    )
    t_s = np.arange(0.0, 6.0, 1e-3)
    late_s = t_s - 2.7e-4  # true time of a receiver whose clock is fast
    seen = view(0.0, 50.0, t_s=late_s)
    amplitude, excess_m = _ray(around, seen)
    ms = np.arange(6000)
    assert (amplitude == np.where((ms >= 2000) & (ms < 4000), 0.5, 0.0)).all()
    # Doppler positive: the range of the ray shrinks against the direct one
    assert np.diff(excess_m) / 1e-3 == pytest.approx(-0.1 * WAVELENGTH_M, rel=1e-6)
    assert np.interp(2.0, late_s, excess_m) == pytest.approx(30.0)
    assert (around.arrivals(seen, L1_HZ).direct == 1.0).all()
    other = view(0.0, 50.0, t_s=t_s, satellite="G06")
    assert (_ray(around, other)[0] == 0.0).all()
    # Hz at the carrier of the signal that is asked for
    b1i = around.arrivals(seen, 1561.098e6).ray_excess_m[0]
    assert (b1i[-1] - b1i[0]) / (excess_m[-1] - excess_m[0]) == pytest.approx(1575.42 / 1561.098)


def test_a_road_and_a_wall_agree() -> None:
    """The same wall by the road and by coordinates."""
    by_road = surrounded(
        {
            "canyon": {
                "from": 100,
                "to": 300,
                "left": None,
                "right": {"distance": 20, "height": 30, "reflectivity": 0.6},
            }
        },
        road=northward(),
    )
    by_place = surrounded(
        {"wall": {"position": [100, 20], "length": 200, "height": 30, "reflectivity": 0.6}},
        local=True,
    )
    seen = view(np.arange(0.0, 360.0, 3.0), 35.0, north_m=200.0)
    one, two = (around.arrivals(seen, L1_HZ) for around in (by_road, by_place))
    assert one.direct == pytest.approx(two.direct)
    assert one.ray_amplitude == pytest.approx(two.ray_amplitude)
    assert 0.2 < (one.ray_amplitude > 0.0).mean() < 0.5
