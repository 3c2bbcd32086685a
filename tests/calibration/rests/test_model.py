from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration import RestSettings
from calibration.rest_readings import RestReadings
from calibration.rests.model import RestModel
from calibration.rests.unknowns import find_unknowns
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import roll_and_pitch
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from tests.calibration.rests.scenes import surveyed_robot


@pytest.fixture(scope="module")
def exact():
    """Model of exact readings, with the parameters, lengths and equilibria that they are of."""
    robot = surveyed_robot()
    rest = statics.inverse_kinematics(robot, [[0.3, -1.8, 2.2], [0.6, -3.0, 3.0]])
    assert rest.converged.all()
    mounting, heading = Rotation.from_rotvec([0.03, -0.02, 0.01]), Rotation.from_rotvec([0, 0, 1.0])
    read = RestReadings(
        time=np.arange(2.0), length=rest.unstrained_length - 5.0, tension=1.1 * rest.tension + 0.5,
        attitude=(heading * Rotation.from_matrix(rest.rotation) * mounting).as_matrix(),
        swivel_angle=swivel_angle(robot, -rest.exit_tension), skipped={},
    )  # fmt: skip
    settings = RestSettings()
    unknowns = find_unknowns(robot, read, settings, relative=True)
    value = unknowns.prior.mean.copy()
    for prefix, true in (
        ("length_offset", -5.0), ("tension_scale", 0.1), ("tension_offset", 0.5),
        ("mounting", [0.03, -0.02, 0.01]), ("heading", 1.0),
    ):  # fmt: skip
        value[unknowns.prior.rows(prefix)] = true
    return RestModel(unknowns, read, settings), value, rest


def test_true_parameters_leave_no_residual(exact):
    model, value, rest = exact
    residual = model.residual(value, rest.unstrained_length, rest)
    assert residual.shape == (2, 4 + 4 + 3 + 4)
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)


def test_derivatives_predict_a_step_of_everything(exact):
    model, value, rest = exact
    rng = np.random.default_rng(0)
    small = 1e-4 * rng.standard_normal(len(value))
    shorter = 1e-4 * rng.standard_normal((2, 4))
    linear = model.linear(value, rest.unstrained_length, rest)
    moved_length = rest.unstrained_length + shorter
    moved = model.equilibria(value + small, moved_length, rest)
    change = model.residual(value + small, moved_length, moved) - linear.residual
    predicted = linear.by_shared @ small + np.einsum("kmn,kn->km", linear.by_own, shorter)
    np.testing.assert_allclose(predicted, change, atol=2e-3 * np.abs(change).max())
    by_length, by_shared = model.pose_derivatives(value, rest.unstrained_length, rest)
    pose = by_shared @ small + np.einsum("kmn,kn->km", by_length, shorter)
    np.testing.assert_allclose(pose[:, :3], moved.position - rest.position, atol=2e-6)
    turn = Rotation.from_matrix(moved.rotation @ rest.rotation.swapaxes(1, 2)).as_rotvec()
    np.testing.assert_allclose(pose[:, 3:], turn, atol=2e-6)


def test_roll_and_pitch_do_not_depend_on_the_heading():
    for yaw in (-2.0, 0.0, 1.0):
        turn = Rotation.from_euler("ZYX", [yaw, 0.3, -0.2]).as_matrix()[None]
        np.testing.assert_allclose(roll_and_pitch(turn), [[-0.2, 0.3]], atol=1e-12)


def test_geometry_without_covariance_is_held():
    robot = surveyed_robot()
    read = RestReadings(time=np.zeros(1), length=np.zeros((1, 4)), skipped={})
    names = find_unknowns(robot, read, RestSettings(), relative=True).robot_names
    assert sorted({name.split("[")[0] for name in names}) == ["exit_points", "length_offset"]


@pytest.mark.parametrize("name", ["length_noise", "offset_prior", "swivel_noise"])
def test_noise_and_the_prior_of_the_zeros_are_positive(name):
    with pytest.raises(InvalidField, match=f"{name}: got 0.0; allowed: {name} > 0"):
        RestSettings(**{name: 0.0})


def test_a_prior_of_zero_holds_the_error_of_a_sensor():
    robot = surveyed_robot()
    read = RestReadings(
        time=np.zeros(1), length=np.zeros((1, 4)), tension=np.ones((1, 4)), skipped={}
    )
    names = find_unknowns(
        robot, read, RestSettings(tension_scale_prior=0.0), relative=True
    ).prior.names
    assert not [name for name in names if name.startswith("tension_scale")]
    assert len([name for name in names if name.startswith("tension_offset")]) == 4
