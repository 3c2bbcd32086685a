r"""A TD3 policy whose critic is a learned distance between an action and a target.

.. math:: Q(s, g, a) = -\frac{\ln(1 + \lVert \varphi(s, a) - \psi(g) \rVert / s_0)}
                             {\ln(1 + D / s_0)}

The reward ``fit`` has this form with what the action reaches in place of :math:`\varphi` and the
target in place of :math:`\psi`: the networks learn smooth maps, and the sharp peak at the right
action, which decides the last millimetre, needs not be learned at all.

References:
    Liu et al., *Metric residual networks for sample efficient goal-conditioned reinforcement
    learning*, AAAI 2023 (the idea of a metric critic; this one is Euclidean).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import BaseModel, ContinuousCritic
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.td3.policies import TD3Policy

EMBEDDING_SIZE = 16  # of the embeddings
DISTANCE_FLOOR_M2 = (
    1e-8  # [m^2] under the root, where its slope would be infinite: a floor of 0.1 mm
)


class MetricCritic(ContinuousCritic):
    """Critics as above; arguments beyond those of stable-baselines3 are those of the reward."""

    def __init__(
        self, observation_space: Any, action_space: Any, net_arch: list[int],
        features_extractor: Any, features_dim: int, activation_fn: Any = torch.nn.ReLU,
        normalize_images: bool = True, n_critics: int = 2, share_features_extractor: bool = True,
        *, target: slice, scale: float, span: float,
    ) -> None:  # fmt: skip
        """Make the networks.

        Args:
            observation_space: See stable-baselines3, as all up to `share_features_extractor`.
            action_space: See there.
            net_arch: See there.
            features_extractor: See there.
            features_dim: See there.
            activation_fn: See there.
            normalize_images: See there.
            n_critics: See there.
            share_features_extractor: See there.
            target: Where the target stands in an observation.
            scale: s_0 [m]; the embeddings learn to count in metres.
            span: D [m].
        """
        BaseModel.__init__(
            self, observation_space, action_space, features_extractor=features_extractor,
            normalize_images=normalize_images,
        )  # fmt: skip
        self.share_features_extractor = share_features_extractor
        self.n_critics = n_critics
        self._target = target
        self._state = [k for k in range(features_dim) if k not in range(features_dim)[target]]
        self._scale = scale
        self._factor = 1.0 / float(np.log1p(span / scale))
        acted = len(self._state) + get_action_dim(action_space)
        wanted = features_dim - len(self._state)
        self.q_networks = []  # of stable-baselines3; not used
        self.reached = torch.nn.ModuleList()
        self.wanted = torch.nn.ModuleList()
        for _ in range(n_critics):
            for networks, size in ((self.reached, acted), (self.wanted, wanted)):
                layers = create_mlp(size, EMBEDDING_SIZE, net_arch, activation_fn)
                networks.append(torch.nn.Sequential(*layers))

    def forward(self, obs: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the values of all critics, each of shape (B, 1)."""
        return tuple(self._value(k, obs, actions) for k in range(self.n_critics))

    def q1_forward(self, obs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return the values of the first critic, shape (B, 1)."""
        return self._value(0, obs, actions)

    def _value(self, k: int, obs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        reached = self.reached[k](torch.cat([obs[:, self._state], actions], dim=1))
        apart = reached - self.wanted[k](obs[:, self._target])
        distance = torch.sqrt((apart**2).sum(dim=1, keepdim=True) + DISTANCE_FLOOR_M2)
        return -torch.log1p(distance / self._scale) * self._factor


class MetricPolicy(TD3Policy):
    """TD3's policy with `MetricCritic`."""

    def __init__(self, *args: Any, metric: dict[str, Any], **kwargs: Any) -> None:
        """Make TD3's policy, with the arguments of the critic's metric."""
        self._metric = metric
        super().__init__(*args, **kwargs)

    def make_critic(self, features_extractor: Any = None) -> ContinuousCritic:
        """Make a metric critic."""
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return MetricCritic(**arguments, **self._metric).to(self.device)
