import copy
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from learned.environment import FAILURE_REWARD, CableEnvironment, EnvironmentSettings
from learned.moving_worlds import MovingSettings
from learned.observation import slices
from learned.rewards import PAPER_SAG, RewardSettings
from learned.target_paths import PathSettings
from tests.robots import simple_robot

SHORT = PathSettings(steps=4)
NO_SAG = EnvironmentSettings(path=SHORT)
SETTLE = EnvironmentSettings(world="settle", path=SHORT, reward=RewardSettings(terms=PAPER_SAG))
REALTIME = EnvironmentSettings(
    world="realtime", action="push", path=PathSettings(steps=4, period=0.05),
    observation=("error", "velocity", "tilt", "target_velocity", "preview", "last_action",
                 "mean_error"),
    preview=(2, 5), reward=RewardSettings(terms=("tracking", "effort")),
)  # fmt: skip
WORLDS = {"no_sag": NO_SAG, "settle": SETTLE, "realtime": REALTIME}


def made(settings, size=3, seed=0, robot=None):
    return CableEnvironment(robot or simple_robot(), settings, size=size, seed=seed)


def reaching(environment):
    """Actions whose lengths are those of rest at the targets, or no push."""
    if environment.settings.action == "push":
        return np.zeros((environment.size, environment.action_size))
    state = environment.state()
    target = np.stack(
        [path.position[k + 1] for path, k in zip(state["paths"], state["step"], strict=True)]
    )
    if environment.settings.world == "no_sag":
        length = straight_line.inverse_kinematics(environment.robot, target)
    else:
        length = statics.inverse_kinematics(environment.robot, target).unstrained_length
    return environment.scales.to_action(length)


