"""Attitude: quaternions (scalar first, Hamilton), matrices, Euler angles, rotation vectors.

A quaternion q_nb turns body axes into NED, v_n = C_nb @ v_b; roll, pitch and yaw are the Z-Y-X
angles from NED to body. Every formula of quaternions stands once, over components: compiled
(`product`, `rotated`, …: tuples of numbers in and out, nothing allocated) for kernels, and under a
longer name over arrays whose last axis holds the components.

Attitude errors follow the phi-angle convention: C_nb_estimated = (I − [φ×]) C_nb_true, φ in NED.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepgnss.core.jit import kernel
from deepgnss.core.records import FloatArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# --- formulas over components: numbers, or arrays of them ----------------------------------------


def _product(p: Any, q: Any) -> Any:
    """Hamilton product p ⊗ q: first q, then p (q_nc = q_nb ⊗ q_bc)."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def _normalized(q: Any) -> Any:
    """Quaternion of unit length."""
    scale = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale)


def _conjugate(q: Any) -> Any:
    """Inverse of a unit quaternion: q_bn of q_nb."""
    return (q[0], -q[1], -q[2], -q[3])


def _rotated(q: Any, v: Any) -> Any:
    """Vector turned by a unit quaternion: v_n of q_nb and v_b."""
    x = 2.0 * (q[2] * v[2] - q[3] * v[1])
    y = 2.0 * (q[3] * v[0] - q[1] * v[2])
    z = 2.0 * (q[1] * v[1] - q[2] * v[0])
    return (
        v[0] + q[0] * x + q[2] * z - q[3] * y,
        v[1] + q[0] * y + q[3] * x - q[1] * z,
        v[2] + q[0] * z + q[1] * y - q[2] * x,
    )


def _matrix(q: Any) -> Any:
    """Rotation matrix of a unit quaternion, by rows."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def _from_rotation_vector(phi: Any) -> Any:
    """Unit quaternion of the rotation by |phi| rad about phi."""
    angle = np.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    scale = 0.5 * np.sinc(angle / (2.0 * np.pi))  # sin(angle/2)/angle, also at zero
    return (np.cos(0.5 * angle), phi[0] * scale, phi[1] * scale, phi[2] * scale)


def _to_rotation_vector(q: Any) -> Any:
    """Rotation vector of a unit quaternion, at most π long."""
    length = np.maximum(np.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), 1e-300)
    scale = np.copysign(2.0, q[0]) * np.arctan2(length, np.abs(q[0])) / length
    return (q[1] * scale, q[2] * scale, q[3] * scale)


# --- for kernels: tuples of numbers ---------------------------------------------------------------

product = kernel(_product)
normalized = kernel(_normalized)
conjugate = kernel(_conjugate)
rotated = kernel(_rotated)
matrix = kernel(_matrix)
from_rotation_vector = kernel(_from_rotation_vector)
to_rotation_vector = kernel(_to_rotation_vector)


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product a × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def _error_n(q_nb_estimated: FloatArray, q_nb_true: FloatArray) -> FloatArray:
    """As `attitude_error_n`, of one attitude (4,)."""
    e, t = q_nb_estimated, q_nb_true
    turn = product((t[0], t[1], t[2], t[3]), conjugate((e[0], e[1], e[2], e[3])))
    return np.array(to_rotation_vector(turn))


@kernel
def _corrected(q_nb_estimated: FloatArray, phi_n_rad: FloatArray) -> FloatArray:
    """As `attitude_corrected`, of one attitude (4,)."""
    e, phi = q_nb_estimated, phi_n_rad
    back = from_rotation_vector((phi[0], phi[1], phi[2]))
    return np.array(normalized(product(back, (e[0], e[1], e[2], e[3]))))


@kernel
def _euler_rad(q_nb: FloatArray) -> FloatArray:
    """As `euler_rad`, of one attitude (4,)."""
    C = matrix((q_nb[0], q_nb[1], q_nb[2], q_nb[3]))
    level = np.hypot(C[2][1], C[2][2])
    pitch = np.arctan2(-C[2][0], level)
    if level > 1e-9:
        return np.array([np.arctan2(C[2][1], C[2][2]), pitch, np.arctan2(C[1][0], C[0][0])])
    return np.array([0.0, pitch, np.arctan2(-C[0][1], C[1][1])])


# --- over arrays: components on the last axis -----------------------------------------------------


def _parts(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    return values.transpose((values.ndim - 1, *range(values.ndim - 1)))


def _joined(parts: Sequence[FloatArray]) -> FloatArray:
    joined = np.empty((*np.broadcast(*parts).shape, len(parts)))
    for k, part in enumerate(parts):  # np.stack of broadcast arrays takes four times as long
        joined[..., k] = part
    return joined


def quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton product (..., 4): q_nc = q_nb ⊗ q_bc."""
    return _joined(_product(_parts(p), _parts(q)))


