from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories import line, waypoints
from tests.trajectories.samples import POINTS

LIMITS = {"speed_max": 1.0, "acceleration_max": 1.0}


def test_it_rests_at_every_inner_point():
    trajectory = waypoints(POINTS, rest=0.7, **LIMITS)
    ends = trajectory.curve.breaks
    for i, point in enumerate(POINTS[1:-1]):
        start, stop = ends[2 * i + 1], ends[2 * i + 2]
        assert stop - start == pytest.approx(0.7)
        s = trajectory.sample(np.linspace(start, stop, 20))
        np.testing.assert_allclose(s.position, np.tile(point, (20, 1)), atol=1e-12)
        assert np.abs(s.velocity).max() < 1e-12


def test_moves_are_straight_and_never_turn_back():
    trajectory = waypoints(POINTS, rest=0.0, **LIMITS)
    for i in range(3):
        time = np.linspace(*trajectory.curve.breaks[i : i + 2], 50)
        away = trajectory.sample(time).position - POINTS[i]
        direction = (POINTS[i + 1] - POINTS[i]) / np.linalg.norm(POINTS[i + 1] - POINTS[i])
        along = away @ direction
        np.testing.assert_allclose(away, np.outer(along, direction), atol=1e-12)
        assert (np.diff(along) >= -1e-15).all()


def test_every_move_reaches_a_limit():
    points = [[0, 0, 0], [0.05, 0, 0], [5.0, 0, 0]]
    trajectory = waypoints(points, rest=1.0, speed_max=1.0, acceleration_max=1.0)
    short, _, long = np.diff(trajectory.curve.breaks)
    first = trajectory.sample(np.linspace(0.0, short, 5001))
    last = trajectory.sample(np.linspace(trajectory.duration - long, trajectory.duration, 5001))
    assert np.linalg.norm(first.acceleration, axis=1).max() == pytest.approx(1.0, rel=1e-5)
    assert np.linalg.norm(last.velocity, axis=1).max() == pytest.approx(1.0, rel=1e-5)


def test_a_longer_duration_leaves_the_rests_alone():
    trajectory = waypoints(POINTS, rest=0.7, duration=60.0, **LIMITS)
    assert trajectory.duration == pytest.approx(60.0)
    assert np.diff(trajectory.curve.breaks)[[1, 3]] == pytest.approx([0.7, 0.7])


def test_a_line_is_a_single_move():
    trajectory = line(POINTS[0], POINTS[1], **LIMITS)
    assert trajectory.name == "line"
    middle = trajectory.sample([trajectory.duration / 2])
    np.testing.assert_allclose(middle.position[0], POINTS[:2].mean(axis=0), atol=1e-12)


def test_bad_arguments_are_refused():
    with pytest.raises(InvalidField, match=r"rest: got -1.0 s; allowed: a finite rest >= 0"):
        waypoints(POINTS, rest=-1.0, **LIMITS)
    with pytest.raises(InvalidField, match=r"points\[1\]: got the same point as before"):
        line([0, 0, 0], [0, 0, 0], **LIMITS)
    with pytest.raises(InvalidField, match=r"end: got shape \(2,\); allowed: shape \(3,\)"):
        line([0, 0, 0], [0, 0], **LIMITS)