def played(environment, steps, seed=7):
    """Observations and rewards of right actions with some noise."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(steps):
        action = reaching(environment)
        action = np.clip(action + 0.01 * rng.standard_normal(action.shape), -1.0, 1.0)
        result = environment.step(action)
        found.append((result.observation, result.final_observation, result.reward))
    return found


def assert_same(first, second):
    for one, other in zip(first, second, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("robot, world", [("carosac", "no_sag"), ("scampi", "no_sag"),
                                          ("cogiro", "no_sag"), ("carosac", "settle"),
                                          ("scampi", "settle")])  # fmt: skip
def test_targets_are_the_path_and_right_lengths_reach_them(robot, world):
    robot = load_robot(robot)
    environment = made(WORLDS[world], 2, robot=robot)
    environment.reset()
    paths = environment.paths
    for step in range(4):
        result = environment.step(reaching(environment))
        target = np.stack([path.position[step + 1] for path in paths])
        np.testing.assert_array_equal(result.transition.target, target)
        np.testing.assert_allclose(result.transition.position, target, atol=1e-5)
        np.testing.assert_allclose(result.transition.inconsistency, 0.0, atol=1e-5)
    assert environment.action_size == robot.n
    assert environment.observation_size == robot.n + 6


@pytest.mark.parametrize("world", WORLDS)
def test_the_reward_is_that_of_the_transition(world):
    environment = made(WORLDS[world])
    environment.reset()
    result = environment.step(reaching(environment))
    np.testing.assert_array_equal(result.reward, environment.reward(result.transition))
    assert environment.reward.span == pytest.approx(4.0 * np.sqrt(3.0))


@pytest.mark.parametrize("world", ["no_sag", "settle"])
def test_a_transition_says_what_was_before_and_what_came_of_it(world):
    environment = made(WORLDS[world])
    environment.reset()
    start = environment.state()["reached"]
    action = reaching(environment) + 0.02
    step = environment.step(action).transition
    np.testing.assert_array_equal(step.position_before, start.position)
    np.testing.assert_array_equal(step.length_before, start.length)
    np.testing.assert_allclose(step.asked, environment.scales.to_length(action))
    np.testing.assert_allclose(step.length, step.asked, atol=1e-9)
    straight = straight_line.straight_length(environment.robot, step.position).length
    np.testing.assert_array_equal(step.straight_position, straight)
    wanted = straight_line.inverse_kinematics(environment.robot, step.target)
    np.testing.assert_array_equal(step.straight_target, wanted)


@pytest.mark.parametrize("world", ["no_sag", "realtime"])
def test_slack_has_no_price_where_it_could_not_act(world):
    reward = replace(WORLDS[world].reward, slack=1.0)
    with pytest.raises(InvalidField, match=r"reward\.slack: got 1\.0; allowed: 0, but in world"):
        replace(WORLDS[world], reward=reward)


def test_jerk_is_what_a_push_changed_by_and_forces_are_known_where_cables_sag():
    environment = made(REALTIME)
    environment.reset()
    push = np.tile([0.3, 0.0, -0.4], (3, 1))
    pushes = (push, push, -push)
    first, second, third = (environment.step(a).transition for a in pushes)
    np.testing.assert_allclose(first.jerk, 0.5)
    np.testing.assert_allclose(second.jerk, 0.0, atol=1e-15)
    np.testing.assert_allclose(third.jerk, 1.0)  # there and back
    assert first.tension.shape == (3, 4)
    quiet = made(SETTLE)
    quiet.reset()
    step = quiet.step(reaching(quiet))
    np.testing.assert_array_equal(step.transition.tension, step.reached.tension)
    np.testing.assert_array_equal(step.transition.jerk, 0.0)


@pytest.mark.parametrize("world", ["no_sag", "settle"])
def test_the_last_step_of_an_episode_is_not_changed_by_the_next_one(world):
    """What was asked for at the end is not the start of the next episode."""
    environment = made(WORLDS[world])
    environment.reset()
    for _ in range(4):
        action = reaching(environment)
        result = environment.step(action)
    assert result.truncated.all()
    np.testing.assert_allclose(result.transition.asked, environment.scales.to_length(action))
    np.testing.assert_allclose(result.reached.length, result.transition.asked, atol=1e-9)


@pytest.mark.parametrize("world", WORLDS)
def test_episodes_end_after_their_steps_and_begin_anew_at_rest(world):
    environment = made(WORLDS[world])
    environment.reset()
    old = environment.paths
    ends = []
    for _ in range(9):
        result = environment.step(reaching(environment))
        ends.append(result.truncated.all())
        assert not result.failed.any()
        same = np.array_equal(result.observation, result.final_observation)
        assert same != result.truncated.all()
    assert ends == [False, False, False, True] * 2 + [False]
    state = environment.state()
    assert (state["step"] == 1).all()
    assert all(new is not path for new, path in zip(environment.paths, old, strict=True))


def test_observations_show_what_was_asked_for_where_it_led_and_the_next_target():
    environment = made(NO_SAG)
    observation = environment.reset()
    paths = environment.paths
    where = slices(NO_SAG.observation, 4, 0, 4)
    unit = environment.scales.to_unit
    start = np.stack([path.position[0] for path in paths])
    np.testing.assert_allclose(observation[:, where["position"]], unit(start))
    action = reaching(environment) + 0.05
    result = environment.step(action)
    following = np.stack([path.position[2] for path in paths])
    np.testing.assert_allclose(result.observation[:, where["length"]], action, atol=1e-12)
    np.testing.assert_allclose(result.observation[:, where["target"]], unit(following))
    np.testing.assert_allclose(
        result.observation[:, where["position"]], unit(result.transition.position)
    )


def test_previews_are_later_targets_also_beyond_the_episode():
    environment = made(REALTIME)
    observation = environment.reset()
    where = slices(REALTIME.observation, 4, 2, 3)["preview"]
    paths = environment.paths
    steps = np.stack(  # 5 ahead of 1: the path goes on beyond its last step, 4
        [[path.position[1], path.position[3], path.later[1, 0]] for path in paths]
    )
    expected = (steps[:, 1:] - steps[:, :1]).reshape(3, 6) / 0.5
    np.testing.assert_allclose(observation[:, where], expected, atol=1e-12)


def test_errors_are_against_where_it_should_be_now():
    """Not against where it shall be a step later: at 2 m/s these are centimetres apart."""
    settings = replace(REALTIME, observation=("error", "velocity_error"), preview=())
    environment = made(settings, size=2, seed=3)
    environment.reset()
    for k in range(1, 4):
        result = environment.step(np.zeros((2, 3)))
        reached = result.reached
        due = np.stack([path.position[k] for path in environment.paths])
        speed = np.stack([path.velocity[k] for path in environment.paths])
        error = (reached.belief.position - due) / 0.1
        against = (reached.twist[:, :3] - speed) / 0.3
        if not result.truncated.any():
            expected = np.concatenate([error, against], axis=1)
            np.testing.assert_allclose(result.observation, expected, atol=1e-12)


def test_feedforward_is_of_when_the_lengths_have_arrived():
    robot = simple_robot()
    settings = replace(REALTIME, path=replace(REALTIME.path, steps=8))
    environment = made(settings, size=2, seed=3, robot=robot)
    environment.reset()
    reached = environment.step(np.zeros((2, 3))).reached
    after = 1.0 + float(robot.winch_lag.mean()) / 0.05 - 0.5  # [steps] after now, at step 1
    row, share = divmod(1.0 + after, 1.0)
    for path, found in zip(
        environment.paths, environment._look(reached).aimed_acceleration, strict=True
    ):
        expected = (1.0 - share) * path.acceleration[int(row)]
        expected += share * path.acceleration[int(row) + 1]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_what_lasts_has_a_memory_of_its_own():
    settings = replace(REALTIME, correction=1.0, correction_memory=0.5)
    environment = made(replace(settings, path=replace(settings.path, steps=9)), size=2, seed=3)
    where = slices(REALTIME.observation, 4, 2, 3)["error"]
    errors = [environment.reset()[:, where] * 0.1]
    for _ in range(5):
        errors.append(environment.step(np.zeros((2, 3))).observation[:, where] * 0.1)
    expected = np.zeros((2, 3))
    for error in errors:
        expected += (1.0 - np.exp(-0.05 / 0.5)) * (error - expected)
    found = environment.state()["lasting_error"]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    for _ in range(4):  # to the end of the episode: the next one begins with its first error alone
        begun = environment.step(np.zeros((2, 3))).observation[:, where] * 0.1
    fresh = (1.0 - np.exp(-0.05 / 0.5)) * begun
    np.testing.assert_allclose(environment.state()["lasting_error"], fresh, atol=1e-12)
    found = environment.state()["lasting_error"]
    again = made(environment.settings, size=2, seed=8)
    again.reset()
    again.restore(environment.state())
    np.testing.assert_array_equal(again.state()["lasting_error"], found)


def test_past_errors_are_seen_and_fade():
    memory = 0.2
    environment = made(replace(REALTIME, memory=memory), size=2, seed=3)
    where = slices(REALTIME.observation, 4, 2, 3)
    seen = [environment.reset()]
    for _ in range(7):  # beyond the end of an episode of 4 steps
        seen.append(environment.step(np.zeros((2, 3))).observation)
    errors, means = ([one[:, where[name]] for one in seen] for name in ("error", "mean_error"))
    for first, last in ((0, 3), (4, 7)):
        age = 0.05 * (last - np.arange(first, last + 1)) / memory
        weight = (1.0 - np.exp(-0.05 / memory)) * np.exp(-age)
        expected = np.einsum("k,kbi->bi", weight, np.array(errors[first : last + 1]))
        np.testing.assert_allclose(means[last], expected, atol=1e-12)


def test_an_episode_that_begins_anew_forgets_and_the_others_do_not():
    memory, long = 0.2, PathSettings(steps=40, period=0.05)
    environment = made(replace(REALTIME, lost=0.1, memory=memory, path=long), size=6)
    where = slices(REALTIME.observation, 4, 2, 3)
    share = 1.0 - np.exp(-0.05 / memory)
    seen = environment.reset()
    mixed = 0
    for _ in range(20):
        result = environment.step(np.ones((6, 3)))
        before, error = (
            x[:, where[y]] for x, y in ((seen, "mean_error"), (result.final_observation, "error"))
        )
        expected = before + share * (error - before)
        np.testing.assert_allclose(
            result.final_observation[:, where["mean_error"]], expected, atol=1e-12
        )
        seen, ended = result.observation, result.truncated
        expected[ended] = share * seen[ended][:, where["error"]]
        np.testing.assert_allclose(seen[:, where["mean_error"]], expected, atol=1e-12)
        mixed += 0 < ended.sum() < 6
    assert mixed > 0


def test_a_biased_belief_is_seen_and_the_truth_is_rewarded():
    moving = MovingSettings(position_bias=0.05, perturbation="none", start_speed=0.0)
    environment = made(replace(REALTIME, moving=moving))
    observation = environment.reset()
    state = environment.state()
    reached = state["reached"]
    due = np.stack([path.position[0] for path in state["paths"]])
    believed = reached.belief.position
    np.testing.assert_allclose(observation[:, :3], (believed - due) / 0.1, atol=1e-12)
    result = environment.step(np.zeros((3, 3)))
    np.testing.assert_array_equal(result.transition.position, result.reached.position)
    velocity = np.stack([path.velocity[1] for path in state["paths"]])
    np.testing.assert_allclose(
        result.transition.velocity, result.reached.twist[:, :3] - velocity, atol=1e-12
    )


def test_a_step_without_solution_ends_the_episode_with_its_own_reward():
    environment = made(SETTLE)
    environment.reset()
    action = reaching(environment)
    action[1] = -1.0  # all cables shortest: nothing hangs on those
    result = environment.step(action)
    assert result.failed.tolist() == [False, True, False]
    assert result.truncated.tolist() == [False, True, False]  # cut short: failing saves nothing
    assert result.reward[1] == FAILURE_REWARD
    assert environment.state()["step"].tolist() == [1, 0, 1]
    np.testing.assert_array_equal(result.observation[[0, 2]], result.final_observation[[0, 2]])


@pytest.mark.parametrize("world", WORLDS)
def test_a_seed_repeats_and_another_seed_has_other_paths(world):
    first, second = made(WORLDS[world], seed=4), made(WORLDS[world], seed=4)
    np.testing.assert_array_equal(first.reset(), second.reset())
    assert_same(played(first, 6), played(second, 6))
    other = made(WORLDS[world], seed=5)
    other.reset()
    starts = [{tuple(path.position[0]) for path in env.paths} for env in (first, other)]
    assert len(starts[0]) > 1
    assert not starts[0] & starts[1]


@pytest.mark.parametrize("world", WORLDS)
def test_a_restored_environment_goes_on_bit_by_bit(world):
    environment = made(WORLDS[world], seed=2)
    environment.reset()
    played(environment, 3)
    state = copy.deepcopy(environment.state())
    live = environment.state()
    expected = played(environment, 6)
    environment.restore(live)  # what happened in between has not touched it
    assert_same(played(environment, 6), expected)
    other = made(WORLDS[world], seed=2)
    other.restore(state)
    assert_same(played(other, 6), expected)


def test_given_paths_are_followed():
    environment = made(NO_SAG, seed=1)
    environment.reset()
    paths = environment.paths
    other = made(NO_SAG, seed=9)
    other.reset(paths)
    result = other.step(reaching(other))
    np.testing.assert_array_equal(result.transition.target, [p.position[1] for p in paths])
    with pytest.raises(InvalidField, match="paths: got 2 paths; allowed: 3, one for each"):
        other.reset(paths[:2])


def test_a_step_before_the_reset_is_refused():
    with pytest.raises(InvalidField, match="reset before step"):
        made(NO_SAG).step(np.zeros((3, 4)))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"world": "underwater"}, "world: got 'underwater'"),
        ({"action": "speed"}, "action: got 'speed'"),
        ({"observation": ("wind",)}, r"observation\[0\]: got 'wind'"),
        ({"world": "realtime"}, "path.period: got None"),
        ({"path": PathSettings(period=0.1)}, "path.period: got 0.1"),
        (
            {"moving": MovingSettings(estimator="ks_ekf")},
            "moving.estimator: got 'ks_ekf'; allowed: None",
        ),
        ({"preview": (2,)}, r"preview: got \(2,\)"),
        ({"observation": ("target", "preview")}, r"preview: got \(\)"),
        ({"observation": ("preview",), "preview": (0,)}, r"preview\[0\]: got 0"),
        ({"observation": ("target", "mean_error")}, "parts without 'mean_error' where"),
        ({"memory": 0.0}, "memory: got 0.0 s"),
        ({"correction_memory": -1.0}, "correction_memory: got -1.0 s"),
        ({"correction": -1.0}, "correction: got -1.0"),
        ({"correction": 1.0}, "correction: got 1.0; allowed: 0, but with action 'push'"),
        ({"reach": 0.0}, "reach: got 0.0 m/s"),
    ],
)
def test_settings_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        EnvironmentSettings(**changes)


def test_a_platform_that_is_lost_begins_anew_and_is_no_failure():
    long = PathSettings(steps=40, period=0.05)
    environment = made(replace(REALTIME, lost=0.05, path=long))
    environment.reset()
    ended = 0
    for _ in range(10):
        result = environment.step(np.tile([1.0, 1.0, 1.0], (environment.size, 1)))
        far = result.transition.distance > 0.05
        np.testing.assert_array_equal(result.truncated, far)
        assert not result.failed.any()
        ended += int(far.sum())
    assert ended > 0


def test_a_device_that_is_not_there_is_named():
    with pytest.raises(InvalidField, match=r"device: got 'cuda:77'; allowed: one of \['cpu'"):
        CableEnvironment(simple_robot(), NO_SAG, device="cuda:77")


def test_a_state_from_before_the_first_reset_is_one_too():
    environment = made(NO_SAG)
    environment.restore(environment.state())
    with pytest.raises(InvalidField, match="reset before step"):
        environment.step(np.zeros((3, environment.action_size)))
