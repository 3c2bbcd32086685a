"""Growth of the covariance along a run, by source."""

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.dynamic_estimator import DynamicEstimator, DynamicEstimatorSettings
from baselines.dynamic_estimator.error_growth import SOURCES, error_growth, usual_error
from baselines.dynamic_estimator.settings import settings_for
from baselines.smoother.settings import SmootherSettings, smoother_settings_for
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.robot.model_error import ModelError

TIME = np.arange(0.0, 4.0, 0.05)
ERROR = ModelError(
    mass=0.02, length=2e-3, force=0.4, acceleration=4e-3, position=2e-3, rotation=1e-3
)


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def lengths(robot):
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    pull = 0.05 * np.array([1.0, 1.0, -1.0, -1.0])
    return rest.unstrained_length + np.sin(1.5 * TIME)[:, None] * pull


def test_sources_add_up_to_what_the_estimator_claims(robot, lengths):
    """The covariance of the filter itself, on the same lengths, for sizes in no proportion."""
    told = replace(robot, model_error=ERROR)
    growth = error_growth(
        told, lambda t: np.array([np.interp(t, TIME, c) for c in lengths.T]), TIME
    )
    ratio = [getattr(ERROR, name) / getattr(growth.usual, name) for name in SOURCES]
    whole = growth.always + np.einsum("j,jkab->kab", np.square(ratio), growth.by_source)
    estimator = DynamicEstimator.build(told)
    claimed = []
    for time, length in zip(TIME, lengths, strict=True):
        measurement = Measurement(time=np.array([time]), unstrained_length=length[None])
        if not claimed:
            belief = estimator.reset(measurement)
        else:
            command = Command(time=measurement.time, unstrained_length=length[None])
            belief = estimator.update(belief, command, measurement)
        claimed.append(belief.covariance[0, :6, :6])
    for found, wanted in zip(whole[1:], claimed[1:], strict=True):
        size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        assert np.abs(found - wanted).max() <= 0.05 * size.max()
        assert np.diag(found) == pytest.approx(np.diag(wanted), rel=0.05)


def test_an_identified_robot_takes_the_place_of_defaults_but_not_of_what_the_user_sets(robot):
    told = replace(robot, model_error=ERROR)
    here = settings_for(told, DynamicEstimatorSettings())
    assert (here.length_bias, here.wind_force, here.acceleration_noise) == (2e-3, 0.4, 4e-3)
    assert (here.position_noise, here.rotation_noise) == (2e-3, 1e-3)
    assert here.mass == 0.02 and here.center_of_mass == here.length_bias_walk == 0.0
    mine = settings_for(told, DynamicEstimatorSettings(wind_force=3.0, mass=0.03))
    assert (mine.wind_force, mine.mass, mine.acceleration_noise) == (3.0, 0.03, 4e-3)
    seen = smoother_settings_for(told, SmootherSettings(poses="half")).dynamics
    assert (seen.position_noise, seen.wind_force) == (2e-3, 0.4)
    assert seen.length_bias_walk == 1e-3 and seen.mass == 0.03  # poses tell them
    before = settings_for(robot, DynamicEstimatorSettings())
    assert before.wind_force == usual_error(told).force == 3.0
