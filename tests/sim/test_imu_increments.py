"""Exact increments: earth rate, gravity, and the way back to the trajectory they came from.

The way back is an integrator of this file alone: splines through the sums of the increments,
fourth-order Magnus steps for the attitude in an inertial frame, and Picard iterations for position
(gravity is so smooth that three are enough).
"""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from deepgnss.core.attitude import (
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    quaternion_product,
    rotate,
    rotation_vector,
)
from deepgnss.core.constants import EARTH_RATE_RADPS
from deepgnss.core.earth import gravity_e_mps2, gravity_mps2
from deepgnss.core.time import GpsTime
from deepgnss.sim.imu.carried import Mounted, Shaken, VibrationLine
from deepgnss.sim.imu.increments import increments, panel, sensed
from deepgnss.sim.motion.attitude import EllipseAttitude, Steady
from deepgnss.sim.motion.paths import Ellipse, Line
from deepgnss.sim.motion.profile import acceleration_profile, smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

START = GpsTime(2290, 100_000.0)
PLACE = (0.912, 0.184, 120.0)
OMEGA_E = np.array([0.0, 0.0, EARTH_RATE_RADPS])
CONING = (
    VibrationLine(12.0, (1e-4, 2e-4, 3e-4), (4e-3, 4e-3, 1e-3), (0, 0.3, 0.1, 0.0, 0.25, 0.6)),
    VibrationLine(31.0, (2e-5, 1e-5, 5e-5), (5e-4, 3e-4, 2e-4), (0.4, 0, 0.2, 0.1, 0.8, 0.5)),
)


def circling():
    """A car that pulls away into a circle of 60 m radius, leaning into it."""
    angle = smooth_profile([(0.0, 0.0), (5.0, 0.2)], flat=2)
    ellipse = Ellipse(60.0, 60.0, angle)
    return Vehicle(*PLACE, ellipse, EllipseAttitude(ellipse, bank=0.3))


def whole(body, rate_hz, seconds, **more):
    blocks = list(increments(body, START, rate_hz, round(rate_hz * seconds), **more))
    return (np.concatenate([getattr(b, name) for b in blocks]) for name in (
        "time_s", "dt_s", "dtheta_b_rad", "dv_b_mps",
    ))  # fmt: skip


def chain(first, steps):
    """Products first·s₀, first·s₀·s₁, … of quaternions by doubling."""
    total = np.vstack([first, steps])
    reach = 1
    while reach < len(total):
        total = np.vstack([total[:reach], quaternion_product(total[:-reach], total[reach:])])
        reach *= 2
    return total


def navigated(body, rate_hz, seconds):
    """Position (n, 3) ECEF and quaternion b → e from error-free increments, at half intervals."""
    time_s, _, dtheta, dv = whole(body, rate_hz, seconds)
    knots = np.append(0.0, time_s)
    rate, force = (
        make_interp_spline(knots, np.vstack([np.zeros(3), np.cumsum(sums, axis=0)]), k=9)
        .derivative() for sums in (dtheta, dv)
    )  # fmt: skip
    h = 0.5 / rate_hz
    t = np.arange(2 * time_s.size + 1) * h
    w1, w2 = (rate(t[:-1] + h * (0.5 + side * np.sqrt(3.0) / 6.0)) for side in (-1, 1))
    turns = 0.5 * h * (w1 + w2) - np.sqrt(3.0) / 12.0 * h**2 * np.cross(w2, w1)
    pose = body.pose(np.zeros(1))
    q_ib = chain(quaternion_from_matrix(pose.C_eb), quaternion_from_rotation_vector(turns))
    q_ei = quaternion_from_rotation_vector(-np.outer(t, OMEGA_E))
    f_i = rotate(q_ib, force(t))
    r0, v0 = pose.r_e_m[0], pose.v_e_mps[0] + np.cross(OMEGA_E, pose.r_e_m[0])
    r_i = r0 + np.outer(t, v0)
    for _ in range(3):
        r_e = rotate(q_ei, r_i)
        pull_e = gravity_e_mps2(r_e) + np.cross(OMEGA_E, np.cross(OMEGA_E, r_e))
        back = q_ei * np.array([1.0, -1.0, -1.0, -1.0])
        a_i = make_interp_spline(t, f_i + rotate(back, pull_e), k=5)
        r_i = r0 + np.outer(t, v0) + a_i.antiderivative(2)(t)
    return t, rotate(q_ei, r_i), quaternion_product(q_ei, q_ib)


@pytest.mark.parametrize("rate_hz", [200.0, 500.0])
def test_integrating_them_gives_the_trajectory_back(rate_hz):
    body = Shaken(circling(), CONING)
    t, r_e_m, q_eb = (x[::2] for x in navigated(body, rate_hz, 60.0))  # where intervals meet
    true = body.pose(t)
    assert np.ptp(true.r_e_m, axis=0).max() > 100.0  # it did go somewhere
    assert np.linalg.norm(r_e_m - true.r_e_m, axis=1).max() < 1e-3
    back = quaternion_from_matrix(true.C_eb) * np.array([1.0, -1.0, -1.0, -1.0])
    turned = rotation_vector(quaternion_product(back, q_eb))
    assert np.linalg.norm(turned, axis=1).max() < 1e-6


def test_at_rest_they_are_gravity_and_earth_rate_with_their_signs():
    level = Vehicle(*PLACE, attitude=Steady(yaw_rad=0.5 * np.pi))  # forward is east
    _, dt, dtheta, dv = whole(level, 100.0, 1.0)
    gravity = float(gravity_mps2(PLACE[0], PLACE[2]))
    np.testing.assert_allclose(dv, np.outer(dt, [0.0, 0.0, -gravity]), atol=1e-12)  # it holds up
    north, down = EARTH_RATE_RADPS * np.cos(PLACE[0]), -EARTH_RATE_RADPS * np.sin(PLACE[0])
    np.testing.assert_allclose(dtheta, np.outer(dt, [0.0, -north, down]), atol=1e-17)


def test_pulling_away_turning_right_and_pitching_up_read_positive():
    forward = Vehicle(*PLACE, Line((1.0, 0.0, 0.0), acceleration_profile([(0.0, 2.0)], 100.0)))
    assert whole_mean(forward)[1][0] == pytest.approx(2.0, abs=2e-3)
    right = circling()
    (_, _, yaw_rate), (_, lateral, _) = whole_mean(right, at_s=10.0)
    assert yaw_rate > 0.15 and lateral > 0.0
    nose_up = Vehicle(*PLACE, attitude=Steady(pitch_rad=0.1))
    assert whole_mean(nose_up)[1][0] == pytest.approx(9.81 * np.sin(0.1), abs=1e-2)


def whole_mean(body, at_s=1.0):
    block = next(increments(body, START, 100.0, 1, first=round(100.0 * at_s)))
    return block.dtheta_b_rad[0] / block.dt_s[0], block.dv_b_mps[0] / block.dt_s[0]


@pytest.mark.parametrize("rate_hz", [50.0, 200.0, 2000.0])
def test_lines_of_100_hz_are_integrated_to_1e_9(rate_hz):
    line = VibrationLine(100.0, (1e-4,) * 3, (1e-3,) * 3, (0.0, 0.2, 0.4, 0.1, 0.6, 0.8))
    body = Shaken(circling(), (line,))
    _, _, dtheta, dv = whole(body, rate_hz, 0.1)
    fine = [x.reshape(-1, round(20_000 / rate_hz), 3).sum(axis=1)
            for x in list(whole(body, 20_000.0, 0.1))[2:]]  # fmt: skip
    rates = sensed(body.pose(np.linspace(0.0, 0.1, 997)))
    for got, expected, rate in zip((dtheta, dv), fine, rates, strict=True):
        assert np.abs(got - expected).max() < 1e-9 * np.abs(rate).max() / rate_hz


def test_more_is_asked_of_the_quadrature_where_the_motion_is_faster():
    assert panel(0.005, 1.0) < panel(0.005, 100.0) <= panel(0.02, 100.0)


