from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.physics.cable.swivel import swivel_angle, swivel_slope, swivel_zero
from carosac_toolkit.physics.rest import statics


@pytest.fixture
def robot():
    return ct.load_robot("warehouse")  # swivel axes up


def test_an_upright_pulley_swivels_as_the_anchor_point_goes_round_it(robot):
    # A hanging cable stays in a vertical plane, so its sag does not turn the pulley.
    position = np.array([[0.0, 0.0, 1.5], [2.0, -1.0, 1.0]])
    rest = statics.inverse_kinematics(robot, position)
    towards = position[:, None] + robot.anchor_points @ rest.rotation.swapaxes(1, 2)
    towards = towards - robot.exit_points
    around = np.arctan2(towards[..., 1], towards[..., 0])
    np.testing.assert_allclose(swivel_angle(robot, -rest.exit_tension), around, atol=1e-9)


def test_the_angle_is_right_handed_about_the_axis(robot):
    leaving = np.tile([[0.5, 0.5, -3.0]], (robot.n, 1))[None]
    down = replace(robot, swivel_axis=-robot.swivel_axis)
    assert swivel_angle(robot, leaving) == pytest.approx(np.full((1, 8), np.pi / 4))
    assert swivel_angle(down, leaving) == pytest.approx(np.full((1, 8), -np.pi / 4))


def test_zero_is_towards_x_or_towards_y_about_an_axis_along_x(robot):
    axis = np.array([[0.6, 0.0, 0.8], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turned = replace(robot, swivel_axis=np.concatenate([axis, robot.swivel_axis[3:]]))
    zero = swivel_zero(turned)[:3]
    np.testing.assert_allclose(zero, [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    leaving = np.tile(swivel_zero(turned) + 2.0 * turned.swivel_axis, (1, 1, 1))
    np.testing.assert_allclose(swivel_angle(turned, leaving), 0.0, atol=1e-12)


def test_a_cable_without_a_pulley_has_angle_zero():
    robot = ct.load_robot("carosac")
    assert (swivel_angle(robot, np.ones((2, 4, 3))) == 0.0).all()


def test_the_slope_is_the_change_of_the_angle(robot):
    rng = np.random.default_rng(0)
    axis = robot.swivel_axis + 0.2 * rng.standard_normal((8, 3))
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    tilted = replace(robot, swivel_axis=axis)
    leaving, step = rng.standard_normal((3, 8, 3)), 1e-6 * rng.standard_normal((3, 8, 3))
    change = swivel_angle(tilted, leaving + step) - swivel_angle(tilted, leaving - step)
    by_slope = 2.0 * (swivel_slope(tilted, leaving) * step).sum(axis=-1)
    np.testing.assert_allclose(change, by_slope, rtol=1e-6, atol=1e-12)
    assert not swivel_slope(ct.load_robot("carosac"), np.ones((1, 4, 3))).any()
