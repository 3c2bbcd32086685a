"""Platforms that swing on cables of constant length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.held_lengths import (
    moved_poses,
    pull_of_held_cables,
    twists_on_rates,
)
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests.robots import hanging


@pytest.fixture(scope="module", params=[2, 3, 4])
def swing(request):
    """A robot, its poses, lengths, and twists along which no length changes."""
    robot = hanging(request.param) if request.param < 4 else ct.load_robot("carosac")
    rng = np.random.default_rng(request.param)
    position = robot.home_position + 0.1 * rng.standard_normal((5, 3))
    turn = np.array([from_rotation_vector(0.2 * rng.standard_normal(3)) for _ in range(5)])
    rotation = turn @ robot.home_rotation
    length = straight_length(robot, position, rotation).length
    twist = twists_on_rates(
        robot, position, rotation, length, np.zeros_like(length), rng.standard_normal((5, 6))
    )
    return robot, position, rotation, length, twist


def test_cables_in_motion_keep_their_lengths(swing):
    robot, position, rotation, length, twist = swing
    _, acceleration = pull_of_held_cables(robot, position, rotation, twist)
    step = 1e-3
    later, earlier = (
        straight_length(
            robot, *moved_poses(position, rotation, side * step * twist + 0.5 * step**2 * push)
        ).length
        for side, push in ((1.0, acceleration), (-1.0, acceleration))
    )
    bent = (later + earlier - 2.0 * length) / step**2
    free = straight_length(robot, *moved_poses(position, rotation, step * twist)).length
    assert np.abs(bent).max() < 1e-4 * np.abs((free - length) / (0.5 * step**2)).max()


def test_held_cables_do_no_work(swing):
    """Kinetic energy grows by what the weight does alone."""
    robot, position, rotation, _, twist = swing
    _, acceleration = pull_of_held_cables(robot, position, rotation, twist)
    step = 1e-5

    def energy(side):
        place = moved_poses(position, rotation, side * step * twist)
        moving = twist + side * step * acceleration
        mass = mass_matrix(robot, place[1])
        kinetic = 0.5 * np.einsum("bi,bij,bj->b", moving, mass, moving)
        return kinetic + robot.weight * (place[0] + place[1] @ robot.center_of_mass)[:, 2]

    power = (energy(1.0) - energy(-1.0)) / (2.0 * step)
    assert np.abs(power).max() < 1e-5 * robot.weight * np.abs(twist[:, :3]).max()


def test_cables_at_rest_carry_the_weight():
    robot = replace(hanging(3), linear_density=1e-9 * hanging(3).linear_density)
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    tension, acceleration = pull_of_held_cables(
        robot, rest.position, rest.rotation, np.zeros((1, 6))
    )
    structure = structure_matrix(robot, rest.position, rest.rotation)
    assert (structure @ tension[:, :, None])[0, 2, 0] == pytest.approx(robot.weight, rel=1e-6)
    assert np.abs(acceleration).max() < 1e-6 * robot.gravity
