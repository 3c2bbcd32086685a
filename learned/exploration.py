"""Exploration noise that decays: an Ornstein-Uhlenbeck process for a batch of environments."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from stable_baselines3.common.noise import VectorizedActionNoise

from learned.exploration_settings import ExplorationSettings

NOISE_REVERSION = 0.15  # share by which the noise returns to zero in a step


class DecayingNoise(VectorizedActionNoise):
    r"""An Ornstein-Uhlenbeck process with a standard deviation that decays.

    .. math:: x_{k+1} = (1 - \theta) x_k + \sigma_k \sqrt{\theta (2 - \theta)} z_k

    has the standard deviation :math:`\sigma` when at rest.
    """

    def __init__(self, settings: ExplorationSettings, shape: tuple[int, int], seed: int) -> None:
        """Start at zero.

        Args:
            settings: Standard deviations.
            shape: Environments and numbers of an action.
            seed: Of the draws.
        """
        self.n_envs = shape[0]
        self.settings = settings
        self.progress = 0.0  # of training, in [0, 1]
        self._value = np.zeros(shape)
        self._rng = np.random.default_rng([seed, 5])

    def __call__(self) -> Any:
        """Return the next values, shape (B, a)."""
        done = min(max(self.progress, 0.0), 1.0)
        sigma = self.settings.start + done * (self.settings.end - self.settings.start)
        drawn = sigma * np.sqrt(NOISE_REVERSION * (2.0 - NOISE_REVERSION))
        self._value = (1.0 - NOISE_REVERSION) * self._value + drawn * self._rng.standard_normal(
            self._value.shape
        )
        return self._value.astype(np.float32)

    def reset(self, indices: Iterable[int] | None = None) -> None:
        """Start anew at zero where an episode has ended."""
        rows = slice(None) if indices is None else list(indices)
        self._value[rows] = 0.0

    def state(self) -> dict[str, Any]:
        """Return everything that changes."""
        return {
            "value": self._value.copy(),
            "progress": self.progress,
            "rng": self._rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self._value = state["value"].copy()
        self.progress = state["progress"]
        self._rng.bit_generator.state = state["rng"]

    def __repr__(self) -> str:
        """Return the settings."""
        return f"DecayingNoise({self.settings})"
