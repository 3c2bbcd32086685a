import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from learned.environment import CableEnvironment, EnvironmentSettings
from learned.episodes import PathSettings
from learned.observation import slices
from learned.relabelling import RelabellingBuffer
from learned.rewards import Reward, RewardSettings
from learned.vector_environment import CableVecEnv
from tests.learned.transitions import transition
from tests.robots import simple_robot

REWARD = RewardSettings(terms=("fit",), fit_scale=0.03, consistency=0.7)
PARTS = ("length", "position", "target")
TARGET = slices(PARTS, 4, 0, 4)["target"]
SIZE = 8


def filled(share, world="no_sag", steps=40, action=0.3):
    """A buffer with random steps, its environment, and where each step led."""
    settings = EnvironmentSettings(
        world=world, observation=PARTS, reward=REWARD, path=PathSettings(steps=15)
    )
    environment = CableVecEnv(CableEnvironment(simple_robot(), settings, size=SIZE))
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
        following, reward, done, infos = environment.step(act)
        buffer.add(observation, following, act, reward, done, infos)
        for row in range(SIZE):
            led[act[row].tobytes()] = (infos[row], observation[row], float(reward[row]))
        observation = following
    return buffer, cables, led


def rows(batch, led):
    """Samples beside the steps they come from."""
    for k in range(len(batch.rewards)):
        known = led[batch.actions[k].numpy().tobytes()]
        yield batch.observations[k].numpy(), float(batch.rewards[k]), *known


def test_relabelled_rewards_are_those_of_the_relabelled_transitions():
    np.random.seed(0)  # noqa: NPY002 - stable-baselines3 draws from it
    buffer, cables, led = filled(1.0)
    reward = Reward(REWARD, cables.reward.span)
    distances = []
    for seen, value, info, observation, _ in rows(buffer.sample(256), led):
        target = cables.scales.center + cables.scales.half * seen[TARGET].astype(np.float64)
        lack = [[info["lengths_misfit"] / REWARD.consistency, 0.0, 0.0, 0.0]]
        step = transition(position=[info["position"]] * 2, target=[target] * 2,
                          inconsistency=lack * 2)  # fmt: skip
        assert value == pytest.approx(reward(step)[0], abs=1e-5)
        others = np.setdiff1d(np.arange(10), np.arange(10)[TARGET])
        np.testing.assert_array_equal(seen[others], observation[others])
        distances.append(step.distance[0])
    low, high = np.percentile(distances, [5, 95])
    assert low < 0.01 and high > 0.5  # at all scales


def test_what_is_not_relabelled_stays_as_it_was():
    np.random.seed(1)  # noqa: NPY002
    buffer, _, led = filled(0.0)
    for seen, value, _, observation, reward in rows(buffer.sample(100), led):
        np.testing.assert_array_equal(seen, observation)
        assert value == pytest.approx(reward, abs=1e-6)


def test_the_share_is_the_share_of_steps_with_another_target():
    np.random.seed(2)  # noqa: NPY002
    buffer, _, led = filled(0.8)
    kept = [np.array_equal(seen, old) for seen, _, _, old, _ in rows(buffer.sample(1500), led)]
    assert np.mean(kept) == pytest.approx(0.2, abs=0.04)  # 0.01 is one sigma


def test_steps_without_a_solution_keep_their_target_and_reward():
    np.random.seed(3)  # noqa: NPY002
    buffer, _, led = filled(1.0, "settle", steps=6, action=1.0)
    failed = 0
    for seen, value, _, observation, reward in rows(buffer.sample(200), led):
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
