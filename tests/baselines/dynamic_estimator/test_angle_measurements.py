"""Swivel angles, AHRS and inclinometer in the filter, against differences and simulated robots."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

import carosac_toolkit as ct
from baselines.dynamic_estimator import DynamicEstimator, DynamicEstimatorSettings
from baselines.dynamic_estimator.filter import DynamicFilter
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.orientation_measurement import (
    measured_attitude,
    measured_inclination,
)
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.dynamic_estimator.settings import settings_for
from baselines.dynamic_estimator.swivel_measurement import measured_swivels
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix, roll_and_pitch
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from tests.baselines.dynamic_estimator.test_estimator import KNOWN, believe, rms, swing

USED = DynamicEstimatorSettings(swivels=True, attitude=True)


@pytest.fixture(scope="module")
def robot():
    """The robot `carosac` with pulleys."""
    carosac = ct.load_robot("carosac")
    return replace(carosac, pulley_radius=np.full(carosac.n, 0.05))


@pytest.fixture(scope="module")
def settings(robot):
    return settings_for(robot, USED)


@pytest.fixture(scope="module")
def state(robot, settings):
    """At rest off the middle, with sensors that are mounted askew."""
    where = robot.home_position + np.array([0.5, -0.4, 0.2])
    rest = statics.inverse_kinematics(robot, where[None])
    errors = DynamicModel(robot, settings).errors
    at = RestStart(robot, settings, errors).state(0.0, rest.unstrained_length[0])
    return replace(at, mounting=pinocchio.exp3(np.array([0.3, -0.2, 0.1])), heading=2.0)


def attitude_of(state):
    turn = pinocchio.exp3(np.array([0.0, 0.0, state.heading])) @ state.rotation @ state.mounting
    return from_matrix(turn[None])[0]


def inclination_of(state):
    return roll_and_pitch((state.rotation @ state.mounting)[None])[0]


def angles_of(robot, state):
    """Angles of straight cables to the platform as it is there."""
    anchors = state.position + robot.anchor_points @ state.rotation.T
    return swivel_angle(robot, (anchors - robot.exit_points)[None])[0] + state.swivel_offset


@pytest.mark.parametrize("sensor", ["swivels", "attitude", "inclination"])
def test_a_reading_changes_with_each_error_as_the_model_says(robot, settings, state, sensor):
    models = {
        "swivels": (measured_swivels, lambda there: angles_of(robot, there)),
        "attitude": (measured_attitude, attitude_of),
        "inclination": (measured_inclination, inclination_of),
    }
    model, reading = models[sensor]
    by = model(robot, state, reading(state), settings).by
    for k in range(state.errors.size):
        error = 1e-5 * np.eye(state.errors.size)[k]
        sides = [
            model(robot, state, reading(state.corrected(sign * error, state.covariance)), settings)
            for sign in (1.0, -1.0)
        ]
        change = (sides[0].residual - sides[1].residual) / 2e-5
        np.testing.assert_allclose(change, by[:, k], rtol=1e-4, atol=1e-5)


def test_no_heading_is_too_far_off(robot, settings, state):
    """The first reading tells it, and nothing else of a platform that is where it was believed."""
    filter_ = DynamicFilter(DynamicModel(robot, settings), settings)
    for heading in (-3.0, -1.0, 0.5, 3.1):
        reading = attitude_of(replace(state, heading=heading))
        found, tally = filter_.reading(replace(state, heading=0.0), "attitude", reading)
        assert found.heading == pytest.approx(heading, abs=0.02) and tally.disturbed == 0
        assert np.abs(found.position - state.position).max() < 1e-3
        assert np.abs(found.mounting - state.mounting).max() < 1e-3


def test_how_a_sensor_is_mounted_is_learned_where_the_platform_turns(robot, settings, state):
    """Twenty rotations that are known tell it better than one reading does."""
    filter_, rng = DynamicFilter(DynamicModel(robot, settings), settings), np.random.default_rng(0)
    known = np.array(state.covariance)
    where = state.errors
    for part in (where.motion, where.bias):
        known[part, :] = known[:, part] = 0.0
    known[range(where.size), range(where.size)] += 1e-12
    begin = replace(state, mounting=np.eye(3), heading=0.0, covariance=known)
    true = replace(state, mounting=pinocchio.exp3(np.array([0.03, -0.02, 0.01])), heading=1.0)
    for _ in range(20):
        turn = pinocchio.exp3(0.3 * rng.standard_normal(3))
        rotation = turn @ state.rotation
        noise = pinocchio.exp3(settings.attitude_noise * rng.standard_normal(3))
        seen = replace(true, rotation=rotation)
        seen = replace(seen, mounting=true.mounting @ noise)
        begin = replace(begin, rotation=rotation)
        begin, _ = filter_.reading(begin, "attitude", attitude_of(seen))
    off = pinocchio.log3(begin.mounting.T @ true.mounting)
    sigma = np.sqrt(np.diag(begin.covariance[where.mounting, where.mounting]))
    assert (sigma < settings.attitude_noise).all() and (np.abs(off) < 4.0 * sigma).all()


@pytest.mark.parametrize(
    ("suite", "used"),
    [
        ("lengths+swivel", {"swivels": True}),
        ("lengths+attitude", {"attitude": True}),
        ("lengths+inclination", {"attitude": True}),
    ],
)
def test_angles_tell_what_the_wind_does(robot, suite, used):
    settings = DynamicEstimatorSettings(**KNOWN, **used)
    found = swing(robot, suite, SensorSettings(), seed=3, wind=3.0)
    blind, _ = believe(DynamicEstimator.build(robot, DynamicEstimatorSettings(**KNOWN)), found)
    errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    assert rms(errors) < 0.7 * rms(blind)
    assert rms(errors[:, 6:9]) < 0.8 * rms(blind[:, 6:9])
    squares = [
        e[:6] @ np.linalg.solve(b.covariance[0, :6, :6], e[:6]) / 6.0
        for e, b in zip(errors[50:], beliefs[50:], strict=True)
    ]
    assert 0.3 < np.mean(squares) < 2.0
    innovations = [b.innovations for b in beliefs]
    square, freedoms = (sum(getattr(i, k)[0] for i in innovations) for k in ("squares", "dof"))
    assert 0.6 < square / freedoms < 1.5


def test_of_ahrs_and_inclinometer_the_ahrs_counts(robot):
    settings = DynamicEstimatorSettings(attitude=True)
    found = swing(robot, "lengths+attitude", SensorSettings(), duration=1.0)
    absurd = Stamped(time=np.zeros(1), value=np.array([[1.0, -1.0]]))
    both = [
        (replace(m, inclination=replace(absurd, time=m.attitude.time)), truth) for m, truth in found
    ]
    alone, _ = believe(DynamicEstimator.build(robot, settings), found)
    together, _ = believe(DynamicEstimator.build(robot, settings), both)
    np.testing.assert_array_equal(alone, together)


def test_sensors_that_are_not_used_have_no_states(robot):
    sizes = {
        name: DynamicModel(robot, settings_for(robot, settings)).errors.size
        for name, settings in (
            ("none", DynamicEstimatorSettings()),
            ("swivels", DynamicEstimatorSettings(swivels=True)),
            ("attitude", DynamicEstimatorSettings(attitude=True)),
        )
    }
    assert sizes["swivels"] == sizes["none"] + 4 and sizes["attitude"] == sizes["none"] + 4
    for name in ("swivels", "attitude"):
        with pytest.raises(InvalidField, match=f"{name}: got 1; allowed: True or False"):
            DynamicEstimatorSettings(**{name: 1})
