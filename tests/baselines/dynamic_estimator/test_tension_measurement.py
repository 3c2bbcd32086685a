"""Measured tensions in the filter: statics at rest, and what tensions against each other say."""

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings, settings_for
from baselines.dynamic_estimator.tension_measurement import measured_tension, rigid_tensions
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import statics

USED = DynamicEstimatorSettings(load_cells=True)


def at_rest(robot, settings=USED):
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    settings = settings_for(robot, settings)
    errors = DynamicModel(robot, settings).errors
    return RestStart(robot, settings, errors).state(0.0, rest.unstrained_length[0])


def tensions(robot, state, **changes):
    values = dict(
        position=state.position[None], rotation=state.rotation[None], twist=state.twist[None],
        wind=state.wind[None], mass=np.array([robot.mass]), center=state.center[None],
    )  # fmt: skip
    return rigid_tensions(robot, **(values | changes))[0]


def test_tensions_without_stretch_are_those_of_rest():
    robot = ct.load_robot("carosac")
    light = replace(robot, linear_density=1e-3 * robot.linear_density)
    state = at_rest(light)
    assert tensions(light, state) == pytest.approx(state.tension, rel=2e-3)


def test_a_heavier_platform_pulls_in_proportion():
    robot = ct.load_robot("carosac")
    state = at_rest(robot)
    heavier = tensions(robot, state, mass=np.array([1.1 * robot.mass]))
    # The inertia about the centre of mass stays, which matters only for accelerations.
    assert heavier.sum() == pytest.approx(1.1 * tensions(robot, state).sum(), rel=1e-3)


def test_the_mass_is_learned_from_tensions_at_rest():
    """At 5 % more mass the tensions rise by 5 %; the load cells know it to 1 N each."""
    robot = ct.load_robot("carosac")
    state = at_rest(robot)
    found = measured_tension(robot, state, 1.05 * state.tension, settings_for(robot, USED))
    by_mass = found.by[:, state.errors.mass][:, 0]
    share = found.residual @ by_mass / (by_mass @ by_mass)
    assert share == pytest.approx(0.05, abs=0.005)


def test_tensions_against_each_other_are_left_out_of_eight_cables():
    robot = ct.load_robot("cogiro")
    state = at_rest(robot)
    inner = np.linalg.svd(state.sway.pulls)[2][6:]  # tensions that balance one another
    usual = measured_tension(robot, state, state.tension, settings_for(robot, USED))
    strained = measured_tension(
        robot, state, state.tension + 100.0 * inner.sum(axis=0), settings_for(robot, USED)
    )
    assert usual.residual == pytest.approx(np.zeros(6), abs=1e-9)
    assert strained.residual == pytest.approx(usual.residual, abs=1e-9)


def test_without_load_cells_the_filter_has_no_states_for_them():
    robot = ct.load_robot("carosac")
    assert at_rest(robot, DynamicEstimatorSettings()).errors.size + 4 == at_rest(robot).errors.size
    with pytest.raises(InvalidField, match="load_cells: got 1; allowed: True or False"):
        DynamicEstimatorSettings(load_cells=1)
