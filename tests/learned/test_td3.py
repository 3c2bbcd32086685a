from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch

from learned.environment import CableEnvironment
from learned.exploration import DecayingNoise
from learned.metric_policy import MetricCritic
from learned.presets import PRESETS, Td3Settings
from learned.relabelling import RelabellingBuffer
from learned.td3 import build_model, layers_of
from learned.vector_environment import CableVecEnv
from tests.robots import simple_robot


def built(preset="carosac", seed=0, **changes):
    stage = PRESETS[preset].stage("no_sag")
    small = {"environments": 4, "steps": 400, "random_steps": 20, "buffer_size": 1000,
             "hidden": (16, 16), "batch_size": 16, "gradient_steps": 1}  # fmt: skip
    stage = replace(stage, td3=replace(stage.td3, **(small | changes)))
    cables = CableEnvironment(simple_robot(), stage.environment, size=4)
    return build_model(stage, CableVecEnv(cables), seed)


def test_the_presets_get_what_their_settings_say():
    paper, ours = built("paper"), built("carosac")
    assert (paper.gamma, paper.n_envs, len(paper.critic.q_networks)) == (0.99, 4, 2)
    assert not isinstance(paper.replay_buffer, RelabellingBuffer)
    assert ours.gamma == 0.0
    assert isinstance(ours.critic, MetricCritic)
    assert isinstance(ours.replay_buffer, RelabellingBuffer)
    assert isinstance(ours.actor.mu[1], torch.nn.SiLU)
    assert isinstance(paper.actor.mu[1], torch.nn.ReLU)


def test_actor_and_critic_have_rates_of_their_own_that_fall_linearly():
    model = built("paper", actor_rate=3e-4, critic_rate=3e-3, rate_end=0.1)
    model.learn(100)
    model.set_logger(model.logger)
    optimizers = [model.actor.optimizer, model.critic.optimizer]
    for left, share in ((1.0, 1.0), (0.5, 0.55), (0.0, 0.1), (-0.01, 0.1)):
        model._current_progress_remaining = left
        model._update_learning_rate(optimizers)
        rates = [group["lr"] for one in optimizers for group in one.param_groups]
        assert rates == pytest.approx([3e-4 * share, 3e-3 * share])


def test_a_quiet_start_does_next_to_nothing_and_the_actor_waits_for_the_critics():
    model = built("paper", quiet_start=True, critic_first=50, random_steps=0)
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (20, model.observation_space.shape[0]))
    before = model.predict(seen.astype(np.float32), deterministic=True)[0]
    loud = built("paper").predict(seen.astype(np.float32), deterministic=True)[0]
    assert np.abs(before).max() < 0.02
    assert np.abs(before).max() < 0.1 * np.abs(loud).max()
    waiting = Td3Settings(environments=4, critic_first=50, random_steps=0)
    model.learn(waiting.begins_to_change)
    np.testing.assert_array_equal(
        model.predict(seen.astype(np.float32), deterministic=True)[0], before
    )
    model.learn(240, reset_num_timesteps=False)
    assert (
        np.abs(model.predict(seen.astype(np.float32), deterministic=True)[0] - before).max() > 1e-4
    )


def test_noise_decays_with_the_steps():
    model = built("paper")
    model.learn(100)
    assert isinstance(model.action_noise, DecayingNoise)
    assert model.action_noise.progress == pytest.approx(1.0)


@pytest.mark.parametrize("preset", ["paper", "carosac"])
def test_the_layers_are_those_of_the_actor(preset):
    model = built(preset)
    observation = np.random.default_rng(0).standard_normal((20, model.observation_space.shape[0]))
    value = observation.astype(np.float32)
    *hidden, last = layers_of(model)
    for weight, bias in hidden:
        value = value @ weight.T + bias
        value = np.maximum(value, 0.0) if preset == "paper" else value / (1.0 + np.exp(-value))
    expected = np.tanh(value @ last[0].T + last[1])
    found, _ = model.predict(observation.astype(np.float32), deterministic=True)
    np.testing.assert_allclose(found, expected, atol=1e-5)
