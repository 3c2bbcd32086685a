"""The balance of the platform at measured poses."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.lengths.platform_balance import PlatformBalance, balance
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.robot import Robot
from tests.calibration.lengths.scenes import with_pulleys


@pytest.fixture(scope="module")
def robot() -> Robot:
    return with_pulleys("carosac")


@pytest.fixture(scope="module")
def rest(robot: Robot) -> Equilibrium:
    places = np.array([[0.4, -1.8, 2.2], [-1.0, -3.0, 3.5], [1.8, -0.4, 1.4]])
    found = statics.inverse_kinematics(robot, places)
    assert found.converged.all()
    return found


def at(robot: Robot, position: Array, rotation: Array) -> PlatformBalance:
    return balance(robot, rotation, straight_length(robot, position, rotation))


def test_equilibrium_on_hanging_cables_balances_with_the_same_tensions(
    robot: Robot, rest: Equilibrium
) -> None:
    found = at(robot, rest.position, rest.rotation)
    assert np.abs(found.residual).max() < 1e-4  # of the weight: cables are nearly straight
    assert found.tension == pytest.approx(rest.tension, rel=2e-3)


def test_tilted_platform_does_not_balance(robot: Robot, rest: Equilibrium) -> None:
    angle = 0.05
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    assert (
        np.linalg.norm(at(robot, rest.position, turn @ rest.rotation).residual, axis=1).min() > 0.01
    )


NAMES = ("exit_points[front_left].x", "anchor_points[rear_right].z", "center_of_mass.y")


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_agree_with_differences(robot: Robot, rest: Equilibrium, name: str) -> None:
    """In norm, as the basis of the free motions turns; a pulley counts as a point, 1 % of 9 m."""
    step = 1e-5
    value = values_of(robot, [name])
    ends = [
        at(with_values(robot, [name], value + s * step), rest.position, rest.rotation).residual
        for s in (1.0, -1.0)
    ]
    found = at(robot, rest.position, rest.rotation)
    exact = {
        NAMES[0]: found.by_exit[:, :, 0, 0],
        NAMES[1]: found.by_anchor[:, :, 2, 2],
        NAMES[2]: found.by_center[:, :, 1],
    }[name]
    numeric = np.linalg.norm(ends[0] - ends[1], axis=1) / (2.0 * step)
    assert np.linalg.norm(exact, axis=1) == pytest.approx(numeric, rel=2e-2, abs=1e-3)
