"""Roads as laid out, and drives that keep to their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.errors import ConfigError
from deepgnss.sim.motion.road import Road, Waypoint, lay_road
from deepgnss.sim.motion.street import Limits, Stop, StreetAttitude, StreetPath, Zone, drive

BLOCK = [
    Waypoint(0.0, 0.0, 5.0),
    Waypoint(400.0, 0.0, 8.0, 30.0),
    Waypoint(400.0, 300.0),
    Waypoint(700.0, 500.0, 2.0),
    Waypoint(300.0, 900.0, None, 60.0),
    Waypoint(-100.0, 400.0),
]
LOOP = lay_road(BLOCK, radius_m=15.0, closed=True)
STREET = lay_road(BLOCK, radius_m=15.0)
LIMITS = Limits(13.9, acceleration_mps2=1.8, braking_mps2=2.6, jerk_mps3=1.5, lateral_mps2=2.2)


def _off_the_legs(road: Road, s_m: np.ndarray, closed: bool) -> np.ndarray:
    """Distance of points of the road from the nearest leg between waypoints, seen from above."""
    points = road.centreline(s_m).r_n_m[:, :2]
    corners = np.array([w[:2] for w in BLOCK] + ([BLOCK[0][:2]] if closed else []))
    legs = np.diff(corners, axis=0)
    along = np.einsum("kij,ij->ki", points[:, None] - corners[:-1], legs)
    share = np.clip(along / (legs**2).sum(axis=1), 0.0, 1.0)
    feet = corners[:-1] + share[..., None] * legs
    apart: np.ndarray = np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1)
    return apart


@pytest.mark.parametrize("road", [LOOP, STREET], ids=["loop", "street"])
def test_road_follows_its_legs(road: Road) -> None:
    s_m = np.linspace(0.0, road.length_m, 4001)
    apart_m = _off_the_legs(road, s_m, road.closed)
    in_bend = np.zeros(s_m.size, dtype=bool)
    for bend in road.bends:
        inside = (s_m >= bend.begin_m) & (s_m <= bend.end_m)
        in_bend |= inside
        curvature = np.abs(road.heading(s_m[inside], 1))
        assert curvature.max() == pytest.approx(1.0 / bend.radius_m, rel=1e-3)
        assert curvature.max() <= 1.0 / bend.radius_m * (1.0 + 1e-12)
    assert apart_m[~in_bend].max() < 1e-9
    assert 1.0 < apart_m[in_bend].max() < 25.0
    assert not road.heading(s_m[~in_bend], 1).any()
    assert len(road.bends) == len(BLOCK) - (0 if road.closed else 2)
    assert road.bends[0].radius_m == pytest.approx(30.0)
    assert min(bend.radius_m for bend in road.bends) == pytest.approx(15.0)


@pytest.mark.parametrize("road", [LOOP, STREET], ids=["loop", "street"])
def test_tangent_is_the_heading_and_the_slope(road: Road) -> None:
    s_m = np.linspace(1.0, road.length_m - 1.0, 3001)
    h = 0.01
    parts = ((1, 45.0), (2, -9.0), (3, 1.0))
    tangent = sum(
        w * (road.centreline(s_m + k * h).r_n_m - road.centreline(s_m - k * h).r_n_m)
        for k, w in parts
    ) / (60.0 * h)
    line = road.centreline(s_m)
    expected = (np.cos(line.heading_rad), np.sin(line.heading_rad), -np.tan(line.slope_rad))
    np.testing.assert_allclose(tangent, np.column_stack(expected), atol=1e-9)
    np.testing.assert_allclose(road.plan(s_m, 1), np.column_stack(expected[:2]), atol=1e-13)


def test_loop_closes() -> None:
    ends = LOOP.centreline(np.array([0.0, LOOP.length_m - 1e-9, LOOP.length_m * 3, -1e-9]))
    np.testing.assert_allclose(ends.r_n_m, ends.r_n_m[:1].repeat(4, axis=0), atol=3e-9)
    turned = (ends.heading_rad - ends.heading_rad[0]) / (2.0 * np.pi)
    np.testing.assert_allclose(turned, np.round(turned), atol=1e-9)
    np.testing.assert_allclose(ends.slope_rad, ends.slope_rad[0], atol=1e-9)
    raw = LOOP.plan([0.0, LOOP.length_m])
    np.testing.assert_allclose(raw[1], raw[0], atol=1e-10)
    assert LOOP.height(LOOP.length_m) == pytest.approx(float(LOOP.height(0.0)), abs=1e-10)


def test_open_road_goes_straight_on() -> None:
    line = STREET.centreline(np.array([-200.0, 0.0, STREET.length_m, STREET.length_m + 300.0]))
    np.testing.assert_allclose(line.r_n_m[1], [0.0, 0.0, -5.0], atol=1e-9)
    np.testing.assert_allclose(line.r_n_m[0, :2], [-200.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(line.r_n_m[2, :2], [-100.0, 400.0], atol=1e-9)
    onwards = line.r_n_m[3, :2] - line.r_n_m[2, :2]
    np.testing.assert_allclose(onwards, 300.0 * np.array([-0.624695, -0.780869]), atol=1e-3)


def test_heights() -> None:
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(500.0, 0.0)],
        radius_m=10.0,
        heights=[(100.0, 1.0), (200.0, 7.0), (300.0, 7.0), (350.0, 4.0)],
    )
    s_m = np.array([0.0, 50.0, 150.0, 250.0, 325.0, 400.0, 500.0])
    assert road.height(s_m) == pytest.approx([1.0, 1.0, 4.0, 7.0, 5.5, 4.0, 4.0])
    assert road.height(s_m, 1) == pytest.approx([0.0, 0.0, 0.06, 0.0, -0.06, 0.0, 0.0])
    # rounded at a crest: below the corner of the grades
    assert 6.0 < road.height(200.0) < 7.0
    ramp = lay_road([Waypoint(0.0, 0.0, 0.0), Waypoint(0.0, 200.0, 10.0)], radius_m=10.0)
    assert ramp.centreline(np.array([0.0, 100.0, 200.0, 240.0])).r_n_m[:, 2] == pytest.approx(
        [0.0, -5.0, -10.0, -12.0]
    )


def test_curvature_and_grade_have_two_derivatives() -> None:
    for profile, first in ((LOOP.heading, 1), (LOOP.height, 1)):
        for knot in LOOP.knots_m[1:-1]:
            for order in range(first, first + 3):
                sides = profile([knot - 1e-7, knot + 1e-7], order)
                assert sides[1] == pytest.approx(sides[0], abs=1e-6)


# --- drives --------------------------------------------------------------------------------------


@settings(deadline=None, derandomize=True, max_examples=40)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 2500.0), st.floats(1.0, 800.0), st.floats(1.0, 20.0)), max_size=4
    ),
    st.lists(st.tuples(st.floats(0.0, 2600.0), st.floats(1.0, 60.0)), max_size=4),
    st.floats(0.0, 2000.0),
)
def test_drive_keeps_all_limits(
    zones: list[tuple[float, float, float]], stops: list[tuple[float, float]], start_m: float
) -> None:
    slow = [Zone(begin, begin + length, speed) for begin, length, speed in zones]
    halts = [Stop(at, seconds) for at, seconds in stops]
    s = drive(LOOP, LIMITS, zones=slow, stops=halts, start_m=start_m, laps=2)
    end_s = s.x[-2]
    t_s = np.linspace(-1.0, end_s + 1.0, 20_001)
    at_m, v, a, jerk = (s(t_s, order) for order in range(4))
    assert v.min() >= -1e-9
    assert v.max() <= LIMITS.speed_mps * (1.0 + 1e-12)
    assert -LIMITS.braking_mps2 * (1 + 1e-9) <= a.min()
    assert a.max() <= LIMITS.acceleration_mps2 * (1 + 1e-9)
    assert np.abs(jerk).max() <= LIMITS.jerk_mps3 * (1 + 1e-9)
    curvature = LOOP.heading(LOOP.wrapped(at_m), 1)
    assert np.abs(curvature * v**2).max() <= LIMITS.lateral_mps2 * (1 + 1e-9)
    for zone in slow:
        for lap_m in (0.0, LOOP.length_m):
            inside = (at_m > zone.begin_m + lap_m + 1e-5) & (at_m < zone.end_m + lap_m - 1e-5)
            assert (v[inside] <= zone.speed_mps * (1 + 1e-9)).all()
    assert s(0.0) == pytest.approx(start_m)
    assert s(end_s) == pytest.approx(start_m + 2 * LOOP.length_m, abs=1e-8)
    assert s(end_s + 1e4) == s(end_s + 1e3)  # for ever


def test_stands_still_where_and_as_long_as_told() -> None:
    stops = [Stop(0.0, 7.0), Stop(300.0, 20.0), Stop(1900.0, 3.5)]
    s = drive(LOOP, LIMITS, stops=stops, laps=2)
    path = StreetPath(LOOP, s)
    x, v = s.x[1:-1], s(s.x[1:-1], 1)
    waits = [
        (s(begin), end - begin)
        for begin, end, before, after in zip(x, x[1:], v, v[1:], strict=False)
        if before == after == 0.0
    ]
    lap = LOOP.length_m
    places = [0.0, 300.0, 1900.0, lap, lap + 300.0, lap + 1900.0]
    assert [at for at, _ in waits] == pytest.approx(places, abs=1e-8)
    assert [seconds for _, seconds in waits] == pytest.approx([7.0, 20.0, 3.5] * 2)
    begin = x[list(np.isclose(s(x), 300.0)).index(True)]
    still = path(np.linspace(begin, begin + 19.999, 500))
    assert not np.ptp(still.r_m, axis=0).any()
    assert not still.v_mps.any()
    assert not still.a_mps2.any()
    assert path.arrival_s == s.x[-2]


def test_drive_is_brisk() -> None:
    """On a long straight the limit is reached as soon as acceleration and jerk allow."""
    road = lay_road([Waypoint(0.0, 0.0), Waypoint(2000.0, 0.0)], radius_m=10.0)
    s = drive(road, Limits(20.0, 2.0, 2.0, 100.0))
    t_s = np.linspace(0.0, s.x[-2], 5001)
    assert s(t_s, 2).max() == pytest.approx(2.0, rel=1e-3)
    # 1.875·20/2 s up and down at half the speed on average, the rest at the limit
    assert s.x[-2] == pytest.approx(2 * 18.75 + (2000.0 - 375.0) / 20.0)
    short = lay_road([Waypoint(0.0, 0.0), Waypoint(30.0, 0.0)], radius_m=10.0)
    s = drive(short, Limits(20.0, 2.0, 3.0, 2.0))
    jerk = s(np.linspace(0.0, s.x[-2], 5001), 3)
    assert np.abs(jerk).max() == pytest.approx(2.0, rel=1e-3)
    assert s(s.x[-2]) == pytest.approx(30.0, abs=1e-9)


def test_slow_over_a_steep_hump() -> None:
    road = lay_road(
        [Waypoint(0.0, 0.0), Waypoint(400.0, 0.0)],
        radius_m=10.0,
        heights=[(200.0, 0.0), (203.0, 0.4), (206.0, 0.0)],
    )
    path = StreetPath(road, drive(road, LIMITS))
    motion = path(np.linspace(0.0, path.arrival_s, 20_001))
    assert np.abs(motion.a_mps2[:, 2]).max() == pytest.approx(LIMITS.lateral_mps2, rel=0.02)
    assert motion.v_mps[:, 0].max() > 13.0


def test_start_in_motion() -> None:
    s = drive(STREET, LIMITS, start_m=20.0, speed_mps=11.0)
    assert s(-5.0) == pytest.approx(20.0 - 55.0)
    assert s(0.0, 1) == 11.0
    before = StreetPath(STREET, s)(np.array([-5.0]))
    np.testing.assert_allclose(before.r_m[0, :2], [-35.0, 0.0], atol=1e-9)


def test_attitude_of_a_plain_car_is_the_roads() -> None:
    path = StreetPath(LOOP, drive(LOOP, LIMITS))
    t_s = np.linspace(0.0, path.arrival_s, 500)
    angles = StreetAttitude(path)(t_s)
    line = LOOP.centreline(path.distance(t_s))
    assert not angles.roll.x.any()
    assert np.array_equal(angles.pitch.x, line.slope_rad)
    assert np.array_equal(angles.yaw.x, line.heading_rad)
    squat = StreetAttitude(path, squat=1.0)(t_s).pitch.x - line.slope_rad
    gaining = path.distance(t_s, 2) > 0.5
    assert (squat[gaining] > math.atan(0.05)).all()


def test_breaks_are_crossings_of_the_roads_knots() -> None:
    path = StreetPath(LOOP, drive(LOOP, LIMITS, laps=2))
    crossed = LOOP.wrapped(path.distance(np.array(path.breaks_s)))
    own = set(path.distance.x)
    off_m = [
        np.abs(LOOP.knots_m - s).min()
        for s, second in zip(crossed, path.breaks_s, strict=True)
        if second not in own
    ]
    assert len(off_m) > 2 * 4 * len(LOOP.bends)
    assert max(off_m) < 1e-9
    assert list(path.breaks_s) == sorted(path.breaks_s)


# --- refusals ------------------------------------------------------------------------------------

SQUARE = [Waypoint(0.0, 0.0), Waypoint(100.0, 0.0), Waypoint(100.0, 100.0)]


@pytest.mark.parametrize(
    ("waypoints", "radius_m", "heights", "text"),
    [
        (SQUARE, 120.0, [], r"waypoints\[1\]: the bends .* leg of 100 m .* 0\.\d+ times"),
        ([*SQUARE, Waypoint(100.0, 100.0)], 10.0, [], r"waypoints\[3\]: the place of the one"),
        ([*SQUARE, Waypoint(100.0, 1.0)], 10.0, [], r"waypoints\[2\]: the road turns by 180°"),
        (SQUARE, 10.0, [(50.0, 0.0), (60.0, 9.0)], r"after 50 m is 90%; expected up to 40%"),
        (SQUARE, 10.0, [(50.0, 0.0), (50.0, 9.0)], r"heights: 50 m does not come later"),
    ],
)
def test_impossible_roads(
    waypoints: list[Waypoint], radius_m: float, heights: list[tuple[float, float]], text: str
) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        lay_road(waypoints, radius_m=radius_m, heights=heights)
    assert "\n" not in str(caught.value)


def test_radius_that_is_said_to_fit_does() -> None:
    with pytest.raises(ConfigError) as caught:
        lay_road(SQUARE, radius_m=120.0)
    share = float(str(caught.value).split("radii of ")[1].split(" times")[0])
    assert lay_road(SQUARE, radius_m=120.0 * share).length_m > 100.0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"stops": [Stop(9.0, 1.0), Stop(5000.0, 1.0)]}, r"stops\[1\].at: 5000 m is not on"),
        ({"zones": [Zone(3000.0, 4000.0, 5.0)]}, r"zones\[0\].from: 3000 m is not on"),
        ({"zones": [Zone(30.0, 20.0, 5.0)]}, r"zones\[0\].to: 20 m is not after 30 m"),
        ({"start_m": 9999.0}, "start: 9999 m is not on the road, which is"),
        ({"speed_mps": 14.0}, "initial_speed: 14 m/s; the road ahead allows up to 13.9"),
        ({"start_m": 370.0, "speed_mps": 13.0}, "initial_speed: 13 m/s; the road ahead"),
        ({"stops": [Stop(0.0, 1.0)], "speed_mps": 3.0}, "initial_speed: 3 m/s at a place to stop"),
    ],
)
def test_impossible_drives(options: dict, text: str) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        drive(STREET, LIMITS, **options)
    assert "\n" not in str(caught.value)
