"""``CaRoSaC-NoSag-v0`` and ``CaRoSaC-Sag-v0`` of Gymnasium: one robot each.

``gymnasium.make("CaRoSaC-NoSag-v0")`` works once `learned.gym_environment` is imported.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.presets import PRESETS
from learned.vector_environment import spaces_of


class CableGymEnvironment(gymnasium.Env[Any, Any]):
    """One robot; targets, rewards and observations of a preset, the paper's by default."""

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own spelling

    def __init__(
        self,
        robot: str | Robot = "carosac",
        settings: EnvironmentSettings | None = None,
        *,
        stage: str = "no_sag",
        render_mode: None = None,
    ) -> None:
        """Make the environment.

        Args:
            robot: A bundled name, a path, or a robot.
            settings: Of the environment; None takes a stage of the preset ``paper``.
            stage: Which stage: ``no_sag`` or ``sag``.
            render_mode: None: pictures are made by other parts of the toolkit.
        """
        self.robot = load_robot(robot) if isinstance(robot, str) else robot
        self._settings = settings or PRESETS["paper"].stage(stage).environment
        self.render_mode = render_mode
        self._environment = CableEnvironment(self.robot, self._settings)
        self._seeded = False
        self.observation_space, self.action_space = spaces_of(self._environment)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the same seed draws the same targets, none at first draws any."""
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            own = int(self.np_random.integers(2**31)) if seed is None else seed
            self._environment = CableEnvironment(self.robot, self._settings, seed=own)
            self._seeded = True
        return self._environment.reset()[0].astype(np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act once; the info has position, target and distance [m], and each reward term.

        A step without a solution terminates the episode, with a reward of its own.
        """
        result = self._environment.step(np.asarray(action, dtype=np.float64)[None])
        transition, failed = result.transition, bool(result.failed[0])
        terms = self._environment.reward.terms(transition)
        info = {
            "position": transition.position[0],
            "target": transition.target[0],
            "distance": float(transition.distance[0]),
            "failed": failed,
            "inconsistency": float(np.abs(transition.inconsistency[0]).max()),
            "reward_terms": {name: float(value[0]) for name, value in terms.items()},
        }
        return (
            result.final_observation[0].astype(np.float32), float(result.reward[0]),
            failed, bool(result.truncated[0]) and not failed, info,
        )  # fmt: skip


for _name, _stage in (("CaRoSaC-NoSag-v0", "no_sag"), ("CaRoSaC-Sag-v0", "sag")):
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name, entry_point="learned.gym_environment:CableGymEnvironment",
            kwargs={"stage": _stage},
        )  # fmt: skip
