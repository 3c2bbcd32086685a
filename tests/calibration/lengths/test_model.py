"""Predicted readings and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.lengths.model import correction, in_world, predict, tensions, upwards
from calibration.lengths.pose_path import PosesAt
from calibration.lengths.unknowns import all_names
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.robot import Robot
from tests.calibration.lengths.scenes import with_pulleys

TURN = np.array([[0.98, -0.17, 0.1], [0.19, 0.96, -0.2], [-0.06, 0.22, 0.97]])


def poses_of(robot: Robot) -> tuple[PosesAt, statics.Equilibrium]:
    u, _, v = np.linalg.svd(TURN)
    turns = np.stack([np.eye(3), u @ v])
    held = turns if robot.n >= 6 else None
    rest = statics.inverse_kinematics(
        robot, robot.home_position + np.array([[0, 0, 0], [0.7, -0.5, 0.4]]), held
    )
    assert rest.converged.all()
    twist = np.array([[0.3, -0.2, 0.1, 0.02, 0.05, -0.1]] * 2)
    valid = np.ones(2, dtype=np.bool_)
    return PosesAt(position=rest.position, rotation=rest.rotation, twist=twist, valid=valid), rest


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_prediction_is_the_length_of_statics(name: str) -> None:
    robot = with_pulleys(name)
    poses, rest = poses_of(robot)
    tension = tensions(robot, poses, upwards(robot, anchored=True))
    effect = correction(robot, poses, tension)
    found = predict(robot, poses, effect.value, with_balance=False, anchored=True)
    assert found.value == pytest.approx(rest.unstrained_length, abs=2e-5)


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_derivatives_agree_with_differences_at_a_turned_pose(name: str) -> None:
    robot = with_pulleys(name)
    robot = with_values(
        robot, ["pose_tilt.x", "length_scale[" + robot.cable_names[0] + "]"], [0.0, 1.01]
    )
    poses, _ = poses_of(robot)
    zero = np.zeros((2, robot.n))
    names = all_names(robot.cable_names, center=robot.n < 6)
    exact = predict(robot, poses, zero, with_balance=False, anchored=True).by_all
    step = 1e-5
    for k, parameter in enumerate(names):
        if parameter == "length_delay":
            continue  # it moves the poses, not the robot
        ends = []
        for sign in (1.0, -1.0):
            value = values_of(robot, [parameter]) + sign * step
            changed = with_values(robot, [parameter], value)
            placed = in_world(changed, poses, anchored=True)
            ends.append(predict(changed, placed, zero, with_balance=False, anchored=True).value)
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        assert exact[:, :, k] == pytest.approx(numeric, abs=1e-6), parameter


def test_delay_moves_readings_at_the_rate_of_the_lengths() -> None:
    robot = with_pulleys("cogiro")
    poses, _ = poses_of(robot)
    step = 1e-5
    ends = []
    for sign in (1.0, -1.0):
        spin = np.cross(np.eye(3), poses.twist[0, 3:]).T  # matrix of the cross product
        turn = np.eye(3) + sign * step * spin.T
        moved = PosesAt(
            position=poses.position + sign * step * poses.twist[:, :3],
            rotation=turn @ poses.rotation, twist=poses.twist, valid=poses.valid,
        )  # fmt: skip
        ends.append(
            predict(robot, moved, np.zeros((2, 8)), with_balance=False, anchored=True).value
        )
    names = all_names(robot.cable_names, center=False)
    found = predict(robot, poses, np.zeros((2, 8)), with_balance=False, anchored=True)
    rate = found.by_all[:, :, names.index("length_delay")]
    assert rate == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-6)
