import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from learned.environment import CableEnvironment, EnvironmentSettings
from learned.target_paths import PathSettings
from learned.vector_environment import CableVecEnv
from tests.robots import simple_robot

SHORT = PathSettings(steps=3)


def made(world="no_sag", seed=0):
    settings = EnvironmentSettings(world=world, path=SHORT)
    return CableVecEnv(CableEnvironment(simple_robot(), settings, size=2, seed=seed))


def test_the_batch_is_the_environment_in_single_precision():
    vector = made()
    plain = CableEnvironment(simple_robot(), EnvironmentSettings(path=SHORT), size=2)
    np.testing.assert_allclose(vector.reset(), plain.reset(), atol=1e-6)
    action = np.random.default_rng(0).uniform(-0.2, 0.2, (2, 4)).astype(np.float32)
    observation, reward, done, infos = vector.step(action)
    result = plain.step(action.astype(np.float64))
    np.testing.assert_allclose(observation, result.observation, atol=1e-6)
    np.testing.assert_allclose(reward, result.reward, atol=1e-6)
    assert observation.dtype == reward.dtype == np.float32
    assert not done.any()
    misfit = np.linalg.norm(result.transition.inconsistency, axis=1)
    assert (misfit > 0.0).all()
    for row, info in enumerate(infos):
        np.testing.assert_array_equal(info["position"], result.transition.position[row])
        assert info["lengths_misfit"] == pytest.approx(misfit[row], rel=1e-12)
        assert "episode" not in info


def test_an_end_in_time_is_marked_and_shows_what_was_seen_last():
    vector = made()
    vector.reset()
    target = slice(7, 10)
    total = np.zeros(2)
    for step in range(6):
        last = np.stack([p.position[-1] for p in vector.environment.state()["paths"]])
        observation, reward, done, infos = vector.step(np.zeros((2, 4)))
        total += reward
        assert done.all() == (step % 3 == 2)
        if done.all():
            for row, info in enumerate(infos):
                assert info["TimeLimit.truncated"] is True
                seen = info["terminal_observation"]
                unit = vector.environment.scales.to_unit(last[row])
                np.testing.assert_allclose(seen[target], unit, atol=1e-6)
                assert np.abs(seen[target] - observation[row, target]).max() > 1e-3
                assert info["episode"]["l"] == 3
                assert info["episode"]["r"] == pytest.approx(total[row], rel=1e-5)
            total[:] = 0.0


def test_an_end_for_lack_of_a_solution_is_cut_short_and_said():
    vector = made("settle")
    vector.reset()
    action = -np.ones((2, 4))  # the shortest lengths of all cables hold no platform
    _, _, done, infos = vector.step(action)
    assert done.all()
    assert [info["TimeLimit.truncated"] for info in infos] == [True, True]
    assert [info["failed"] for info in infos] == [True, True]
    assert [info["episode"]["l"] for info in infos] == [1, 1]
    assert [info["episode"]["r"] for info in infos] == [-1.0, -1.0]


def test_a_restored_batch_goes_on_with_its_sums():
    vector = made()
    vector.reset()
    vector.step(np.zeros((2, 4)))
    state = vector.state()
    other = made()
    other.restore(state)
    for _ in range(2):
        mine, his = vector.step(np.full((2, 4), 0.1)), other.step(np.full((2, 4), 0.1))
    assert mine[3][0]["episode"] == his[3][0]["episode"]
    np.testing.assert_array_equal(mine[0], his[0])


def test_attributes_are_those_of_the_batch():
    vector = made()
    assert vector.get_attr("settings") == [vector.environment.settings] * 2
    assert vector.get_attr("settings", 1) == vector.get_attr("settings", np.array([0]))
    assert vector.env_is_wrapped(object, [0, 1]) == [False, False]
    with pytest.raises(NotImplementedError, match="of their own"):
        vector.set_attr("settings", None)
    with pytest.raises(NotImplementedError, match="of their own"):
        vector.env_method("reset")
