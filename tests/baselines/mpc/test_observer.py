"""What the controller learns from beliefs, and what it must not learn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from baselines.mpc.geometry import geometry_at
from baselines.mpc.length_offsets import OFFSET_MAX, SLACK_EXCESS
from baselines.mpc.observer import Observer
from baselines.mpc.unknown_load import PlannedMotion
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.scales import Scales


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


def at_home(robot, twist=(0.0,) * 6):
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    return Belief(
        time=np.zeros(1), position=rest.position, rotation=rest.rotation,
        twist=np.array([twist]),
    )  # fmt: skip


def resting(robot):
    """A planned motion that is none, with cables that carry the weight."""
    return PlannedMotion(
        rotation=np.eye(3), spin=np.zeros(3), spin_rate=np.zeros(3),
        force=np.array([0.0, 0.0, robot.weight]), length=np.zeros(robot.n),
    )  # fmt: skip


def observed(robot, extra, steps):
    """The observer after the cables were sent to lengths that are longer than the pose says."""
    observer = Observer(robot, resolved(MpcSettings(), Scales(robot).ratios))
    observer.reset()
    belief = at_home(robot)
    length = geometry_at(robot, belief.position[0], belief.rotation[0]).length + extra
    for _ in range(steps):
        start = observer.start(belief, length, np.zeros(robot.n))
    return observer, start


def test_an_offset_of_millimetres_is_learned_whole(robot):
    bias = np.array([5e-3, -4e-3, 3e-3, -6e-3])
    observer, start = observed(robot, bias, 500)
    assert observer.lengths.offset == pytest.approx(bias, abs=1e-5)
    assert start.position == pytest.approx(robot.home_position, abs=1e-5)


def test_a_slack_cable_is_no_offset_and_is_reeled_in(robot):
    """A cable that is 18 cm too long says nothing about the pose; sent on, it would stay slack."""
    observer = Observer(robot, resolved(MpcSettings(), Scales(robot).ratios))
    observer.reset()
    belief = at_home(robot)
    taut = geometry_at(robot, belief.position[0], belief.rotation[0]).length
    surplus = np.array([0.18, 0.0, 0.0, 0.0])
    for _ in range(200):
        start = observer.start(belief, taut + surplus, np.zeros(robot.n))
        surplus = observer.lengths.surplus  # what is sent is longer than the chord by it
    assert surplus[0] < OFFSET_MAX
    assert surplus[1:] == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.linalg.norm(start.position - robot.home_position) < SLACK_EXCESS


def test_nothing_is_learned_of_the_motion_of_a_platform_on_a_slack_cable(robot):
    """It falls; that is no disturbance, and would be planned for once the cable is taut."""
    observer = Observer(robot, resolved(MpcSettings(), Scales(robot).ratios))
    observer.reset()
    for k in range(20):
        belief = at_home(robot, (0.1 * k, 0.0, -0.2 * k, 0.0, 0.0, 0.0))
        length = geometry_at(robot, belief.position[0], belief.rotation[0]).length
        slack = np.array([0.19, 0.0, 0.0, 0.0])
        start = observer.start(belief, length + slack, np.zeros(robot.n))
        observer.predict(start, resting(robot))
    assert not observer.load.acceleration.any()
    assert not observer.load.shift.any()


@pytest.mark.parametrize("size", [0.01, 0.045])
def test_the_plan_starts_at_exactly_the_lengths_and_rates_that_were_sent(robot, size):
    """What is left over at every command would be paid out as speed that no plan has asked for."""
    observer = Observer(robot, resolved(MpcSettings(), Scales(robot).ratios))
    observer.reset()
    rest = at_home(robot)
    turn = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
    belief = replace(rest, rotation=turn[None] @ rest.rotation,
                     twist=np.array([[0.4, -0.3, -0.8, 1.0, -0.6, 0.9]]))  # fmt: skip
    length = geometry_at(robot, belief.position[0], belief.rotation[0]).length
    length = length + size * np.array([1.0, -1.0, 0.8, -0.7])
    rate = np.array([0.5, -0.2, 0.1, 0.3])
    start = observer.start(belief, length, rate)
    assert start.geometry.length == pytest.approx(length - observer.lengths.surplus, abs=2e-6)
    there = geometry_at(robot, start.position, start.rotation)
    assert there.jacobian @ start.twist == pytest.approx(rate, abs=1e-9)


def gaining(robot, told):
    """The observer after beliefs that gain speed along x, which no prediction has."""
    observer = Observer(robot, resolved(MpcSettings(), Scales(robot).ratios))
    observer.reset()
    center = None if told is None else told[None]
    for k in range(60):
        belief = replace(at_home(robot, (2e-3 * k, 0, 0, 0, 0, 0)), center_of_mass=center)
        length = geometry_at(robot, belief.position[0], belief.rotation[0]).length
        observer.predict(observer.start(belief, length, np.zeros(robot.n)), resting(robot))
    return observer


def test_an_unknown_acceleration_of_the_sway_is_found(robot):
    careful = gaining(robot, None)
    assert 0.01 < careful.load.acceleration[0] < 0.2
    told = robot.center_of_mass + np.array([0.01, -0.02, 0.03])
    quick = gaining(robot, told)
    assert quick.load.robot.center_of_mass == pytest.approx(told)
    assert quick.load.acceleration[0] > careful.load.acceleration[0]
