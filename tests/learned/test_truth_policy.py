from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch

from carosac_toolkit.base.errors import InvalidField
from learned.environment import CableEnvironment
from learned.presets import Stage, find_preset
from learned.td3 import build_model, layers_of
from learned.vector_environment import CableVecEnv
from tests.robots import simple_robot

STAGE = find_preset("residual").stage("realtime")
TRUE = replace(
    STAGE.environment, truth=True, path=replace(STAGE.environment.path, pool=4, steps=3),
    moving=replace(STAGE.environment.moving, cables="catenary"),
)  # fmt: skip
SMALL = replace(STAGE.td3, environments=2, hidden=(8, 8), buffer_size=100, batch_size=8)


def made():
    environment = CableVecEnv(CableEnvironment(simple_robot(), TRUE, size=2))
    return build_model(Stage(environment=TRUE, td3=SMALL), environment, seed=0), environment


def test_the_actor_sees_beliefs_alone_and_critics_the_truth_as_well():
    model, environment = made()
    size = environment.environment.observation_size
    assert layers_of(model)[0][0].shape[1] == size
    seen = np.random.default_rng(0).standard_normal((2, 2 * size)).astype(np.float32)
    other = seen.copy()
    other[:, size:] += 1.0
    actions = [model.predict(each, deterministic=True)[0] for each in (seen, other)]
    np.testing.assert_array_equal(*actions)
    with torch.no_grad():
        values = [
            model.critic(torch.tensor(each), torch.tensor(actions[0]))[0].numpy()
            for each in (seen, other)
        ]
    assert (np.abs(values[0] - values[1]) > 1e-6).all()


def test_what_stands_behind_the_observation_is_what_a_true_belief_would_show():
    _, environment = made()
    cables = environment.environment
    size = cables.observation_size
    row = environment.reset()
    for _ in range(5):
        seen, true = row[:, :size], row[:, size:]
        error = cables.reached.belief.position - cables.reached.position
        np.testing.assert_allclose(
            seen[:, :3] - true[:, :3], error / cables.scales.units.error, atol=1e-5
        )
        np.testing.assert_allclose(seen[:, 3:], true[:, 3:], atol=1e-6)  # only positions err here
        row = act(environment)[0]


def test_the_last_look_of_an_episode_has_its_truth_too():
    _, environment = made()
    environment.reset()
    for _ in range(3):
        _, _, done, infos = act(environment)
    assert done.all()
    assert infos[0]["terminal_observation"].shape == (2 * environment.environment.observation_size,)


def test_the_truth_is_refused_where_beliefs_are_true_and_critics_are_distances():
    other = find_preset("carosac").stage("sag")
    with pytest.raises(InvalidField, match="truth: got True; allowed: False, but in world"):
        replace(other.environment, truth=True)
    with pytest.raises(InvalidField, match="critic: got 'metric'; allowed: 'value', as critics"):
        Stage(environment=TRUE, td3=replace(SMALL, critic="metric", discount=0.0))


def act(environment):
    environment.step_async(np.full((2, 3), 0.1))
    return environment.step_wait()