def test_they_do_not_depend_on_where_a_block_begins_and_meet_at_breaks():
    body = Vehicle(
        *PLACE, Line((1.0, 0.0, 0.0), acceleration_profile([(0.0, 0.0), (0.503, 5.0)], 50.0))
    )
    whole_run = [*whole(body, 100.0, 1.0)]
    parts = [next(increments(body, START, 100.0, 10, first=k)) for k in range(0, 100, 10)]
    for column, name in zip(whole_run, ("time_s", "dt_s", "dtheta_b_rad", "dv_b_mps"), strict=True):
        np.testing.assert_array_equal(column, np.concatenate([getattr(b, name) for b in parts]))
    # every interval by itself, twenty times finer: a break within one makes no difference
    fine = [*whole(body, 2000.0, 1.0)]
    assert any(0.5 < instant < 0.51 for instant in body.breaks_s)
    np.testing.assert_allclose(whole_run[3], fine[3].reshape(100, 20, 3).sum(axis=1), atol=1e-13)


def test_a_unit_at_a_lever_arm_feels_the_turn():
    centre, arm = circling(), (1.5, -0.4, 0.8)
    unit = Mounted(centre, arm, (0.0, 0.0, 0.0))
    t = np.linspace(1.0, 11.0, 7)
    pose, point = unit.pose(t), centre.point(t, arm)
    for got, expected in zip(pose[:3], point, strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9)
    (_, f_centre), (_, f_unit) = sensed(centre.pose(t)), sensed(pose)
    rate = 0.2  # centripetal: −ω²·forward arm, once it turns steadily
    assert (f_unit - f_centre)[-1, 0] == pytest.approx(-(rate**2) * 1.5, abs=2e-2)


def test_turned_axes_read_the_same_vectors():
    turned = Mounted(circling(), euler_rad=(0.02, -0.03, 0.5 * np.pi))
    t = np.linspace(0.0, 10.0, 5)
    plain, other = sensed(circling().pose(t)), sensed(turned.pose(t))
    C_vb = np.swapaxes(circling().pose(t).C_eb, 1, 2) @ turned.pose(t).C_eb
    for vector, read in zip(plain, other, strict=True):
        np.testing.assert_allclose(np.einsum("nij,nj->ni", C_vb, read), vector, atol=1e-9)
        assert not np.allclose(vector, read)


def test_derivatives_of_what_is_carried():
    body = Mounted(Shaken(circling(), CONING), (0.5, 0.2, -0.1), (0.1, 0.2, 0.3))
    t, h = np.linspace(0.5, 8.0, 40), 1e-5
    before, now, after = (body.pose(t + side * h) for side in (-1, 0, 1))
    slope = [(b - a) / (2.0 * h) for a, b in zip(before, after, strict=True)]
    np.testing.assert_allclose(slope[0], now.v_e_mps, atol=1e-3)  # 1e-9 m of ECEF digits / h
    np.testing.assert_allclose(slope[1], now.a_e_mps2, atol=1e-4)
    np.testing.assert_allclose(slope[4], now.alpha_eb_b_radps2, atol=1e-5)
    rate = np.swapaxes(now.C_eb, 1, 2) @ slope[3]  # C_be dC_eb/dt = [ω×]
    found = np.column_stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0]])
    np.testing.assert_allclose(found, now.omega_eb_b_radps, atol=1e-6)
    np.testing.assert_allclose(
        now.C_eb @ np.swapaxes(now.C_eb, 1, 2), np.broadcast_to(np.eye(3), (40, 3, 3)), atol=1e-12
    )


def test_antenna_and_unit_of_a_shaken_vehicle_see_one_motion():
    body = Shaken(circling(), CONING)
    t = np.linspace(0.0, 0.2, 21)
    still = np.abs(body.point(t).r_m - circling().point(t).r_m).max()
    assert 1e-4 < still < 1e-3
    arm = (0.4, 0.1, -1.2)
    mounted = Mounted(body, arm).pose(t)
    np.testing.assert_allclose(body.point(t, arm).a_mps2, mounted.a_e_mps2, atol=1e-9)
    assert body.highest_hz == 31.0
