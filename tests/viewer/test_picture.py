"""What is drawn: cables end where they should, sag is enlarged as said, the unknown is marked."""

import numpy as np
import pytest

from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.colors import (
    OVERLOAD_COLOR,
    SLACK_COLOR,
    TENSION_COLOR_SCALE,
    UNKNOWN_COLOR,
    tension_colors,
)
from carosac_toolkit.viewer.picture import take_picture


@pytest.fixture(scope="module")
def rest():
    robot = load_robot("scampi")
    return robot, statics.inverse_kinematics(robot, robot.home_position[None])


def taken(robot, rest, **known):
    return take_picture(robot, rest.position[0], rest.rotation[0], **known)


def test_lengths_and_tensions_of_a_rest_give_the_same_shapes(rest):
    robot, found = rest
    by_length = taken(robot, found, unstrained_length=found.unstrained_length[0])
    by_tension = taken(robot, found, tension=found.tension[0])
    assert by_tension.points == pytest.approx(by_length.points, abs=1e-6)
    assert by_length.tension == pytest.approx(found.tension[0], rel=1e-7)
    assert by_length.sag == pytest.approx(statics.sag(robot, found)[0], rel=0.01)


def test_sag_is_drawn_so_many_times_larger_and_the_ends_stay(rest):
    robot, found = rest
    picture = taken(robot, found, unstrained_length=found.unstrained_length[0])
    drawn = picture.drawn(7.0)
    middle = picture.points.shape[1] // 2
    for ends in (0, -1):
        assert drawn[:, ends] == pytest.approx(picture.points[:, ends], abs=1e-12)
    below = picture.points[:, middle, 2] - drawn[:, middle, 2]
    assert (below > 0.0).all()  # cables hang down
    larger = taken(robot, found, points=drawn, tension=found.tension[0])
    assert larger.sag == pytest.approx(7.0 * picture.sag, rel=1e-9)


def test_a_cable_that_nobody_knows_is_straight_grey_and_counted(rest):
    robot, found = rest
    tension = found.tension[0].copy()
    tension[1] = np.nan
    picture = taken(robot, found, tension=tension)
    assert picture.straight.tolist() == [False, True, False, False]
    assert picture.sag[1] == pytest.approx(0.0, abs=1e-12)
    assert tuple(tension_colors(robot, picture.tension)[1]) == UNKNOWN_COLOR


def test_colours_run_from_limit_to_limit_and_mark_what_is_beyond(rest):
    robot, _ = rest
    low, high = robot.tension_min, robot.tension_max
    assert (tension_colors(robot, low) == TENSION_COLOR_SCALE[0]).all()
    assert (tension_colors(robot, high) == TENSION_COLOR_SCALE[-1]).all()
    assert (tension_colors(robot, 0.9 * low) == SLACK_COLOR).all()
    assert (tension_colors(robot, 1.1 * high) == OVERLOAD_COLOR).all()
    middle = tension_colors(robot, np.sqrt(low * high))
    assert (
        not (middle == TENSION_COLOR_SCALE[0]).any()
        and not (middle == TENSION_COLOR_SCALE[-1]).any()
    )
