"""stable-baselines3's TD3 as the presets use it, and everything in it that changes."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.td3.policies import TD3Policy

from learned.environment import CableEnvironment
from learned.exploration import DecayingNoise
from learned.metric_policy import MetricPolicy
from learned.observation import slices
from learned.presets import Stage, Td3Settings
from learned.relabelling import RelabellingBuffer
from learned.truth_policy import TruthPolicy
from learned.vector_environment import CableVecEnv

ACTIVATION_MODULES = {"relu": torch.nn.ReLU, "silu": torch.nn.SiLU}
QUIET_START_RATIO = 0.01  # by which the last layer of a quiet start is smaller
NOISE_CLIP_RATIO = 2.5  # of the noise on target actions, over its standard deviation
BUFFER_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
BUFFER_EXTRAS = ("positions", "lengths_misfits", "failed")


class StagedTd3(TD3):
    """TD3 with learning rates of its own for actor and critic, and noise that decays."""

    rates: Td3Settings

    def _update_learning_rate(self, optimizers: Any) -> None:
        """Set both rates; they fall linearly, and the actor waits for the critics."""
        left = max(0.0, self._current_progress_remaining)  # the last step may go beyond the end
        share = self.rates.rate_end + (1.0 - self.rates.rate_end) * left
        actor = 0.0 if self._n_updates < self.rates.critic_first else self.rates.actor_rate
        for optimizer, rate in zip(optimizers, (actor, self.rates.critic_rate), strict=True):
            for group in optimizer.param_groups:
                group["lr"] = rate * share
        self.logger.record("train/rate_share", share)

    def _on_step(self) -> None:
        """Let the noise decay with the steps."""
        if isinstance(self.action_noise, DecayingNoise):
            self.action_noise.progress = self.num_timesteps / self._total_timesteps
        super()._on_step()


def build_model(stage: Stage, environment: CableVecEnv, seed: int) -> StagedTd3:
    """Build a model that has learned nothing yet.

    Args:
        stage: Its settings.
        environment: With as many environments as they say.
        seed: Of networks, replay and noise.
    """
    settings = stage.td3
    cables = environment.environment
    noise = DecayingNoise(settings.exploration, (settings.environments, cables.action_size), seed)
    parts = slices(
        stage.environment.observation, cables.robot.n, len(stage.environment.preview),
        cables.action_size,
    )  # fmt: skip
    target, span = parts.get("target"), cables.reward.span
    buffer = _relabelling(stage, environment, target, span)
    model = StagedTd3(
        _policy(stage), environment,
        learning_rate=settings.actor_rate, buffer_size=settings.buffer_size,
        learning_starts=settings.random_steps, batch_size=settings.batch_size,
        gamma=settings.discount, tau=settings.target_rate, train_freq=1,
        gradient_steps=settings.gradient_steps,
        target_policy_noise=settings.target_noise,
        target_noise_clip=NOISE_CLIP_RATIO * settings.target_noise,
        action_noise=noise, policy_kwargs=_networks(stage, cables, target), seed=seed, device="cpu",
        stats_window_size=max(100, settings.environments),  # all episodes that end in one step
        replay_buffer_class=RelabellingBuffer if buffer else None,
        replay_buffer_kwargs=buffer or None,
    )  # fmt: skip
    model.rates = settings
    if settings.quiet_start:
        _quieten(model)
    return model


def _quieten(model: StagedTd3) -> None:
    """Let the actor start with actions near zero."""
    last = [module for module in model.actor.mu if isinstance(module, torch.nn.Linear)][-1]
    with torch.no_grad():
        last.weight.mul_(QUIET_START_RATIO)
        last.bias.zero_()
    model.actor_target.load_state_dict(model.actor.state_dict())


def _policy(stage: Stage) -> str | type[TD3Policy]:
    """Return the kind of the policy."""
    if stage.environment.truth:
        return TruthPolicy
    return MetricPolicy if stage.td3.critic == "metric" else "MlpPolicy"


def _networks(stage: Stage, cables: CableEnvironment, target: slice | None) -> dict[str, Any]:
    """Return the arguments of the policy: sizes, activation, critics."""
    settings = stage.td3
    policy: dict[str, Any] = {
        "net_arch": list(settings.hidden),
        "activation_fn": ACTIVATION_MODULES[settings.activation],
        "n_critics": settings.critics,
    }
    if settings.critic == "metric":
        scale = stage.environment.reward.fit_scale
        policy["metric"] = {"target": target, "scale": scale, "span": cables.reward.span}
    if stage.environment.truth:
        policy["observed"] = cables.observation_size
    return policy


def _relabelling(
    stage: Stage, environment: CableVecEnv, target: slice | None, span: float
) -> dict[str, Any]:
    """Return the arguments of the relabelling buffer; empty without relabelling."""
    if stage.td3.relabelled == 0.0:
        return {}
    return {
        "share": stage.td3.relabelled, "target": target,
        "scales": environment.environment.scales, "fit_scale": stage.environment.reward.fit_scale,
        "span": span,
    }  # fmt: skip


def state_of(model: StagedTd3) -> dict[str, Any]:
    """Return everything that changes while training, with all sources of randomness."""
    buffer = model.replay_buffer
    assert buffer is not None and isinstance(model.action_noise, DecayingNoise)
    assert isinstance(model.env, CableVecEnv)
    names = [*BUFFER_ARRAYS, *(name for name in BUFFER_EXTRAS if hasattr(buffer, name))]
    filled = buffer.buffer_size if buffer.full else buffer.pos
    return {
        "parameters": model.get_parameters(),
        "steps": model.num_timesteps,
        "updates": model._n_updates,
        "episodes": model._episode_num,
        "progress": model._current_progress_remaining,
        "buffer": {name: getattr(buffer, name)[:filled].copy() for name in names},
        "buffer_position": (buffer.pos, buffer.full),
        "last_observation": np.array(model._last_obs),
        "noise": model.action_noise.state(),
        "environment": model.env.state(),
        "action_space": model.action_space.np_random.bit_generator.state,
        "numpy": np.random.get_state(),  # noqa: NPY002 - stable-baselines3 draws from it
        "python": random.getstate(),
        "torch": torch.get_rng_state(),
    }


def restore_state(model: StagedTd3, state: dict[str, Any]) -> None:
    """Go on as if training had never stopped; after `_setup_learn`."""
    buffer = model.replay_buffer
    assert buffer is not None and isinstance(model.action_noise, DecayingNoise)
    assert isinstance(model.env, CableVecEnv)
    model.set_parameters(state["parameters"])
    model.num_timesteps = state["steps"]
    model._n_updates = state["updates"]
    model._episode_num = state["episodes"]
    model._current_progress_remaining = state["progress"]
    for name, values in state["buffer"].items():
        getattr(buffer, name)[: len(values)] = values
    buffer.pos, buffer.full = state["buffer_position"]
    model._last_obs = state["last_observation"]
    model.action_noise.restore(state["noise"])
    model.env.restore(state["environment"])
    model.action_space.np_random.bit_generator.state = state["action_space"]
    np.random.set_state(state["numpy"])  # noqa: NPY002
    random.setstate(state["python"])
    torch.set_rng_state(state["torch"])


def take_networks(model: StagedTd3, state: dict[str, Any]) -> list[Any]:
    """Start from the networks of another training, its targets included.

    Optimisers start anew: their moments belong to other data and other learning rates.

    Returns:
        Names and values of what was taken.
    """
    networks = state["parameters"]["policy"]
    model.policy.load_state_dict(networks)
    return [x for name, value in networks.items() for x in (name, value.numpy())]


def layers_of(model: StagedTd3) -> list[tuple[Any, Any]]:
    """Return weights and biases of the actor, layer by layer, for `learned.policy_file`."""
    linear = [module for module in model.actor.mu if isinstance(module, torch.nn.Linear)]
    return [(x.weight.detach().numpy().copy(), x.bias.detach().numpy().copy()) for x in linear]
