"""Propagation, lengths and poses of rest against finite differences and other solvers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

import carosac_toolkit as ct
from baselines.ks_ekf import KsEkfSettings, initial_state
from baselines.ks_ekf.cable_model import ExpectedLengths, expected_lengths
from baselines.ks_ekf.cable_swing import CableSwing
from baselines.ks_ekf.error_filter import ErrorFilter
from baselines.ks_ekf.filter_settings import FilterSettings, filter_settings
from baselines.ks_ekf.filter_state import (
    FIXED_ERROR_COUNT,
    LENGTH_ERRORS,
    POSE_ERRORS,
    InertialSamples,
    KsEkfState,
)
from baselines.ks_ekf.inertial import InertialMotion, slope
from baselines.ks_ekf.platform_motion import carried, moved_to_imu, origin
from baselines.ks_ekf.rest_detection import RecentMeasurements, detect_rest
from baselines.ks_ekf.rest_pose import find_rest
from baselines.ks_ekf.timed_lengths import TimedLengths
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics

ROBOT = ct.load_robot("carosac")
SIZE = FIXED_ERROR_COUNT + ROBOT.n
SETTINGS = filter_settings(ROBOT, KsEkfSettings(imu_position=np.array([0.1, -0.05, 0.2])))


def moving_state() -> KsEkfState:
    """A rotated, turning and accelerating platform, with all biases."""
    rng = np.random.default_rng(1)
    time = np.array([0.0, 0.004, 0.01, 0.015])
    samples = InertialSamples(
        time=time,
        rate=rng.normal(0.0, 0.5, (4, 3)),
        force=rng.normal([0.0, 0.0, 9.8], 2.0, (4, 3)),
    )
    return replace(
        initial_state.blank(ROBOT, SETTINGS, 0.0),
        position=np.array([0.5, -1.5, 3.0]),
        rotation=pinocchio.exp3(np.array([0.4, -0.3, 0.7])),
        velocity=np.array([0.3, -0.6, 0.2]),
        rate_bias=np.array([0.02, -0.01, 0.03]),
        force_bias=np.array([0.1, 0.2, -0.1]),
        length_bias=rng.normal(0.0, 5e-3, ROBOT.n),
        inertial=True,
        samples=samples,
    )


def difference(one: KsEkfState, other: KsEkfState) -> Array:
    """Error that leads from one state to another, shape (18 + n,)."""
    return np.concatenate(
        [
            other.position - one.position,
            pinocchio.log3(other.rotation @ one.rotation.T),
            other.velocity - one.velocity,
            other.rate_bias - one.rate_bias,
            other.force_bias - one.force_bias,
            other.center - one.center,
            other.length_bias - one.length_bias,
        ]
    )


def test_covariance_is_carried_as_small_errors_are():
    kalman = ErrorFilter(SIZE, 0.99)
    quiet = replace(
        SETTINGS, angular_rate_noise=1e-12, specific_force_noise=1e-12, bias_walk=0.0,
        rate_change=1e-9, force_change=1e-9,
    )  # fmt: skip
    motion = InertialMotion(9.81, quiet, SIZE, kalman)
    state = moving_state()
    after = motion.advance(state, 0.0185)
    assert after.time == pytest.approx(0.0185)
    step, columns = 1e-6, []
    for row in step * np.eye(SIZE):
        up = motion.advance(state.injected(row, state.covariance), 0.0185)
        down = motion.advance(state.injected(-row, state.covariance), 0.0185)
        columns.append((difference(after, up) - difference(after, down)) / (2.0 * step))
    jacobian = np.array(columns).T
    expected = jacobian @ state.covariance @ jacobian.T
    # Terms of the third order in the step are left out.
    assert after.covariance == pytest.approx(expected, abs=2e-5)


def test_injected_error_moves_the_origin_of_the_rotation_error():
    state, error = moving_state(), np.zeros(SIZE)
    error[3:6] = [0.3, -0.2, 0.25]
    after = state.injected(error, state.covariance)
    step, columns = 1e-6, []
    for row in step * np.eye(3):
        turns = [pinocchio.exp3(error[3:6] + s * row) @ state.rotation for s in (1.0, -1.0)]
        both = [pinocchio.log3(turn @ after.rotation.T) for turn in turns]
        columns.append((both[0] - both[1]) / (2.0 * step))
    jacobian = np.array(columns).T
    block = jacobian @ state.covariance[3:6, 3:6] @ jacobian.T
    assert after.covariance[3:6, 3:6] == pytest.approx(block, abs=1e-8)


def test_free_fall_and_rest_are_integrated_exactly():
    motion = InertialMotion(9.81, SETTINGS, SIZE, ErrorFilter(SIZE, 0.99))
    time = np.arange(0.0, 0.105, 0.005)
    none = np.zeros((len(time), 3))
    still = replace(
        moving_state(), rate_bias=np.zeros(3), force_bias=np.zeros(3), velocity=np.ones(3)
    )
    falling = replace(still, samples=InertialSamples(time=time, rate=none, force=none))
    after = motion.advance(falling, 0.1)
    assert after.velocity == pytest.approx([1.0, 1.0, 1.0 - 0.981])
    assert after.position - still.position == pytest.approx([0.1, 0.1, 0.1 - 0.5 * 9.81 * 0.01])
    held = none + still.rotation.T @ [0.0, 0.0, 9.81]
    after = motion.advance(
        replace(still, samples=InertialSamples(time=time, rate=none, force=held)), 0.1
    )
    assert after.velocity == pytest.approx(still.velocity)


def test_map_from_imu_to_origin_is_that_of_small_errors():
    state = moving_state()
    twist, covariance = carried(state, SETTINGS)
    quiet = replace(SETTINGS, angular_rate_noise=1e-12)

    def outputs(s: KsEkfState) -> Array:
        moved, _ = carried(s, quiet)
        turn = pinocchio.log3(s.rotation @ state.rotation.T)
        return np.concatenate([origin(s, SETTINGS.imu_position), turn, moved])

    step = 1e-6
    columns = []
    for row in step * np.eye(SIZE):
        up, down = (outputs(state.injected(s * row, state.covariance)) for s in (1.0, -1.0))
        columns.append((up - down) / (2.0 * step))
    jacobian = np.array(columns).T
    expected = jacobian @ state.covariance @ jacobian.T
    assert carried(state, quiet)[1] == pytest.approx(expected, abs=1e-6)
    assert (np.diag(covariance) >= np.diag(expected) - 1e-9).all()
    rate = state.rotation @ (state.samples.rate[0] - state.rate_bias)
    assert twist[3:] == pytest.approx(rate)
    at_origin = replace(state, position=origin(state, SETTINGS.imu_position), velocity=twist[:3])
    back = moved_to_imu(at_origin, rate, SETTINGS.imu_position)
    assert back.position == pytest.approx(state.position)
    assert back.velocity == pytest.approx(state.velocity)


def test_pose_is_kept_at_the_origin_where_the_state_is_lost():
    state, lever = moving_state(), SETTINGS.imu_position
    back = initial_state.inertial(initial_state.released(state, SETTINGS), SETTINGS)
    assert back.velocity == pytest.approx(state.velocity)
    assert back.covariance == pytest.approx(state.covariance)
    assert difference(back, state) == pytest.approx(np.zeros(SIZE), abs=1e-9)
    for found in (
        initial_state.lost(ROBOT, SETTINGS, state, 1.0),
        initial_state.forgotten(ROBOT, SETTINGS, state),
    ):
        assert not found.inertial
        assert found.position == pytest.approx(state.position - state.rotation @ lever)
        assert found.rotation == pytest.approx(state.rotation)
        again = initial_state.lost(ROBOT, SETTINGS, found, 1.1)  # there already
        assert again.position == pytest.approx(found.position)


def state_at_rest(settings: FilterSettings) -> tuple[KsEkfState, statics.Equilibrium]:
    """An equilibrium away from home, as the filter sees it."""
    rest = statics.inverse_kinematics(ROBOT, np.array([[1.2, -3.0, 2.4]]))
    force = rest.rotation[0].T @ [0.0, 0.0, 9.81]
    state = replace(
        moving_state(),
        position=rest.position[0] + rest.rotation[0] @ settings.imu_position,
        rotation=rest.rotation[0],
        rate_bias=np.zeros(3),
        force_bias=np.zeros(3),
        covariance=1e-8 * np.eye(SIZE),
        samples=InertialSamples(time=np.zeros(1), rate=np.zeros((1, 3)), force=force[None]),
    )
    return state, rest


def test_lengths_at_rest_are_those_of_the_statics():
    state, rest = state_at_rest(SETTINGS)
    found = expected_lengths(ROBOT, state, np.zeros(3), CableSwing(), SETTINGS)
    assert found.valid.all()
    assert found.tension == pytest.approx(rest.tension[0], rel=0.02)
    assert found.length == pytest.approx(rest.unstrained_length[0], abs=1e-4)


def test_length_jacobian_is_that_of_small_errors():
    state, _ = state_at_rest(SETTINGS)
    found = expected_lengths(ROBOT, state, np.zeros(3), CableSwing(), SETTINGS)
    step, columns = 1e-5, []
    for row in step * np.eye(SIZE):
        both = [
            expected_lengths(ROBOT, s, np.zeros(3), CableSwing(), SETTINGS).length + s.length_bias
            for s in (state.injected(row, state.covariance), state.injected(-row, state.covariance))
        ]
        columns.append((both[0] - both[1]) / (2.0 * step))
    jacobian = np.array(columns).T
    # Tensions follow the pose too, which the filter leaves out: parts per thousand.
    assert found.jacobian[:, POSE_ERRORS] == pytest.approx(jacobian[:, POSE_ERRORS], abs=5e-3)
    assert found.jacobian[:, LENGTH_ERRORS] == pytest.approx(np.eye(ROBOT.n))


def test_slack_cable_says_nothing():
    state, _ = state_at_rest(SETTINGS)
    falling = InertialSamples(time=np.zeros(1), rate=np.zeros((1, 3)), force=np.zeros((1, 3)))
    found = expected_lengths(
        ROBOT, replace(state, samples=falling), np.zeros(3), CableSwing(), SETTINGS
    )
    assert not found.valid.any()


def test_lengths_count_less_where_motion_changes_the_tension():
    state, _ = state_at_rest(SETTINGS)
    blind = replace(SETTINGS, tension_change=0.0)

    def spread(factor: float, settings: FilterSettings) -> Array:
        samples = replace(state.samples, force=factor * state.samples.force)
        found = expected_lengths(
            ROBOT, replace(state, samples=samples), np.zeros(3), CableSwing(), settings
        )
        assert found.valid.all()
        return found.spread

    assert spread(1.0, SETTINGS) == pytest.approx(spread(1.0, blind), rel=1e-3)
    for factor in (0.8, 1.4):
        assert (spread(factor, SETTINGS) > 1.5 * spread(factor, blind)).all()


def test_pose_of_rest_moves_with_lengths_and_centre_of_mass():
    rest = statics.inverse_kinematics(ROBOT, np.array([[1.0, -3.0, 2.5]]))
    lengths = rest.unstrained_length[0]
    found = find_rest(ROBOT, lengths, np.zeros(3), None, SETTINGS.length_step)
    assert found is not None
    assert found.position == pytest.approx(rest.position[0], abs=1e-6)
    change = np.array([4e-3, -2e-3, 1e-3, 3e-3])
    other = statics.forward_kinematics(ROBOT, (lengths + change)[None], guess=rest)
    moved = found.position + (found.per_length @ change)[:3]
    assert moved == pytest.approx(other.position[0], abs=2e-4)
    shift = np.array([4e-3, -3e-3, 2e-3])
    shifted = replace(ROBOT, center_of_mass=ROBOT.center_of_mass + shift)
    other = statics.forward_kinematics(shifted, lengths[None])
    moved_by_center = find_rest(ROBOT, lengths, shift, None, SETTINGS.length_step)
    assert moved_by_center is not None
    turn = pinocchio.log3(moved_by_center.rotation @ other.rotation[0].T)
    lean = pinocchio.log3(found.rotation @ other.rotation[0].T)
    assert np.linalg.norm(turn) < 0.1 * np.linalg.norm(lean)
    assert moved_by_center.position == pytest.approx(other.position[0], abs=1e-3)


def test_rest_is_quiet_encoders_and_quiet_imu():
    settings = filter_settings(ROBOT, KsEkfSettings())
    time = np.arange(0.0, 1.2, 0.005)
    bias, still = np.array([0.01, -0.02, 0.0]), np.zeros((len(time), 3))
    window = RecentMeasurements(time=np.zeros(0), lengths=np.zeros((0, 4)))

    def seen(sway: float, wind: float, shake: float = 0.0) -> RecentMeasurements:
        rate = still + bias
        rate[:, 0] += sway * np.sin(2.8 * time)
        force = still + np.array([0.0, 0.0, 9.81]) + shake * np.sin(40.0 * time)[:, None]
        samples = InertialSamples(time=time, rate=rate, force=force)
        found = window
        for k in range(0, len(time), 4):
            part = samples.keep(slice(k, k + 4))
            lengths = 8.0 + wind * time[k] * np.ones(4)
            reading = TimedLengths(time=time[k], lengths=lengths, rates=np.zeros(4))
            found = found.extended([reading], part, 1.0)
        return found

    quiet = detect_rest(seen(0.0, 0.0), bias, settings)
    assert quiet is not None
    assert quiet.rate == pytest.approx(bias)
    assert detect_rest(seen(0.1, 0.0), bias, settings) is None
    assert detect_rest(seen(0.1, 0.0), bias, replace(settings, rest_rate=0.2)) is not None
    assert detect_rest(seen(0.0, 0.0, 0.3), bias, settings) is None
    assert detect_rest(seen(0.0, 0.0, 0.3), bias, replace(settings, rest_force=0.5)) is not None
    assert detect_rest(seen(0.0, 0.1), bias, settings) is None
    assert (
        detect_rest(RecentMeasurements(time=time, lengths=np.zeros((len(time), 4))), bias, settings)
        is None
    )


def test_slope_is_the_angular_acceleration():
    time = np.arange(0.0, 0.05, 0.005)
    samples = InertialSamples(
        time=time, rate=np.outer(time, [1.0, -2.0, 0.5]), force=np.zeros((10, 3))
    )
    assert slope(samples, 0.02, 0.0125) == pytest.approx([1.0, -2.0, 0.5])
    assert slope(samples, 9.0, 0.0125) == pytest.approx(np.zeros(3))


def test_lengths_of_a_swinging_cable_count_less_until_it_has_calmed_down():
    state, _ = state_at_rest(SETTINGS)
    loose = replace(state.samples, force=0.1 * state.samples.force)  # a tenth of the weight

    def found(swing: CableSwing, time: float, samples: InertialSamples) -> ExpectedLengths:
        at = replace(state, time=time, samples=samples)
        return expected_lengths(ROBOT, at, np.zeros(3), swing, SETTINGS)

    calm = found(CableSwing(), 0.0, state.samples)
    for held, least in ((0.02, 0.0), (1.0, 3e-4)):  # [s] that it hangs loose, [m] for that
        sagging = found(calm.swing, held, loose)
        taut = found(sagging.swing, held + 0.01, state.samples)
        assert taut.valid.all()
        assert (taut.spread > calm.spread + least).all()
        assert taut.length == pytest.approx(calm.length, abs=1e-9)
    late = found(taut.swing, 20.0 * SETTINGS.swing_fade_time, state.samples)
    assert late.spread == pytest.approx(calm.spread, rel=1e-6)


def test_a_robot_whose_lower_cables_hang_loose_by_least_squares_keeps_finite_swings():
    robot = ct.load_robot("ipanema1")
    settings = filter_settings(robot, KsEkfSettings())
    place = np.array([[-1.16, 0.50, 1.50]])
    state = replace(
        initial_state.blank(robot, settings, 0.0), position=place[0], rotation=np.eye(3),
        samples=InertialSamples(
            time=np.zeros(1), rate=np.zeros((1, 3)), force=np.array([[0.0, 0.0, 9.81]])
        ),
    )  # fmt: skip
    found = expected_lengths(robot, state, np.zeros(3), CableSwing(), settings)
    again = expected_lengths(robot, replace(state, time=0.02), np.zeros(3), found.swing, settings)
    assert (found.tension < 0.0).any()
    assert np.isfinite(again.swing.sag).all() and np.isfinite(again.swing.speed).all()
    assert np.isfinite(again.spread[again.valid]).all()
