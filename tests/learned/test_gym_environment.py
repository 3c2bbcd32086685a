import warnings

import numpy as np
import pytest

from tests.robots import eight_cable_robot

gymnasium = pytest.importorskip("gymnasium")
checker = pytest.importorskip("gymnasium.utils.env_checker")
pytest.importorskip("stable_baselines3")
pytest.importorskip("learned.gym_environment")  # registers

IDS = ["CaRoSaC-NoSag-v0", "CaRoSaC-Sag-v0"]


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_nothing_wrong(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Observations are unbounded boxes of numbers about 1, which it advises against.
        warnings.filterwarnings("ignore", message=".*Box observation space.*infinity.*")
        checker.check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


def episode(environment, seed, steps=5):
    observation, _ = environment.reset(seed=seed)
    found = [observation]
    rng = np.random.default_rng(0)
    for _ in range(steps):
        step = environment.step(rng.uniform(-0.05, 0.05, environment.action_space.shape))
        found.append(np.append(step[0], step[1]))
        if step[2] or step[3]:
            break
    return np.concatenate(found)


@pytest.mark.parametrize("name", IDS)
def test_a_seed_repeats_the_episode_and_another_does_not(name):
    first, second = gymnasium.make(name), gymnasium.make(name)
    expected = episode(first, 3)
    np.testing.assert_array_equal(episode(second, 3), expected)
    np.testing.assert_array_equal(episode(first, 3), expected)  # whatever happened in between
    assert np.abs(episode(second, 4)[:10] - expected[:10]).max() > 1e-3


def test_without_a_seed_each_environment_has_targets_of_its_own():
    first, second = gymnasium.make(IDS[0]), gymnasium.make(IDS[0])
    assert np.abs(first.reset()[0] - second.reset()[0]).max() > 1e-3


@pytest.mark.parametrize("name, steps", [(IDS[0], 200), (IDS[1], 30)])
def test_episodes_are_as_long_as_those_of_the_paper(name, steps):
    environment = gymnasium.make(name)
    assert environment.unwrapped._settings.path.steps == steps
    assert environment.unwrapped._settings.observation == ("length", "position", "target")


def test_the_info_explains_the_reward():
    environment = gymnasium.make(IDS[1])
    environment.reset(seed=1)
    _, reward, terminated, _, info = environment.step(np.zeros(4, dtype=np.float32))
    assert not terminated
    assert sum(info["reward_terms"].values()) == pytest.approx(reward, rel=1e-12)
    apart = np.linalg.norm(info["position"] - info["target"])
    assert info["distance"] == pytest.approx(apart, rel=1e-12)


def test_any_robot_will_do():
    environment = gymnasium.make(IDS[0], robot=eight_cable_robot())
    observation, _ = environment.reset(seed=0)
    assert environment.action_space.shape == (8,)
    assert observation.shape == (14,)
