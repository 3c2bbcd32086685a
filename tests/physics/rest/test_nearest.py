"""Robots of two and three cables: where they rest, and how they swing there."""

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.rest.nearest import nearest_rest, plane_of_rest, rest_at
from carosac_toolkit.trajectories import build
from tests.robots import hanging


def positions(robot, count):
    rng = np.random.default_rng(5)
    return rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))


def test_three_cables_hold_a_platform_anywhere_under_their_exit_points():
    robot = hanging(3)
    rest = ct.statics.inverse_kinematics(robot, positions(robot, 50))
    assert rest.converged.all() and rest.stable.all()
    back = ct.statics.forward_kinematics(robot, rest.unstrained_length)
    assert back.position == pytest.approx(rest.position, abs=1e-9)


def test_two_cables_rest_in_the_vertical_plane_of_their_exit_points():
    robot = hanging(2)
    wanted = positions(robot, 50)
    nearest = nearest_rest(robot, wanted)
    rest = nearest.equilibrium
    assert rest.converged.all() and rest.stable.all()
    assert rest.position == pytest.approx(wanted * [1.0, 0.0, 1.0], abs=1e-9)
    assert nearest.distance == pytest.approx(np.abs(wanted[:, 1]), abs=1e-9)
    middle = rest.position + rest.rotation @ robot.center_of_mass
    assert (middle[:, 2] < rest.position[:, 2]).all()  # the centre of mass hangs below
    again = ct.statics.inverse_kinematics(robot, rest.position)
    assert again.converged.all()
    assert again.unstrained_length == pytest.approx(rest.unstrained_length, abs=1e-9)


def test_between_two_vertical_cables_a_platform_swings_as_a_pendulum():
    down = 4.0  # [m] from the exit points to the centre of mass, which is at the anchor points
    exits = np.array([[-0.5, 0.0, 6.0], [0.5, 0.0, 6.0]])
    light = np.full(2, 1e-6)
    robot = replace(
        hanging(2), exit_points=exits, anchor_points=exits - [0.0, 0.0, 6.0],
        center_of_mass=np.array([0.0, 0.0, -1e-3]), linear_density=light, run_length=np.zeros(2),
        axial_stiffness=np.full(2, 1e8), inertia=np.diag([1e-7, 1e-7, 1e-7]),
        home_position=np.array([0.0, 0.0, 6.0 - down]),
    )  # fmt: skip
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    pendulum = np.sqrt(9.81 / down) / (2.0 * np.pi)
    assert natural_frequencies(robot, rest)[0, :2] == pytest.approx(pendulum, rel=1e-3)


def test_each_plant_of_two_cables_starts_on_its_own_surface():
    robot = hanging(2)
    moved = replace(robot, exit_points=robot.exit_points + np.array([0.0, 0.01, 0.0]))
    rest = rest_at(Fleet([robot, moved]), np.tile([0.0, 0.0, 2.0], (2, 1)))
    assert rest.converged.all()
    assert rest.position[:, 1] == pytest.approx([0.0, 0.01], abs=1e-9)


@pytest.mark.parametrize("name", ["minimum_snap", "circle"])
def test_a_path_of_two_cables_lies_where_the_platform_can_rest(name):
    robot = hanging(2)
    path = build(name, robot, seed=1)
    where = path.sample(np.linspace(0.0, path.duration, 50)).position
    assert 0.1 < path.moved <= 0.5
    assert where[:, 1] == pytest.approx(0.0, abs=1e-12)
    assert ct.statics.inverse_kinematics(robot, where).converged.all()
    assert build(name, hanging(3), seed=1).moved == 0.0


@pytest.mark.parametrize("n", [2, 3])
def test_straight_cables_find_the_position_of_few_cables(n):
    robot = hanging(n)
    where = positions(robot, 30) * ([1.0, 0.0, 1.0] if n == 2 else 1.0)
    fit = straight_line.forward_kinematics(robot, straight_line.inverse_kinematics(robot, where))
    assert fit.converged.all()
    assert fit.position == pytest.approx(where, abs=1e-9)
    beside = where + ([0.0, 0.3, 0.0] if n == 2 else [0.0, 0.0, 0.1])
    again = straight_line.forward_kinematics(
        robot, straight_line.inverse_kinematics(robot, where), guess=beside
    )
    assert again.position == pytest.approx(where, abs=1e-9)


def test_two_cables_rest_in_a_plane_wherever_centre_of_mass_and_anchor_points_are():
    rng = np.random.default_rng(1)
    for _ in range(4):
        robot = replace(
            hanging(2), center_of_mass=np.array([0.0, 0.0, -0.3]) + rng.uniform(-0.1, 0.1, 3),
            anchor_points=hanging(2).anchor_points + rng.uniform(-0.1, 0.1, (2, 3)),
            exit_points=hanging(2).exit_points + rng.uniform(-0.5, 0.5, (2, 3)),
        )  # fmt: skip
        rest = nearest_rest(robot, positions(robot, 20)).equilibrium
        assert rest.converged.all()
        normal, point = plane_of_rest(robot, rest.position)
        assert (rest.position - point) @ normal == pytest.approx(0.0, abs=1e-9)


def test_inclined_pulleys_leave_two_cables_no_plane():
    robot = replace(
        hanging(2), pulley_radius=np.full(2, 0.05),
        swivel_axis=np.tile([0.0, 0.6, 0.8], (2, 1)),
    )  # fmt: skip
    rest = nearest_rest(robot, positions(robot, 20)).equilibrium
    with pytest.raises(InvalidField, match=r"swivel_axis: got positions of rest 0\.0.* m off"):
        plane_of_rest(robot, rest.position)
