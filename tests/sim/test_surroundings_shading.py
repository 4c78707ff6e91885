"""Walls, decks, tunnels and pillars against plane geometry and the knife edge."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel
from street_views import ANTENNA_M, L1_HZ, WAVELENGTH_M, direct, northward, surrounded, view
from yardstick import cost

from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.road import Waypoint, lay_road
from deepgnss.sim.surroundings.panels import Panels, joined, slab, stretch, tube, wall
from deepgnss.sim.surroundings.scene import directions
from deepgnss.sim.surroundings.shadow import Rays, knife_edge, screens, shade
from deepgnss.sim.surroundings.sight import STATES

SHARP: dict[str, object] = {"edges": "sharp"}
ELEVATIONS = np.arange(1.0, 90.0, 0.05)


def _lowest_free_deg(free: FloatArray) -> float:
    """Elevation from which on the sky is free, given amplitudes over ELEVATIONS."""
    assert set(np.unique(free)) <= {0.0, 1.0}
    first = int(np.argmax(free))
    assert (free[first:] == 1.0).all()
    return float(ELEVATIONS[first])


@pytest.mark.parametrize("azimuth_deg", [90.0, 60.0, 120.0, 30.0])
def test_a_wall_blocks_below_its_top(azimuth_deg: float) -> None:
    """Height over the way to the wall, which is longer for a slanting azimuth."""
    around = surrounded(
        {"canyon": {"from": 0, "to": 1000, "left": None, "right": {"distance": 8, "height": 20}}},
        SHARP,
    )
    mask_deg = math.degrees(math.atan((20 - ANTENNA_M) / 8 * math.sin(math.radians(azimuth_deg))))
    seen = direct(around, view(azimuth_deg, ELEVATIONS))
    assert _lowest_free_deg(seen) == pytest.approx(mask_deg, abs=0.06)
    assert (direct(around, view(-azimuth_deg, ELEVATIONS)) == 1.0).all()


def test_left_is_left_whatever_the_heading() -> None:
    road = lay_road([Waypoint(0.0, 0.0), Waypoint(0.0, 1000.0)], radius_m=10.0)  # eastwards
    around = surrounded(
        {"canyon": {"from": 0, "to": 1000, "left": {"distance": 8}, "right": None}},
        SHARP,
        road=road,
    )
    at = {"north_m": 0.0, "east_m": 500.0}
    assert direct(around, view(0.0, 30.0, **at)) == 0.0
    assert direct(around, view(180.0, 30.0, **at)) == 1.0


def test_a_side_street_lets_the_sky_in() -> None:
    side = {"distance": 10, "height": 30, "gaps": [[495, 505]]}
    around = surrounded({"canyon": {"from": 0, "to": 1000, "right": side, "left": None}}, SHARP)
    north = np.arange(480.0, 520.0, 0.01) + 0.005
    seen = direct(around, view(90.0, 20.0, north_m=north))
    assert (seen == ((north > 495.0) & (north < 505.0))).all()


def test_a_wall_ends_where_it_should() -> None:
    around = surrounded({"barrier": {"from": 200, "to": 300, "side": "right"}}, SHARP)
    north = np.arange(150.0, 350.0, 0.5) + 0.1
    seen = direct(around, view(90.0, 10.0, north_m=north))
    assert (seen == ((north < 200.0) | (north > 300.0))).all()


def test_a_wall_follows_a_bend() -> None:
    """On an arc of 60 m radius the mask of an outer wall stays that of its distance and height."""
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(200.0, 0.0), Waypoint(200.0, 200.0)], radius_m=60.0
    )
    around = surrounded(
        {
            "canyon": {
                "from": 0,
                "to": road.length_m,
                "left": {"distance": 9, "height": 25},
                "right": None,
            }
        },
        SHARP,
        road=road,
    )
    s = np.linspace(60.0, road.length_m - 60.0, 40)
    point, heading, _ = road.centreline(s)
    mask_deg = math.degrees(math.atan((25 - ANTENNA_M) / 9))
    place = {"north_m": point[:, 0], "east_m": point[:, 1]}
    abeam = np.degrees(heading) - 90.0
    # Chords of the outer side stray inwards by up to 0.2 m, about a degree here.
    assert (direct(around, view(abeam, mask_deg + 1.0, **place)) == 1.0).all()
    assert (direct(around, view(abeam, mask_deg - 1.0, **place)) == 0.0).all()


def test_a_bend_that_is_too_tight_for_a_wall_is_refused() -> None:
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(200.0, 0.0), Waypoint(200.0, 200.0)], radius_m=20.0
    )
    with pytest.raises(Exception, match=r"surroundings\[0\].canyon: 30 m to the right lies beyond"):
        surrounded({"canyon": {"from": 0, "to": 300, "right": {"distance": 30}}}, road=road)


def test_a_footbridge_blocks_the_zenith_for_width_over_speed() -> None:
    around = surrounded({"footbridge": {"at": 400, "width": 4, "height": 6}}, SHARP)
    speed_mps, t_s = 12.5, np.arange(0.0, 60.0, 1e-3)
    seen = direct(around, view(0.0, 90.0, north_m=speed_mps * t_s, t_s=t_s))
    dark = t_s[seen == 0.0]
    assert dark[0] == pytest.approx(398.0 / speed_mps, abs=1.1e-3)
    assert dark.size * 1e-3 == pytest.approx(4.0 / speed_mps, abs=2.1e-3)
    assert np.diff(dark).max() < 1.5e-3


def test_the_shadow_of_a_deck_lies_opposite_to_the_satellite_and_grows_by_its_thickness() -> None:
    """At 45° ahead the underside's near edge and the top's far edge bound the shadow."""
    around = surrounded({"footbridge": {"at": 400, "width": 4, "height": 6, "thickness": 1}}, SHARP)
    north = np.arange(380.0, 410.0, 0.01) + 0.005
    dark = north[direct(around, view(0.0, 45.0, north_m=north)) == 0.0]
    assert dark[0] == pytest.approx(398.0 - 5.5, abs=0.02)
    assert dark[-1] == pytest.approx(402.0 - 4.5, abs=0.02)
    dark = north[direct(around, view(180.0, 60.0, north_m=north)) == 0.0]
    assert dark[0] == pytest.approx(398.0 + 4.5 / math.tan(math.radians(60)), abs=0.02)
    assert dark[-1] == pytest.approx(402.0 + 5.5 / math.tan(math.radians(60)), abs=0.02)


def test_a_tunnel_shows_the_sky_through_its_portals_only() -> None:
    around = surrounded({"tunnel": {"from": 100, "to": 300, "width": 10, "height": 6}}, SHARP)
    clear_m = 6.0 - ANTENNA_M
    for ahead_m in (2.0, 20.0, 80.0):
        limit_deg = math.degrees(math.atan(clear_m / ahead_m))
        at = {"north_m": 300.0 - ahead_m}
        seen = direct(around, view(0.0, ELEVATIONS, **at))
        assert (seen == (limit_deg > ELEVATIONS)).all()
        aside_deg = math.degrees(math.atan(5.0 / ahead_m))
        azimuth = np.arange(-89.0, 89.0, 0.1) + 0.05
        seen = direct(around, view(azimuth, min(2.0, limit_deg / 2), **at))
        assert (seen == (np.abs(azimuth) < aside_deg)).all()
    everywhere = view(np.arange(0.0, 360.0, 7.0)[:, None], np.arange(5.0, 91.0, 5.0), north_m=200.0)
    assert (direct(around, everywhere) == 0.0).all()
    assert direct(around, view(0.0, 90.0, north_m=99.9)) == 1.0
    assert direct(around, view(0.0, 90.0, north_m=100.1)) == 0.0


def test_a_viaduct_beside_the_road_hides_its_side_of_the_sky() -> None:
    around = surrounded(
        {"viaduct": {"from": 100, "to": 900, "height": 8, "width": 10, "offset": 7}}, SHARP
    )
    underside_m = 8.0 - ANTENNA_M  # from 2 to 12 m to the right
    seen = direct(around, view(90.0, ELEVATIONS))
    low, high = (
        math.degrees(math.atan(x)) for x in (underside_m / 12.0, (underside_m + 1.5) / 2.0)
    )
    assert (seen == ((low > ELEVATIONS) | (high < ELEVATIONS))).all()
    assert direct(around, view(90.0, 90.0)) == 1.0
    assert (direct(around, view(-90.0, ELEVATIONS)) == 1.0).all()


def test_pillars_stand_under_the_deck() -> None:
    deck = {"from": 100, "to": 900, "height": 8, "width": 10, "offset": 7}
    around = surrounded({"viaduct": deck | {"pillars": {"spacing": 50, "width": 2}}}, SHARP)
    north = np.arange(400.0, 500.0, 0.05) + 0.01
    dark = north[direct(around, view(90.0, 5.0, north_m=north)) == 0.0]
    assert dark.size * 0.05 == pytest.approx(4.0, abs=0.11)  # two pillars of 2 m
    assert {int(x) for x in dark} == {400, 401, 450, 451}


def test_a_transparent_barrier_takes_decibels() -> None:
    around = surrounded(
        {"barrier": {"from": 0, "to": 1000, "side": "left", "height": 5, "attenuation": 6}}, SHARP
    )
    low, high = direct(around, view(-90.0, np.array([20.0, 50.0])))
    assert 20.0 * math.log10(low) == pytest.approx(-6.0)
    assert high == 1.0


# --- edges ---------------------------------------------------------------------------------------


def test_knife_edge_against_fresnels_integral() -> None:
    """P.526's curve lies within 0.3 dB of the exact field in the shadow, 6 dB at grazing."""
    v = np.linspace(0.0, 10.0, 300)
    s, c = fresnel(v)
    exact = np.abs((1.0 - c - s) + 1j * (s - c)) / 2.0
    ours = np.array([knife_edge(x) for x in v])
    assert np.abs(20.0 * np.log10(ours / exact)).max() < 0.3
    assert 20.0 * math.log10(knife_edge(0.0)) == pytest.approx(-6.03, abs=0.01)
    assert knife_edge(-0.78) == 1.0
    assert knife_edge(-0.7799) == pytest.approx(1.0, abs=1e-3)