def quaternion_normalized(q: FloatArray) -> FloatArray:
    """Quaternions (..., 4) of unit length."""
    return _joined(_normalized(_parts(q)))


def quaternion_conjugate(q: FloatArray) -> FloatArray:
    """Inverse rotations (..., 4): q_bn of q_nb."""
    return _joined(_conjugate(_parts(q)))


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (..., 3) turned by unit quaternions (..., 4): v_n of q_nb and v_b."""
    return _joined(_rotated(_parts(q), _parts(v)))


def rotation_matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4): C_nb of q_nb."""
    if q.ndim == 1:
        return np.array(_matrix(q.tolist()))
    return np.stack([_joined(row) for row in _matrix(_parts(q))], axis=-2)


def quaternion_from_rotation_vector(phi_rad: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3)."""
    return _joined(_from_rotation_vector(_parts(phi_rad)))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), rad, at most π long, of unit quaternions (..., 4)."""
    return _joined(_to_rotation_vector(_parts(q)))


def quaternion_from_matrix(C: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4), scalar part not negative, of rotation matrices (..., 3, 3).

    All products 4·q_i·q_j are sums of elements; the row of the largest square loses no digits.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(np.asarray(C), (-2, -1), (0, 1))
    products = np.stack(
        [
            _joined([1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy]),
            _joined([zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx]),
            _joined([xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy]),
            _joined([yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz]),
        ],
        axis=-2,
    )
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    rows = np.take_along_axis(products, largest[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :]
    return quaternion_normalized(rows * np.copysign(1.0, rows[..., :1]))


def quaternion_from_euler(euler_rad: FloatArray) -> FloatArray:
    """q_nb (..., 4) of roll, pitch, yaw (..., 3)."""
    roll, pitch, yaw = _parts(euler_rad)
    (cr, cp, cy), (sr, sp, sy) = (
        [function(0.5 * angle) for angle in (roll, pitch, yaw)] for function in (np.cos, np.sin)
    )
    return _joined(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def matrix_from_euler(euler_rad: FloatArray) -> FloatArray:
    """C_nb (..., 3, 3) of roll, pitch, yaw (..., 3)."""
    (cr, cp, cy), (sr, sp, sy) = (function(_parts(euler_rad)) for function in (np.cos, np.sin))
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def euler_rad(q_nb: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (..., 3) of q_nb (..., 4): ±π, ±π/2, ±π; roll is 0 where pitch is ±π/2."""
    if q_nb.ndim == 1:
        return _euler_rad(q_nb)
    C = rotation_matrix(q_nb)
    level = np.hypot(C[..., 2, 1], C[..., 2, 2])
    upright = level > 1e-9  # else only yaw ∓ roll is known
    roll = np.where(upright, np.arctan2(C[..., 2, 1], C[..., 2, 2]), 0.0)
    yaw = np.where(
        upright,
        np.arctan2(C[..., 1, 0], C[..., 0, 0]),
        np.arctan2(-C[..., 0, 1], C[..., 1, 1]),
    )
    return _joined([roll, np.arctan2(-C[..., 2, 0], level), yaw])


def skew(v: FloatArray) -> FloatArray:
    """Matrices [v×] (..., 3, 3) of vectors (..., 3): skew(a) @ b = a × b."""
    x, y, z = _parts(v)
    matrices = np.zeros((*x.shape, 3, 3))
    matrices[..., 0, 1], matrices[..., 0, 2] = -z, y
    matrices[..., 1, 0], matrices[..., 1, 2] = z, -x
    matrices[..., 2, 0], matrices[..., 2, 1] = -y, x
    return matrices


def slerp(q0: FloatArray, q1: FloatArray, fraction: FloatArray) -> FloatArray:
    """Quaternions (..., 4) on the shorter way from q0 to q1, fraction (...) in [0, 1]."""
    turn = rotation_vector(quaternion_product(quaternion_conjugate(q0), q1))
    step = turn * np.asarray(fraction)[..., np.newaxis]
    return quaternion_product(q0, quaternion_from_rotation_vector(step))


def attitude_error_n(q_nb_estimated: FloatArray, q_nb_true: FloatArray) -> FloatArray:
    """Attitude errors φ in NED (..., 3): C_nb_estimated = (I − [φ×]) C_nb_true."""
    if q_nb_estimated.ndim == q_nb_true.ndim == 1:
        return _error_n(q_nb_estimated, q_nb_true)
    return rotation_vector(quaternion_product(q_nb_true, quaternion_conjugate(q_nb_estimated)))


def attitude_corrected(q_nb_estimated: FloatArray, phi_n_rad: FloatArray) -> FloatArray:
    """Attitudes (..., 4) freed of their error φ in NED (..., 3)."""
    if q_nb_estimated.ndim == phi_n_rad.ndim == 1:
        return _corrected(q_nb_estimated, phi_n_rad)
    correction = quaternion_from_rotation_vector(phi_n_rad)
    return quaternion_normalized(quaternion_product(correction, q_nb_estimated))
