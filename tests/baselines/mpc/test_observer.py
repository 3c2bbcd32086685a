"""What the controller learns from beliefs, and what it must not learn."""

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from baselines.mpc.geometry import geometry_at
from baselines.mpc.observer import SLACK, Observer
from carosac_toolkit.values import Belief


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


def at_home(robot, twist=(0.0,) * 6):
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    return Belief(
        time=np.zeros(1), position=rest.position, rotation=rest.rotation,
        twist=np.array([twist]),
    )  # fmt: skip


def observed(robot, extra, steps):
    """The observer after the cables were sent to lengths that are longer than the pose says."""
    observer = Observer(robot, MpcSettings())
    observer.reset()
    belief = at_home(robot)
    length = geometry_at(robot, belief.position[0], belief.rotation[0]).length + extra
    for _ in range(steps):
        start = observer.start(belief, length, np.zeros(robot.n))
    return observer, start


def test_an_offset_of_millimetres_is_learned_whole(robot):
    bias = np.array([5e-3, -4e-3, 3e-3, -6e-3])
    observer, start = observed(robot, bias, 500)
    assert observer.offset == pytest.approx(bias, abs=1e-5)
    assert start.position == pytest.approx(robot.home_position, abs=1e-5)


def test_a_slack_cable_is_no_offset_and_is_reeled_in(robot):
    """A cable that is 30 cm too long says nothing about the pose; sent on, it would stay slack."""
    observer, start = observed(robot, np.array([0.3, 0.0, 0.0, 0.0]), 500)
    assert observer.kept[0] == pytest.approx(MpcSettings().offset_max, abs=1e-9)
    assert observer.offset[0] > 0.3 - 1.2 * SLACK  # what is beyond moves no platform
    assert np.linalg.norm(start.position - robot.home_position) < 3.0 * SLACK


def test_an_unknown_acceleration_of_the_sway_is_found(robot):
    """The believed twist gains speed along x that no prediction has."""
    observer = Observer(robot, MpcSettings())
    observer.reset()
    length = None
    for k in range(300):
        belief = at_home(robot, (0.02 * 0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0))
        length = geometry_at(robot, belief.position[0], belief.rotation[0]).length
        before = observer.start(belief, length, np.zeros(robot.n))
        observer.predict(before)
    assert observer.disturbance[0] > 0.02
