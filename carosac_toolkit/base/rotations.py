"""Unit quaternions, order w x y z, as arrays of shape (B, 4); angles, and cross products."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array

SMALL_ANGLE_RAD = 1e-2  # below which a series is more exact than the formula


def to_matrix(quaternion: Array) -> Array:
    """Return the rotation matrices (B, 3, 3) of quaternions (B, 4), which are normalised first."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def from_matrix(rotation: Array) -> Array:
    """Return the quaternions (B, 4), w >= 0, of rotation matrices (B, 3, 3).

    Each row of the symmetric matrix 4 q q^T follows from sums and differences of the entries of
    R; the row with the largest diagonal is the one without cancellation.
    """
    r = rotation
    trace = np.trace(r, axis1=1, axis2=2)
    outer = np.empty((len(r), 4, 4))
    outer[:, 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[:, i + 1, i + 1] = 1 + 2 * r[:, i, i] - trace
        outer[:, 0, i + 1] = outer[:, i + 1, 0] = r[:, k, j] - r[:, j, k]
        outer[:, j + 1, k + 1] = outer[:, k + 1, j + 1] = r[:, j, k] + r[:, k, j]
    largest = np.argmax(np.einsum("bii->bi", outer), axis=1)
    quaternion = outer[np.arange(len(r)), largest]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.asarray(np.where(quaternion[:, :1] < 0, -quaternion, quaternion))


def from_rotation_vector(vector: Array) -> Array:
    """Return the matrices (..., 3, 3) of rotation vectors (..., 3) [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    half = np.sinc(0.5 * angle / np.pi)  # sin(x) / x of half the angle
    turn = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross
    return np.asarray(turn)


def best_rotation(points: Array, towards: Array, *, mirror: bool = False) -> Array:
    """Return the rotation R about the origin that brings points closest to others, shape (3, 3).

    Args:
        points: p, shape (N, 3); R p is close to t in least squares.
        towards: t, shape (N, 3).
        mirror: True for the best matrix with determinant -1 instead, a rotation with a reflection.

    References:
        Kabsch, *A solution for the best rotation to relate two sets of vectors*, Acta
        Crystallographica A, 1976.
    """
    left, _, right = np.linalg.svd(towards.T @ points)
    side = np.linalg.det(left @ right) * (-1.0 if mirror else 1.0)
    return np.asarray(left @ np.diag([1.0, 1.0, side]) @ right)


def roll_and_pitch(rotation: Array) -> Array:
    """Return roll and pitch [rad] of R = R_z(yaw) R_y(pitch) R_x(roll), shape (B, 2)."""
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    pitch = -np.arcsin(np.clip(rotation[:, 2, 0], -1.0, 1.0))
    return np.stack([roll, pitch], axis=1)


def vertical(roll_pitch: Array) -> Array:
    """Return the vertical in a frame of roll and pitch (B, 2) [rad] against a level one, (B, 3)."""
    roll, pitch = roll_pitch.T
    up = [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    return np.column_stack(up)


def wrapped_angle(angle: Array) -> Array:
    """Return angles [rad] within a half turn about 0."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def left_jacobian(vector: Array) -> Array:
    r"""Return the angular change in W per change of rotation vectors (..., 3), (..., 3, 3).

    With the matrix of the cross product :math:`[v]` and the angle :math:`a = |v|`,

    .. math:: J = I + \frac{1 - \cos a}{a^2} [v] + \frac{a - \sin a}{a^3} [v]^2.
    """
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    first = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    small = angle < SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def slerp(start: Array, end: Array, fraction: Array) -> Array:
    """Interpolate along the shorter great arc.

    Args:
        start: Quaternions at fraction 0, shape (B, 4).
        end: Quaternions at fraction 1, shape (B, 4).
        fraction: Between 0 and 1, shape (B,).

    Returns:
        Unit quaternions, shape (B, 4).
    """
    start = start / np.linalg.norm(start, axis=1, keepdims=True)
    end = end / np.linalg.norm(end, axis=1, keepdims=True)
    end = np.where(np.sum(start * end, axis=1, keepdims=True) < 0, -end, end)
    # half the distance of the end points is exact for small angles, where arccos is not
    angle = 2 * np.arcsin(np.clip(np.linalg.norm(end - start, axis=1) / 2, 0.0, 1.0))
    # sin(f a) / sin(a), which tends to f as a tends to 0
    ratio = np.sinc(angle / np.pi)
    weight_end = fraction * np.sinc(fraction * angle / np.pi) / ratio
    rest = 1.0 - fraction
    weight_start = rest * np.sinc(rest * angle / np.pi) / ratio
    mixed = weight_start[:, None] * start + weight_end[:, None] * end
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def cross_matrix(vector: Array) -> Array:
    """Return the matrices of the cross product with vectors (..., 3), shape (..., 3, 3)."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix
