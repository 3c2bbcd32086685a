from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories import circle, spiral

CENTER = np.array([0.4, -1.8, 3.0])
NORMAL = np.array([0.2, -0.3, 1.0])


def test_a_circle_keeps_its_radius_and_its_plane():
    trajectory = circle(CENTER, 0.8, normal=NORMAL, turns=2, speed_max=1, acceleration_max=9)
    away = trajectory.sample(np.linspace(0, trajectory.duration, 500)).position - CENTER
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.8, atol=1e-13)
    np.testing.assert_allclose(away @ NORMAL, 0.0, atol=1e-13)
    np.testing.assert_allclose(away[0], away[-1], atol=1e-12)


@pytest.mark.parametrize("radius", [0.3, 2.0])
def test_acceleration_on_a_circle_is_speed_squared_over_radius(radius):
    trajectory = circle(CENTER, radius, turns=3, speed_max=1.2, acceleration_max=1.0)
    s = trajectory.sample(trajectory.duration * np.linspace(0.3, 0.7, 50))  # between the ramps
    speed = np.linalg.norm(s.velocity, axis=1)
    np.testing.assert_allclose(speed, min(1.2, np.sqrt(radius)), rtol=1e-3)
    inward = (CENTER - s.position) / radius
    np.testing.assert_allclose(s.acceleration, inward * speed[:, None] ** 2 / radius, atol=1e-9)
    np.testing.assert_allclose(s.jerk, -s.velocity * (speed[:, None] / radius) ** 2, atol=1e-9)


def test_the_sense_of_turning_and_the_start_angle():
    limits = {"speed_max": 1.0, "acceleration_max": 1.0}
    quarter = circle([0, 0, 0], 1.0, turns=0.25, start_angle=np.pi / 2, **limits)
    ends = quarter.sample([0.0, quarter.duration]).position
    np.testing.assert_allclose(ends, [[0, 1, 0], [-1, 0, 0]], atol=1e-12)
    back = circle([0, 0, 0], 1.0, turns=-0.25, **limits)
    np.testing.assert_allclose(back.sample([back.duration]).position, [[0, -1, 0]], atol=1e-12)
    upright = circle([0, 0, 0], 1.0, normal=(2, 0, 0), turns=0.25, **limits)
    ends = upright.sample([0.0, upright.duration]).position
    np.testing.assert_allclose(ends, [[0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_radius_and_height_of_a_spiral_change_in_proportion_to_the_angle():
    trajectory = spiral(CENTER, 1.0, 0.2, 1.5, turns=2.5, speed_max=1, acceleration_max=1)
    away = trajectory.sample(np.linspace(0, trajectory.duration, 2000)).position - CENTER
    radius = np.hypot(away[:, 0], away[:, 1])
    share = away[:, 2] / 1.5
    angle = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    np.testing.assert_allclose(radius, 1.0 - 0.8 * share, atol=1e-12)
    np.testing.assert_allclose(angle, 5 * np.pi * share, atol=1e-10)
    assert share[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius": -1.0}, r"radius: got -1.0 m, -1.0 m; allowed: both >= 0, one > 0"),
        ({"radius": 0.0}, r"radius: got 0.0 m"),
        ({"turns": 0.0}, r"turns: got 0.0; allowed: a finite number of turns, not 0"),
        ({"normal": (0, 0, 0)}, r"normal: got .*; allowed: a non-zero vector"),
        ({"center": (0, 0)}, r"center: got shape \(2,\); allowed: shape \(3,\)"),
    ],
)
def test_bad_arguments_are_refused(changes, message):
    arguments = {"center": CENTER, "radius": 1.0} | changes
    with pytest.raises(InvalidField, match=message):
        circle(**arguments, speed_max=1.0, acceleration_max=1.0)
