from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from learned.environment import CableEnvironment, EnvironmentSettings
from learned.observation import slices
from learned.relabelling import RelabellingBuffer
from learned.rewards import Reward, RewardSettings
from learned.target_paths import PathSettings
from learned.vector_environment import CableVecEnv
from tests.robots import simple_robot

REWARD = RewardSettings(terms=("fit",), fit_scale=0.03, consistency=0.7)
TAUT = replace(REWARD, slack=2.0, reserve=0.5)
PARTS = ("length", "position", "target")
TARGET = slices(PARTS, 4, 0, 4)["target"]
SIZE = 8


def filled(share, world="no_sag", steps=40, action=0.3, reward=REWARD):
    """A buffer with random steps, its environment, and where each step led."""
    settings = EnvironmentSettings(
        world=world, observation=PARTS, reward=reward, path=PathSettings(steps=15)
    )
    environment = CableVecEnv(CableEnvironment(simple_robot(), settings, size=SIZE))
    twin = CableEnvironment(simple_robot(), settings, size=SIZE)
    twin.reset()
    cables = environment.environment
    buffer = RelabellingBuffer(
        1000 * SIZE, environment.observation_space, environment.action_space, n_envs=SIZE,
        share=share, target=TARGET, scales=cables.scales, fit_scale=REWARD.fit_scale,
        span=cables.reward.span,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    observation = environment.reset()
    led = {}
    for _ in range(steps):
        act = rng.uniform(-action, action, (SIZE, 4)).astype(np.float32)
        following, rewards, done, infos = environment.step(act)
        buffer.add(observation, following, act, rewards, done, infos)
        step = twin.step(act.astype(np.float64)).transition
        for row in range(SIZE):
            led[act[row].tobytes()] = (step, row, observation[row], float(rewards[row]))
        observation = following
    return buffer, cables, led


def rows(batch, led):
    """Samples beside the steps they come from."""
    for k in range(len(batch.rewards)):
        *_, observation, reward = led[batch.actions[k].numpy().tobytes()]
        yield batch.observations[k].numpy(), float(batch.rewards[k]), observation, reward


@pytest.mark.parametrize("world, action, asked",
                         [("no_sag", 0.3, REWARD), ("settle", 0.3, TAUT)])  # fmt: skip
def test_relabelled_rewards_are_those_of_the_relabelled_transitions(world, action, asked):
    np.random.seed(0)  # noqa: NPY002 - stable-baselines3 draws from it
    buffer, cables, led = filled(1.0, world, action=action, reward=asked)
    reward = Reward(asked, cables.reward.span)
    others = np.setdiff1d(np.arange(10), np.arange(10)[TARGET])
    distances, free = [], []
    batch = buffer.sample(256)
    for k in range(256):
        seen, value = batch.observations[k].numpy(), float(batch.rewards[k])
        step, row, observation, _ = led[batch.actions[k].numpy().tobytes()]
        if step.failed[row]:
            continue
        target = cables.scales.center + cables.scales.half * seen[TARGET].astype(np.float64)
        step = replace(step, target=np.tile(target, (SIZE, 1)))
        assert value == pytest.approx(reward(step)[row], abs=1e-5)
        np.testing.assert_array_equal(seen[others], observation[others])
        distances.append(step.distance[row])
        unpriced = Reward(replace(asked, slack=0.0, reserve=0.0), cables.reward.span)
        free.append(unpriced(step)[row] - reward(step)[row])
    low, high = np.percentile(distances, [5, 95])
    assert low < 0.01 and high > 0.5  # at all scales
    assert (np.max(free) > 0.01) == (asked.slack > 0.0)  # some cables were slack


def test_what_is_not_relabelled_stays_as_it_was():
    np.random.seed(1)  # noqa: NPY002
    buffer, _, led = filled(0.0)
    for seen, value, observation, reward in rows(buffer.sample(100), led):
        np.testing.assert_array_equal(seen, observation)
        assert value == pytest.approx(reward, abs=1e-6)


def test_the_share_is_the_share_of_steps_with_another_target():
    np.random.seed(2)  # noqa: NPY002
    buffer, _, led = filled(0.8)
    kept = [np.array_equal(seen, old) for seen, _, old, _ in rows(buffer.sample(1500), led)]
    assert np.mean(kept) == pytest.approx(0.2, abs=0.04)  # 0.01 is one sigma


def test_steps_without_a_solution_keep_their_target_and_reward():
    np.random.seed(3)  # noqa: NPY002
    buffer, _, led = filled(1.0, "settle", steps=6, action=1.0)
    failed = 0
    for seen, value, observation, reward in rows(buffer.sample(200), led):
        if reward == -1.0:
            failed += 1
            np.testing.assert_array_equal(seen, observation)
            assert value == -1.0
    assert failed > 10


def test_nothing_ends_for_good_so_that_failing_saves_nothing():
    np.random.seed(4)  # noqa: NPY002
    buffer, _, _ = filled(1.0)
    assert buffer.dones[:40].any() and not buffer.failed.any()
    assert not buffer.sample(500).dones.any()
    buffer, _, _ = filled(1.0, "settle", steps=6, action=1.0)
    assert buffer.failed[:6].any()
    assert not buffer.sample(200).dones.any()
