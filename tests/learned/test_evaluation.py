"""Protocols are the same for all policies of a robot, and inverse kinematics is judged by them."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import statics
from learned import evaluation
from learned.environment import EnvironmentSettings
from learned.evaluation import (
    evaluate,
    evaluate_inverse_kinematics,
    random_trajectories,
    rmse_ratio,
    timed,
    trajectory_errors,
    trajectory_rmse,
)
from learned.moving_worlds import MovingSettings
from learned.observation import ObservationScales
from learned.policy_file import PolicyDescription
from learned.rewards import RewardSettings
from learned.target_paths import PathSettings
from tests.robots import simple_robot

ROBOT = simple_robot()
SMOOTH = PathSettings(kind="minimum_snap", speed=(1.0, 1.0), period=0.1, steps=20)
IN_MOTION = EnvironmentSettings(
    world="realtime", observation=("error", "velocity_error"), action="push",
    reward=RewardSettings(terms=("tracking",)), path=SMOOTH,
)  # fmt: skip
OTHERWISE = replace(  # trained on something else altogether
    IN_MOTION, observation=("error", "preview"), preview=(3,), reach=1.0, share=0.5, lost=0.1,
    path=replace(SMOOTH, speed=(2.0, 3.0), acceleration_max=9.0, steps=7, pool=3),
    moving=MovingSettings(cables="catenary", perturbation="none", position_bias=0.1,
                          length_bias=0.2, start_speed=1.0),
)  # fmt: skip
SET_POINTS = EnvironmentSettings(observation=("target",))


def policy(settings: EnvironmentSettings, act: Any) -> Any:
    """What an evaluation takes of a policy."""
    description = PolicyDescription(
        preset="none", robot=ROBOT, observation=settings.observation, action=settings.action,
        period=settings.path.period, settings={"environment": asdict(settings)}, seed=0, steps=0,
        commit="", scores={},
    )  # fmt: skip
    return SimpleNamespace(description=description, act=act)


def still(seen):
    return np.zeros((len(seen), 3))


def solver(offset=0.0):
    """The lengths of the target, a constant too long."""
    scales = ObservationScales.of(ROBOT)

    def act(seen):
        rest = statics.inverse_kinematics(ROBOT, scales.center + scales.half * seen)
        return scales.to_action(rest.unstrained_length + offset)

    return act


@pytest.fixture(scope="module")
def resting():
    return evaluate(policy(IN_MOTION, still), "realtime", paths=2, seed=3)


def test_real_time_is_the_same_whatever_a_policy_was_trained_on(resting):
    other = evaluate(policy(OTHERWISE, still), "realtime", paths=2, seed=3)
    for name in ("target", "position", "length", "tension", "counted"):
        np.testing.assert_array_equal(getattr(resting, name), getattr(other, name), err_msg=name)


def test_no_push_is_inverse_kinematics(resting):
    other = evaluate_inverse_kinematics(policy(OTHERWISE, None), "realtime", paths=2, seed=3)
    np.testing.assert_array_equal(resting.position, other.position)
    pushing = replace(OTHERWISE, feedforward=True)
    again = evaluate_inverse_kinematics(policy(pushing, None), "realtime", paths=2, seed=3)
    np.testing.assert_array_equal(resting.position, again.position)
    assert rmse_ratio(resting, other) == 1.0
    assert not np.array_equal(resting.position[0], resting.target[0])  # it sways


def test_feedforward_alone_is_a_policy_of_it_that_never_acts(resting):
    arguments = {"paths": 2, "seed": 3}
    pushing = policy(replace(IN_MOTION, feedforward=True), still)
    mine = evaluate(pushing, "realtime", **arguments)
    other = evaluate_inverse_kinematics(pushing, "realtime", feedforward=True, **arguments)
    np.testing.assert_array_equal(mine.position, other.position)
    assert not np.array_equal(mine.position, resting.position)


def test_real_time_follows_whole_paths_and_a_second_of_rest(resting):
    paths = random_trajectories(ROBOT, 2, 3)
    for path, target, counted in zip(paths, resting.target, resting.counted, strict=True):
        steps = int(counted.sum())
        assert counted[:steps].all() and not counted[steps:].any()
        assert 0.0 <= 0.1 * steps - (path.duration + 1.0) < 0.1
        times = 0.1 * np.arange(1, steps + 1)
        np.testing.assert_array_equal(target[:steps], path.sample(times).position)
        np.testing.assert_array_equal(
            target[steps - 10 :], np.tile(target[-1], (len(target) - steps + 10, 1))
        )
    assert len(set(resting.counted.sum(axis=1))) == 2  # they differ in length
    assert resting.counted.shape[1] == resting.counted.sum(axis=1).max()


def test_paths_do_not_depend_on_the_period_and_keep_the_limits_of_the_protocol():
    for path in random_trajectories(ROBOT, 3, 0):
        coarse, fine = timed(path, 0.1), timed(path, 0.05)
        both = min(len(coarse.position), len(fine.position[::2]))
        np.testing.assert_allclose(fine.position[::2][:both], coarse.position[:both], atol=1e-9)
        speed = np.linalg.norm(fine.velocity, axis=1)
        assert speed[0] == speed[-1] == 0.0
        assert 0.4 < speed.max() <= 2.08 + 1e-9
        assert np.linalg.norm(fine.acceleration, axis=1).max() <= 2.0 + 1e-6
        rest = statics.inverse_kinematics(ROBOT, coarse.position)
        assert (rest.converged & rest.stable).all()


def test_set_points_of_inverse_kinematics_are_reached_and_leave_no_cable_slack(monkeypatch):
    monkeypatch.setattr(evaluation, "SET_POINTS_PER_PATH", 4)
    arguments = {"paths": 3, "seed": 1}
    exact = evaluate_inverse_kinematics(policy(SET_POINTS, None), "settle", **arguments)
    np.testing.assert_allclose(exact.error, 0.0, atol=1e-5)
    data = exact.data(ROBOT)
    assert data["slack_share"] == data["overload_share"] == data["failures"] == 0
    mine = evaluate(policy(SET_POINTS, solver()), "settle", **arguments)
    np.testing.assert_array_equal(mine.target, exact.target)
    np.testing.assert_allclose(mine.length, exact.length, atol=1e-6)
    low = evaluate(policy(SET_POINTS, solver(0.05)), "settle", **arguments)
    assert (low.error[..., 2] < -0.02).all()  # longer cables hang deeper
    assert rmse_ratio(low, mine) > 100.0


def test_without_sag_inverse_kinematics_is_exact_and_not_asked():
    with pytest.raises(InvalidField, match="protocol: got 'no-sag'; allowed: 'settle' or"):
        evaluate_inverse_kinematics(policy(SET_POINTS, None), "no-sag", paths=1, seed=0)


@pytest.mark.parametrize(
    ("settings", "protocol", "message"),
    [
        (SET_POINTS, "realtime", "'no-sag' or 'settle', as the policy was trained"),
        (IN_MOTION, "settle", "'realtime', as the policy was trained"),
        (IN_MOTION, "fast", "one of"),
    ],
)
def test_a_protocol_must_fit_the_policy(settings, protocol, message):
    with pytest.raises(InvalidField, match=message):
        evaluate(policy(settings, still), protocol, paths=1, seed=0)


def test_what_comes_after_the_end_of_a_path_is_no_part_of_its_errors(resting):
    position = np.array(resting.position)
    position[~resting.counted] = 1e3
    moved = replace(resting, position=position)
    np.testing.assert_equal(moved.data(ROBOT), resting.data(ROBOT))
    np.testing.assert_array_equal(trajectory_errors(moved), trajectory_errors(resting))
    rmse = trajectory_rmse(moved)
    for k, row in enumerate(resting.counted):
        expected = np.sqrt((resting.error[k, row] ** 2).mean(axis=0))
        np.testing.assert_allclose(rmse[k], expected, rtol=1e-12)


def test_cables_that_errors_leave_slack_at_rest_are_counted_without_motion(monkeypatch):
    tried = policy(IN_MOTION, still)
    exact = replace(evaluation.EVALUATION_WORLDS, perturbation="none", length_bias=0.0)
    monkeypatch.setattr(evaluation, "EVALUATION_WORLDS", exact)
    assert evaluation.slack_at_rest(tried, paths=4, seed=1) == 0.0
    monkeypatch.setattr(evaluation, "EVALUATION_WORLDS", replace(exact, length_bias=0.3))
    assert 0.1 < evaluation.slack_at_rest(tried, paths=4, seed=1) <= 1.0


def test_a_ratio_is_of_the_steps_that_count_for_both(resting):
    failed = np.zeros_like(resting.failed)
    failed[0, 5] = True
    position = resting.target + 2.0 * resting.error
    position[0, 5:] = np.nan  # stands where it failed, and counts no more
    twice = replace(resting, position=position, failed=failed)
    assert rmse_ratio(twice, resting) == pytest.approx(2.0)
    assert rmse_ratio(resting, twice) == pytest.approx(0.5)
    nothing = replace(resting, failed=np.ones_like(failed))
    assert np.isnan(rmse_ratio(nothing, resting))