def test_grazing_a_long_wall_costs_six_decibels() -> None:
    around = surrounded(
        {"canyon": {"from": 0, "to": 1000, "left": None, "right": {"distance": 8, "height": 20}}}
    )
    mask_deg = math.degrees(math.atan((20 - ANTENNA_M) / 8))
    left = direct(around, view(90.0, mask_deg))
    assert 20.0 * math.log10(left[0]) == pytest.approx(-6.03, abs=0.02)


@pytest.mark.parametrize("azimuth_deg", [90.0, 45.0, 130.0])
def test_behind_the_edge_as_its_v_says(azimuth_deg: float) -> None:
    """v = h·√(2/(λ·d)), h the edge's distance from the ray, d the way to where it is nearest."""
    around = surrounded(
        {"canyon": {"from": 0, "to": 2000, "left": None, "right": {"distance": 8, "height": 20}}},
        road=northward(2000.0),
    )
    elevation = np.radians(np.arange(45.0, 80.0, 0.5))
    azimuth = math.radians(azimuth_deg)
    seen = direct(around, view(azimuth_deg, np.degrees(elevation), north_m=1000.0))
    # In the plane across the edge, which runs north.
    east, up = np.cos(elevation) * math.sin(azimuth), np.sin(elevation)
    across = np.hypot(east, up)
    height_m = ((20 - ANTENNA_M) * east - 8 * up) / across  # positive: the edge lies above the ray
    way_m = (8 * east + (20 - ANTENNA_M) * up) / across**2
    expected = [
        knife_edge(h * math.sqrt(2.0 / (WAVELENGTH_M * d)))
        for h, d in zip(height_m, way_m, strict=True)
    ]
    assert seen == pytest.approx(expected, abs=1e-12)
    assert min(expected) < 0.2
    assert max(expected) == 1.0


