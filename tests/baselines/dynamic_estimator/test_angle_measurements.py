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
from carosac_toolkit.base.rotations import (
    from_matrix,
    from_rotation_vector,
    roll_and_pitch,
    to_matrix,
    vertical,
    wrapped_angle,
)
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from tests.baselines.dynamic_estimator.test_estimator import KNOWN, believe, rms, swing

LEVEL = (0.0, 0.0, 0.0)
USED = DynamicEstimatorSettings(swivels=True, swivel_offset=3.5e-3, attitude_rotation=LEVEL)
ASKEW = np.array([1.2, -0.7, 0.5])  # rotation vector of a sensor that is mounted anyhow [rad]


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


@pytest.fixture(scope="module")
def tilted(robot):
    """The robot with swivel axes that are not upright, so that sag turns pulleys."""
    axis = robot.swivel_axis + 0.3 * np.random.default_rng(0).standard_normal((4, 3))
    return replace(robot, swivel_axis=axis / np.linalg.norm(axis, axis=1, keepdims=True))


def attitude_of(state):
    turn = pinocchio.exp3(np.array([0.0, 0.0, state.heading])) @ state.rotation @ state.mounting
    return from_matrix(turn[None])[0]


def inclination_of(state):
    return roll_and_pitch((state.rotation @ state.mounting)[None])[0]


def test_pulleys_are_expected_where_hanging_cables_turn_them(tilted, settings, state):
    at = RestStart(tilted, settings, state.errors).state(
        0.0, statics.inverse_kinematics(tilted, state.position[None]).unstrained_length[0]
    )
    angle = swivel_angle(tilted, -at.exit_tension[None])[0]
    assert np.abs(at.swivel_sag).max() > 2e-3
    assert measured_swivels(tilted, at, angle, settings).residual == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sensor", ["swivels", "attitude", "inclination"])
def test_a_reading_is_off_by_each_error_as_the_model_says(robot, settings, state, sensor):
    """The reading stays; the estimate is wrong by one error after another."""
    model, reading = {
        "swivels": (measured_swivels, swivel_angle(robot, -state.exit_tension[None])[0]),
        "attitude": (measured_attitude, attitude_of(state)),
        "inclination": (measured_inclination, inclination_of(state)),
    }[sensor]
    by = model(robot, state, reading, settings).by
    for k in range(state.errors.size):
        error = 1e-5 * np.eye(state.errors.size)[k]
        sides = [
            model(robot, state.corrected(sign * error, state.covariance), reading, settings)
            for sign in (1.0, -1.0)
        ]
        change = (sides[1].residual - sides[0].residual) / 2e-5
        if sensor == "inclination":  # axes across the vertical may have turned
            change, wanted = np.linalg.norm(change), np.linalg.norm(by[:, k])
        else:
            wanted = by[:, k]
        np.testing.assert_allclose(change, wanted, rtol=1e-4, atol=1e-5)


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


@pytest.fixture(scope="module")
def swings(robot):
    """Runs in the wind, by the suite."""
    suites = ("lengths+swivel", "lengths+attitude", "lengths+inclination")
    return {
        suite: swing(robot, suite, SensorSettings(), seed=3, wind=3.0, duration=4.0)
        for suite in suites
    }


@pytest.fixture(scope="module")
def blind(robot, swings):
    """Errors on lengths alone."""
    settings = DynamicEstimatorSettings(**KNOWN)
    return believe(DynamicEstimator.build(robot, settings), swings["lengths+swivel"])[0]


def changed(found, channel, change):
    """Another reading of a channel in each measurement."""
    return [(replace(m, **{channel: change(getattr(m, channel))}), truth) for m, truth in found]


def mounted_anyhow(stamped):
    turned = to_matrix(stamped.value) @ from_rotation_vector(ASKEW)
    return replace(stamped, value=from_matrix(turned))


def tilted_anyhow(stamped):
    """Roll and pitch of another mounting tell the same vertical."""
    up = vertical(stamped.value) @ from_rotation_vector(ASKEW)
    pitch, roll = -np.arcsin(up[:, 0]), np.arctan2(up[:, 1], up[:, 2])
    return replace(stamped, value=np.column_stack([roll, pitch]))


def zeros_anywhere(stamped):
    return replace(stamped, value=wrapped_angle(stamped.value + np.array([3.0, -1.0, 0.5, 2.0])))


def check(errors, beliefs, blind, share):
    """Errors are smaller, as the covariance says, and so are innovations."""
    assert rms(errors) < share * rms(blind)
    squares = [
        e[:6] @ np.linalg.solve(b.covariance[0, :6, :6], e[:6]) / 6.0
        for e, b in zip(errors[50:], beliefs[50:], strict=True)
    ]
    assert 0.3 < np.mean(squares) < 2.0
    innovations = [b.innovations for b in beliefs]
    square, freedoms = (sum(getattr(i, k)[0] for i in innovations) for k in ("squares", "dof"))
    assert 0.5 < square / freedoms < 1.5


@pytest.mark.parametrize("offset", [3.5e-3, None])
def test_swivel_angles_tell_what_the_wind_does(robot, swings, blind, offset):
    """Nothing needs to be known of zeros."""
    settings = DynamicEstimatorSettings(**KNOWN, swivels=True, swivel_offset=offset)
    found = swings["lengths+swivel"]
    found = changed(found, "swivel_angle", zeros_anywhere) if offset is None else found
    errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    check(errors, beliefs, blind, 0.7)


