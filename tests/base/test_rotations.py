from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base import rotations as quaternions
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples


def rotations(count: int = 500) -> Rotation:
    """Random rotations, and half turns about each axis, where one formula would cancel."""
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    return Rotation.concatenate([Rotation.random(count, rng=0), half_turns, Rotation.identity(1)])


def test_matrices_agree_with_scipy():
    rotation = rotations()
    quaternion = np.roll(rotation.as_quat(), 1, axis=1)  # scipy's order is x y z w
    np.testing.assert_allclose(quaternions.to_matrix(quaternion), rotation.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(
        quaternions.to_matrix(3.0 * quaternion), rotation.as_matrix(), atol=1e-15
    )


def test_quaternions_come_back_from_matrices():
    matrix = rotations().as_matrix()
    quaternion = quaternions.from_matrix(matrix)
    assert (quaternion[:, 0] >= 0).all()
    np.testing.assert_allclose(quaternions.to_matrix(quaternion), matrix, atol=3e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_rotation_vectors_turn_as_scipy_says(angle):
    vector = angle * np.array([0.6, -0.64, 0.48])
    wanted = Rotation.from_rotvec(vector).as_matrix()
    assert quaternions.from_rotation_vector(vector) == pytest.approx(wanted, abs=1e-15)


def test_slerp_turns_at_a_constant_rate_the_shorter_way():
    start, end = rotations(100)[:50], rotations(100)[50:100]
    q0, q1 = (np.roll(r.as_quat(), 1, axis=1) for r in (start, end))
    step = (start.inv() * end).as_rotvec()
    for fraction in (0.0, 0.3, 1.0):
        wanted = (start * Rotation.from_rotvec(fraction * step)).as_matrix()
        for sign in (1.0, -1.0):
            mixed = quaternions.slerp(q0, sign * q1, np.full(50, fraction))
            np.testing.assert_allclose(quaternions.to_matrix(mixed), wanted, atol=1e-14)


def test_slerp_of_tiny_and_of_no_angles_is_finite():
    q0 = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    q1 = np.array([[1.0, 1e-9, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    mixed = quaternions.slerp(q0, q1, np.array([0.25, 0.5]))
    np.testing.assert_allclose(mixed[:, 1], [2.5e-10, 0.0], rtol=1e-9)


def test_samples_without_unit_quaternion_are_refused():
    quaternion = np.array([[1.0, 0, 0, 0], [0.0, 0, 0, 0]])
    with pytest.raises(InvalidField, match=r"poses.quaternion\[1\]: got norm 0; allowed: a norm"):
        PoseSamples(time=np.arange(2.0), position=np.zeros((2, 3)), quaternion=quaternion)


def test_a_matrix_that_is_no_rotation_is_refused():
    mirror = np.diag([1.0, 1.0, -1.0])
    with pytest.raises(InvalidField, match=r"poses.rotation\[1\].*allowed: R R\^T = 1, det \+1"):
        PoseSamples.from_rotation([0.0, 1.0], np.zeros((2, 3)), [np.eye(3), mirror])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"length_kind": "stretched"}, r"metadata.length_kind: got 'stretched'; allowed: one of"),
        ({"quaternion_order": "xyzw"}, r"metadata.quaternion_order: got 'xyzw'; allowed: 'wxyz'"),
        ({"source": 3}, r"metadata.source: got 3; allowed: text"),
        ({"sorce": "x"}, r"metadata.sorce: got an unknown key; .* did you mean 'source'"),
    ],
)
def test_metadata_faults(fields, message):
    with pytest.raises(InvalidField, match=message):
        RecordingMetadata.from_dict(fields)


def test_metadata_round_trip():
    metadata = RecordingMetadata(robot="scampi", citation="someone")
    assert RecordingMetadata.from_dict(metadata.to_dict()) == metadata


def test_the_left_jacobian_is_the_derivative_of_the_rotation():
    rng = np.random.default_rng(0)
    for vector in (np.zeros(3), 1e-4 * rng.normal(size=3), rng.normal(size=3)):
        jacobian = quaternions.left_jacobian(vector)
        back = quaternions.from_rotation_vector(vector).T
        for k in range(3):
            away = 1e-6 * np.eye(3)[k]
            ends = [quaternions.from_rotation_vector(vector + sign * away) for sign in (1, -1)]
            change = (ends[0] - ends[1]) @ back / 2e-6
            assert quaternions.cross_matrix(jacobian[:, k]) == pytest.approx(change, abs=1e-8)
    both = quaternions.left_jacobian(np.array([vector, 2 * vector]))
    assert both[0] == pytest.approx(jacobian, abs=1e-15)


def test_the_best_rotation_turns_points_as_scipy_does():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6, 3))
    turn = Rotation.from_rotvec([0.4, -1.2, 2.0])
    towards = turn.apply(points) + rng.normal(0.0, 0.05, (6, 3))
    expected, _ = Rotation.align_vectors(towards, points)
    np.testing.assert_allclose(
        quaternions.best_rotation(points, towards), expected.as_matrix(), atol=1e-12
    )
    flat = points * [1.0, 1.0, -1.0]
    mirrored = quaternions.best_rotation(flat, points, mirror=True)
    np.testing.assert_allclose(mirrored, np.diag([1.0, 1.0, -1.0]), atol=1e-12)
    assert np.linalg.det(quaternions.best_rotation(flat, points)) == pytest.approx(1.0)