def test_the_corner_of_a_wall_takes_a_quarter() -> None:
    around = surrounded({"barrier": {"from": 500, "to": 700, "distance": 10, "height": 11.5}})
    corner = math.degrees(math.atan2(10.0, 10.0))
    assert direct(around, view(90.0, corner)) == pytest.approx(0.75, abs=0.002)


def test_no_jump_anywhere_under_a_bridge() -> None:
    around = surrounded({"footbridge": {"at": 400, "width": 4, "height": 6}})
    north = np.arange(380.0, 420.0, 0.005)
    for azimuth, elevation in ((0.0, 89.0), (0.0, 50.0), (35.0, 40.0), (90.0, 60.0)):
        seen = direct(around, view(azimuth, elevation, north_m=north))
        assert np.abs(np.diff(seen)).max() < 0.02
        assert seen.max() == 1.0
        assert seen.min() < 0.3


def test_bent_shadows_stay_near_the_sharp_ones() -> None:
    """Free where everything within the bend's width is free, dark where all of it is dark."""
    obstacles: list[dict[str, object]] = [
        {"footbridge": {"at": 400, "span": 24}},
        {"viaduct": {"from": 430, "to": 470, "offset": 9, "pillars": {"spacing": 15}}},
        {"canyon": {"from": 480, "to": 530, "right": None, "left": {"gaps": [[500, 508]]}}},
    ]
    bent, sharp = surrounded(*obstacles), surrounded(*obstacles, SHARP)
    random = np.random.default_rng(11)
    count, around = 3000, 48
    azimuth, elevation, north = (
        random.uniform(low, high, count)[:, None] for low, high in ((0, 360), (12, 78), (385, 535))
    )
    # Bodies are 4 m away and more: within v = ±1 of a ray lies less than 9°.
    turn = np.linspace(0.0, 6.0 * np.pi, around)
    size = 9.0 * np.linspace(0.0, 1.0, around)
    azimuth = azimuth + size * np.sin(turn) / np.cos(np.radians(elevation))
    elevation = elevation + size * np.cos(turn)
    cone = direct(sharp, view(azimuth, elevation, north_m=north)).reshape(count, around)
    middle = direct(bent, view(azimuth[:, 0], elevation[:, 0], north_m=north[:, 0]))
    clear, dark = (cone == 1.0).all(axis=1), (cone == 0.0).all(axis=1)
    assert clear.sum() > 500
    assert dark.sum() > 200
    assert middle[clear].min() > 0.9
    assert middle[dark].max() < 0.5


def test_no_seam_shows_between_the_panels_of_a_bent_wall() -> None:
    """Along a bend the shadow of a wall without ends has no holes."""
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(200.0, 0.0), Waypoint(200.0, 200.0)], radius_m=60.0
    )
    side = {"distance": 9, "height": 25}
    around = surrounded(
        {"canyon": {"from": 0, "to": road.length_m, "left": side, "right": side}}, road=road
    )
    s = np.linspace(60.0, road.length_m - 60.0, 3000)
    point, heading, _ = road.centreline(s)
    for side_deg in (-90.0, 90.0):
        seen = direct(
            around,
            view(np.degrees(heading) + side_deg, 40.0, north_m=point[:, 0], east_m=point[:, 1]),
        )
        assert seen.max() < 0.12
        assert seen.min() > 0.0


# --- the kernel against a plain twin -------------------------------------------------------------


def _plain(panels: Panels, start: FloatArray, along: FloatArray) -> bool:
    """Whether a ray meets a panel: plane first, then the corners' sense of rotation."""
    for corners, normal in zip(
        panels.corners_m[~panels.cut], panels.normals[~panels.cut], strict=True
    ):
        height, slope = (start - corners[0]) @ normal, along @ normal
        if height * slope >= 0.0:
            continue
        hit = start - height / slope * along
        turns = [
            np.cross(corners[(i + 1) % 4] - corners[i], hit - corners[i]) @ normal for i in range(4)
        ]
        if min(turns) > 0.0:
            return True
    return False


