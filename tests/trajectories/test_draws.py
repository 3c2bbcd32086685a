from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.trajectories import TRAJECTORY_NAMES, build, random_minimum_snap, random_spline
from carosac_toolkit.trajectories.draws import draw_points
from tests.robots import eight_cable_robot, simple_robot

LIMITS = {"speed_max": 1.0, "acceleration_max": 1.0}


@pytest.mark.parametrize("factory", [random_minimum_snap, random_spline])
def test_the_whole_curve_lies_in_the_box(factory):
    robot = simple_robot()
    rng = np.random.default_rng(0)
    for _ in range(10):
        trajectory = factory(robot, rng, **LIMITS)
        position = trajectory.sample(np.linspace(0, trajectory.duration, 3000)).position
        assert (position >= robot.workspace_min).all()
        assert (position <= robot.workspace_max).all()
        spans = (position.max(axis=0) - position.min(axis=0)) / 4.0
        assert spans.max() > 0.5  # it uses the box, of 4 m


@pytest.mark.parametrize("factory", [random_minimum_snap, random_spline])
def test_a_seed_decides(factory):
    one, same, other = (
        factory(simple_robot(), np.random.default_rng(seed), **LIMITS) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.points, same.points)
    assert one.duration == same.duration
    assert one.duration != other.duration


def test_drawn_points_keep_their_distance():
    points = draw_points(simple_robot(), np.random.default_rng(0), count=200, distance_min=1.5)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).min() >= 1.5
    with pytest.raises(InvalidField, match=r"count: got 1; allowed: at least 2 points"):
        draw_points(simple_robot(), np.random.default_rng(0), count=1)
    with pytest.raises(InvalidField, match=r"distance_min: got 3.0 m; allowed: 0 < .* <= 2 m"):
        draw_points(simple_robot(), np.random.default_rng(0), count=3, distance_min=3.0)


@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot()], ids=lambda r: r.name)
@pytest.mark.parametrize("name", TRAJECTORY_NAMES)
def test_the_catalogue_fits_any_box(name, robot):
    for seed in range(3):
        trajectory = build(name, robot, seed, speed_max=0.8)
        assert trajectory.name == name
        assert trajectory.within(robot).peak_speed <= 0.8
        repeated = build(name, robot, seed, speed_max=0.8)
        time = np.linspace(0, trajectory.duration, 9)
        np.testing.assert_array_equal(
            trajectory.sample(time).position, repeated.sample(time).position
        )


def test_the_fast_move_crosses_half_of_the_box_along_the_short_side_of_the_frame():
    robot = load_robot("carosac")  # 4.5 m x 13.2 m
    ends = set()
    for seed in range(6):
        move = build("fast_move", robot, seed)
        start, end = move.sample([0.0, move.duration]).position
        np.testing.assert_allclose((start + end) / 2, [0.4, -1.8, 3.0], atol=1e-12)
        np.testing.assert_allclose(np.abs(end - start), [2.0, 0.0, 0.0], atol=1e-12)
        assert move.peak_acceleration == pytest.approx(2.0, rel=1e-2)
        ends.add(round(float(end[0]), 6))
    assert ends == {1.4, -0.6}  # to either side


def test_an_unknown_name_is_refused():
    with pytest.raises(InvalidField, match=r"trajectory: got 'eight'; allowed: one of \['minimum_"):
        build("eight", simple_robot())
