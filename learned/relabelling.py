"""A replay buffer that asks of each step what it would have been worth for another target.

Where each set-point settles, an action decides alone where the platform gets: its reward is known
for every target. Hindsight puts many targets near the position that was reached, at all scales, so
that the critic sees the neighbourhood of the right action, down to the last millimetre.

References:
    Andrychowicz et al., *Hindsight Experience Replay*, NeurIPS 2017.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from learned.observation import ObservationScales
from learned.rewards import misfit_reward


class RelabellingBuffer(ReplayBuffer):
    """Replay with targets around what was reached, for the reward ``fit`` and a discount of zero.

    Relabelled targets lie at normally distributed offsets from the position reached, whose scale
    is drawn from a millimetre to a metre, evenly in its logarithm.
    """

    def __init__(
        self,
        *args: Any,
        share: float,
        target: slice,
        scales: ObservationScales,
        fit_scale: float,
        span: float,
        **kwargs: Any,
    ) -> None:
        """Allocate.

        Args:
            args: Of stable-baselines3's buffer.
            share: Of samples that are relabelled.
            target: Where the target stands in an observation.
            scales: Of the workspace.
            fit_scale: See `learned.rewards.RewardSettings`.
            span: Largest distance in the workspace [m].
            kwargs: Of stable-baselines3's buffer.
        """
        super().__init__(*args, **kwargs)
        shape = (self.buffer_size, self.n_envs)
        self.positions = np.zeros((*shape, 3), dtype=np.float64)
        self.lengths_misfits = np.zeros(shape, dtype=np.float64)
        self.failed = np.zeros(shape, dtype=bool)
        self._share = share
        self._target = target
        self._scales = scales
        self._reward = (fit_scale, span)

    def add(
        self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any,
        infos: list[dict[str, Any]],
    ) -> None:  # fmt: skip
        """Keep the step, with the position reached."""
        self.positions[self.pos] = [info["position"] for info in infos]
        self.lengths_misfits[self.pos] = [info["lengths_misfit"] for info in infos]
        self.failed[self.pos] = [info["failed"] for info in infos]
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        """Draw steps, and other targets for a share of them."""
        rows = np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002
        drawn = (batch_inds, rows)
        observations = np.array(self.observations[drawn])
        rewards = np.array(self.rewards[drawn])
        chosen = np.random.random(len(rows)) < self._share  # noqa: NPY002
        chosen &= ~self.failed[drawn]
        targets = self._targets(self.positions[drawn][chosen])
        observations[chosen, self._target] = self._scales.to_unit(targets)
        distance = np.linalg.norm(self.positions[drawn][chosen] - targets, axis=1)
        misfit = np.hypot(distance, self.lengths_misfits[drawn][chosen])
        rewards[chosen] = misfit_reward(misfit, *self._reward)
        done = self.dones[drawn] * (1 - self.timeouts[drawn])
        parts = (
            observations, self.actions[drawn], self.next_observations[drawn],
            done[:, None], rewards[:, None],
        )  # fmt: skip
        return ReplayBufferSamples(*(self.to_torch(part) for part in parts))

    def _targets(self, reached: Any) -> Any:
        """Draw other targets, in the workspace box and a little around it."""
        scale = 10.0 ** np.random.uniform(-3.0, 0.0, (len(reached), 1))  # noqa: NPY002
        moved = reached + scale * np.random.standard_normal(reached.shape)  # noqa: NPY002
        reach = 1.1 * self._scales.half
        return np.clip(moved, self._scales.center - reach, self._scales.center + reach)
