"""Errors of poses, and which poses are looked at."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.identification.measured_poses import MeasuredPoses, poses_of, rotation_vectors
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording


def some_poses(count: int = 11, period: float = 0.1) -> MeasuredPoses:
    rng = np.random.default_rng(0)
    return MeasuredPoses(
        index=np.arange(count),
        time=period * np.arange(count),
        position=rng.standard_normal((count, 3)),
        rotation=Rotation.from_rotvec(rng.standard_normal((count, 3))).as_matrix(),
    )


def test_rotation_vectors_are_those_of_scipy_and_exact_for_small_angles():
    vectors = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 3))  # below half a turn
    assert rotation_vectors(Rotation.from_rotvec(vectors).as_matrix()) == pytest.approx(vectors)
    tiny = 1e-8 * vectors
    assert rotation_vectors(Rotation.from_rotvec(tiny).as_matrix()) == pytest.approx(tiny, rel=1e-6)
    assert rotation_vectors(np.eye(3)[None]) == pytest.approx(np.zeros((1, 3)))


def test_errors_are_model_minus_measured_with_rotations_in_the_platform_frame():
    poses = some_poses()
    turn = np.array([0.02, -0.03, 0.01])
    moved = poses.position + np.array([1e-3, -2e-3, 3e-3])
    turned = poses.rotation @ Rotation.from_rotvec(turn).as_matrix()
    errors = poses.errors(moved, turned)
    assert errors == pytest.approx(np.tile([1e-3, -2e-3, 3e-3, *turn], (11, 1)))


def test_thinning_keeps_the_first_and_no_more_than_the_rate():
    assert some_poses(11, 0.1).thinned(5.0).index.tolist() == [0, 2, 4, 6, 8, 10]
    assert some_poses(11, 0.1).thinned(100.0).index.tolist() == list(range(11))


def test_poses_without_a_measurement_nearby_are_left_out():
    time = np.arange(10.0)
    kept = time[:4]
    recording = Recording(
        time=time,
        unstrained_length=np.ones((10, 4)),
        poses=PoseSamples(
            time=np.repeat(kept, 2) + np.tile([-0.1, 0.1], 4),
            position=np.zeros((8, 3)),
            quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (8, 1)),
        ),
    )
    assert poses_of(recording).index.tolist() == [0, 1, 2, 3]


def test_errors_are_the_same_in_another_world_frame():
    poses, other = some_poses(), some_poses().rows(np.arange(10, -1, -1))
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    errors = poses.errors(other.position, other.rotation)
    turned = poses.turned(turn).errors(other.position @ turn.T, turn @ other.rotation)
    assert turned[:, :3] == pytest.approx(errors[:, :3] @ turn.T)
    assert turned[:, 3:] == pytest.approx(errors[:, 3:])  # in the frame of the platform
