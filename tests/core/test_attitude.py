"""Attitude: quaternions against matrices, Euler angles by hand, signs of the phi-angle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deepgnss.core import attitude
from deepgnss.core.records import FloatArray

pytestmark = pytest.mark.kernel

_number = st.floats(-1.0, 1.0)
_vector = st.tuples(_number, _number, _number)


def _random(count: int, seed: int = 1) -> FloatArray:
    return attitude.quaternion_normalized(np.random.default_rng(seed).normal(size=(count, 4)))


def _scipy(q: FloatArray) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def test_matrix_is_scipy_s() -> None:
    q = _random(50)
    np.testing.assert_allclose(attitude.rotation_matrix(q), _scipy(q).as_matrix(), atol=1e-14)


def test_product_rotates_second_factor_first() -> None:
    p, q = _random(20, 1), _random(20, 2)
    C = attitude.rotation_matrix(attitude.quaternion_product(p, q))
    np.testing.assert_allclose(
        C, attitude.rotation_matrix(p) @ attitude.rotation_matrix(q), atol=1e-14
    )


def test_rotating_is_the_matrix_times_the_vector() -> None:
    q, v = _random(20), np.random.default_rng(3).normal(size=(20, 3))
    C = attitude.rotation_matrix(q)
    np.testing.assert_allclose(attitude.rotate(q, v), np.einsum("kij,kj->ki", C, v), atol=1e-14)
    back = attitude.rotate(attitude.quaternion_conjugate(q), attitude.rotate(q, v))
    np.testing.assert_allclose(back, v, atol=1e-14)


def test_euler_angles_by_hand() -> None:
    """Yaw 90°: forward is east. Pitch up: forward has an upward part. Roll right: right is down."""
    angles = np.radians([[0.0, 0.0, 90.0], [0.0, 30.0, 0.0], [90.0, 0.0, 0.0]])
    q = attitude.quaternion_from_euler(angles)
    forward, right = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(attitude.rotate(q[0], forward), [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        attitude.rotate(q[1], forward), [np.sqrt(0.75), 0.0, -0.5], atol=1e-15
    )
    np.testing.assert_allclose(attitude.rotate(q[2], right), [0.0, 0.0, 1.0], atol=1e-15)


def test_euler_angles_are_scipy_s_and_come_back() -> None:
    rng = np.random.default_rng(4)
    angles = rng.uniform(-1.0, 1.0, (100, 3)) * np.array([3.1, 1.55, 3.1])
    q = attitude.quaternion_from_euler(angles)
    np.testing.assert_allclose(attitude.euler_rad(q), angles, atol=1e-12)
    np.testing.assert_allclose(_scipy(q).as_euler("ZYX"), angles[:, ::-1], atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_straight_up_and_down_keep_the_rotation(sign: float) -> None:
    q = attitude.quaternion_from_euler(np.array([0.4, sign * np.pi / 2.0, 1.1]))
    angles = attitude.euler_rad(q)
    assert angles[0] == 0.0
    again = attitude.quaternion_from_euler(angles)
    np.testing.assert_allclose(
        attitude.rotation_matrix(again), attitude.rotation_matrix(q), atol=1e-8
    )


def test_from_matrix_for_every_largest_part() -> None:
    q = np.concatenate([_random(100), np.eye(4), -np.eye(4)])
    again = attitude.quaternion_from_matrix(attitude.rotation_matrix(q))
    assert np.all(again[:, 0] >= 0.0)
    np.testing.assert_allclose(np.abs(np.sum(q * again, axis=-1)), 1.0, atol=1e-14)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(direction=_vector, exponent=st.integers(-12, 0))
def test_rotation_vector_and_back_at_every_size(
    direction: tuple[float, float, float], exponent: int
) -> None:
    phi = 1.8 * np.array(direction) * 10.0**exponent
    q = attitude.quaternion_from_rotation_vector(phi)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)
    for signed in (q, -q):
        np.testing.assert_allclose(
            attitude.rotation_vector(signed), phi, rtol=1e-14, atol=1e-16 * 10.0**exponent
        )
    np.testing.assert_allclose(
        attitude.rotation_matrix(q), Rotation.from_rotvec(phi).as_matrix(), atol=1e-15
    )


def test_phi_angle_s_sign() -> None:
    """C_estimated = (I − [φ×]) C_true to first order, and taken back exactly."""
    truth = _random(10)
    phi = np.random.default_rng(5).normal(size=(10, 3)) * 1e-5
    estimated = attitude.quaternion_from_matrix(
        (np.eye(3) - attitude.skew(phi)) @ attitude.rotation_matrix(truth)
    )
    np.testing.assert_allclose(attitude.attitude_error_n(estimated, truth), phi, atol=1e-9)
    corrected = attitude.attitude_corrected(estimated, attitude.attitude_error_n(estimated, truth))
    np.testing.assert_allclose(np.abs(np.sum(corrected * truth, axis=-1)), 1.0, atol=1e-15)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(6).normal(size=(2, 7, 3))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", attitude.skew(a), b), np.cross(a, b))
    np.testing.assert_allclose(attitude.cross(tuple(a[0]), tuple(b[0])), np.cross(a[0], b[0]))


def test_slerp_turns_evenly_the_short_way() -> None:
    phi = np.array([0.3, -0.4, 0.5])
    q0 = _random(1)[0]
    q1 = attitude.quaternion_product(q0, attitude.quaternion_from_rotation_vector(phi))
    fractions = np.array([0.0, 0.25, 1.0])
    for end in (q1, -q1):
        between = attitude.slerp(q0, end, fractions)
        turned = attitude.rotation_vector(
            attitude.quaternion_product(attitude.quaternion_conjugate(q0), between)
        )
        np.testing.assert_allclose(turned, np.outer(fractions, phi), atol=1e-15)


def test_kernels_are_the_array_forms() -> None:
    p, q = _random(2)
    v = np.array([0.3, -1.2, 2.0])
    np.testing.assert_allclose(
        attitude.product(tuple(p), tuple(q)), attitude.quaternion_product(p, q), rtol=1e-15
    )
    np.testing.assert_allclose(attitude.rotated(tuple(q), tuple(v)), attitude.rotate(q, v))
    np.testing.assert_allclose(attitude.matrix(tuple(q)), attitude.rotation_matrix(q))
    np.testing.assert_allclose(
        attitude.from_rotation_vector(tuple(v)), attitude.quaternion_from_rotation_vector(v)
    )
    np.testing.assert_allclose(
        attitude.to_rotation_vector(tuple(q)), attitude.rotation_vector(q), rtol=1e-14
    )
    assert attitude.from_rotation_vector((0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)
