import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.rest import statics
from tests.robots import eight_cable_robot, simple_robot, with_pulleys


@pytest.mark.parametrize("pulleys", [False, True])
@pytest.mark.parametrize("make", [simple_robot, eight_cable_robot])
def test_lengths_agree_with_the_equilibria_that_have_these_tensions(make, pulleys):
    robot = with_pulleys(make()) if pulleys else make()
    rng = np.random.default_rng(0)
    box = np.array([[-0.3], [0.3]]) * (robot.workspace_max - robot.workspace_min)
    position = robot.home_position + rng.uniform(*box, (40, 3)) * 0.5
    turned = Rotation.from_rotvec(rng.uniform(-0.1, 0.1, (40, 3))).as_matrix()
    rest = statics.inverse_kinematics(robot, position, turned if robot.n > 6 else None)
    good = rest.converged
    assert good.sum() > 20
    lengths = length_at_tension(robot, rest.position[good], rest.rotation[good], rest.tension[good])
    assert lengths.valid.all()
    assert lengths.unstrained_length == pytest.approx(rest.unstrained_length[good], abs=1e-9)


def test_a_slack_cable_sags_and_a_taut_one_stretches():
    robot = simple_robot()
    pose = robot.home_position[None], robot.home_rotation[None]
    slack = length_at_tension(robot, *pose, np.full((1, 4), 0.8))
    taut = length_at_tension(robot, *pose, np.full((1, 4), 400.0))
    assert (slack.sag > 20 * taut.sag).all() and (slack.sag > 0.05).all()
    free = slack.unstrained_length.mean()
    assert taut.stretch == pytest.approx(400.0 * (free + 8.0) / 0.95e6, rel=0.02)


def test_sag_of_a_taut_cable_is_that_of_a_parabola():
    robot = simple_robot()
    tension = 200.0
    lengths = length_at_tension(
        robot, robot.home_position[None], robot.home_rotation[None], np.full((1, 4), tension)
    )
    reach = robot.exit_points - robot.home_position - robot.anchor_points
    chord, span = np.linalg.norm(reach, axis=1), np.linalg.norm(reach[:, :2], axis=1)
    middle = tension + 0.5 * robot.weight_per_length * reach[:, 2]
    parabola = (robot.weight_per_length * span) ** 2 * chord / (24.0 * middle**2)
    assert lengths.sag[0] == pytest.approx(parabola, rel=5e-3)


def test_an_unknown_or_impossible_tension_has_no_length():
    robot = simple_robot()
    tension = np.array([[np.nan, 0.0, -3.0, 50.0]])
    lengths = length_at_tension(
        robot, robot.home_position[None], robot.home_rotation[None], tension
    )
    assert lengths.valid.tolist() == [[False, False, False, True]]
    assert np.isnan(lengths.unstrained_length[0, :3]).all()


def test_length_falls_with_tension_down_to_the_least_one_that_hangs():
    robot = simple_robot()
    tension = np.geomspace(0.05, 400.0, 200)
    pose = (np.tile(robot.home_position, (200, 1)), np.tile(robot.home_rotation, (200, 1, 1)))
    lengths = length_at_tension(robot, *pose, np.tile(tension[:, None], (1, 4)))
    for i in range(4):
        hangs = lengths.valid[:, i]
        assert hangs[np.argmax(hangs) :].all() and not hangs[0]
        assert (np.diff(lengths.unstrained_length[hangs, i]) < 0.0).all()
