"""The environment as stable-baselines3 wants it: one batch, no processes."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from learned.environment import CableEnvironment
from learned.rewards import lengths_misfit


class CableVecEnv(VecEnv):
    """B environments that advance together; see `learned.environment.CableEnvironment`.

    Where critics see the truth it stands behind the observation of the policy.

    Infos carry ``position`` and ``lengths_misfit`` (see `learned.rewards`) of each step, and, at
    the end of an episode, what stable-baselines3 asks for.
    """

    def __init__(self, environment: CableEnvironment) -> None:
        self.environment = environment
        self._action: Any = None
        self._total = np.zeros(environment.size)
        self._length = np.zeros(environment.size, dtype=np.int64)
        observed, acted = spaces_of(environment)
        if environment.settings.truth:
            shape = (2 * environment.observation_size,)
            observed = spaces.Box(-np.inf, np.inf, shape, np.float32)
        super().__init__(environment.size, observed, acted)

    def reset(self) -> Any:
        """Return the first observations, shape (B, d)."""
        self._total[:] = 0.0
        self._length[:] = 0
        return _with(self.environment.reset(), self.environment.truth)

    def step_async(self, actions: Any) -> None:
        """Keep the actions."""
        self._action = np.asarray(actions, dtype=np.float64)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Act on them."""
        result = self.environment.step(self._action)
        self._total += result.reward
        self._length += 1
        done = result.truncated
        misfit = lengths_misfit(result.transition, self.environment.settings.reward)
        infos: list[dict[str, Any]] = [
            {"position": position, "lengths_misfit": value, "failed": bool(failed)}
            for position, value, failed in zip(
                result.transition.position, misfit, result.failed, strict=True
            )
        ]
        final = _with(result.final_observation, result.final_truth)
        for row in np.flatnonzero(done):
            infos[row] |= {
                "terminal_observation": final[row],
                "TimeLimit.truncated": bool(result.truncated[row]),
                "episode": {"r": float(self._total[row]), "l": int(self._length[row])},
            }
        self._total[done] = 0.0
        self._length[done] = 0
        observation = _with(result.observation, self.environment.truth)
        return observation, result.reward.astype(np.float32), done, infos

    def state(self) -> dict[str, Any]:
        """Return everything that changes."""
        return {
            "environment": self.environment.state(),
            "total": self._total.copy(),
            "length": self._length.copy(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.environment.restore(state["environment"])
        self._total = state["total"].copy()
        self._length = state["length"].copy()

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, once for each environment."""
        return [getattr(self.environment, attr_name, None)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: all environments are one."""
        raise NotImplementedError("environments of a batch have no attributes of their own")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: all environments are one."""
        raise NotImplementedError("environments of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each environment."""
        return [False] * self._count(indices)

    def _count(self, indices: Any) -> int:
        return self.num_envs if indices is None else int(np.size(indices))


def spaces_of(environment: CableEnvironment) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of observations and actions."""
    observed = spaces.Box(-np.inf, np.inf, (environment.observation_size,), np.float32)
    return observed, spaces.Box(-1.0, 1.0, (environment.action_size,), np.float32)


def _with(observation: Any, truth: Any) -> Any:
    """Return what critics see: observations (B, d), and the truth behind them."""
    seen = observation if truth is None else np.hstack([observation, truth])
    return seen.astype(np.float32)
