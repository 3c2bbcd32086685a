"""How far cables give way, against exact catenaries."""

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.cable.softness import softness
from carosac_toolkit.physics.cable.straight_line import straight_length


@pytest.mark.parametrize("tension", [8.0, 20.0, 100.0])  # of cables that weigh 1 N
def test_a_longer_cable_lowers_the_tension_as_a_catenary_does(tension):
    """At a fixed chord, unstrained length per tension; sag rules at 8 N, stretch at 100 N."""
    robot = ct.load_robot("scampi")
    place, turn = robot.home_position[None], robot.home_rotation[None]
    step = 1e-3 * tension
    low, high = (
        length_at_tension(robot, place, turn, np.full((1, 4), tension + side * step))
        for side in (-1.0, 1.0)
    )
    change = -(high.unstrained_length - low.unstrained_length)[0] / (2.0 * step)
    direction = straight_length(robot, place, turn).direction[0]
    found = softness(robot, direction, low.unstrained_length[0], np.full(4, tension))
    weight = robot.weight_per_length * low.unstrained_length[0]
    assert found == pytest.approx(change, rel=float(weight.max()) / tension)


def test_a_cable_that_hangs_deeply_is_not_without_limit_soft():
    robot = ct.load_robot("scampi")
    level, length = np.tile([1.0, 0.0, 0.0], (4, 1)), np.full(4, 9.0)
    slack = softness(robot, level, length, np.zeros(4))
    half = 0.5 * robot.weight_per_length * length
    assert slack == pytest.approx(softness(robot, level, length, half))
