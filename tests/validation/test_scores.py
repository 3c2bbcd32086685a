import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.loop.values import Pose
from carosac_toolkit.validation.scores import (
    normalised_pose_squares,
    rotation_angle,
    score_lengths,
    score_poses,
)


def test_scores_of_known_errors():
    scores = score_poses(np.array([[3.0, 0.0, 4.0], [-1.0, 0.0, 0.0]]), np.array([0.1, 0.2]))
    assert scores.rmse == pytest.approx([np.sqrt(5), 0.0, np.sqrt(8), np.sqrt(13)])
    assert scores.mae == pytest.approx([2.0, 0.0, 2.0, 3.0])
    assert scores.max == pytest.approx([3.0, 0.0, 4.0, 5.0])
    assert scores.bias == pytest.approx([1.0, 0.0, 2.0])
    assert scores.orientation_rmse == pytest.approx(np.sqrt(0.025))
    assert scores.orientation_max == pytest.approx(0.2)


def test_no_sample_scores_nothing():
    scores = score_poses(np.zeros((0, 3)), np.zeros(0))
    assert scores.samples == 0 and np.isnan(scores.rmse).all()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi])
def test_angles_between_rotations(angle):
    turn = Rotation.from_rotvec([0.4, -0.3, 0.2])
    axis = np.array([0.6, 0.0, 0.8])
    other = turn * Rotation.from_rotvec(angle * axis)
    found = rotation_angle(turn.as_matrix()[None], other.as_matrix()[None])
    assert found == pytest.approx([angle], rel=1e-6, abs=1e-15)


def test_lengths_without_a_prediction_do_not_count():
    error = np.array([[1.0, np.nan], [3.0, np.nan], [np.nan, np.nan]])
    scores = score_lengths(error)
    assert scores.rmse == pytest.approx(np.sqrt(5))
    assert scores.bias[0] == pytest.approx(2.0) and np.isnan(scores.bias[1])
    assert scores.std[0] == pytest.approx(1.0)
    assert scores.samples.tolist() == [2, 0]
    assert np.isnan(score_lengths(np.full((2, 2), np.nan)).rmse)


def test_errors_as_large_as_claimed_have_squares_of_one():
    """Errors drawn from a covariance in W, and seen with noisy poses, are as it says."""
    rng = np.random.default_rng(0)
    count, noise = 4000, (2e-3, 1e-3)
    root = 1e-3 * rng.normal(size=(6, 6)) + 2e-3 * np.eye(6)
    draw = rng.normal(size=(count, 6)) @ root.T
    seen = draw + rng.normal(size=(count, 6)) * np.repeat(noise, 3)
    turn = Rotation.random(count, rng=rng)
    place = rng.normal(size=(count, 3))
    model = Pose(position=place, rotation=turn.as_matrix())
    measured = Pose(
        position=place + seen[:, :3],
        rotation=(Rotation.from_rotvec(seen[:, 3:]) * turn).as_matrix(),
    )
    claimed = np.tile(root @ root.T, (count, 1, 1))
    squares = normalised_pose_squares(measured, model, claimed, noise)
    assert squares.mean() == pytest.approx(1.0, abs=0.05)
    assert normalised_pose_squares(measured, model, 4.0 * claimed, noise).mean() < 0.6
