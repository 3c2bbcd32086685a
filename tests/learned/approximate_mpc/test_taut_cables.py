"""What pulls weak cables taut moves no origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from learned.approximate_mpc.taut_cables import GAIN, MARGIN, TautCables
from tests.robots import PER_CABLE, hanging


@pytest.fixture
def robot():
    return ct.load_robot("carosac")


def directions(robot):
    chord = robot.exit_points - robot.home_position - robot.anchor_points @ robot.home_rotation.T
    return chord / np.linalg.norm(chord, axis=1)[:, None]


def push(robot, over):
    """Return what is added to usual tensions that are so much over those of weak cables [N]."""
    wanted = robot.tension_min + MARGIN * robot.weight / robot.n
    return TautCables(robot).push(robot.home_position, robot.home_rotation, wanted + over)


def test_taut_cables_are_left_alone(robot):
    assert push(robot, np.array([0.1, 20.0, 30.0, 40.0])) is None


@pytest.mark.parametrize("weak", range(4))
def test_a_weak_cable_gains_and_forces_add_up_to_nothing(robot, weak):
    over = np.full(4, 30.0)
    over[weak] = -3.0
    added = push(robot, over)
    assert added[weak] == pytest.approx(3.0 * GAIN)
    assert np.abs(directions(robot).T @ added).max() < 1e-9


def test_no_other_cable_becomes_weak(robot):
    over = np.array([-3.0, 0.5, 0.5, 0.5])
    added = push(robot, over)
    assert added[0] > 0.0
    assert (over[1:] + added[1:] >= -1e-9).all()
    assert (over[1:] + added[1:]).min() == pytest.approx(0.0, abs=1e-9)


def test_a_cable_is_not_helped_at_the_cost_of_another_weak_one(robot):
    null = np.linalg.svd(directions(robot).T)[2][3]
    first = int(np.argmax(null))
    other = int(np.argmin(null))  # falls where the first one gains
    over = np.full(4, 30.0)
    over[first], over[other] = -3.0, -1.0
    added = push(robot, over)
    assert added is None or np.abs(added).max() == 0.0


def test_three_cables_have_one_way_to_hold_a_place():
    robot = hanging(3)
    assert push(robot, np.array([-3.0, 30.0, 30.0])) is None


def test_five_cables_share_what_one_gains(robot):
    def more(rows):
        return np.concatenate([rows, rows[:1]])

    robot = replace(
        robot, cable_names=(*robot.cable_names, "fifth"),
        exit_points=np.vstack([robot.exit_points, [0.0, 0.0, robot.exit_points[:, 2].max()]]),
        anchor_points=np.vstack([robot.anchor_points, robot.anchor_points.mean(axis=0)]),
        **{name: more(getattr(robot, name)) for name in PER_CABLE},
    )  # fmt: skip
    added = push(robot, np.array([-3.0, 30.0, 30.0, 30.0, 30.0]))
    assert added[0] == pytest.approx(3.0 * GAIN)
    assert np.abs(directions(robot).T @ added).max() < 1e-9
