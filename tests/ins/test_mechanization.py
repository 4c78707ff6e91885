"""Mechanization: coning and sculling to the textbook residual, motions in closed form, a twin."""

from __future__ import annotations

from dataclasses import astuple
from itertools import pairwise

import numpy as np
import pytest
from driving import drive as simulated_drive
from exact_motion import ExactMotion, drive, line
from scipy.special import j1

from deepgnss.core import attitude, earth
from deepgnss.core.records import FloatArray, ImuBlock, InsState
from deepgnss.ins.mechanization import (
    NOTHING_BEFORE,
    Calibration,
    Increment,
    Pose,
    Poses,
    body_rotation,
    body_velocity,
    calibration_of,
    mechanize,
    pose_of,
    step,
    without_errors,
)

pytestmark = pytest.mark.kernel


def _run(state: InsState, block: ImuBlock) -> Poses:
    return mechanize(
        pose_of(state),
        NOTHING_BEFORE,
        calibration_of(state),
        block.dt_s,
        block.dtheta_b_rad,
        block.dv_b_mps,
    )[0]


def _errors(motion: ExactMotion, edges_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors of position (m, NED), velocity and attitude (φ) at the ends of the intervals."""
    poses = _run(motion.state(float(edges_s[0])), motion.increments(edges_s))
    place, v, q = motion.pose(edges_s[1:])
    meridian = earth.meridian_radius_m(place[:, 0]) + place[:, 2]
    around = (earth.transverse_radius_m(place[:, 0]) + place[:, 2]) * np.cos(place[:, 0])
    position = np.column_stack(
        [
            (poses.lat_rad - place[:, 0]) * meridian,
            (poses.lon_rad - place[:, 1]) * around,
            place[:, 2] - poses.height_m,
        ]
    )
    return position, poses.v_n_mps - v, attitude.attitude_error_n(poses.q_nb, q)


def _increment(dt_s: float, dtheta: FloatArray, dv: FloatArray) -> Increment:
    return Increment(dt_s, tuple(map(float, dtheta)), tuple(map(float, dv)))


# --- coning and sculling --------------------------------------------------------------------------


def two_sample_residual(beta: float) -> float:
    """What two-sample compensation leaves per interval of phase β, for unit amplitudes (→ β⁵/60).

    The truth ½(β − sin β) less the algorithm's ⅓ sin²(β/2) sin β.
    """
    return 0.5 * beta - 2.0 / 3.0 * np.sin(beta) + np.sin(2.0 * beta) / 12.0


def one_sample_residual(beta: float) -> float:
    return 0.5 * (beta - np.sin(beta))


FREQUENCIES_HZ = (2.0, 5.0, 10.0, 20.0)


def _coning_drift_radps(frequency_hz: float, two_samples: bool) -> float:
    """Drift about the cone's axis of a cone with half angle `a`, 100 Hz, ten seconds."""
    a, w, T, count = 0.01, 2.0 * np.pi * frequency_hz, 0.01, 1000
    t = np.arange(-1, count + 1) * T
    dtheta = np.column_stack(
        [
            np.full(t.size - 1, -2.0 * w * np.sin(a / 2.0) ** 2 * T),
            np.sin(a) * np.diff(np.cos(w * t)),
            np.sin(a) * np.diff(np.sin(w * t)),
        ]
    )

    def truth(phase: float) -> tuple[float, float, float, float]:
        s = np.sin(a / 2.0)
        return np.cos(a / 2.0), 0.0, s * np.cos(phase), s * np.sin(phase)

    q = truth(0.0)
    for earlier, later in pairwise(dtheta):
        before = _increment(T, earlier, np.zeros(3)) if two_samples else NOTHING_BEFORE
        turned = body_rotation(before, _increment(T, later, np.zeros(3)))
        q = attitude.product(q, attitude.from_rotation_vector(turned))
    # The true motion closes after whole periods; what is left is the algorithm's.
    error = attitude.product(attitude.conjugate(truth(w * t[-1])), q)
    return attitude.to_rotation_vector(error)[0] / (count * T)


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
def test_coning_drifts_as_the_formula_says(frequency_hz: float) -> None:
    beta, rate = 2.0 * np.pi * frequency_hz * 0.01, 0.01**2 / 0.01
    two = _coning_drift_radps(frequency_hz, two_samples=True)
    one = _coning_drift_radps(frequency_hz, two_samples=False)
    assert -two == pytest.approx(rate * two_sample_residual(beta), rel=1e-3)
    assert -one == pytest.approx(rate * one_sample_residual(beta), rel=1e-3)
    assert abs(two) < 0.21 * beta**2 * abs(one)  # β⁵/60 of β³/12


def _sculling_drift_mps2(frequency_hz: float, two_samples: bool) -> float:
    """Wrong acceleration with a roll of amplitude a in phase with a lateral force c, 100 Hz."""
    a, c, w, T, count = 0.01, 10.0, 2.0 * np.pi * frequency_hz, 0.01, 1000
    t = np.arange(-1, count + 1) * T
    angle = a * np.sin(w * t)
    dtheta = np.column_stack([np.diff(angle), np.zeros((t.size - 1, 2))])
    dv = np.column_stack(
        [np.zeros(t.size - 1), np.diff(-c / w * np.cos(w * t)), np.zeros(t.size - 1)]
    )
    down = 0.0
    for k in range(1, count + 1):
        before = _increment(T, dtheta[k - 1], dv[k - 1]) if two_samples else NOTHING_BEFORE
        gained = body_velocity(before, _increment(T, dtheta[k], dv[k]))
        down += attitude.rotated(attitude.from_rotation_vector((angle[k], 0.0, 0.0)), gained)[2]
    return float(down / (count * T) - c * j1(a))  # mean of c·sin(x)·sin(a·sin(x))


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
def test_sculling_drifts_as_the_formula_says(frequency_hz: float) -> None:
    w = 2.0 * np.pi * frequency_hz
    beta, rate = w * 0.01, 0.01 * 10.0 / w / 0.01
    two = _sculling_drift_mps2(frequency_hz, two_samples=True)
    one = _sculling_drift_mps2(frequency_hz, two_samples=False)
    assert -two == pytest.approx(rate * two_sample_residual(beta), rel=1e-3)
    assert -one == pytest.approx(rate * one_sample_residual(beta), rel=1e-3)


def test_unequal_intervals_are_exact_for_linear_rate_and_force() -> None:
    """Against the fine integration of ω = a + b·t, f = c + d·t over lengths 4 ms and 11 ms."""
    a, b = np.array([0.02, -0.03, 0.05]), np.array([4.0, 3.0, -2.0])
    c, d = np.array([5.0, -3.0, -9.8]), np.array([300.0, -500.0, 200.0])

    def between(t0: float, t1: float) -> Increment:
        length, square = t1 - t0, (t1**2 - t0**2) / 2.0
        return _increment(length, a * length + b * square, c * length + d * square)

    before, now = between(-0.004, 0.0), between(0.0, 0.011)
    q, velocity, n = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 4000
    for k in range(n):
        t0, t1 = 0.011 * k / n, 0.011 * (k + 1) / n
        part = between(t0, t1)
        half = attitude.quaternion_from_rotation_vector(np.array(part.dtheta_b_rad) / 2.0)
        velocity += attitude.rotate(attitude.quaternion_product(q, half), np.array(part.dv_b_mps))
        q = attitude.quaternion_product(
            q, attitude.quaternion_from_rotation_vector(np.array(part.dtheta_b_rad))
        )
    compensated = np.array(body_rotation(before, now)) - np.array(now.dtheta_b_rad)
    coning = attitude.rotation_vector(q) - np.array(now.dtheta_b_rad)
    np.testing.assert_allclose(compensated, coning, rtol=2e-3, atol=1e-12)
    plain = np.array(now.dv_b_mps) + 0.5 * np.cross(now.dtheta_b_rad, now.dv_b_mps)
    np.testing.assert_allclose(
        np.array(body_velocity(before, now)) - plain, velocity - plain, rtol=2e-2, atol=3e-9
    )


# --- motions in closed form -----------------------------------------------------------------------


def test_rest_stays_at_rest_for_an_hour() -> None:
    motion = ExactMotion(line(0.6), line(-1.2), line(300.0), line(0.05), line(-0.08), line(2.5))
    one = motion.increments(np.array([0.0, 0.02]))
    hour = ImuBlock(one.origin, *(np.repeat(part, 180_000, axis=0) for part in astuple(one)[1:]))
    start, poses = motion.state(), _run(motion.state(), hour)
    assert abs(poses.lat_rad[-1] - start.lat_rad) * earth.SEMI_MAJOR_M < 1e-3
    assert abs(poses.lon_rad[-1] - start.lon_rad) * earth.SEMI_MAJOR_M < 1e-3
    assert poses.height_m[-1] == pytest.approx(300.0, abs=1e-3)
    assert np.abs(poses.v_n_mps).max() < 1e-6
    assert np.abs(attitude.attitude_error_n(poses.q_nb, start.q_nb)).max() < 1e-9


def test_a_push_swings_as_schuler_s_pendulum() -> None:
    """Level velocity error on the equator: position sin with √(R/g), zero velocity at a quarter."""
    motion = ExactMotion(line(0.0), line(0.0), line(0.0))
    radius_m = earth.meridian_radius_m(0.0)
    schuler = np.sqrt(earth.gravity_mps2(0.0, 0.0) / radius_m)
    quarter_s = np.pi / 2.0 / schuler
    edges = np.linspace(0.0, quarter_s, 20_001)
    start = motion.state()
    pushed = InsState(
        start.time, 0.0, 0.0, 0.0, np.array([0.1, 0.0, 0.0]), start.q_nb, *(np.zeros(3),) * 4
    )
    poses = _run(pushed, motion.increments(edges))
    assert poses.lat_rad[-1] * radius_m == pytest.approx(0.1 / schuler, rel=2e-3)
    assert abs(poses.v_n_mps[-1, 0]) < 2e-4


@pytest.mark.parametrize(("north", "east"), [(250.0, 0.0), (0.0, -250.0), (120.0, 90.0)])
def test_fast_over_the_ellipsoid(north: float, east: float) -> None:
    """Ten minutes along meridian, parallel and slanting: earth and transport rate, Coriolis."""
    r_m = earth.SEMI_MAJOR_M
    motion = ExactMotion(
        line(0.6, north / r_m), line(1.0, east / r_m), line(5000.0, 2.0), yaw=line(0.4)
    )
    position, velocity, phi = _errors(motion, np.arange(0.0, 600.001, 0.02))
    assert np.abs(position).max() < 1e-4
    assert np.abs(velocity).max() < 5e-7
    assert np.abs(phi).max() < 2e-10


@pytest.mark.parametrize(
    ("rate_hz", "position_m", "phi_rad"),
    [(50.0, 1e-3, 2e-7), (100.0, 1e-4, 2e-8), (200.0, 1e-5, 3e-9), (2000.0, 1e-6, 1e-10)],
)
def test_a_lively_minute(rate_hz: float, position_m: float, phi_rad: float) -> None:
    count = round(60.0 * rate_hz)
    position, _, phi = _errors(drive(), np.arange(count + 1) / rate_hz)
    assert np.abs(position).max() < position_m
    assert np.abs(phi).max() < phi_rad


def test_a_lively_minute_with_wavering_intervals() -> None:
    dt = np.random.default_rng(7).uniform(0.003, 0.012, 8000)
    position, _, phi = _errors(drive(), np.concatenate([[0.0], np.cumsum(dt)]))
    assert np.abs(position).max() < 1e-3
    assert np.abs(phi).max() < 1e-7


def test_sensor_errors_are_taken_off_first() -> None:
    motion = drive()
    edges = np.arange(0.0, 20.001, 0.01)
    block, start = motion.increments(edges), motion.state()
    rng = np.random.default_rng(8)
    bias, scale = rng.normal(size=(2, 3)) * [[1e-3], [0.1]], rng.normal(size=(2, 3)) * 1e-2
    dt = block.dt_s[:, np.newaxis]
    read = ImuBlock(
        block.origin,
        block.time_s,
        block.dt_s,
        block.dtheta_b_rad * (1.0 + scale[0]) + bias[0] * dt,
        block.dv_b_mps * (1.0 + scale[1]) + bias[1] * dt,
    )
    knowing = InsState(
        start.time,
        start.lat_rad,
        start.lon_rad,
        start.height_m,
        start.v_n_mps,
        start.q_nb,
        *(bias[0], bias[1], scale[0], scale[1]),
    )
    ideal, freed = _run(start, block), _run(knowing, read)
    for one, other in zip(ideal, freed, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-10, atol=1e-10)


# --- twin -----------------------------------------------------------------------------------------


def _twin(pose: Pose, before: Increment, now: Increment) -> Pose:
    """The same step in vectors and matrices."""
    T0, T = before.dt_s, now.dt_s
    th0, v0, th, v1 = map(
        np.array, (before.dtheta_b_rad, before.dv_b_mps, now.dtheta_b_rad, now.dv_b_mps)
    )
    share = T**2 / (6.0 * T0 * (T0 + T))
    C = attitude.rotation_matrix(np.array(pose.q_nb))
    v = np.array(pose.v_n_mps)
    lat = pose.lat_rad + v[0] * T / 2.0 / earth.SEMI_MAJOR_M
    h = pose.height_m - v[2] * T / 2.0
    g = np.array([0.0, 0.0, earth.gravity_mps2(lat, h)])
    ie = np.array(earth.earth_rate_n(lat))

    def en(v_n: FloatArray) -> FloatArray:
        return np.array(earth.transport_rate_n(lat, h, v_n[0], v_n[1]))

    def fall(v_n: FloatArray) -> FloatArray:
        return g - attitude.skew(2.0 * ie + en(v_n)) @ v_n

    th_x = attitude.skew(th)
    dv_n = C @ (
        (np.eye(3) + th_x / 2.0 + th_x @ th_x / 6.0) @ v1
        + share * (np.cross(th0, v1) + np.cross(v0, th))
    )
    middle = v + (dv_n + fall(v) * T) / 2.0
    frame = ie + en(middle)
    end = v + (np.eye(3) - attitude.skew(frame) * T / 2.0) @ dv_n + fall(middle) * T
    mean = (v + end) / 2.0
    phi = th + share * np.cross(th0, th)
    C_end = (
        attitude.rotation_matrix(attitude.quaternion_from_rotation_vector(-frame * T))
        @ C
        @ attitude.rotation_matrix(attitude.quaternion_from_rotation_vector(phi))
    )
    return Pose(
        pose.lat_rad + mean[0] * T / (earth.meridian_radius_m(lat) + h),
        pose.lon_rad + mean[1] * T / ((earth.transverse_radius_m(lat) + h) * np.cos(lat)),
        pose.height_m - mean[2] * T,
        tuple(end),
        tuple(attitude.quaternion_from_matrix(C_end)),
    )


def test_kernel_is_its_twin() -> None:
    rng = np.random.default_rng(9)
    for _ in range(20):
        q = attitude.quaternion_normalized(rng.normal(size=4))
        q *= np.sign(q[0])
        pose = Pose(
            float(rng.uniform(-1.2, 1.2)), 0.3, 100.0, tuple(rng.normal(size=3) * 30.0), tuple(q)
        )
        before, now = (
            _increment(
                float(rng.uniform(0.002, 0.02)), rng.normal(size=3) * 0.03, rng.normal(size=3)
            )
            for _ in range(2)
        )
        ours, twin = step(pose, before, now), _twin(pose, before, now)
        np.testing.assert_allclose(ours[:3], twin[:3], rtol=1e-14)
        np.testing.assert_allclose(ours.v_n_mps, twin.v_n_mps, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(
            attitude.rotation_matrix(np.array(ours.q_nb)),
            attitude.rotation_matrix(np.array(twin.q_nb)),
            atol=1e-14,
        )


def test_errors_are_subtracted_as_the_model_says() -> None:
    """Reading = (1 + scale)·true + bias."""
    errors = Calibration((0.1, 0.2, 0.3), (1.0, 2.0, 3.0), (0.01, 0.02, 0.03), (0.1, 0.2, 0.3))
    freed = without_errors(Increment(0.5, (1.06, 0.1, 0.15), (1.6, 1.0, 1.5)), errors)
    np.testing.assert_allclose(freed.dtheta_b_rad, (1.0, 0.0, 0.0), atol=1e-15)
    np.testing.assert_allclose(freed.dv_b_mps, (1.0, 0.0, 0.0), atol=1e-15)


# --- against the simulator ------------------------------------------------------------------------


def test_a_simulated_minute_by_car() -> None:
    """Its increments come from ECEF and quadrature, ours go through NED: nothing shared."""
    car = simulated_drive(60.0)
    start, end = car.state(0.0), car.state(60.0)
    poses = _run(start, car.block)
    north_m = earth.meridian_radius_m(end.lat_rad) + end.height_m
    east_m = (earth.transverse_radius_m(end.lat_rad) + end.height_m) * np.cos(end.lat_rad)
    assert abs(poses.lat_rad[-1] - end.lat_rad) * north_m < 1e-4
    assert abs(poses.lon_rad[-1] - end.lon_rad) * east_m < 1e-4
    assert abs(poses.height_m[-1] - end.height_m) < 1e-4
    np.testing.assert_allclose(poses.v_n_mps[-1], end.v_n_mps, atol=1e-6)
    assert np.abs(attitude.attitude_error_n(poses.q_nb[-1], end.q_nb)).max() < 1e-9