@pytest.mark.parametrize("mounted", [LEVEL, tuple(ASKEW)])
@pytest.mark.parametrize("channel", ["attitude", "inclination"])
def test_an_orientation_tells_what_the_wind_does(robot, swings, blind, channel, mounted):
    settings = DynamicEstimatorSettings(**KNOWN, attitude_rotation=mounted)
    found = swings[f"lengths+{channel}"]
    if mounted == tuple(ASKEW):
        change = mounted_anyhow if channel == "attitude" else tilted_anyhow
        found = changed(found, channel, change)
    errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    check(errors, beliefs, blind, 0.8)
    assert rms(errors[:, 6:9]) < 0.7 * rms(blind[:, 6:9])


def test_a_sensor_whose_mounting_is_not_stated_is_not_used(robot, swings):
    estimator = DynamicEstimator.build(robot, DynamicEstimatorSettings(**KNOWN))
    for channel in ("attitude", "inclination"):
        _, beliefs = believe(estimator, swings[f"lengths+{channel}"][:20])
        assert sum(belief.innovations.dof[0] for belief in beliefs) == 0.0


def test_an_ahrs_that_is_later_than_lengths_counts_for_when_it_was_read(robot, blind):
    sensors = SensorSettings(attitude_delay=0.04)
    found = swing(robot, "lengths+attitude", sensors, seed=3, wind=3.0, duration=4.0)
    settings = DynamicEstimatorSettings(**KNOWN, attitude_rotation=LEVEL)
    errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    assert sum(belief.innovations.dof[0] for belief in beliefs) > 0.9 * 3 * len(found)
    check(errors, beliefs, blind, 0.95)


def test_readings_that_come_too_late_are_counted(robot):
    sensors = SensorSettings(attitude_delay=0.2)
    found = swing(robot, "lengths+attitude", sensors, duration=1.0)
    settings = DynamicEstimatorSettings(**KNOWN, attitude_rotation=LEVEL)
    _, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    assert sum(belief.innovations.rejected[0] for belief in beliefs) > 10


def test_a_delay_of_the_lengths_loses_no_reading(robot):
    """Stamps that are the same but for rounding are one stop of the filter."""
    found = swing(robot, "lengths+imu+swivel+attitude", SensorSettings(), duration=1.0)
    settings = DynamicEstimatorSettings(**KNOWN, swivels=True, attitude_rotation=LEVEL, delay=0.03)
    _, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    freedoms = np.array([belief.innovations.dof[0] for belief in beliefs[5:]])
    assert (freedoms >= 4 + 3 + 6).all()


def test_a_heading_that_drifts_turns_no_platform(robot, swings):
    """A degree a minute, for as long as the platform swings."""
    rate, settings = (
        np.radians(1.0) / 60.0,
        DynamicEstimatorSettings(**KNOWN, attitude_rotation=LEVEL),
    )
    scale = 20.0  # so that the few seconds here are a minute and more

    def drifting(stamped):
        turn = from_rotation_vector(scale * rate * stamped.time[:, None] * np.array([0, 0, 1.0]))
        return replace(stamped, value=from_matrix(turn @ to_matrix(stamped.value)))

    estimator = DynamicEstimator.build(robot, replace(settings, attitude_heading_walk=0.01))
    still, _ = believe(estimator, swings["lengths+attitude"])
    errors, _ = believe(estimator, changed(swings["lengths+attitude"], "attitude", drifting))
    assert np.abs(errors[:, 5] - still[:, 5]).max() < 0.25 * scale * rate * 4.0


def test_of_ahrs_and_inclinometer_the_ahrs_counts_whichever_reads_more_often(robot, swings):
    settings = DynamicEstimatorSettings(attitude_rotation=LEVEL)
    found = swings["lengths+attitude"][:40]
    few = [(m if k % 4 == 0 else replace(m, attitude=None), t) for k, (m, t) in enumerate(found)]
    absurd = np.array([[1.0, -1.0]])
    both = [
        (replace(m, inclination=Stamped(time=full.attitude.time, value=absurd)), truth)
        for (m, truth), (full, _) in zip(few, found, strict=True)
    ]
    alone, _ = believe(DynamicEstimator.build(robot, settings), few)
    together, _ = believe(DynamicEstimator.build(robot, settings), both)
    np.testing.assert_array_equal(alone, together)


def test_a_platform_on_its_side_has_an_inclination_too(robot, settings, state):
    """Roll and pitch are undefined at 90 degrees of pitch; the vertical is not."""
    on_side = replace(
        state, mounting=state.rotation.T @ pinocchio.exp3(np.array([0, np.pi / 2, 0]))
    )
    found = measured_inclination(robot, on_side, np.array([0.3, np.pi / 2 - 1e-9]), settings)
    assert np.isfinite(found.by).all() and np.abs(found.by).max() < 10.0
    assert np.abs(found.residual).max() < 1e-6


def test_sensors_that_are_not_used_have_no_states(robot):
    def size(robot, **used):
        settings = settings_for(robot, DynamicEstimatorSettings(**used))
        return DynamicModel(robot, settings).errors.size

    assert size(robot, swivels=True) == size(robot, attitude_rotation=LEVEL) == size(robot) + 4
    bare = ct.load_robot("carosac")  # without pulleys
    assert size(bare, swivels=True) == size(bare)
    with pytest.raises(InvalidField, match="swivels: got 1; allowed: True or False"):
        DynamicEstimatorSettings(swivels=1)
    for wrong in ((0.0, 1.0), (np.nan, 0.0, 0.0)):
        with pytest.raises(InvalidField, match=r"^attitude_rotation"):
            DynamicEstimatorSettings(attitude_rotation=wrong)
