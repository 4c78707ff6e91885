"""Vehicles against numerical differentiation, and what their attitudes mean."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pymap3d
import pytest

from deepgnss.core.constants import STANDARD_GRAVITY_MPS2
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray
from deepgnss.sim.motion.attitude import (
    Attitude,
    EllipseAttitude,
    Steady,
    along,
)
from deepgnss.sim.motion.paths import Ellipse, Line, Path, Sine, SineFromRest, Static
from deepgnss.sim.motion.profile import (
    acceleration_profile,
    breaks,
    constant_rate,
    smooth_profile,
)
from deepgnss.sim.motion.road import Waypoint, lay_road
from deepgnss.sim.motion.street import Limits, Stop, StreetAttitude, StreetPath, drive
from deepgnss.sim.motion.vehicle import Vehicle, geographic

PLACE = (0.91, 0.18, 120.0)
HUNDRED_G = 100.0 * STANDARD_GRAVITY_MPS2

DRIVE = smooth_profile([(2.0, 0.0), (7.0, 13.0), (9.0, 13.0), (12.0, 0.0)])
OVAL = Ellipse(100.0, 60.0, smooth_profile([(1.0, 0.0), (6.0, 0.16), (8.0, -0.1)]))
LEFT = Ellipse(40.0, -40.0, smooth_profile([(0.0, 0.1), (9.0, 0.3)]))
ROAD = lay_road(
    [Waypoint(0.0, 0.0), Waypoint(60.0, 10.0, 3.0), Waypoint(40.0, 90.0, 0.0)], radius_m=12.0
)
STREET = StreetPath(ROAD, drive(ROAD, Limits(9.0, jerk_mps3=3.0), stops=[Stop(20.0, 2.0)]))
STEPS = acceleration_profile(
    [(1.0, HUNDRED_G), (3.0, -HUNDRED_G), (6.0, 0.0)], HUNDRED_G, speed_mps=5.0
)
MOVERS: dict[str, tuple[Path, Attitude]] = {
    "static": (Static(), Steady(0.1, -0.2, 2.0)),
    "line": (Line((0.6, 0.0, -0.8), DRIVE), along((0.6, 0.0, -0.8))),
    "steps": (Line((0.0, 1.0, 0.0), STEPS), Steady()),
    "ellipse": (OVAL, EllipseAttitude(OVAL, bank=0.7)),
    "left": (LEFT, EllipseAttitude(LEFT, bank=0.5)),
    "sine": (Sine((0.0, 1.0, 0.0), 3.0, 1.5), Steady()),
    "sine from rest": (SineFromRest((0.0, 1.0, 0.0), 3.0, 0.5, 7.0), Steady()),
    "street": (STREET, StreetAttitude(STREET, bank=0.6)),
    "squat": (STREET, StreetAttitude(STREET, bank=-0.2, squat=0.5)),
}
STEP_S = 2.0e-3


@pytest.fixture(params=MOVERS, name="vehicle")
def _vehicle(request: pytest.FixtureRequest) -> Vehicle:
    return Vehicle(*PLACE, *MOVERS[request.param])


def _times(vehicle: Vehicle) -> FloatArray:
    """Times whose stencils hold no break, from before the first to after the last."""
    t_s = np.random.default_rng(5).uniform(-3.0, 45.0, 1500)
    gaps = np.abs(t_s[:, None] - np.array([*vehicle.breaks_s, -1e3])).min(axis=1)
    return t_s[gaps > 3.1 * STEP_S]


def _slope(f: Callable[[FloatArray], FloatArray], t_s: FloatArray) -> FloatArray:
    """Derivative by central differences of sixth order."""
    parts = ((1, 45.0), (2, -9.0), (3, 1.0))
    total: FloatArray = sum(
        (w * (f(t_s + k * STEP_S) - f(t_s - k * STEP_S)) for k, w in parts), np.zeros(1)
    )
    return total / (60.0 * STEP_S)


def test_velocity_and_acceleration_are_those_of_the_position(vehicle: Vehicle) -> None:
    t_s = _times(vehicle)
    local, pose = vehicle.path(t_s), vehicle.pose(t_s)
    v_mps = _slope(lambda t: vehicle.path(t).r_m, t_s)
    a_mps2 = _slope(lambda t: vehicle.path(t).v_mps, t_s)
    np.testing.assert_allclose(local.v_mps, v_mps, atol=1e-9 + 1e-12 * np.abs(local.r_m).max())
    np.testing.assert_allclose(local.a_mps2, a_mps2, atol=1e-8 + 1e-11 * np.abs(v_mps).max())
    C = C_ne(*PLACE[:2])
    np.testing.assert_allclose((pose.r_e_m - ecef(*PLACE)) @ C.T, local.r_m, atol=5e-9)
    np.testing.assert_allclose(pose.v_e_mps @ C.T, local.v_mps, atol=1e-11)
    np.testing.assert_allclose(pose.a_e_mps2 @ C.T, local.a_mps2, atol=1e-11)


def test_rates_are_those_of_the_matrix(vehicle: Vehicle) -> None:
    t_s = _times(vehicle)
    pose = vehicle.pose(t_s)
    C_be = np.swapaxes(pose.C_eb, 1, 2)
    np.testing.assert_allclose(C_be @ pose.C_eb, np.tile(np.eye(3), (t_s.size, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(pose.C_eb), 1.0, atol=1e-14)
    turning = C_be @ _slope(lambda t: vehicle.pose(t).C_eb, t_s)
    omega = np.column_stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]])
    np.testing.assert_allclose(pose.omega_eb_b_radps, omega, atol=1e-10)
    alpha = _slope(lambda t: vehicle.pose(t).omega_eb_b_radps, t_s)
    np.testing.assert_allclose(pose.alpha_eb_b_radps2, alpha, atol=1e-8)


def test_points_of_the_body_move_with_it(vehicle: Vehicle) -> None:
    t_s = _times(vehicle)
    lever = (0.4, -1.3, -2.0)
    pose, origin_e_m = vehicle.pose(t_s), ecef(*PLACE)

    def position(t: FloatArray) -> FloatArray:
        return vehicle.point(t, lever).r_m - origin_e_m

    point = vehicle.point(t_s, lever)
    np.testing.assert_allclose(point.r_m, pose.r_e_m + pose.C_eb @ np.array(lever), atol=5e-9)
    np.testing.assert_allclose(point.v_mps, _slope(position, t_s), atol=2e-6)
    slope = _slope(lambda t: vehicle.point(t, lever).v_mps, t_s)
    np.testing.assert_allclose(point.a_mps2, slope, atol=1e-7)
    for ours, of_pose in zip(vehicle.point(t_s), pose[:3], strict=True):
        assert np.array_equal(ours, of_pose)


@pytest.mark.parametrize("name", ["line", "ellipse", "left", "street"])
def test_velocity_points_forward(name: str) -> None:
    vehicle = Vehicle(*PLACE, *MOVERS[name])
    pose = vehicle.pose(np.linspace(0.0, 30.0, 1000))
    v_b_mps = np.einsum("kji,kj->ki", pose.C_eb, pose.v_e_mps)
    assert np.abs(v_b_mps[:, 1:]).max() < 1e-12 * max(1.0, np.abs(v_b_mps).max() * 10.0)
    assert v_b_mps[:, 0].max() > 3.0
    if name != "ellipse":  # which also goes backwards
        assert v_b_mps[:, 0].min() >= -1e-12


@pytest.mark.parametrize("name", ["ellipse", "left", "street"])
def test_coordinated_turn_leaves_no_side_force(name: str) -> None:
    path, _ = MOVERS[name]
    attitude = (
        EllipseAttitude(path, bank=1.0)
        if isinstance(path, Ellipse)
        else StreetAttitude(STREET, bank=1.0)
    )
    t_s = np.linspace(0.0, 30.0, 800)
    vehicle = Vehicle(*PLACE, path, attitude)
    up_e = -C_ne(*PLACE[:2])[2]
    felt_e = vehicle.pose(t_s).a_e_mps2 + STANDARD_GRAVITY_MPS2 * up_e
    felt_b = np.einsum("kji,kj->ki", vehicle.pose(t_s).C_eb, felt_e)
    # With a grade the lateral axis tilts less than the body is rolled.
    assert np.abs(felt_b[:, 1]).max() < (0.01 if name == "street" else 1e-12)
    assert np.ptp(vehicle.attitude(t_s).roll.x) > 0.05


def test_right_turn_to_the_right_and_right_side_down() -> None:
    circle = Ellipse(50.0, 50.0, constant_rate(0.2))
    vehicle = Vehicle(*PLACE, circle, EllipseAttitude(circle, bank=1.0))
    seen = geographic(vehicle.pose(np.array([0.0, math.pi / 2.0 / 0.2])))
    np.testing.assert_allclose(seen.v_n_mps[0], [10.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(seen.v_n_mps[1], [0.0, 10.0, 0.0], atol=2e-4)  # local level
    roll, pitch, yaw = seen.euler_rad.T
    assert yaw == pytest.approx([0.0, math.pi / 2.0], abs=1e-4)
    assert roll == pytest.approx(math.atan(2.0 / STANDARD_GRAVITY_MPS2), abs=1e-4)
    assert pitch == pytest.approx(0.0, abs=1e-4)
    C_nb = C_ne(*PLACE[:2]) @ vehicle.pose(np.zeros(1)).C_eb[0]
    assert C_nb[2, 1] > 0.1  # the right axis points down


def test_uphill_is_nose_up() -> None:
    steady = along((0.6, 0.0, -0.8))
    assert steady.pitch_rad == pytest.approx(math.atan2(0.8, 0.6))
    assert along((0.0, -1.0, 0.0)).yaw_rad == pytest.approx(-math.pi / 2.0)
    assert along((0.0, 0.0, 1.0)) == Steady(0.0, -math.pi / 2.0, 0.0)


def test_geographic_is_of_the_present_position() -> None:
    """100 km to the north the local level is another one; the heading of a meridian is not."""
    vehicle = Vehicle(*PLACE, Line((1.0, 0.0, 0.0), constant_rate(1000.0)), Steady())
    seen = geographic(vehicle.pose(np.array([0.0, 100.0])))
    lat, lon, height = pymap3d.ned2geodetic(1e5, 0.0, 0.0, *PLACE, deg=False)
    assert seen.lat_rad[1] == pytest.approx(lat, abs=1e-12)
    assert seen.lon_rad[1] == pytest.approx(lon, abs=1e-12)
    assert seen.height_m == pytest.approx([PLACE[2], height], abs=1e-6)
    # Straight on is upwards by the angle between the two verticals.
    bow = lat - PLACE[0]
    assert seen.v_n_mps[1] == pytest.approx(
        [1000.0 * math.cos(bow), 0.0, -1000.0 * math.sin(bow)], abs=1e-6
    )
    assert seen.euler_rad[1] == pytest.approx([0.0, bow, 0.0], abs=1e-12)


def test_breaks_are_where_the_parts_have_them() -> None:
    vehicle = Vehicle(*PLACE, Line((1.0, 0.0, 0.0), DRIVE))
    assert vehicle.breaks_s == (2.0, 7.0, 9.0, 12.0)
    assert Vehicle(*PLACE).breaks_s == ()
    assert set(breaks(STREET.distance)) < set(STREET.breaks_s)
    assert Vehicle(*PLACE, STREET).road is ROAD
    assert vehicle.road is None


def test_millisecond_nodes_carry_hundred_g() -> None:
    """Cubics through 1 kHz nodes are 1e-4 cycle from a path with 100 g/s of jerk at most."""
    t_s = np.arange(-1.0, 9.0, 1.0e-3) + 2.3e-4  # breaks lie between nodes
    line = Line((1.0, 0.0, 0.0), STEPS)
    nodes, between = line(t_s).r_m[:, 0], line(t_s[1:-2] + 5.0e-4).r_m[:, 0]
    cubic = (9.0 * (nodes[1:-2] + nodes[2:-1]) - nodes[:-3] - nodes[3:]) / 16.0
    assert np.abs(cubic - between).max() < 1e-4 * 0.19 / 10.0
