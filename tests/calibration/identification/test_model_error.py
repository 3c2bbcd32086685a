"""Sizes of what a model misses, from residuals that were drawn with known ones."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.identification.model_error import FIELDS, Residuals, find_model_error
from carosac_toolkit.robot.model_error import ModelError
from tests.validation.runs import ROBOT, perfect


@pytest.fixture(scope="module")
def nothing():
    """A run without any error."""
    recording = perfect()
    poses = recording.poses
    errors = np.zeros((len(poses.time), 6))
    return Residuals.of(ROBOT, recording, poses.time, errors, poses.rotation)


def drawn(nothing: Residuals, error: ModelError, seed: int) -> Residuals:
    """The run with errors of these sizes, independent from pose to pose."""
    ratio = np.array([getattr(error, f) / getattr(nothing.growth.usual, f) for f in FIELDS])
    claimed = nothing.growth.always + np.einsum("j,jkab->kab", ratio**2, nothing.parts())
    white = np.random.default_rng(seed).normal(size=(len(claimed), 6))
    in_world = np.einsum("kab,kb->ka", np.linalg.cholesky(claimed), white)
    turned = np.einsum("kji,kj->ki", nothing.rotation, in_world[:, 3:])
    return replace(nothing, errors=np.hstack([in_world[:, :3], turned]))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    "error",
    [
        ModelError(
            mass=0.02, length=4e-3, force=0.3, acceleration=1e-3, position=1.5e-3, rotation=3e-3
        ),
        ModelError(
            mass=0.02, length=1e-3, force=3.0, acceleration=1e-2, position=3e-4, rotation=2e-4
        ),
    ],
)
def test_sizes_are_found_and_hold_for_other_draws(nothing, error, seed):
    found = find_model_error([drawn(nothing, error, seed), drawn(nothing, error, seed + 10)])
    others = drawn(nothing, error, seed + 20)
    assert others.nees(found) == pytest.approx(1.0, abs=0.15)
    assert others.nees(nothing.growth.usual) != pytest.approx(1.0, abs=0.3)
    assert found.force == pytest.approx(error.force, rel=0.3)


def test_poses_that_are_off_alone_blame_the_poses(nothing):
    error = ModelError(
        mass=0.0, length=0.0, force=0.0, acceleration=0.0, position=8e-3, rotation=9e-3
    )
    found = find_model_error([drawn(nothing, error, 3)])
    assert (found.position, found.rotation) == pytest.approx((8e-3, 9e-3), rel=0.1)
    assert found.force < 0.2 * nothing.growth.usual.force


def test_errors_turn_with_the_platform(nothing):
    """Residuals of rotations are in the axes of the platform, covariances in W."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    errors = np.zeros_like(nothing.errors)
    errors[:, 3] = 1e-2
    turned = replace(nothing, errors=errors, rotation=np.tile(turn, (len(errors), 1, 1)))
    assert turned.in_world[:, 3:] == pytest.approx(np.tile([0.0, 1e-2, 0.0], (len(errors), 1)))