@pytest.mark.kernel
def test_sharp_shadows_as_a_plain_intersection() -> None:
    road = lay_road(
        [Waypoint(0.0, 0.0, 0.0), Waypoint(120.0, 0.0, 5.0), Waypoint(170.0, 90.0, 1.0)],
        radius_m=40.0,
    )
    bodies = joined(
        [
            slab(stretch(road, 20, 24, -12, 12), 6, 1),
            tube(stretch(road, 60, 110, -5, 5), 6),
            wall(stretch(road, 100, 160, 9, 9).left_m, 14),
            slab(stretch(road, 110, 180, -14, -4), 7, 1.5),
        ]
    )
    random = np.random.default_rng(7)
    count = 500
    s = random.uniform(0.0, 190.0, count)
    start = road.centreline(s).r_n_m + random.uniform(-3, 3, (count, 3)) * [1, 1, 0]
    start[:, 2] -= ANTENNA_M
    along = directions(random.uniform(0, 2 * np.pi, count), random.uniform(0.05, 1.5, count))
    rays = Rays(np.ascontiguousarray(start), along, np.full(count, np.inf))
    ready = screens([bodies], [0.0])
    left, worst = shade(ready, rays, WAVELENGTH_M, False)
    expected = np.array([_plain(bodies, r, d) for r, d in zip(start, along, strict=True)])
    assert 0.2 < expected.mean() < 0.8
    assert ((left == 0.0) == expected).all()
    assert ((worst >= 0) == expected).all()


@given(st.floats(0.0, 2 * np.pi), st.floats(0.05, 1.5), st.floats(300.0, 600.0))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_one_by_one_as_all_at_once(azimuth: float, elevation: float, north: float) -> None:
    """What is left out beforehand as too far never matters."""
    around = surrounded(
        {"footbridge": {"at": 400}},
        {"tunnel": {"from": 420, "to": 480}},
        {"canyon": {"from": 500, "to": 800, "right": {"gaps": [[550, 560]]}}},
        {"trees": {"from": 300, "to": 380}},
    )
    seen = view(
        np.degrees(azimuth) + np.linspace(0, 0.3, 300),
        np.degrees(elevation),
        north_m=north + np.linspace(0.0, 25.0, 300),
    )
    at_once = direct(around, seen)
    for n in (0, 150, 299):
        alone = view(
            np.degrees(seen.azimuth_rad[n]), np.degrees(elevation), north_m=seen.r_n_m[n, 0]
        )
        assert direct(around, alone)[0] == pytest.approx(at_once[n], rel=1e-9, abs=1e-12)


def test_visibility_names_what_stands_in_the_way() -> None:
    around = surrounded(
        {"tunnel": {"from": 100, "to": 200}},
        {"canyon": {"from": 300, "to": 500, "left": None, "right": {"distance": 8, "height": 20}}},
        {"barrier": {"from": 600, "to": 700, "height": 9, "attenuation": 10}},
        {"trees": {"from": 800, "to": 900, "side": "right", "distance": 1, "deviation": 0}},
    )
    mask_deg = math.degrees(math.atan((20 - ANTENNA_M) / 8))
    cases = [
        (50.0, 80.0, "free", None),
        (150.0, 80.0, "blocked", "tunnel 1"),
        (400.0, mask_deg - 0.2, "diffracted", "canyon 1 right"),
        (400.0, mask_deg - 20.0, "blocked", "canyon 1 right"),
        (650.0, 20.0, "attenuated", "barrier 1"),
        (850.0, 50.0, "attenuated", "trees 1 right"),
    ]
    for north, elevation, state, cause in cases:
        sight = around.visibility(view(90.0, elevation, north_m=north), L1_HZ)
        assert STATES[sight.state[0]] == state
        assert (sight.names[sight.cause[0]] if sight.cause[0] >= 0 else None) == cause


@pytest.mark.slow
def test_a_busy_street_costs_little() -> None:
    """Twenty satellites over a second among 56 bodies, 16 of them mirrors: some 35 ms."""
    obstacles: list[dict[str, object]] = [{"footbridge": {"at": 15 + 20 * k}} for k in range(40)]
    facade = {"distance": 12, "height": 18, "reflectivity": 0.4}
    obstacles += [
        {"canyon": {"from": 100 * k, "to": 100 * k + 90, "left": facade, "right": facade}}
        for k in range(8)
    ]
    around = surrounded(*obstacles)
    random = np.random.default_rng(1)
    views = [
        view(az, el, north_m=500.0 + np.linspace(0.0, 15.0, 1000))
        for az, el in zip(random.uniform(0, 360, 20), random.uniform(5, 85, 20), strict=True)
    ]
    assert cost(lambda: [around.arrivals(one, L1_HZ) for one in views], 6) < 9.0
