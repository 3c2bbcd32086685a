"""A TD3 policy whose critics see the truth, and whose actor sees what is believed, never more.

The critics are not needed in use: they may know what no controller can see. Values are then of the
state that the platform is in, and the actor learns what to do for all the states that look alike.

References:
    Pinto et al., *Asymmetric actor critic for image-based robot learning*, RSS 2018.
"""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.td3.policies import Actor, TD3Policy


class BelievingActor(Actor):
    """An actor that reads the first numbers of what critics see."""

    def __init__(self, *, observed: int, **kwargs: Any) -> None:
        """Make the network.

        Args:
            observed: How many numbers of those that critics see it reads.
            kwargs: Of stable-baselines3's actor.
        """
        super().__init__(**(kwargs | {"features_dim": observed}))
        self._observed = observed

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Return actions, shape (B, a)."""
        action: torch.Tensor = self.mu(obs[:, : self._observed])
        return action


class TruthPolicy(TD3Policy):
    """TD3's policy with `BelievingActor`."""

    def __init__(self, *args: Any, observed: int, **kwargs: Any) -> None:
        """Make TD3's policy, with how many numbers the actor reads."""
        self._observed = observed
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: Any = None) -> Actor:
        """Make an actor that sees what is believed."""
        arguments = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return BelievingActor(**arguments, observed=self._observed).to(self.device)
